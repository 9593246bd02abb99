"""What a robot's clock decides: what is valid now, and what lies in the future; never an order."""

from collections.abc import Collection, Iterator
from contextlib import suppress
from datetime import datetime

from pqsec_pki._times import said
from pqsec_pki.certificates import BACKDATE
from pqsec_pki.credentials import CERTIFICATE, GOVERNANCE, PERMISSIONS, REVOCATION_LIST, Credentials
from pqsec_pki.enrolment._installed_trust import credentials_in
from pqsec_pki.enrolment.credential_store import InstalledCredentials
from pqsec_pki.errors import PqsecError
from pqsec_pki.problems import Code, Problem


def verification_time(
    new: Collection[Credentials], before: InstalledCredentials | None, now: datetime
) -> datetime:
    """The time for which a bundle is verified: `now`, unless its CAs had not been made then.

    A machine without a battery for its clock starts in 1970. Then nothing is valid, also what is
    installed, so a bundle is verified for the time at which all of it has begun.
    """
    installed: list[Credentials] = []
    if before:
        with suppress(PqsecError):  # it is damaged: only the bundle says when its CAs were made
            installed = credentials_in(before)
    known = (ca for each in (*installed, *new) for cas in each.anchors.roles.values() for ca in cas)
    if any(ca.not_before <= now for ca in known):
        return now
    return max(begin for each in new for begin in _begins(each))


def future_problems(credentials: Credentials, now: datetime) -> Iterator[Problem]:
    """What is of the future: that clock is wrong, or the CA's was when it was signed.

    `credentials` were verified. A signing time less than BACKDATE ahead is not reported, since what
    was signed begins so much earlier.
    """
    yield from begin_problems(credentials, now)
    documents = {GOVERNANCE: credentials.governance, PERMISSIONS: credentials.permissions}
    for file, document in documents.items():
        at = credentials.anchors.signatures(document)[0].signed_at
        if at and at > now + BACKDATE:
            words = f"it was signed {said(at)}, which is in the future: a clock was wrong"
            yield Problem(words, Code.NOT_YET_VALID, file).of(credentials.name)


def begin_problems(credentials: Credentials, now: datetime) -> Iterator[Problem]:
    """The certificate and the revocation list, if they are not valid yet."""
    begins = {CERTIFICATE: credentials.certificate.not_before}
    if credentials.anchors.revocation_list:
        begins[REVOCATION_LIST] = credentials.anchors.revocation_list.this_update
    for file, begin in begins.items():
        if begin > now:
            words = f"it is not valid before {said(begin)}: a clock is wrong"
            yield Problem(words, Code.NOT_YET_VALID, file).of(credentials.name)


def _begins(credentials: Credentials) -> Iterator[datetime]:
    yield credentials.certificate.not_before
    for found in credentials.anchors.roles.values():
        yield from (ca.not_before for ca in found)
    if credentials.anchors.revocation_list:
        yield credentials.anchors.revocation_list.this_update
