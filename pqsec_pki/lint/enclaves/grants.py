"""Rules about grants and domains for an enclave's participant."""

from collections.abc import Iterator

from pqsec_pki.documents import DefaultAction, Grant, parse_subject, same_subject
from pqsec_pki.errors import PqsecError
from pqsec_pki.lint.documents._shadows import domains_meet
from pqsec_pki.lint.rule import SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import EnclaveFolder


@lint_rule(
    "PQS308", Severity.ERROR, "no grant is for this participant",
    why="Stacks search the grants for the subject of the certificate. If there is none, they refuse"
    " to start.",
    fix="Write the subject as `pqsec inspect cert.pem` prints it, and sign the permissions again.",
    rows=("subset `CN=x` only", "superset (+`,L=Madrid`)"), measured=SIX_STACKS,
    bad="$ cp k/enclaves/listener/permissions.* k/enclaves/talker",
    good="$ pqsec -k k issue --force --publish chatter /talker",
)  # fmt: skip
def no_grant(enclave: EnclaveFolder) -> Iterator[Violation]:
    document, certificate = enclave.permissions(), enclave.certificate()
    if document and document.permissions and certificate and not own_grants(enclave):
        yield Violation(f"no grant is for {certificate.subject_name}", path=document.path)


@lint_rule(
    "PQS309", Severity.ERROR, "governance and permissions have no domain in common",
    why="Governance has no rule for the domains of the permissions, and permissions have no rule"
    " for the domains of the governance. The participant cannot join any domain.",
    fix="Name the same domains in both documents.",
    bad="""
        $ sed -i 's,<id>0</id>,<id>5</id>,' k/enclaves/talker/permissions.xml
        $ pqsec -k k sign-permissions --force k/enclaves/talker/permissions.xml
    """,
    good="""
        $ sed -i 's,<id>5</id>,<id>0</id>,' k/enclaves/talker/permissions.xml
        $ pqsec -k k sign-permissions --force k/enclaves/talker/permissions.xml
    """,
)  # fmt: skip
def no_common_domain(enclave: EnclaveFolder) -> Iterator[Violation]:
    governance, permissions = enclave.governance(), enclave.permissions()
    if not (governance and governance.governance and permissions):
        return
    governed = [rule.domains for rule in governance.governance.domain_rules]
    grants = own_grants(enclave)
    if any(grant.default is DefaultAction.ALLOW for grant in grants):
        return  # on every domain
    granted = dict.fromkeys(rule.domains for grant in grants for rule in grant.rules)
    if granted and not any(domains_meet(one, other) for one in governed for other in granted):
        yield Violation("names no domain that the governance names", path=permissions.path)


def own_grants(enclave: EnclaveFolder) -> list[Grant]:
    """The grants for the certificate's subject, in any spelling."""
    document, certificate = enclave.permissions(), enclave.certificate()
    if not (document and document.permissions and certificate):
        return []
    return [
        grant
        for grant in document.permissions.grants
        if _is_for(grant.subject_name, certificate.subject_name)
    ]


def _is_for(named: str, subject: str) -> bool:
    try:
        return named == subject or same_subject(parse_subject(named), parse_subject(subject))
    except PqsecError:
        return False
