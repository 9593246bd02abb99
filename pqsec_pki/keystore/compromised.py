"""Keys that somebody else may have: of certificates revoked as compromised, or another's own.

Each line of the ledger on a certificate has the hashes of its keys, whatever form they came
in: the same point may be written in two ways. Lines of earlier versions have none; then the
certificate is asked, as long as it lies in its folder. Other reasons say nothing of the key,
and no reason is not taken for that one.
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
"""The detail of a line that holds the hashes, with a blank between two."""


def key_hashes(*keys: PublicKey | None) -> str:
    """SHA-256, in hex, of the bits of each key that there is, as KEYS has them."""
    return " ".join(hashlib.sha256(key.raw).hexdigest() for key in keys if key)


def keys_detail(certificate: Certificate) -> dict[str, str]:
    """What a line says of the certificate's keys; nothing of kinds that are not known here."""
    with suppress(PqsecError):
        return {KEYS: key_hashes(certificate.public_key, certificate.alternative_key)}
    return {}


def compromised_keys_in(root: Path, ledger: Ledger) -> dict[str, Entry]:
    """The line of the certificate that was revoked, by the hash of each of its keys."""
    lines = ledger.revoked_for(Reason.KEY_COMPROMISE.value)
    return {each: line for line in lines for each in _hashes(root, line)}


def refuse_compromised(
    compromised: Mapping[str, Entry], name: str, keys: Iterable[PublicKey | None]
) -> None:
    """VerificationError if any of the keys, which `name` shall have, is compromised."""
    for each in key_hashes(*keys).split():
        if line := compromised.get(each):
            raise VerificationError(
                f"{name}: its key was revoked as compromised, with serial {line.serial} of"
                f" {line.name}",
                hint="whoever else has it could pass for it: have a new key made, with"
                " --rekey here or by `pqsec request` on the robot",
            )


def refuse_shared(
    ledger: Ledger, asked: Mapping[str, Iterable[PublicKey | None]], now: datetime
) -> None:
    """VerificationError if a key that a name asks for is in another's certificate that is good.

    As after a robot's disk was copied: whoever takes the one can be the other. Also of its
    earlier certificates: they hold as long as nobody revokes them.
    """
    holders: dict[str, str] = {}
    for name, keys in asked.items():
        for each in key_hashes(*keys).split():
            _refuse_second(name, holders.setdefault(each, name))
    dead = {each.sha256 for each in ledger.of_kind("revocation")}
    for other, sha256, certified in ledger.certified(now.isoformat()):
        asking = next((holders[each] for each in certified.split() if each in holders), other)
        if sha256 not in dead:
            _refuse_second(asking, other)


def _refuse_second(name: str, holder: str) -> None:
    if name != holder:
        raise VerificationError(
            f"{name}: its key is that of {holder}",
            hint="have it make its own, by `pqsec request`; if it is the same robot by another"
            " name, revoke the old one first",
        )


def _hashes(root: Path, line: Entry) -> list[str]:
    told = line.details
    if KEYS not in told:
        path = root / _layout.enclave_folder(line.name) / _layout.CERTIFICATE
        with suppress(PqsecError):
            certificate = load_first_certificate(path)
            told = keys_detail(certificate) if certificate.fingerprint == line.sha256 else {}
    return str(told.get(KEYS, "")).split()
