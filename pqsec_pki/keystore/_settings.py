"""pqsec.json: the profile of a keystore, its default domains, and where its ledger is."""

import json
from pathlib import Path
from typing import Any

from pqsec_pki import __version__
from pqsec_pki._files import exists, read
from pqsec_pki.algorithms import Profile
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import KeystoreError, MalformedError, UsageError, other_format
from pqsec_pki.keystore._address import LedgerAddress

_IN_A_FILE, _IN_A_DATABASE = 1, 2
"""Formats. Only the second has `ledger`: an older pqsec would make changes without it."""
_NOT_SETTINGS = (ValueError, KeyError, TypeError, AttributeError, RecursionError)


def settings_file(
    profile: Profile, domains: DomainSet, ledger: LedgerAddress | None = None
) -> bytes:
    """The content of pqsec.json; UsageError for domains that `read_settings` would refuse."""
    domains = DomainSet.of(*domains.parts)
    settings = {
        "format": _IN_A_DATABASE if ledger else _IN_A_FILE,
        "pqsec": __version__,
        "algorithms": profile.to_names(),
        "domains": str(domains),
        **({"ledger": ledger.url} if ledger else {}),
    }
    return json.dumps(settings, indent=2).encode() + b"\n"


def read_settings(path: Path) -> tuple[Profile, DomainSet]:
    """The settings in `path`; FileError if it cannot be read, KeystoreError if it is invalid."""
    try:
        settings = _read(path)
        return Profile.from_names(settings["algorithms"]), DomainSet.parse(settings["domains"])
    except (*_NOT_SETTINGS, MalformedError, UsageError) as error:
        raise KeystoreError(f"not settings of pqsec ({error})", where=path) from error


def read_ledger(path: Path) -> LedgerAddress | None:
    """The ledger's address in the settings at `path`; None for a file, or without settings.

    Errors as of `read_settings`.
    """
    if not exists(path):
        return None
    try:
        settings = _read(path)
        return LedgerAddress.parse(settings["ledger"]) if "ledger" in settings else None
    except (*_NOT_SETTINGS, UsageError) as error:
        raise KeystoreError(f"not settings of pqsec ({error})", where=path) from error


def _read(path: Path) -> dict[str, Any]:
    settings: dict[str, Any] = json.loads(read(path))
    found, known = settings["format"], (_IN_A_FILE, _IN_A_DATABASE)
    if found not in known:
        raise other_format(KeystoreError, found, known, made_by=settings.get("pqsec"), where=path)
    if (found == _IN_A_DATABASE) != ("ledger" in settings):
        raise ValueError(f"only format {_IN_A_DATABASE} has the address of a ledger")
    return settings
