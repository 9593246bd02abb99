"""Rules about the validity of certificates."""

from collections.abc import Iterator
from datetime import datetime, timedelta

from pqsec_pki._times import said
from pqsec_pki.certificates import LAST_YEAR
from pqsec_pki.lint.rule import SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import CertificateFile
from pqsec_pki.stacks import Stack

SOON = timedelta(days=30)


@lint_rule(
    "PQS110", Severity.ERROR, "a certificate has expired",
    why="No stack starts with it. The exception is Cyclone DDS (master), which does not check"
    " whether the permissions CA has expired.",
    fix="For a participant, run `pqsec renew NAME`. For a CA, run `pqsec ca rotate`.",
    rows=("leaf expired / not yet valid; CA expired", "permissions CA expired"),
    measured=SIX_STACKS,
    bad="""
        $ openssl req -x509 -key key.pem -days 30 -subj /CN=talker -out cert.pem
        # 40 days later
    """,
    good="""
        $ openssl req -x509 -key key.pem -days 365 -subj /CN=talker -out cert.pem
        # 40 days later
    """,
)  # fmt: skip
def expired(file: CertificateFile) -> Iterator[Violation]:
    if file.first and file.now > file.first.not_after:
        end = file.first.not_after
        yield Violation(f"the certificate of the {file.role} expired on {said(end)}")


@lint_rule(
    "PQS111", Severity.WARNING, "a certificate expires soon",
    why="From that day on, a participant that starts or restarts is refused.",
    fix="Before that day, run `pqsec renew NAME` for a participant, or `pqsec ca rotate` for a CA.",
    bad="""
        $ openssl req -x509 -key key.pem -days 60 -subj /CN=talker -out cert.pem
        # 50 days later
    """,
    good="""
        $ openssl req -x509 -key key.pem -days 365 -subj /CN=talker -out cert.pem
        # 50 days later
    """,
)  # fmt: skip
def expires_soon(file: CertificateFile) -> Iterator[Violation]:
    if file.first and is_near(file.now, file.first.not_before, file.first.not_after):
        end = file.first.not_after
        yield Violation(f"the certificate of the {file.role} expires on {said(end)}")


@lint_rule(
    "PQS112", Severity.ERROR, "a certificate is not valid yet",
    why="No stack starts with it before that time.",
    fix="Correct the clock, or issue the certificate again. pqsec sets the start one day back.",
    rows=("leaf expired / not yet valid; CA expired",),
    measured=SIX_STACKS,
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=camera -out cert.pem \
          -addext basicConstraints=critical,CA:FALSE
        # 12 hours earlier
    """,
    good="""
        $ pqsec -k k issue --publish image /camera
        $ cp k/enclaves/camera/cert.pem cert.pem
        # 12 hours earlier
    """,
)  # fmt: skip
def not_yet_valid(file: CertificateFile) -> Iterator[Violation]:
    if file.first and file.now < file.first.not_before:
        start = file.first.not_before
        yield Violation(f"the {file.role}'s certificate is valid from {said(start)}")


@lint_rule(
    "PQS113", Severity.ERROR, "a certificate ends too late for Fast DDS",
    why="Fast DDS (3.6.2) counts nanoseconds in 64 bits, which overflow in 2262. It reports 'Local"
    " identity certificate has expired' and crashes.",
    fix=f"Issue the certificate with an end in {LAST_YEAR} at the latest.",
    stacks={Stack.FASTDDS: "3.6.2"},
    rows=("cert notAfter 9999 (or 2500)",),
    measured="Fast DDS 3.6.2",
    bad="$ openssl req -x509 -key key.pem -days 100000 -subj /CN=talker -out cert.pem",
    good="$ openssl req -x509 -key key.pem -days 365 -subj /CN=talker -out cert.pem",
)  # fmt: skip
def ends_too_late(file: CertificateFile) -> Iterator[Violation]:
    if file.first and file.first.not_after.year > LAST_YEAR:
        year = file.first.not_after.year
        yield Violation(f"the certificate of the {file.role} ends in {year}: Fast DDS crashes")


def is_near(now: datetime, start: datetime, end: datetime) -> bool:
    """Whether `end` is near: within 30 days, or the last fifth of a shorter validity."""
    return timedelta() <= end - now < min(SOON, (end - start) / 5)
