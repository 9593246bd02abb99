"""Rules about the validity of permissions: expired, soon expired, not yet valid, time zones."""

from collections.abc import Iterator
from datetime import timedelta

from pqsec_pki._times import said
from pqsec_pki.documents import Grant
from pqsec_pki.lint.certificates.validity import is_near
from pqsec_pki.lint.document import PermissionsFile
from pqsec_pki.lint.enclaves.grants import own_grants
from pqsec_pki.lint.rule import FAST, SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import EnclaveFolder

WEST = timedelta(hours=12)
"""The furthest that local time is behind UTC."""
TOGETHER = timedelta(days=2)
"""Ends this close count as equal: one day of margin for time zones is common."""
_LOCAL = "Fast DDS 2.9.1, 3.1.2, 3.6.2, in the zone of Los Angeles"


@lint_rule(
    "PQS320", Severity.ERROR, "a grant has expired",
    why="Stacks refuse the participant of this grant.",
    fix="Sign permissions with a later not_after: `pqsec renew NAME`.",
    rows=("expired / future",), measured=SIX_STACKS,
    bad="<not_after>2026-01-31T00:00:00Z</not_after>",
    good="<not_after>2027-06-01T00:00:00Z</not_after>",
)  # fmt: skip
def expired(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        if document.now > grant.not_after:
            yield _found(document, grant, f"expired on {said(grant.not_after)}")


@lint_rule(
    "PQS321", Severity.WARNING, "a grant expires soon",
    why="From that time on the participant is refused, even if its certificate is still valid.",
    fix="Sign permissions with a later not_after: `pqsec renew NAME`.",
    bad="<not_after>2026-06-15T00:00:00Z</not_after>",
    good="<not_after>2027-06-01T00:00:00Z</not_after>",
)  # fmt: skip
def expires_soon(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        if is_near(document.now, grant.not_before, grant.not_after):
            yield _found(document, grant, f"expires on {said(grant.not_after)}")


@lint_rule(
    "PQS322", Severity.ERROR, "a grant is not valid yet",
    why="Stacks refuse the participant of this grant until that time.",
    fix="Correct the clock, or sign permissions with an earlier not_before.",
    rows=("expired / future",), measured=SIX_STACKS,
    bad="<not_before>2026-06-02T00:00:00Z</not_before>",
    good="<not_before>2026-05-01T00:00:00Z</not_before>",
)  # fmt: skip
def not_yet(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        if document.now < grant.not_before:
            yield _found(document, grant, f"is valid from {said(grant.not_before)}")


@lint_rule(
    "PQS323", Severity.WARNING, "a grant is too new for other time zones",
    why="Fast DDS ignores the zone and reads the time as local time. West of Greenwich, a grant"
    " that began an hour ago is not valid yet.",
    fix="Set not_before one day back, as pqsec does.",
    stacks=FAST,
    rows=("TZ=America/Los_Angeles, not_before = now-1h Z",), measured=_LOCAL,
    bad="<not_before>2026-05-31T23:00:00Z</not_before>",
    good="<not_before>2026-05-30T23:00:00Z</not_before>",
)  # fmt: skip
def too_new_for_time_zones(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        if timedelta() <= document.now - grant.not_before < WEST:
            words = f"begins at {grant.not_before:%H:%M} UTC, which Fast DDS reads as local time"
            yield _found(document, grant, words)


@lint_rule(
    "PQS324", Severity.WARNING, "a grant has expired, but not in every time zone",
    why="Fast DDS ignores the zone and reads the time as local time. West of Greenwich, it accepts"
    " a grant for hours after its end.",
    fix="Set not_after one day earlier than needed.",
    stacks=FAST,
    rows=("TZ=America/Los_Angeles, not_after expired 1 h ago Z",), measured=_LOCAL,
    bad="<not_after>2026-05-31T23:00:00Z</not_after>",
    good="<not_after>2026-05-30T23:00:00Z</not_after>",
)  # fmt: skip
def expired_in_some_time_zones(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        if timedelta() < document.now - grant.not_after < WEST:
            words = f"expired at {grant.not_after:%H:%M} UTC, which Fast DDS reads as local time"
            yield _found(document, grant, words)


@lint_rule(
    "PQS325", Severity.WARNING, "the permissions expire before the certificate",
    why="From that time on the participant is refused, although its certificate is still valid.",
    fix="Set the same end for both, as `pqsec issue` does.",
    bad=r"""
        $ sed -i "s/\(<not_after>\)[^<]*/\1$(date -ud '100 days' +%FT%TZ)/" \
          k/enclaves/talker/permissions.xml
        $ pqsec -k k sign-permissions --force k/enclaves/talker/permissions.xml
    """,
    good="$ pqsec -k k issue --force --publish chatter /talker",
)  # fmt: skip
def permissions_end_first(enclave: EnclaveFolder) -> Iterator[Violation]:
    certificate, grants = enclave.certificate(), own_grants(enclave)
    if certificate is None or not grants:
        return
    end = max(grant.not_after for grant in grants)
    if certificate.not_after - end > TOGETHER:
        days = (certificate.not_after - end).days
        yield _of(enclave, f"ends {days} days before the certificate, on {said(end)}")


@lint_rule(
    "PQS326", Severity.INFO, "the permissions end after the certificate",
    why="They are also valid for the next certificate with the same name, even if it should have"
    " other rights.",
    fix="Set the same end for both, as `pqsec issue` does.",
    bad=r"""
        $ sed -i "s/\(<not_after>\)[^<]*/\1$(date -ud '700 days' +%FT%TZ)/" \
          k/enclaves/talker/permissions.xml
        $ pqsec -k k sign-permissions --force k/enclaves/talker/permissions.xml
    """,
    good="$ pqsec -k k issue --force --publish chatter /talker",
)  # fmt: skip
def permissions_end_last(enclave: EnclaveFolder) -> Iterator[Violation]:
    certificate, grants = enclave.certificate(), own_grants(enclave)
    if certificate is None or not grants:
        return
    end = max(grant.not_after for grant in grants)
    if end - certificate.not_after > TOGETHER:
        days = (end - certificate.not_after).days
        yield _of(enclave, f"ends {days} days after the certificate, on {said(end)}")


@lint_rule(
    "PQS327", Severity.ERROR,
    "certificate and permissions are never valid at the same time",
    why="One expires before the other becomes valid.",
    fix="Renew the participant: `pqsec renew NAME`.",
    bad=r"""
        $ sed -i "s/\(<not_before>\)[^<]*/\1$(date -ud '600 days' +%FT%TZ)/;
            s/\(<not_after>\)[^<]*/\1$(date -ud '700 days' +%FT%TZ)/" \
          k/enclaves/talker/permissions.xml
        $ pqsec -k k sign-permissions --force k/enclaves/talker/permissions.xml
    """,
    good="$ pqsec -k k issue --force --publish chatter /talker",
)  # fmt: skip
def never_valid_together(enclave: EnclaveFolder) -> Iterator[Violation]:
    certificate, grants = enclave.certificate(), own_grants(enclave)
    if certificate is None or not grants:
        return
    first, last = certificate.not_before, certificate.not_after
    if all(grant.not_after < first or grant.not_before > last for grant in grants):
        yield _of(enclave, "is never valid at the same time as the certificate")


def _found(document: PermissionsFile, grant: Grant, words: str) -> Violation:
    return Violation(f"the grant for {grant.subject_name} {words}", document.line(grant.line))


def _of(enclave: EnclaveFolder, words: str) -> Violation:
    document = enclave.permissions()
    return Violation(f"the participant's grant {words}", path=document.path if document else None)
