"""Verify a bundle before its files replace any others.

Only the fingerprints of the CAs' certificates, each with its role, are trusted beforehand;
the room `credentials` verifies everything else.
"""

from collections.abc import Iterable, Mapping
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki.credentials import (
    ALT_KEY,
    KEY,
    PROOF,
    Credentials,
    VerifiedCredentials,
    alternative_spki,
    verify_credentials,
    verify_logged,
)
from pqsec_pki.enrolment.bundle import Bundle
from pqsec_pki.enrolment.trust import Pins, pin_problems, pins_in
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.problems import Code
from pqsec_pki.tokens import Pin, is_reference, key_in, stored_pin
from pqsec_pki.transparency import LedgerProof, TreeHead


@dataclass(frozen=True, slots=True)
class VerifiedBundle:
    """A bundle in which everything was verified."""

    credentials: tuple[Credentials, ...]
    verified: tuple[VerifiedCredentials, ...]
    proofs: Mapping[str, LedgerProof]
    """Proofs by participant; a participant may have none."""

    @property
    def heads(self) -> dict[str, TreeHead]:
        """The signed head of the ledger in each proof, by participant."""
        return {name: each.checkpoint.head for name, each in self.proofs.items()}

    @property
    def files(self) -> dict[str, dict[str, bytes]]:
        """The files of each participant without keys, written again from the verified values."""
        files = {each.name: dict(each.files) for each in self.verified}
        for name, proof in self.proofs.items():
            files[name][PROOF] = proof.to_bytes()
        return files


def verify_bundle(
    bundle: Bundle, pins: Pins, *, now: datetime, proof_demanded: bool = False
) -> VerifiedBundle:
    """Verify everything in `bundle` at the time `now`, except its private keys.

    The CAs of each enclave must be exactly those of `pins`, each in its role, so that none can
    be left out. The proof may be missing unless `proof_demanded`. VerificationError lists
    everything that is wrong; MalformedError for a file that cannot be read.
    """
    found = bundle.credentials
    problems = [
        problem.of(each.name)
        for each in found
        for problem in pin_problems(pins_in(each.anchors), pins)
    ]
    if problems:
        raise VerificationError(
            *problems, hint="`pqsec ca show --pins` on the CA machine prints the fingerprints"
        )
    verified, proofs = [], {}
    for each in found:
        try:
            one = verify_credentials(each, now=now)
            proof = verify_logged(
                one.name, one.anchors, one.files, bundle.proof, demanded=proof_demanded
            )
            verified.append(one)
            if proof:
                proofs[each.name] = proof
        except VerificationError as error:
            problems += error.problems
    if problems:
        raise VerificationError(*problems)
    return VerifiedBundle(found, tuple(verified), proofs)


def keys_of(
    credentials: VerifiedCredentials,
    candidates: Iterable[Mapping[str, bytes]],
    pin: Pin = stored_pin,
) -> Mapping[str, bytes]:
    """The first of `candidates` (files by name) with the private keys of the certificate.

    Keys in tokens are asked for. VerificationError if none of them has the keys; PqsecError if
    a token that may have them cannot be used.
    """
    certificate = credentials.certificate
    second = alternative_spki(certificate)
    wanted = {KEY: certificate.spki} | ({ALT_KEY: second} if second else {})
    unusable: PqsecError | None = None
    for files in candidates:
        try:
            if all(_has(files, file, spki, pin) for file, spki in wanted.items()):
                return {file: files[file] for file in wanted}
        except PqsecError as error:
            if any(map(is_reference, files.values())):
                unusable = unusable or error
    if unusable:
        raise unusable
    raise VerificationError(
        f"{credentials.name}: no private key here matches the certificate",
        code=Code.KEY_MISMATCH,
        hint="the bundle is for another robot, or answers another request",
    )


def _has(files: Mapping[str, bytes], file: str, spki: bytes, pin: Pin) -> bool:
    return file in files and key_in(files[file], pin=pin).public_key.spki == spki
