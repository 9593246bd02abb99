"""pqsec.json: the profiles of a keystore, its default domains, and where its ledger is."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pqsec_pki import __version__
from pqsec_pki._files import exists, read
from pqsec_pki.algorithms import Profile
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import KeystoreError, MalformedError, UsageError, other_format
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._address import LedgerAddress

_IN_A_FILE, _IN_A_DATABASE = 3, 4
"""Formats. Only the second has `ledger`: an older pqsec would make changes without it. Before them,
in 1 and 2, a keystore had one profile."""
_NOT_SETTINGS = (ValueError, KeyError, TypeError, AttributeError, RecursionError)


def settings_file(
    profiles: Sequence[Profile], domains: DomainSet, ledger: LedgerAddress | None = None
) -> bytes:
    """The content of pqsec.json; UsageError for what `read_settings` would refuse."""
    domains = DomainSet.of(*domains.parts)
    _refuse_repeated(profiles)
    settings = {
        "format": _IN_A_DATABASE if ledger else _IN_A_FILE,
        "pqsec": __version__,
        "algorithms": [each.to_names() for each in profiles],
        "domains": str(domains),
        **({"ledger": ledger.url} if ledger else {}),
    }
    return json.dumps(settings, indent=2).encode() + b"\n"


def read_settings(path: Path) -> tuple[tuple[Profile, ...], DomainSet]:
    """The profiles, that of the first set first, and the domains in `path`.

    FileError if it cannot be read, KeystoreError if it is invalid.
    """
    try:
        settings = _read(path)
        profiles = tuple(Profile.from_names(each) for each in list(settings["algorithms"]))
        _refuse_repeated(profiles)
        return profiles, DomainSet.parse(settings["domains"])
    except (*_NOT_SETTINGS, MalformedError, UsageError) as error:
        raise KeystoreError(f"not settings of pqsec ({error})", where=path) from error


def set_names(root: Path) -> tuple[str, ...]:
    """The names of the sets of the keystore at `root`, the first one first.

    Before its settings are written, a keystore has only that. Errors as of `read_settings`.
    """
    path = root / layout.SETTINGS
    if not exists(path):
        return (layout.FIRST,)
    profiles, _ = read_settings(path)
    return (layout.FIRST, *(each.name for each in profiles[1:]))


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


def _refuse_repeated(profiles: Sequence[Profile]) -> None:
    """UsageError without a profile, or if two sets would have the same."""
    names = [each.name for each in profiles]
    if not names:
        raise UsageError("a keystore needs a profile")
    if repeated := next((each for each in names if names.count(each) > 1), None):
        raise UsageError(
            f"profile {repeated} is given twice", hint="each set of credentials has its own"
        )


def _read(path: Path) -> dict[str, Any]:
    settings: dict[str, Any] = json.loads(read(path))
    found, known = settings["format"], (_IN_A_FILE, _IN_A_DATABASE)
    if found not in known:
        raise other_format(KeystoreError, found, known, made_by=settings.get("pqsec"), where=path)
    if (found == _IN_A_DATABASE) != ("ledger" in settings):
        raise ValueError(f"only format {_IN_A_DATABASE} has the address of a ledger")
    return settings
