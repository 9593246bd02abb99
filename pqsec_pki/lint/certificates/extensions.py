"""Rules about certificate extensions: what a CA and a participant must be allowed to do.

Each variant was measured in Cyclone DDS 0.10.2, 0.10.5 and 11.0.1 and Fast DDS 2.9.1,
3.1.2 and 3.6.2.
"""

from collections.abc import Iterator

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from pqsec_pki.certificates import Certificate
from pqsec_pki.lint._keys import is_ca
from pqsec_pki.lint.roles import CertificateRole
from pqsec_pki.lint.rule import SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import CertificateFile
from pqsec_pki.stacks import Stack

_OLD = "Cyclone DDS 0.10.2, 0.10.5; Fast DDS 2.9.1"

_ALTERNATIVE = {"2.5.29.72", "2.5.29.73", "2.5.29.74"}
_UNDERSTOOD = {
    *("2.5.29.15", "2.5.29.17", "2.5.29.19", "2.5.29.30", "2.5.29.31"),
    *("2.5.29.32", "2.5.29.33", "2.5.29.36", "2.5.29.37", "2.5.29.54"),
    *("1.3.6.1.5.5.7.1.7", "1.3.6.1.5.5.7.1.8", "1.3.6.1.5.5.7.48.1.5", "2.16.840.1.113730.1.1"),
}
"""Extensions that `openssl verify` 3.0.19 and 3.5 accept as critical; each was tested."""


@lint_rule(
    "PQS120", Severity.ERROR, "the identity CA is not marked as a CA",
    why="Every stack refuses certificates below a version 3 CA without this mark. PQS134 covers"
    " certificates of version 1.",
    fix="Create the CA with basicConstraints=critical,CA:TRUE.",
    rows=("CA without any extension",), measured=SIX_STACKS,
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out identity_ca.cert.pem \
          -addext basicConstraints=critical,CA:FALSE
    """,
    good=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out identity_ca.cert.pem \
          -addext basicConstraints=critical,CA:TRUE
    """,
)  # fmt: skip
def identity_ca_without_mark(file: CertificateFile) -> Iterator[Violation]:
    if file.first and file.role.issues and _lacks_mark(file.first):
        yield Violation(f"the {file.role}'s certificate is not marked as a CA (basicConstraints)")


@lint_rule(
    "PQS121", Severity.WARNING, "the permissions CA is not marked as a CA",
    why="Stacks accept it. pqsec and strict implementations of RFC 5280 refuse it.",
    fix="Create the CA with basicConstraints=critical,CA:TRUE.",
    measured="taken by " + SIX_STACKS,
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out permissions_ca.cert.pem \
          -addext basicConstraints=critical,CA:FALSE
    """,
    good=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out permissions_ca.cert.pem \
          -addext basicConstraints=critical,CA:TRUE
    """,
)  # fmt: skip
def permissions_ca_without_mark(file: CertificateFile) -> Iterator[Violation]:
    if file.first and file.role is CertificateRole.PERMISSIONS_CA and _lacks_mark(file.first):
        yield Violation("the permissions CA's certificate is not marked as a CA (basicConstraints)")


@lint_rule(
    "PQS122", Severity.ERROR, "the identity CA may not sign certificates",
    why="keyUsage is present and does not include keyCertSign: every stack refuses the"
    " participants.",
    fix="Create the CA with keyUsage=critical,keyCertSign,cRLSign,digitalSignature.",
    rows=("CA KU without keyCertSign",), measured=SIX_STACKS,
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out identity_ca.cert.pem \
          -addext keyUsage=critical,cRLSign
    """,
    good=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out identity_ca.cert.pem \
          -addext keyUsage=critical,cRLSign,keyCertSign
    """,
)  # fmt: skip
def identity_ca_without_cert_sign(file: CertificateFile) -> Iterator[Violation]:
    usage = _usage(file)
    if usage and file.role.issues and not usage.key_cert_sign:
        yield Violation(f"the {file.role} may not sign certificates (keyUsage lacks keyCertSign)")


@lint_rule(
    "PQS123", Severity.ERROR, "Fast DDS requires keyCertSign in a permissions CA",
    why="Fast DDS 3.1.2 and later check the CA against itself, strictly. A certificate that is"
    " marked as a CA and has keyUsage must include keyCertSign.",
    fix="Create the CA with keyUsage=critical,keyCertSign,cRLSign,digitalSignature.",
    stacks={Stack.FASTDDS: "3.1.2, 3.6.2"},
    rows=("KU digitalSignature only",), measured="Fast DDS 3.1.2, 3.6.2",
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out permissions_ca.cert.pem \
          -addext basicConstraints=critical,CA:TRUE -addext keyUsage=critical,digitalSignature
    """,
    good=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out permissions_ca.cert.pem \
          -addext basicConstraints=critical,CA:TRUE \
          -addext keyUsage=critical,digitalSignature,keyCertSign
    """,
)  # fmt: skip
def permissions_ca_without_cert_sign(file: CertificateFile) -> Iterator[Violation]:
    usage = _usage(file)
    if file.first is None or file.role is not CertificateRole.PERMISSIONS_CA:
        return
    if usage and is_ca(file.first) and not usage.key_cert_sign:
        yield Violation(
            "the permissions CA's keyUsage lacks keyCertSign, which Fast DDS 3 requires"
        )


@lint_rule(
    "PQS124", Severity.ERROR, "the permissions CA may not sign documents",
    why="Cyclone DDS 0.10 and Fast DDS 2.9 check the S/MIME purpose of the signer. If keyUsage is"
    " present, it must include digitalSignature.",
    fix="Create the CA with keyUsage=critical,keyCertSign,cRLSign,digitalSignature.",
    stacks={Stack.CYCLONEDDS: "0.10.2, 0.10.5", Stack.FASTDDS: "2.9.1"},
    rows=("KU keyCertSign+cRLSign only (no digitalSignature)",), measured=_OLD,
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out permissions_ca.cert.pem \
          -addext keyUsage=critical,keyCertSign
    """,
    good=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out permissions_ca.cert.pem \
          -addext keyUsage=critical,keyCertSign,digitalSignature
    """,
)  # fmt: skip
def may_not_sign_documents(file: CertificateFile) -> Iterator[Violation]:
    usage, role = _usage(file), file.role
    if usage and role.signs_documents and not usage.digital_signature:
        yield Violation(
            f"the {role}'s keyUsage lacks digitalSignature: Cyclone DDS 0.10 and Fast DDS 2.9"
            " refuse documents that it signs"
        )


@lint_rule(
    "PQS125", Severity.ERROR, "the permissions CA is for another purpose",
    why="Cyclone DDS 0.10 and Fast DDS 2.9 check the S/MIME purpose of the signer. If"
    " extendedKeyUsage is present, it must include emailProtection.",
    fix="Create the CA without extendedKeyUsage.",
    stacks={Stack.CYCLONEDDS: "0.10.2, 0.10.5", Stack.FASTDDS: "2.9.1"},
    rows=("EKU serverAuth",), measured=_OLD,
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=CA -out permissions_ca.cert.pem \
          -addext extendedKeyUsage=serverAuth
    """,
    good="$ openssl req -x509 -key key.pem -subj /CN=CA -out permissions_ca.cert.pem",
)  # fmt: skip
def for_another_purpose(file: CertificateFile) -> Iterator[Violation]:
    purposes = file.first.extension(x509.ExtendedKeyUsage) if file.first else None
    fitting = {ExtendedKeyUsageOID.EMAIL_PROTECTION, ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE}
    if purposes and file.role.signs_documents and not fitting & set(purposes):
        yield Violation(f"the {file.role}'s extendedKeyUsage lacks emailProtection")


@lint_rule(
    "PQS126", Severity.ERROR, "a critical extension that no stack supports",
    why="A program must refuse a certificate with a critical extension that it does not support,"
    " and every stack does. OpenSSL also refuses critical key identifiers (2.5.29.14 and .35).",
    fix="Issue the certificate without the extension, or mark the extension as not critical.",
    rows=("leaf: unknown critical extension",), measured=SIX_STACKS,
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem \
          -addext 1.2.3.4=critical,ASN1:NULL
    """,
    good="""
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem -addext 1.2.3.4=ASN1:NULL
    """,
)  # fmt: skip
def unknown_critical(file: CertificateFile) -> Iterator[Violation]:
    for oid in sorted(_critical(file) - _UNDERSTOOD - _ALTERNATIVE):
        yield Violation(f"critical extension {oid} of the {file.role}: no stack supports it")


@lint_rule(
    "PQS127", Severity.ERROR, "alternative keys are marked as critical",
    why="Stacks do not support the extensions 2.5.29.72 to .74. They ignore them if they are not"
    " critical, and only then accept the certificate.",
    fix="Issue the certificate with pqsec, which never marks them as critical; some other tools"
    " do.",
    rows=("alt extensions marked critical",), measured=SIX_STACKS,
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem \
          -addext "2.5.29.72=critical,DER:$(openssl pkey -in key.pem -pubout -outform DER |
            od -An -v -tx1 | tr -d ' \n')"
    """,
    good=r"""
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem \
          -addext "2.5.29.72=DER:$(openssl pkey -in key.pem -pubout -outform DER |
            od -An -v -tx1 | tr -d ' \n')"
    """,
)  # fmt: skip
def critical_alternative(file: CertificateFile) -> Iterator[Violation]:
    if _critical(file) & _ALTERNATIVE:
        yield Violation(f"the alternative key of the {file.role} is in a critical extension")


@lint_rule(
    "PQS128", Severity.WARNING, "a participant is marked as a CA",
    why="Stacks accept it. Its key could issue certificates that other programs trust.",
    fix="Issue the certificate with basicConstraints=critical,CA:FALSE.",
    measured="taken by " + SIX_STACKS,
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem \
          -addext basicConstraints=critical,CA:TRUE
    """,
    good=r"""
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem \
          -addext basicConstraints=critical,CA:FALSE
    """,
)  # fmt: skip
def participant_is_ca(file: CertificateFile) -> Iterator[Violation]:
    if file.first and file.role is CertificateRole.PARTICIPANT and is_ca(file.first):
        yield Violation("the participant's certificate is marked as a CA (basicConstraints)")


@lint_rule(
    "PQS129", Severity.WARNING, "a participant may not sign",
    why="Participants sign the handshake. Stacks do not check keyUsage; pqsec does.",
    fix="Issue the certificate with keyUsage=critical,digitalSignature.",
    measured="taken by " + SIX_STACKS,
    bad=r"""
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem \
          -addext keyUsage=critical,keyAgreement
    """,
    good=r"""
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem \
          -addext keyUsage=critical,digitalSignature
    """,
)  # fmt: skip
def participant_may_not_sign(file: CertificateFile) -> Iterator[Violation]:
    usage = _usage(file)
    if usage and file.role is CertificateRole.PARTICIPANT and not usage.digital_signature:
        yield Violation("the participant's keyUsage lacks digitalSignature")


def _lacks_mark(certificate: Certificate) -> bool:
    """Whether the mark of a CA is missing; certificates of version 1 cannot have it."""
    return certificate.version > 1 and not is_ca(certificate)


def _usage(file: CertificateFile) -> x509.KeyUsage | None:
    return file.first.extension(x509.KeyUsage) if file.first else None


def _critical(file: CertificateFile) -> set[str]:
    extensions = file.first.extensions if file.first else ()
    return {each.oid.dotted_string for each in extensions if each.critical}
