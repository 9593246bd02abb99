"""Rules about single certificates: kinds of keys, signature algorithms, and validity.

Each kind was measured as identity CA, permissions CA and participant in Cyclone DDS
0.10.2, 0.10.5 and 11.0.1 and Fast DDS 2.9.1, 3.1.2 and 3.6.2.
"""

from collections.abc import Iterator
from datetime import datetime, timedelta

from pqsec_pki.algorithms import Family, is_encrypted
from pqsec_pki.certificates.authority import LAST_YEAR
from pqsec_pki.credentials import KEYS
from pqsec_pki.lint import _roles
from pqsec_pki.lint._roles import Role, role_of
from pqsec_pki.lint.file import File
from pqsec_pki.lint.rule import Family as Rules
from pqsec_pki.lint.rule import Severity, Target, Violation
from pqsec_pki.lint.subjects import CertificateFile

FAMILY = Rules("x509")
SOON = timedelta(days=30)
WEAKEST_RSA = 2048
"""Bits: the minimum in DDS-Security 1.1 and NIST SP 800-131A."""

_CYCLONE = {"ecdsa-p256", "rsa-2048"}
_LET_IN = {"brainpoolP256r1", "secp256k1"}
_NOWHERE = {"ed25519", "ed448", "dsa", _roles.UNREADABLE}
_NOT_SHA256 = {
    "1.2.840.10045.4.3.3": "ecdsa-with-SHA384",
    "1.2.840.10045.4.3.4": "ecdsa-with-SHA512",
    "1.2.840.113549.1.1.10": "RSASSA-PSS",
    "1.2.840.113549.1.1.12": "sha384WithRSAEncryption",
    "1.2.840.113549.1.1.13": "sha512WithRSAEncryption",
}
_BROKEN = {
    "1.2.840.113549.1.1.2": "MD2 with RSA",
    "1.2.840.113549.1.1.4": "MD5 with RSA",
    "1.2.840.113549.1.1.5": "SHA-1 with RSA",
    "1.2.840.10045.4.1": "SHA-1 with ECDSA",
    "1.2.840.10040.4.3": "SHA-1 with DSA",
}


@FAMILY.rule(
    "PQS101", Severity.ERROR, CertificateFile,
    "Cyclone DDS does not accept an identity key of this kind",
    why="Cyclone DDS supports only P-256 and RSA-2048 for identity CAs and participants, with any"
    " version of OpenSSL. For other keys it reports 'algorithm unknown (code: 125)'.",
    fix="Use ecdsa-p256, the default of pqsec, for the identity CA and the participants.",
    stacks=(Target.CYCLONEDDS,),
    rows=(
        "identity CA P-384, leaf P-256", "leaf P-384", "all RSA-3072", "all RSA-4096",
        "identity CA RSA-4096, leaf P-256",
    ),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1",
)  # fmt: skip
def not_for_cyclonedds(file: CertificateFile) -> Iterator[Violation]:
    certificate, role = file.first, role_of(file)
    if certificate is None or not role.identifies:
        return
    kind = _roles.key_kind(certificate)
    known = _CYCLONE | _LET_IN | _NOWHERE
    is_classical = _roles.family_of(certificate) is Family.CLASSICAL
    if is_classical and kind not in known and not kind.startswith("algorithm "):
        yield Violation(f"the {role} has a key of kind {kind}, which Cyclone DDS refuses")


@FAMILY.rule(
    "PQS102", Severity.ERROR, CertificateFile, "no stack accepts a key of this kind",
    why="Every stack refused Ed25519 for identity CA, participant and permissions CA. Their code"
    " has no name for it in the handshake, and PKCS7_verify cannot check it.",
    fix="Create the key with ecdsa-p256, or with a post-quantum profile for pqsec peers.",
    rows=(
        "identity CA Ed25519", "leaf Ed25519",
        "permissions CA Ed25519 (CMS by OpenSSL 3.5)",
    ),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1; Fast DDS 2.9.1, 3.1.2, 3.6.2",
)  # fmt: skip
def for_no_stack(file: CertificateFile) -> Iterator[Violation]:
    if file.first is None:
        return
    kind = _roles.key_kind(file.first)
    if kind in _NOWHERE or kind.startswith("algorithm "):
        yield Violation(f"the {role_of(file)} has a key of kind {kind}, which no stack accepts")


@FAMILY.rule(
    "PQS103", Severity.WARNING, CertificateFile, "a curve that stacks accept by mistake",
    why="Stacks announce this key as P-256, because it also has 256 bits. No version of"
    " DDS-Security lists this curve, and a later version of a stack may refuse it.",
    fix="Create the key with ecdsa-p256.",
    rows=("leaf brainpoolP256r1 / secp256k1 (wrongly let in)",),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1; Fast DDS 2.9.1, 3.1.2, 3.6.2",
)  # fmt: skip
def let_in_by_mistake(file: CertificateFile) -> Iterator[Violation]:
    if file.first and (kind := _roles.key_kind(file.first)) in _LET_IN:
        yield Violation(f"the {role_of(file)} has a key on {kind}, which stacks mistake for P-256")


@FAMILY.rule(
    "PQS104", Severity.ERROR, CertificateFile, "Fast DDS does not support this signature algorithm",
    why="Fast DDS reads the algorithm from the certificate's signature and supports only SHA-256"
    " with ECDSA or RSA (PKCS #1 v1.5). Its error message is empty.",
    fix="Sign certificates with SHA-256: use -sha256, and no -sigopt rsa_padding_mode:pss.",
    stacks=(Target.FASTDDS,),
    rows=("certs signed ecdsa-with-SHA384 or SHA512", "certs signed RSASSA-PSS"),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2",
)  # fmt: skip
def signed_otherwise(file: CertificateFile) -> Iterator[Violation]:
    role = role_of(file)
    name = _NOT_SHA256.get(file.first.signature_algorithm) if file.first else None
    if name and role is not Role.COUNTERSIGNER:
        yield Violation(f"the certificate of the {role} is signed with {name}, unknown to Fast DDS")


@FAMILY.rule(
    "PQS105", Severity.ERROR, CertificateFile, "signed with a broken hash",
    why="An attacker can create two certificates with the same SHA-1 or MD5 digest. Your CA signs"
    " one, and its signature is valid for the other one too.",
    fix="Issue the certificate again with SHA-256.",
)  # fmt: skip
def broken_hash(file: CertificateFile) -> Iterator[Violation]:
    name = _BROKEN.get(file.first.signature_algorithm) if file.first else None
    if name:
        yield Violation(f"the certificate of the {role_of(file)} is signed with {name}")


@FAMILY.rule(
    "PQS106", Severity.ERROR, CertificateFile, "a weak key",
    why="RSA keys below 2048 bits and curves below 256 bits have been broken or can be broken.",
    fix="Create the key with ecdsa-p256, or with rsa-2048 at least.",
)  # fmt: skip
def weak_key(file: CertificateFile) -> Iterator[Violation]:
    kind = _roles.key_kind(file.first) if file.first else ""
    bits = kind.removeprefix("rsa-")
    if kind == "ecdsa-p224" or (bits.isdigit() and int(bits) < WEAKEST_RSA):
        yield Violation(f"the key of the {role_of(file)} is weak: {kind}")


@FAMILY.rule(
    "PQS107", Severity.ERROR, CertificateFile, "a certificate with an empty subject",
    why="Permissions cannot name this participant. Cyclone DDS refuses the certificate, and Fast"
    " DDS crashes (std::length_error).",
    fix="Issue the certificate with a common name, such as CN=/fleet/robot1.",
    rows=("cert with empty subject",),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1; Fast DDS 2.9.1, 3.1.2, 3.6.2",
)  # fmt: skip
def empty_subject(file: CertificateFile) -> Iterator[Violation]:
    if file.first and not file.first.subject_name:
        yield Violation(f"the certificate of the {role_of(file)} has an empty subject")


@FAMILY.rule(
    "PQS110", Severity.ERROR, CertificateFile, "a certificate has expired",
    why="No stack starts with it. The exception is Cyclone DDS (master), which does not check"
    " whether the permissions CA has expired.",
    fix="For a participant, run `pqsec renew NAME`. For a CA, run `pqsec ca rotate`.",
    rows=("leaf expired / not yet valid; CA expired", "permissions CA expired"),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1; Fast DDS 2.9.1, 3.1.2, 3.6.2",
)  # fmt: skip
def expired(file: CertificateFile) -> Iterator[Violation]:
    if file.first and file.now > file.first.not_after:
        end = file.first.not_after
        yield Violation(
            f"the certificate of the {role_of(file)} expired on {end:%Y-%m-%d %H:%M} UTC"
        )


@FAMILY.rule(
    "PQS111", Severity.WARNING, CertificateFile, "a certificate expires soon",
    why="From that day on, a participant that starts or restarts is refused.",
    fix="Before that day, run `pqsec renew NAME` for a participant, or `pqsec ca rotate` for a CA.",
)  # fmt: skip
def expires_soon(file: CertificateFile) -> Iterator[Violation]:
    if file.first and ends_soon(file.now, file.first.not_before, file.first.not_after):
        end = file.first.not_after
        yield Violation(
            f"the certificate of the {role_of(file)} expires on {end:%Y-%m-%d %H:%M} UTC"
        )


@FAMILY.rule(
    "PQS112", Severity.ERROR, CertificateFile, "a certificate is not valid yet",
    why="No stack starts with it before that time.",
    fix="Correct the clock, or issue the certificate again. pqsec sets the start one day back.",
    rows=("leaf expired / not yet valid; CA expired",),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1; Fast DDS 2.9.1, 3.1.2, 3.6.2",
)  # fmt: skip
def not_yet_valid(file: CertificateFile) -> Iterator[Violation]:
    if file.first and file.now < file.first.not_before:
        start = file.first.not_before
        yield Violation(
            f"the {role_of(file)}'s certificate is valid from {start:%Y-%m-%d %H:%M} UTC"
        )


@FAMILY.rule(
    "PQS113", Severity.ERROR, CertificateFile, "a certificate ends too late for Fast DDS",
    why="Fast DDS (3.6.2) counts nanoseconds in 64 bits, which overflow in 2262. It reports 'Local"
    " identity certificate has expired' and crashes.",
    fix=f"Issue the certificate with an end in {LAST_YEAR} at the latest.",
    stacks=(Target.FASTDDS,),
    rows=("cert notAfter 9999 (or 2500)",),
    measured="Fast DDS 3.6.2",
)  # fmt: skip
def ends_too_late(file: CertificateFile) -> Iterator[Violation]:
    if file.first and file.first.not_after.year > LAST_YEAR:
        year = file.first.not_after.year
        yield Violation(f"the certificate of the {role_of(file)} ends in {year}: Fast DDS crashes")


@FAMILY.rule(
    "PQS150", Severity.ERROR, File, "ROS 2 cannot open an encrypted private key",
    why="ROS 2 has no setting to pass the passphrase to the middleware.",
    fix="Leave the key unencrypted, with mode 0600, on an encrypted disk.",
    stacks=(Target.ROS2,), only_when_asked=True,
    rows=("wrong / missing password",),
    measured="source of rmw_dds_common (security.cpp)",
)  # fmt: skip
def encrypted_for_ros(file: File) -> Iterator[Violation]:
    if file.is_private_key and file.path.name in KEYS and is_encrypted(file.data):
        yield Violation("the participant's private key is encrypted, and ROS 2 cannot open it")


def ends_soon(now: datetime, start: datetime, end: datetime) -> bool:
    """Whether `end` is near: within 30 days, or the last fifth of a shorter validity."""
    return timedelta() <= end - now < min(SOON, (end - start) / 5)
