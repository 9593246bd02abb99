"""Requests and orders that the domain file names, of participants with their keys on robots."""

import os
from collections.abc import Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

from pqsec_pki._files import MAX_FILE, disk_errors, read, write
from pqsec_pki.algorithms import Profile
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.domain.desired import Member
from pqsec_pki.enrolment import MAX_ARCHIVE, SignRequest, name_asked_for, validate_csrs
from pqsec_pki.errors import (
    FileError,
    KeystoreError,
    PqsecError,
    UsageError,
    VerificationError,
    located,
    shown,
)
from pqsec_pki.keystore import key_hashes
from pqsec_pki.lifecycle import ParticipantSpec, PublicKeys


def is_there(member: Member) -> bool:
    """Whether the file for the member's request has arrived."""
    return member.request is not None and os.path.lexists(member.request)


def admitted(member: Member, profiles: Sequence[Profile]) -> PublicKeys | None:
    """The keys of the member's request; None if the domain file names no request.

    FileError or MalformedError if it cannot be read. VerificationError if none in the file has
    its name, or several; and for keys of other algorithms, or no proof of possession.
    """
    if member.request is None:
        return None
    with located(member.request):
        found = _requests(member)
        if member.name not in found:
            raise VerificationError(f"no request in it is for {member.name}: {_said(found)}")
        return validate_csrs(found[member.name], profiles, names=[member.name])[member.name]


def asks_for_other_keys(member: Member, certified: Collection[str]) -> bool:
    """Whether its request has arrived, and is for other keys than those of its certificates.

    The request is not verified: that takes long for thousands.
    """
    if not is_there(member):
        return False
    with suppress(PqsecError):
        own = _requests(member).get(member.name, ())
        asked = [key_hashes(a.public_key, a.alternative_key) for each in own for a in each.sets]
        return any(each not in certified for each in asked)
    return True


def deliver_request(member: Member, request: CertificateRequest) -> None:
    """Put the request where the domain file says, in place of an earlier one of that name.

    UsageError if the file names none; FileError or MalformedError for what is there now.
    """
    path = member.request
    if path is None or member.by_order:
        raise UsageError(f"{member.source} has no `request` for {member.name}")
    with located(path):
        there = _requests(member) if is_there(member) else {}
    kept = [each for name, found in there.items() if name != member.name for each in found]
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write(path, b"".join(each.pem for each in [*kept, request]), force=True)


def spec_of(member: Member, profiles: Sequence[Profile], planned: str) -> ParticipantSpec:
    """The input of `issue`, with the keys of its request if it has one.

    Errors as of `admitted` and `Member.spec`. VerificationError also if the keys' hashes are
    not those `planned`; KeystoreError if the request can no longer be read.
    """
    try:
        keys = admitted(member, profiles)
    except FileError as error:
        raise KeystoreError(str(error), hint="it was there when the plan was made") from error
    if hashes_in(keys) != planned:
        raise VerificationError(
            f"{member.request}: it is for another key than when the plan was made",
            hint="apply again, and check who else can write there",
        )
    return replace(member.spec(), keys=keys)


def order_in(path: Path) -> SignRequest:
    """The order in the file; FileError, MalformedError or VerificationError if it is damaged."""
    return SignRequest.from_bytes(_content(path, MAX_ARCHIVE))


def hashes_in(keys: PublicKeys | None) -> str:
    """The keys' hashes as in the ledger; empty for None."""
    sets = keys.sets if keys else ()
    return " ".join(key_hashes(each.key, each.alternative) for each in sets)


def _requests(member: Member) -> dict[str, list[CertificateRequest]]:
    if member.request is None:
        raise FileError("there is no file")
    limit = MAX_ARCHIVE if member.by_order else MAX_FILE
    return _by_name(_content(member.request, limit), ordered=member.by_order)


def _content(path: Path, limit: int) -> bytes:
    """What is in the file; only a regular one, because others may put a pipe there."""
    if not os.path.isfile(path):  # noqa: PTH113 -- never raises
        raise FileError("there is no file")
    return read(path, limit=limit)


@lru_cache(maxsize=4)
def _by_name(data: bytes, *, ordered: bool) -> dict[str, list[CertificateRequest]]:
    """All requests in a file by the names they ask for, cached: many participants may have it.

    One that asks for no participant's name is under its subject, which begins with no slash.
    """
    found: dict[str, list[CertificateRequest]] = {}
    asked = SignRequest.from_bytes(data).requests if ordered else None
    for each in asked or CertificateRequest.all_from_pem(data):
        name = name_asked_for(each) or each.subject_name or "an empty subject"
        found.setdefault(name, []).append(each)
    return found


def _said(names: Iterable[str]) -> str:
    first, *others = names
    rest = f" and {len(others)} more" if others else ""
    return f"there is one for {shown(first)}{rest}"
