"""Rules about subjects of certificates that stacks cannot match."""

from collections.abc import Iterator

from pqsec_pki.lint.permissions._names import parsed, repeated
from pqsec_pki.lint.rule import CYCLONE, Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import CertificateFile
from pqsec_pki.stacks import Stack

ERROR = Severity.ERROR


@lint_rule(
    "PQS431", ERROR, "an attribute type twice in a certificate's subject",
    why="If a subject has two OUs, Cyclone DDS reads only the first, and Fast DDS 3 finds no"
    " grant.",
    fix="Issue the certificate with one of them. CN alone works with every stack.",
    stacks={**CYCLONE, Stack.FASTDDS: "3.1.2, 3.6.2", Stack.ROS2: ""},
    rows=("two OUs",),
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=talker/OU=Lab/OU=Robots -out cert.pem \
          -CA k/public/identity_ca.cert.pem -CAkey k/private/identity_ca.key.pem
    """,
    good=r"""
        $ openssl req -x509 -key key.pem -subj /CN=talker/OU=Lab -out cert.pem \
          -CA k/public/identity_ca.cert.pem -CAkey k/private/identity_ca.key.pem
    """,
)  # fmt: skip
def certificate_repeats(file: CertificateFile) -> Iterator[Violation]:
    for certificate in file.issued:
        if twice := repeated(parsed(certificate.subject_name)):
            yield Violation(f"the subject {certificate.subject_name} has {twice} twice")


@lint_rule(
    "PQS432", ERROR, "a multi-valued part in a certificate's subject",
    why="No stack finds a grant for a subject such as CN=x+OU=y.",
    fix="Issue the certificate with separate parts, or with CN alone.",
    rows=("multi-valued RDN",), measured="all six stacks",
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=talker+OU=Lab -out cert.pem \
          -CA k/public/identity_ca.cert.pem -CAkey k/private/identity_ca.key.pem
    """,
    good=r"""
        $ openssl req -x509 -key key.pem -subj /CN=talker/OU=Lab -out cert.pem \
          -CA k/public/identity_ca.cert.pem -CAkey k/private/identity_ca.key.pem
    """,
)  # fmt: skip
def certificate_joins(file: CertificateFile) -> Iterator[Violation]:
    for certificate in file.issued:
        if any(len(list(rdn)) > 1 for rdn in certificate.subject.rdns):
            yield Violation(f"the subject {certificate.subject_name} has parts joined by +")
