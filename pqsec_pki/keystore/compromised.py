"""Finds keys of certificates that were revoked as compromised.

A certificate's ledger entry has the hashes of its keys, independent of their encoding: one
point can be encoded in two ways. Entries of earlier versions have no hashes; then the
certificate is read, if it is still in its folder. Only the reason keyCompromise counts.
"""

import hashlib
from contextlib import suppress
from pathlib import Path

from pqsec_pki.algorithms import PublicKey
from pqsec_pki.certificates import Certificate, Reason
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore.participant import load_first_certificate

KEYS = "keys"
"""The detail with the hashes, separated by blanks."""
PARTS = "key_parts"
"""Likewise of the keys that composite ones consist of; without them, there is no such detail."""


def key_hashes(*keys: PublicKey | None) -> str:
    """SHA-256, in hex, of the raw bytes of each key, separated by blanks."""
    return " ".join(hashlib.sha256(key.raw).hexdigest() for key in keys if key)


def part_hashes(*keys: PublicKey | None) -> str:
    """Likewise of the keys that composite ones consist of: whoever has such a key has half."""
    return key_hashes(*(part for key in keys if key for part in key.parts))


def all_hashes(*keys: PublicKey | None) -> list[str]:
    """The hashes of each key, and of those that it consists of."""
    return [*key_hashes(*keys).split(), *part_hashes(*keys).split()]


def keys_detail(certificate: Certificate) -> dict[str, str]:
    """The details with the certificate's key hashes; empty for an unknown algorithm."""
    with suppress(PqsecError):
        keys = certificate.public_key, certificate.alternative_key
        parts = part_hashes(*keys)
        return {KEYS: key_hashes(*keys), **({PARTS: parts} if parts else {})}
    return {}


def compromised_keys_in(root: Path, ledger: Ledger) -> dict[str, Entry]:
    """The entry of each certificate revoked as compromised, by the hash of each of its keys."""
    lines = ledger.revoked_for(Reason.KEY_COMPROMISE.value)
    return {each: line for line in lines for each in _hashes(root, line)}


def _hashes(root: Path, line: Entry) -> list[str]:
    details = line.details
    if KEYS not in details:
        path = root / layout.enclave_folder(line.name) / layout.CERTIFICATE
        with suppress(PqsecError):
            certificate = load_first_certificate(path)
            details = keys_detail(certificate) if certificate.fingerprint == line.sha256 else {}
    return f"{details.get(KEYS, '')} {details.get(PARTS, '')}".split()
