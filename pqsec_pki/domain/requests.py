"""Requests that the domain file names, of participants whose keys are on their robots."""

import os
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki.algorithms import Profile
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.domain.desired import Member
from pqsec_pki.enrolment import validate_csrs
from pqsec_pki.errors import FileError, KeystoreError, PqsecError, VerificationError, located
from pqsec_pki.keystore import key_hashes
from pqsec_pki.lifecycle import ParticipantSpec, PublicKeys

MAX_FILE = 1 << 20
"""Bytes; a request with the largest keys has 20 kB."""


def is_there(member: Member) -> bool:
    """Whether the member's request has arrived."""
    return member.request is not None and os.path.lexists(member.request)


def admitted(member: Member, profile: Profile) -> PublicKeys | None:
    """The keys of the member's request; None if the domain file names no request.

    FileError or MalformedError if it cannot be read. VerificationError if it has another name,
    keys of other algorithms, or no proof of possession.
    """
    if member.request is None:
        return None
    with located(member.request):
        return validate_csrs([_read(member.request)], profile, names=[member.name])[member.name]


def asks_for_other_keys(member: Member, certified: str) -> bool:
    """Whether its request has arrived, and is for other keys than the certified ones.

    The request is not verified: that takes long for thousands.
    """
    if member.request is None or not is_there(member):
        return False
    with suppress(PqsecError):
        request = _read(member.request)
        return key_hashes(request.public_key, request.alternative_key) != certified
    return True


def spec_of(member: Member, profile: Profile, planned: str) -> ParticipantSpec:
    """The input of `issue`, with the keys of its request if it has one.

    Errors as of `admitted` and `Member.spec`. VerificationError also if the keys' hashes are
    not those `planned`; KeystoreError if the request cannot be read any more.
    """
    try:
        keys = admitted(member, profile)
    except FileError as error:
        raise KeystoreError(str(error), hint="it was there when the plan was made") from error
    if hashes_in(keys) != planned:
        raise VerificationError(
            f"{member.request}: it is for another key than when the plan was made",
            hint="apply again, and check who else can write there",
        )
    return replace(member.spec(), keys=keys)


def hashes_in(keys: PublicKeys | None) -> str:
    """The keys' hashes as in the ledger; empty for None."""
    return key_hashes(keys.key, keys.alternative) if keys else ""


def _read(path: Path) -> CertificateRequest:
    """Read a request; only a regular file, because others may put a pipe there."""
    if not os.path.isfile(path):  # noqa: PTH113 -- never raises
        raise FileError("there is no file")
    return CertificateRequest.from_pem(read(path, limit=MAX_FILE))
