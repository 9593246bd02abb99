"""pqsec.json: the profile of a keystore, and its default domains."""

import json
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki.algorithms import Profile
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import KeystoreError, MalformedError, UsageError

FORMAT = 1
_NOT_SETTINGS = (ValueError, KeyError, TypeError, AttributeError, RecursionError)


def settings_file(profile: Profile, domains: DomainSet) -> bytes:
    """The content of pqsec.json; UsageError for domains that `read_settings` would refuse."""
    domains = DomainSet.of(*domains.parts)
    settings = {"format": FORMAT, "algorithms": profile.to_names(), "domains": str(domains)}
    return json.dumps(settings, indent=2).encode() + b"\n"


def read_settings(path: Path) -> tuple[Profile, DomainSet]:
    """The settings in `path`; FileError if it cannot be read, KeystoreError if it is invalid."""
    try:
        settings = json.loads(read(path))
        if settings["format"] != FORMAT:
            raise KeystoreError("made by another version of pqsec", where=path)
        return Profile.from_names(settings["algorithms"]), DomainSet.parse(settings["domains"])
    except (*_NOT_SETTINGS, MalformedError, UsageError) as error:
        raise KeystoreError(f"not settings of pqsec ({error})", where=path) from error
