"""The options of a rollover, and which participants it reissues."""

from dataclasses import dataclass
from datetime import datetime, timedelta
from enum import StrEnum

from pqsec_pki._files import disk_errors, exists
from pqsec_pki._processes import shared_out
from pqsec_pki.algorithms import Profile
from pqsec_pki.certificates import BACKDATE, Certificate
from pqsec_pki.documents import Permissions
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Keystore, key_hashes, layout
from pqsec_pki.lifecycle._inspector import Inspector
from pqsec_pki.lifecycle.renewing import keys_fit
from pqsec_pki.smime import document_in

CA_VALIDITY = timedelta(days=3650)


class Scope(StrEnum):
    """Which CAs are replaced."""

    BOTH = "both"
    IDENTITY = "identity"
    PERMISSIONS = "permissions"


@dataclass(frozen=True, slots=True, kw_only=True)
class Rollover:
    """The options of a rollover."""

    profile: Profile
    scope: Scope = Scope.BOTH
    name: str | None = None
    """The start of the new CAs' names; None for the old name and the generation: Lab G2."""
    validity: timedelta = CA_VALIDITY
    """Of the new CAs; participants keep the validity that they were issued for."""
    rekey: bool = False
    """Whether participants get new keys even if their algorithms fit the profile."""
    destroy: bool = False
    """Whether the old CAs' keys are overwritten with zeros instead of archived."""


def check_scope(keystore: Keystore, terms: Rollover) -> None:
    """UsageError for a rollover of one CA that changes the profile, which applies to both."""
    if terms.scope is not Scope.BOTH and terms.profile.to_names() != keystore.profile.to_names():
        raise UsageError(
            "a new profile applies to both CAs",
            hint="leave out --profile; or leave out --only and --overlap",
        )


def generation(keystore: Keystore) -> int:
    """The generation of the keystore's CAs, counted from 1."""
    folder = keystore.root / layout.GENERATIONS
    with disk_errors(folder):
        found = list(folder.iterdir()) if exists(folder) else []
    return 1 + max((int(path.name) for path in found if path.name.isdecimal()), default=0)


def not_reissued(
    keystore: Keystore, terms: Rollover, inspector: Inspector, now: datetime
) -> dict[str, str]:
    """The participants that cannot be reissued, and why.

    KeystoreError for a participant whose files are not the ledger's newest. The CAs' signatures
    are not verified: that takes long for thousands.
    """
    names = keystore.names()
    issued_by_previous_ca = set(inspector.issued_by_previous_ca_of(names))
    revoked = dict.fromkeys(inspector.revoked_of(names), "revoked")
    others = [name for name in names if name not in revoked]

    def reason(name: str) -> str:
        folder = keystore.root / layout.enclave_folder(name)
        certificate = inspector.certificate(name, folder)
        has_key = (folder / layout.KEY).exists()
        if name in issued_by_previous_ca:
            return "it was not reissued before: its CA has been replaced"
        if not (has_key or keys_fit(certificate, terms.profile)):
            return "its key is not here and does not fit the profile: it needs a new request"
        if not has_key and _is_compromised(inspector, certificate):
            return "its key is not here and is compromised: it needs a new request"
        ended = _ended(inspector.signed_permissions(name, folder), certificate, now)
        return f"its permissions ended on {ended:%Y-%m-%d}" if ended else ""

    reasons = zip(others, shared_out(reason, others), strict=True)
    return revoked | {name: words for name, words in reasons if words}


def _ended(signed: bytes, certificate: Certificate, now: datetime) -> datetime | None:
    """The past end of its own grant, if a policy set it before the certificate's end."""
    own = certificate.subject_name
    ends = [
        grant.not_after
        for grant in Permissions.from_xml(document_in(signed)).grants
        if grant.subject_name == own and grant.not_after < certificate.not_after
    ]
    return min((end for end in ends if end <= now - BACKDATE), default=None)


def gets_keys(keystore: Keystore, terms: Rollover, inspector: Inspector, name: str) -> bool:
    """Whether that participant, which is reissued, gets new keys."""
    folder = keystore.root / layout.enclave_folder(name)
    if not (folder / layout.KEY).exists():  # its key was made elsewhere, and fits
        return False
    certificate = inspector.certificate(name, folder)
    fits = keys_fit(certificate, terms.profile)
    return terms.rekey or not fits or _is_compromised(inspector, certificate)


def _is_compromised(inspector: Inspector, certificate: Certificate) -> bool:
    """Whether a certificate with the same key was revoked as compromised."""
    hashes = key_hashes(certificate.public_key, certificate.alternative_key).split()
    return any(each in inspector.compromised for each in hashes)
