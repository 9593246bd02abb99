"""What this lab demands of certificates, beyond what pqsec knows."""

from collections.abc import Iterator
from datetime import timedelta

from pqsec_pki.lint import CertificateFile, Severity, Violation, lint_rule

LONGEST = timedelta(days=180)


@lint_rule(
    "LAB001",
    Severity.WARNING,
    "a participant's certificate that is valid for more than 180 days",
    why="Robots of this lab are lent; what is not renewed ends with the term.",
    fix="Issue it with --validity 180d.",
    bad="$ pqsec issue /talker --publish rt/chatter --validity 1y",
    good="$ pqsec issue /talker --publish rt/chatter --validity 180d --force",
)
def lives_too_long(subject: CertificateFile) -> Iterator[Violation]:
    if subject.path.name != "cert.pem":  # a CA's
        return
    for each in subject.certificates:
        life = each.not_after - each.not_before
        if life > LONGEST + timedelta(days=2):
            yield Violation(f"{each.subject_name} is valid for {life.days} days")
