"""Verify a bundle before its files replace any others.

Only the fingerprints of the CAs' certificates, each with its role, are trusted beforehand;
the room `credentials` verifies everything else.
"""

from collections.abc import Iterable, Iterator, Mapping
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
from pqsec_pki.enrolment.one_meaning import differences
from pqsec_pki.enrolment.pins import Pins, of_sets, pin_problems, pins_in, set_problems, sets_in
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.keystore import layout
from pqsec_pki.problems import Code, Problem
from pqsec_pki.tokens import Pin, is_reference, key_in, stored_pin
from pqsec_pki.transparency import LedgerProof, TreeHead


@dataclass(frozen=True, slots=True)
class VerifiedBundle:
    """A bundle in which everything was verified."""

    credentials: tuple[Credentials, ...]
    sets: Mapping[str, tuple[VerifiedCredentials, ...]]
    """The participants in each set of credentials, the first one first."""
    proofs: Mapping[tuple[str, str], LedgerProof]
    """Proofs by set and participant; there may be none."""

    @property
    def verified(self) -> tuple[VerifiedCredentials, ...]:
        """Those of all sets."""
        return tuple(each for found in self.sets.values() for each in found)

    @property
    def heads(self) -> dict[str, TreeHead]:
        """The signed head of the ledger in each proof, by participant; all sets have one."""
        return {name: each.checkpoint.head for (_, name), each in self.proofs.items()}

    @property
    def files(self) -> dict[str, dict[str, dict[str, bytes]]]:
        """The files of each participant without keys, by set and name, written again from the
        verified values."""
        return {
            place: {each.name: self._files(place, each) for each in found}
            for place, found in self.sets.items()
        }

    def _files(self, place: str, verified: VerifiedCredentials) -> dict[str, bytes]:
        proof = self.proofs.get((place, verified.name))
        return {**verified.files, **({PROOF: proof.to_bytes()} if proof else {})}


def verify_bundle(
    bundle: Bundle, pins: Pins, *, now: datetime, proof_demanded: bool = False
) -> VerifiedBundle:
    """Verify everything in `bundle` at the time `now`, except its private keys.

    The sets of credentials, and the CAs of each enclave in each set, must be exactly those of
    `pins`, each in its role, so that none can be left out. The proof may be missing unless
    `proof_demanded`. VerificationError lists everything that is wrong, also what differs between
    the sets; MalformedError for a file that cannot be read.
    """
    if problems := [*_pin_problems(bundle, pins)]:
        raise VerificationError(
            *problems, hint="`pqsec ca show --pins` on the CA machine prints the fingerprints"
        )
    verified: dict[str, list[VerifiedCredentials]] = {each: [] for each in bundle.sets}
    proofs = {}
    for place, each in _each(bundle):
        try:
            one = verify_credentials(each, now=now)
            proof = verify_logged(
                one.name, one.anchors, one.files, bundle.proof, demanded=proof_demanded
            )
            verified[place].append(one)
            if proof:
                proofs[place, each.name] = proof
        except VerificationError as error:
            problems += [_of_set(place, problem) for problem in error.problems]
    if problems := problems or [*differences(verified)]:
        raise VerificationError(*problems)
    sets = {place: tuple(each) for place, each in verified.items()}
    return VerifiedBundle(bundle.credentials, sets, proofs)


def _each(bundle: Bundle) -> Iterator[tuple[str, Credentials]]:
    """The credentials in a bundle, each with its set."""
    for place, found in bundle.credentials_by_set.items():
        for each in found:
            yield place, each


def _pin_problems(bundle: Bundle, pins: Pins) -> Iterator[Problem]:
    known = (layout.FIRST, *sets_in(pins))
    yield from set_problems(bundle.further, known[1:])
    for place, each in _each(bundle):
        own = of_sets(pins_in(each.anchors, set_name=place), known)
        for problem in pin_problems(own, of_sets(pins, [place])):
            yield problem.of(each.name)


def _of_set(place: str, problem: Problem) -> Problem:
    return problem.of(f"set {place}") if place else problem


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
