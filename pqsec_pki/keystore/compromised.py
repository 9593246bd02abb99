"""Finds keys of certificates that were revoked as compromised, and keys of other participants.

A certificate's ledger entry has the hashes of its keys, independent of their encoding: one
point can be encoded in two ways. Entries of earlier versions have no hashes; then the
certificate is read, if it is still in its folder. Only the reason keyCompromise counts.
"""

import hashlib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path

from pqsec_pki.algorithms import PublicKey
from pqsec_pki.certificates import Certificate, Reason
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.keystore import _layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore.participant import load_first_certificate

KEYS = "keys"
"""The detail with the hashes, separated by blanks."""


def key_hashes(*keys: PublicKey | None) -> str:
    """SHA-256, in hex, of the raw bytes of each key, separated by blanks."""
    return " ".join(hashlib.sha256(key.raw).hexdigest() for key in keys if key)


def keys_detail(certificate: Certificate) -> dict[str, str]:
    """The detail with the certificate's key hashes; empty for an unknown algorithm."""
    with suppress(PqsecError):
        return {KEYS: key_hashes(certificate.public_key, certificate.alternative_key)}
    return {}


def compromised_keys_in(root: Path, ledger: Ledger) -> dict[str, Entry]:
    """The entry of each certificate revoked as compromised, by the hash of each of its keys."""
    lines = ledger.revoked_for(Reason.KEY_COMPROMISE.value)
    return {each: line for line in lines for each in _hashes(root, line)}


def refuse_compromised(
    compromised: Mapping[str, Entry], name: str, keys: Iterable[PublicKey | None]
) -> None:
    """VerificationError if any of the keys for `name` is compromised."""
    for each in key_hashes(*keys).split():
        if line := compromised.get(each):
            raise VerificationError(
                f"{name}: its key was revoked as compromised, with serial {line.serial} of"
                f" {line.name}",
                hint="others may have this key and could impersonate it: make a new key, with"
                " --rekey here or `pqsec request` on the robot",
            )


def refuse_shared(
    ledger: Ledger, asked: Mapping[str, Iterable[PublicKey | None]], now: datetime
) -> None:
    """VerificationError if a key in `asked` is in a valid certificate of another participant.

    This happens after a robot's disk was copied: then each robot can impersonate the other.
    Earlier certificates count too: they are valid until they are revoked or expire.
    """
    holders: dict[str, str] = {}
    for name, keys in asked.items():
        for each in key_hashes(*keys).split():
            _refuse_second(name, holders.setdefault(each, name))
    revoked = {each.sha256 for each in ledger.of_kind("revocation")}
    for other, sha256, certified in ledger.certified(now.isoformat()):
        asking = next((holders[each] for each in certified.split() if each in holders), other)
        if sha256 not in revoked:
            _refuse_second(asking, other)


def _refuse_second(name: str, holder: str) -> None:
    if name != holder:
        raise VerificationError(
            f"{name}: its key is that of {holder}",
            hint="make a key of its own with `pqsec request`; if it is the same robot under"
            " another name, revoke the old name first",
        )


def _hashes(root: Path, line: Entry) -> list[str]:
    details = line.details
    if KEYS not in details:
        path = root / _layout.enclave_folder(line.name) / _layout.CERTIFICATE
        with suppress(PqsecError):
            certificate = load_first_certificate(path)
            details = keys_detail(certificate) if certificate.fingerprint == line.sha256 else {}
    return str(details.get(KEYS, "")).split()
