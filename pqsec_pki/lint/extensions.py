"""Rules about what a certificate says it may do, and about files of certificates.

Measured with each variant in Cyclone DDS 0.10.2, 0.10.5 and 11.0.1 and Fast DDS 2.9.1,
3.1.2 and 3.6.2.
"""

from collections.abc import Iterator

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID

from pqsec_pki.certificates import Certificate
from pqsec_pki.lint._roles import Role, extension, is_signed_by, role_of
from pqsec_pki.lint.rule import Family, Severity, Target, Violation
from pqsec_pki.lint.subjects import CertificateFile

FAMILY = Family("x509")
_ALL = "Cyclone DDS 0.10.2, 0.10.5, 11.0.1; Fast DDS 2.9.1, 3.1.2, 3.6.2"
_OLD = "Cyclone DDS 0.10.2, 0.10.5; Fast DDS 2.9.1"

_ALTERNATIVE = {"2.5.29.72", "2.5.29.73", "2.5.29.74"}
_UNDERSTOOD = {
    *("2.5.29.15", "2.5.29.17", "2.5.29.19", "2.5.29.30", "2.5.29.31"),
    *("2.5.29.32", "2.5.29.33", "2.5.29.36", "2.5.29.37", "2.5.29.54"),
    *("1.3.6.1.5.5.7.1.7", "1.3.6.1.5.5.7.48.1.5", "2.16.840.1.113730.1.1"),
}
"""Those that `openssl verify` 3.0.19 and 3.5 take as critical; each was tried."""


@FAMILY.rule(
    "PQS120", Severity.ERROR, CertificateFile, "the identity CA is not marked as a CA",
    why="Every stack refuses to build a chain on it, if it is of version 3; PQS134 is about"
    " version 1.",
    fix="Make it with basicConstraints=critical,CA:TRUE.",
    rows=("CA without any extension",), measured=_ALL,
)  # fmt: skip
def identity_ca_is_no_ca(file: CertificateFile) -> Iterator[Violation]:
    if file.first and role_of(file).issues and _lacks_mark(file.first):
        yield Violation(
            f"the {role_of(file)}'s certificate is not marked as a CA (basicConstraints)"
        )


@FAMILY.rule(
    "PQS121", Severity.WARNING, CertificateFile, "the permissions CA is not marked as a CA",
    why="Stacks take it so; pqsec and strict readers of RFC 5280 do not.",
    fix="Make it with basicConstraints=critical,CA:TRUE.",
    measured="taken by " + _ALL,
)  # fmt: skip
def permissions_ca_is_no_ca(file: CertificateFile) -> Iterator[Violation]:
    if file.first and role_of(file) is Role.PERMISSIONS_CA and _lacks_mark(file.first):
        yield Violation("the permissions CA's certificate is not marked as a CA (basicConstraints)")


@FAMILY.rule(
    "PQS122", Severity.ERROR, CertificateFile, "the identity CA may not sign certificates",
    why="keyUsage is there and lacks keyCertSign: every stack refuses the participants.",
    fix="Make the CA with keyUsage=critical,keyCertSign,cRLSign,digitalSignature.",
    rows=("CA KU without keyCertSign",), measured=_ALL,
)  # fmt: skip
def identity_ca_may_not_issue(file: CertificateFile) -> Iterator[Violation]:
    usage = _usage(file)
    if usage and role_of(file).issues and not usage.key_cert_sign:
        yield Violation(
            f"the {role_of(file)} may not sign certificates (keyUsage lacks keyCertSign)"
        )


@FAMILY.rule(
    "PQS123", Severity.ERROR, CertificateFile, "Fast DDS wants keyCertSign of a permissions CA",
    why="Fast DDS 3.1.2 and later check the CA against itself, strictly: what is marked as a"
    " CA and has keyUsage must have keyCertSign.",
    fix="Make the CA with keyUsage=critical,keyCertSign,cRLSign,digitalSignature.",
    stacks=(Target.FASTDDS,),
    rows=("KU digitalSignature only",), measured="Fast DDS 3.1.2, 3.6.2",
)  # fmt: skip
def permissions_ca_may_not_issue(file: CertificateFile) -> Iterator[Violation]:
    usage = _usage(file)
    if file.first is None or role_of(file) is not Role.PERMISSIONS_CA:
        return
    if usage and _is_ca(file.first) and not usage.key_cert_sign:
        yield Violation(
            "the permissions CA's keyUsage lacks keyCertSign, which Fast DDS 3 asks for"
        )


@FAMILY.rule(
    "PQS124", Severity.ERROR, CertificateFile, "the permissions CA may not sign documents",
    why="Cyclone DDS 0.10 and Fast DDS 2.9 check the S/MIME purpose of the signer, and that"
    " needs digitalSignature where keyUsage is there.",
    fix="Make the CA with keyUsage=critical,keyCertSign,cRLSign,digitalSignature.",
    stacks=(Target.CYCLONEDDS, Target.FASTDDS),
    rows=("KU keyCertSign+cRLSign only (no digitalSignature)",), measured=_OLD,
)  # fmt: skip
def may_not_sign_documents(file: CertificateFile) -> Iterator[Violation]:
    usage, role = _usage(file), role_of(file)
    if usage and role.signs_documents and not usage.digital_signature:
        yield Violation(
            f"the {role}'s keyUsage lacks digitalSignature: Cyclone DDS 0.10 and Fast DDS 2.9"
            " refuse what it signs"
        )


@FAMILY.rule(
    "PQS125", Severity.ERROR, CertificateFile, "the permissions CA is for another purpose",
    why="Cyclone DDS 0.10 and Fast DDS 2.9 check the S/MIME purpose of the signer: an"
    " extendedKeyUsage without emailProtection excludes it.",
    fix="Make the CA without extendedKeyUsage.",
    stacks=(Target.CYCLONEDDS, Target.FASTDDS),
    rows=("EKU serverAuth",), measured=_OLD,
)  # fmt: skip
def for_another_purpose(file: CertificateFile) -> Iterator[Violation]:
    purposes = extension(file.first, x509.ExtendedKeyUsage) if file.first else None
    fitting = {ExtendedKeyUsageOID.EMAIL_PROTECTION, ExtendedKeyUsageOID.ANY_EXTENDED_KEY_USAGE}
    if purposes and role_of(file).signs_documents and not fitting & set(purposes):
        yield Violation(f"the {role_of(file)}'s extendedKeyUsage lacks emailProtection")


@FAMILY.rule(
    "PQS126", Severity.ERROR, CertificateFile, "a critical extension that no stack knows",
    why="Critical means: refuse me if you do not understand this. Every stack does."
    " OpenSSL refuses critical key identifiers (2.5.29.14 and .35) too.",
    fix="Issue it without the extension, or with it as not critical.",
    rows=("leaf: unknown critical extension",), measured=_ALL,
)  # fmt: skip
def unknown_critical(file: CertificateFile) -> Iterator[Violation]:
    for oid in sorted(_critical(file) - _UNDERSTOOD - _ALTERNATIVE):
        yield Violation(f"critical extension {oid} of the {role_of(file)}: no stack knows it")


@FAMILY.rule(
    "PQS127", Severity.ERROR, CertificateFile, "alternative keys are marked as critical",
    why="Stacks do not know the extensions 2.5.29.72 to .74. As not critical they are passed"
    " over, which is what makes such a certificate work in them.",
    fix="Issue it with pqsec, which never marks them; some other tools do.",
    rows=("alt extensions marked critical",), measured=_ALL,
)  # fmt: skip
def critical_alternative(file: CertificateFile) -> Iterator[Violation]:
    if _critical(file) & _ALTERNATIVE:
        yield Violation(f"the alternative key of the {role_of(file)} is in a critical extension")


@FAMILY.rule(
    "PQS128", Severity.WARNING, CertificateFile, "a participant is marked as a CA",
    why="Stacks take it, and its key could issue certificates that other programs believe.",
    fix="Issue it with basicConstraints=critical,CA:FALSE.",
    measured="taken by " + _ALL,
)  # fmt: skip
def participant_is_ca(file: CertificateFile) -> Iterator[Violation]:
    if file.first and role_of(file) is Role.PARTICIPANT and _is_ca(file.first):
        yield Violation("the participant's certificate is marked as a CA (basicConstraints)")


@FAMILY.rule(
    "PQS129", Severity.WARNING, CertificateFile, "a participant may not sign",
    why="Participants sign the handshake. Stacks do not look at keyUsage; pqsec does.",
    fix="Issue it with keyUsage=critical,digitalSignature.",
    measured="taken by " + _ALL,
)  # fmt: skip
def participant_may_not_sign(file: CertificateFile) -> Iterator[Violation]:
    usage = _usage(file)
    if usage and role_of(file) is Role.PARTICIPANT and not usage.digital_signature:
        yield Violation("the participant's keyUsage lacks digitalSignature")


@FAMILY.rule(
    "PQS130", Severity.ERROR, CertificateFile, "a certificate cannot be read",
    why="What cannot be read cannot be used, and what was meant to be there is missing.",
    fix="Issue it again.",
)  # fmt: skip
def unreadable(file: CertificateFile) -> Iterator[Violation]:
    for reason in file.reasons:
        yield Violation(f"a certificate in it cannot be read: {reason}")


@FAMILY.rule(
    "PQS131", Severity.WARNING, CertificateFile, "several certificates where one is looked at",
    why="Cyclone DDS and OpenDDS read the first one and no intermediate CAs; Fast DDS reads"
    " all of a CA file, and 3.x checks the first of them strictly.",
    fix="Leave one in the file: the self-signed CA, or the participant's own. For two CAs,"
    " issue all participants under one. An overlap of two ends with `pqsec ca rotate --overlap"
    " finish`.",
    rows=(
        "identity_ca=root, cert.pem=leaf+intermediate", "identity_ca=root+int, cert=leaf",
        "two CAs in file, right one second", "…, CA file = root+intermediate",
    ),
    measured=_ALL,
)  # fmt: skip
def several(file: CertificateFile) -> Iterator[Violation]:
    if len(file.certificates) > 1:
        number = len(file.certificates)
        yield Violation(
            f"{number} certificates: most stacks read the first one and pass over the rest"
        )


@FAMILY.rule(
    "PQS132", Severity.ERROR, CertificateFile, "the CA is an intermediate one",
    why="Stacks want a CA that signed itself, and do not look for who signed another.",
    fix="Use a self-signed CA of its own for DDS.",
    rows=(
        "identity_ca=int only", "identity_ca=int+root, cert=leaf (no AKI)",
        "signer intermediate, CA file = intermediate", "…, CA file = intermediate+root",
    ),
    measured=_ALL,
)  # fmt: skip
def intermediate(file: CertificateFile) -> Iterator[Violation]:
    role = role_of(file)
    if file.first is None or role is Role.PARTICIPANT:
        return
    if not file.first.is_self_issued:
        yield Violation(f"the {role} was issued by another CA: stacks want it self-signed")
    elif not is_signed_by(file.first, file.first):
        yield Violation(
            f"the {role}'s signature is not its own: altered, or another CA of its name"
        )


@FAMILY.rule(
    "PQS133", Severity.INFO, CertificateFile, "a certificate without key identifiers",
    why="RFC 5280 4.2.1.1 and 4.2.1.2 demand them. Where a CA is renewed under its old name,"
    " they alone say which of its keys signed; OpenSSL's strict check (-x509_strict) refuses"
    " certificates without.",
    fix="Issue it with subjectKeyIdentifier, and authorityKeyIdentifier below a CA.",
    measured="taken by " + _ALL,
)  # fmt: skip
def without_key_identifiers(file: CertificateFile) -> Iterator[Violation]:
    if file.first is None:
        return
    if not file.first.is_self_issued:
        if extension(file.first, x509.AuthorityKeyIdentifier) is None:
            yield Violation(f"the {role_of(file)}'s certificate lacks authorityKeyIdentifier")
    elif _is_ca(file.first) and file.first.subject_key_identifier is None:
        yield Violation(f"the {role_of(file)}'s certificate lacks subjectKeyIdentifier")


@FAMILY.rule(
    "PQS134", Severity.WARNING, CertificateFile, "the CA's certificate is of version 1",
    why="It cannot say that it is a CA's. OpenSSL and Cyclone DDS 0.10.2 take one that is"
    " self-signed, and so does pqsec: who names it as the CA trusts a name and a key (RFC 5280"
    " 6.1.1 (d)). OpenSSL's strict check (-x509_strict) refuses it; other stacks were not"
    " measured.",
    fix="Make it with basicConstraints=critical,CA:TRUE, which makes version 3 of it.",
    measured="taken by OpenSSL 3.0, 3.5; Cyclone DDS 0.10.2",
)  # fmt: skip
def version_1_ca(file: CertificateFile) -> Iterator[Violation]:
    if file.first and role_of(file) is not Role.PARTICIPANT and file.first.version == 1:
        yield Violation(
            f"the {role_of(file)}'s certificate is of version 1: it cannot say what it is"
        )


def _lacks_mark(certificate: Certificate) -> bool:
    """Whether it could say that it is a CA's, and does not; version 1 cannot."""
    return certificate.version > 1 and not _is_ca(certificate)


def _is_ca(certificate: Certificate) -> bool:
    constraints = extension(certificate, x509.BasicConstraints)
    return constraints is not None and constraints.ca


def _usage(file: CertificateFile) -> x509.KeyUsage | None:
    return extension(file.first, x509.KeyUsage) if file.first else None


def _critical(file: CertificateFile) -> set[str]:
    extensions = file.first.extensions if file.first else ()
    return {each.oid.dotted_string for each in extensions if each.critical}
