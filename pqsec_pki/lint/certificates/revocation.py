"""Rules about the file of a revocation list.

Each variant was measured in Cyclone DDS 0.10.2, 0.10.5 and 11.0.1 and Fast DDS 2.9.1,
3.1.2 and 3.6.2. A stack with an invalid list refuses every participant.
"""

from collections.abc import Iterator

from pqsec_pki._times import said
from pqsec_pki.lint.certificates.validity import is_near
from pqsec_pki.lint.file import KeyOrListFile
from pqsec_pki.lint.rule import SIX_STACKS, Severity, Violation, lint_rule

_BAD_LIST = "CRL expired / wrong CA / bad signature"
NEW_LIST = "Issue a new revocation list (`pqsec ca crl`), and copy it to all participants."


@lint_rule(
    "PQS140", Severity.ERROR, "a revocation list cannot be read",
    why="A stack that is configured with this list refuses to start.",
    fix=NEW_LIST,
    bad="""
        $ pqsec -k k ca crl
        $ head -n 3 k/public/identity_ca.crl.pem > crl.pem
    """,
    good="$ cp k/public/identity_ca.crl.pem crl.pem",
)  # fmt: skip
def unreadable(file: KeyOrListFile) -> Iterator[Violation]:
    if reason := file.revocation_list[1]:
        yield Violation(f"the revocation list in it cannot be read: {reason}")


@lint_rule(
    "PQS141", Severity.ERROR, "a revocation list has expired",
    why="After nextUpdate, stacks refuse every participant, revoked or not.",
    fix=NEW_LIST, rows=(_BAD_LIST,), measured=SIX_STACKS,
    bad="""
        $ pqsec -k k ca crl --validity 30d --out crl.pem
        # 40 days later
    """,
    good="""
        $ pqsec -k k ca crl --validity 60d --out crl.pem --force
        # 40 days later
    """,
)  # fmt: skip
def expired(file: KeyOrListFile) -> Iterator[Violation]:
    revoked = file.revocation_list[0]
    if revoked and revoked.next_update and file.now > revoked.next_update:
        yield Violation(f"the revocation list expired on {said(revoked.next_update)}")


@lint_rule(
    "PQS148", Severity.WARNING, "a revocation list expires soon",
    why="After nextUpdate, stacks refuse every participant, revoked or not.",
    fix=NEW_LIST,
    bad="""
        $ pqsec -k k ca crl --validity 60d --out crl.pem
        # 50 days later
    """,
    good="""
        $ pqsec -k k ca crl --out crl.pem --force
        # 50 days later
    """,
)  # fmt: skip
def ends_soon(file: KeyOrListFile) -> Iterator[Violation]:
    revoked = file.revocation_list[0]
    end = revoked.next_update if revoked else None
    if revoked and end and is_near(file.now, revoked.this_update, end):
        yield Violation(f"the revocation list expires on {said(end)}")


@lint_rule(
    "PQS142", Severity.ERROR, "a revocation list is not in force yet",
    why="Before thisUpdate, stacks refuse every participant.",
    fix="Correct the clock, or issue a new revocation list.",
    measured="`openssl verify -crl_check` 3.0.19 and 3.5: 'CRL is not yet valid'",
    bad="""
        $ pqsec -k k ca crl --out crl.pem
        # 2 days earlier
    """,
    good="""
        $ pqsec -k k ca crl --show
        # 20 hours earlier
    """,
)  # fmt: skip
def not_yet(file: KeyOrListFile) -> Iterator[Violation]:
    revoked = file.revocation_list[0]
    if revoked and file.now < revoked.this_update:
        yield Violation(f"the revocation list is valid from {said(revoked.this_update)}")


@lint_rule(
    "PQS143", Severity.WARNING, "a revocation list has no nextUpdate",
    why="RFC 5280 5.1.2.5 requires it. Without it, an old list is accepted forever. An attacker who"
    " holds back the new list keeps a revoked participant in the domain.",
    fix="Issue revocation lists with a nextUpdate.",
    bad="""
        $ cp elsewhere/no-next-update.crl.pem crl.pem
        $ openssl crl -in crl.pem -noout -nextupdate
    """,
    good="$ pqsec -k k ca crl --out crl.pem --force",
)  # fmt: skip
def without_next_update(file: KeyOrListFile) -> Iterator[Violation]:
    revoked = file.revocation_list[0]
    if revoked and revoked.next_update is None:
        yield Violation("the revocation list has no nextUpdate")


@lint_rule(
    "PQS144", Severity.WARNING, "a revocation list in a file of certificates",
    why="Fast DDS 3 enforces a list in the identity CA's file; Cyclone DDS and OpenDDS ignore it."
    " No stack reads a list in the permissions CA's file.",
    fix="Put the list into crl.pem and configure the stack with that file.",
    rows=(
        "CRL appended to identity_ca.pem, b revoked",
        "CRL in permissions CA file revoking it (ignored)",
    ),
    measured=SIX_STACKS,
    bad="""
        $ pqsec -k k ca crl
        $ cat k/public/identity_ca.cert.pem k/public/identity_ca.crl.pem > identity_ca.cert.pem
    """,
    good="$ cp k/public/identity_ca.cert.pem identity_ca.cert.pem",
)  # fmt: skip
def misplaced(file: KeyOrListFile) -> Iterator[Violation]:
    if file.is_revocation_list and "CERTIFICATE" in file.labels:
        yield Violation(
            "a revocation list among certificates: Fast DDS 3 enforces it, others do not"
        )
