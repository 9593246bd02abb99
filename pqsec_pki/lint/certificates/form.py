"""Rules about the form of certificates, and about files with several of them."""

from collections.abc import Iterator

from cryptography import x509

from pqsec_pki.lint._keys import is_ca, is_signed_by
from pqsec_pki.lint.roles import CertificateRole
from pqsec_pki.lint.rule import SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import CertificateFile


@lint_rule(
    "PQS130", Severity.ERROR, "a certificate cannot be read",
    why="No stack can use it, and the certificate that should be here is missing.",
    fix="Issue the certificate again.",
    bad="$ head -n 3 k/enclaves/talker/cert.pem > cert.pem",
    good="$ cp k/enclaves/talker/cert.pem cert.pem",
)  # fmt: skip
def unreadable(file: CertificateFile) -> Iterator[Violation]:
    for reason in file.reasons:
        yield Violation(f"a certificate in it cannot be read: {reason}")


@lint_rule(
    "PQS131", Severity.WARNING, "several certificates in a file for one",
    why="Cyclone DDS and OpenDDS read only the first certificate and no intermediate CAs. Fast DDS"
    " reads all certificates of a CA file, and 3.x checks the first one strictly.",
    fix="Leave one certificate in the file: the self-signed CA, or the participant's own. If there"
    " are two CAs, issue all participants with one of them. `pqsec ca rotate --overlap finish` ends"
    " an overlap of two CAs.",
    rows=(
        "identity_ca=root, cert.pem=leaf+intermediate", "identity_ca=root+int, cert=leaf",
        "two CAs in file, right one second", "…, CA file = root+intermediate",
    ),
    measured=SIX_STACKS,
    bad="""
        $ cat k/public/identity_ca.cert.pem k/public/permissions_ca.cert.pem > identity_ca.cert.pem
    """,
    good="$ cp k/public/identity_ca.cert.pem identity_ca.cert.pem",
)  # fmt: skip
def several(file: CertificateFile) -> Iterator[Violation]:
    if len(file.certificates) > 1:
        number = len(file.certificates)
        yield Violation(
            f"{number} certificates: most stacks read the first one and ignore the others"
        )


@lint_rule(
    "PQS132", Severity.ERROR, "the CA is an intermediate CA",
    why="Stacks require a self-signed CA and do not search for the issuer of an intermediate CA.",
    fix="Use a separate, self-signed CA for DDS.",
    rows=(
        "identity_ca=int only", "identity_ca=int+root, cert=leaf (no AKI)",
        "signer intermediate, CA file = intermediate", "…, CA file = intermediate+root",
    ),
    measured=SIX_STACKS,
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=Intermediate -out identity_ca.cert.pem \
          -CA k/public/identity_ca.cert.pem -CAkey k/private/identity_ca.key.pem
    """,
    good="$ openssl req -x509 -key key.pem -subj /CN=CA -out identity_ca.cert.pem",
)  # fmt: skip
def intermediate(file: CertificateFile) -> Iterator[Violation]:
    role = file.role
    if file.first is None or role is CertificateRole.PARTICIPANT:
        return
    if not file.first.is_self_issued:
        yield Violation(f"the {role} was issued by another CA: stacks require a self-signed one")
    elif not is_signed_by(file.first, file.first):
        yield Violation(
            f"the {role} did not sign itself: it was changed, or another CA has its name"
        )


@lint_rule(
    "PQS133", Severity.INFO, "a certificate without key identifiers",
    why="RFC 5280 4.2.1.1 and 4.2.1.2 require them. If a CA is renewed under the same name, only"
    " they show which of its keys signed. OpenSSL's strict check (-x509_strict) refuses"
    " certificates without them.",
    fix="Issue the certificate with subjectKeyIdentifier, and with authorityKeyIdentifier if a CA"
    " issues it.",
    measured="taken by " + SIX_STACKS,
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out identity_ca.cert.pem \
          -addext basicConstraints=critical,CA:TRUE -addext subjectKeyIdentifier=none
    """,
    good=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out identity_ca.cert.pem \
          -addext basicConstraints=critical,CA:TRUE
    """,
)  # fmt: skip
def without_key_identifiers(file: CertificateFile) -> Iterator[Violation]:
    if file.first is None:
        return
    if not file.first.is_self_issued:
        if file.first.extension(x509.AuthorityKeyIdentifier) is None:
            yield Violation(f"the {file.role}'s certificate lacks authorityKeyIdentifier")
    elif is_ca(file.first) and file.first.subject_key_identifier is None:
        yield Violation(f"the {file.role}'s certificate lacks subjectKeyIdentifier")


@lint_rule(
    "PQS134", Severity.WARNING, "the CA's certificate is of version 1",
    why="A version 1 certificate cannot say that it belongs to a CA. OpenSSL, Cyclone DDS 0.10.2"
    " and pqsec accept a self-signed one: a configured CA is only a name and a key (RFC 5280 6.1.1"
    " (d)). OpenSSL's strict check (-x509_strict) refuses it; other stacks were not measured.",
    fix="Create the CA with basicConstraints=critical,CA:TRUE, which makes it version 3.",
    measured="taken by OpenSSL 3.0, 3.5; Cyclone DDS 0.10.2",
    bad="""
        $ cp elsewhere/version-1.pem identity_ca.cert.pem
        $ openssl x509 -in identity_ca.cert.pem -noout -text | grep 'Version: 1'
    """,
    good=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out identity_ca.cert.pem \
          -addext basicConstraints=critical,CA:TRUE
    """,
)  # fmt: skip
def version_1_ca(file: CertificateFile) -> Iterator[Violation]:
    if file.first and file.role is not CertificateRole.PARTICIPANT and file.first.version == 1:
        yield Violation(
            f"the {file.role}'s certificate is of version 1: it cannot say that it is a CA"
        )
