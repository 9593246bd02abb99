"""What a rollover shall be, and whom it takes along: known before anything is done."""

from dataclasses import dataclass
from datetime import timedelta
from enum import StrEnum

from pqsec_pki.algorithms import Profile
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import _journal, _layout
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.renewing import Inspector, keys_fit

CA_VALIDITY = timedelta(days=3650)


class Scope(StrEnum):
    """Which CAs make way."""

    BOTH = "both"
    IDENTITY = "identity"
    PERMISSIONS = "permissions"


@dataclass(frozen=True, slots=True, kw_only=True)
class Rollover:
    """What shall follow."""

    profile: Profile
    scope: Scope = Scope.BOTH
    name: str | None = None
    """The start of the new CAs' names; None for the old one's with the generation: Lab G2."""
    validity: timedelta = CA_VALIDITY
    """Of the new CAs; participants last as long as they were issued for."""
    rekey: bool = False
    """Whether participants get new keys also where the profile asks for no other kind."""
    destroy: bool = False
    """Whether the old CAs' keys are overwritten with zeros, and not kept."""


def check_scope(keystore: Keystore, terms: Rollover) -> None:
    """UsageError for a rollover of one CA that changes what both are made with."""
    if terms.scope is not Scope.BOTH and terms.profile.to_names() != keystore.profile.to_names():
        raise UsageError(
            "another profile is for both CAs",
            hint="leave --only out, or --profile",
        )


def generation(keystore: Keystore) -> int:
    """Which generation of CAs the keystore has now, counted from 1."""
    with _journal.disk_errors(keystore.root):
        found = (keystore.root / _layout.GENERATIONS).glob("[0-9]*")
        return 1 + max((int(path.name) for path in found if path.name.isdigit()), default=0)


def stay_behind(keystore: Keystore, terms: Rollover, inspector: Inspector) -> dict[str, str]:
    """The participants that cannot come along, and why."""
    names = keystore.names()
    behind = dict.fromkeys(inspector.revoked_of(names), "revoked")
    for name in names:
        folder = keystore.root / _layout.enclave_folder(name)
        if name in behind or (folder / _layout.KEY).exists():
            continue
        if not keys_fit(inspector.certificate(name, folder), terms.profile):
            behind[name] = "its key is not here, and of another kind: it needs a new request"
    return behind


def gets_keys(keystore: Keystore, terms: Rollover, inspector: Inspector, name: str) -> bool:
    """Whether that participant, which comes along, gets new keys."""
    folder = keystore.root / _layout.enclave_folder(name)
    if not (folder / _layout.KEY).exists():  # it was made elsewhere, and fits
        return False
    return terms.rekey or not keys_fit(inspector.certificate(name, folder), terms.profile)
