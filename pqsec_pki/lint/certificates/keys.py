"""Rules about the key, the signature algorithm and the subject of a certificate.

Each kind was measured as identity CA, permissions CA and participant in Cyclone DDS
0.10.2, 0.10.5 and 11.0.1 and Fast DDS 2.9.1, 3.1.2 and 3.6.2.
"""

from collections.abc import Iterator

from pqsec_pki.algorithms import Family, is_encrypted
from pqsec_pki.credentials import KEYS
from pqsec_pki.lint._keys import UNREADABLE, WEAK_CURVES, family_of, key_kind
from pqsec_pki.lint.file import KeyOrListFile
from pqsec_pki.lint.roles import CertificateRole
from pqsec_pki.lint.rule import CYCLONE, FAST, SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import CertificateFile
from pqsec_pki.stacks import Stack

WEAKEST_RSA = 2048
"""Bits: the minimum in DDS-Security 1.1 and NIST SP 800-131A."""

_CYCLONE = {"ecdsa-p256", "rsa-2048"}
_MISTAKEN_FOR_P256 = {"brainpoolP256r1", "secp256k1"}
_UNSUPPORTED = {"ed25519", "ed448", "dsa", UNREADABLE}
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


@lint_rule(
    "PQS101", Severity.ERROR,
    "Cyclone DDS does not accept an identity key of this kind",
    why="Cyclone DDS supports only P-256 and RSA-2048 for identity CAs and participants, with any"
    " version of OpenSSL. For other keys it reports 'algorithm unknown (code: 125)'.",
    fix="Use ecdsa-p256, the default of pqsec, for the identity CA and the participants.",
    stacks=CYCLONE,
    rows=(
        "identity CA P-384, leaf P-256", "leaf P-384", "all RSA-3072", "all RSA-4096",
        "identity CA RSA-4096, leaf P-256",
    ),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1",
    bad="""
        $ openssl ecparam -genkey -noout -name secp384r1 -out key.pem
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem
    """,
    good="""
        $ openssl ecparam -genkey -noout -name prime256v1 -out key.pem
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem
    """,
)  # fmt: skip
def unsupported_by_cyclonedds(file: CertificateFile) -> Iterator[Violation]:
    certificate, role = file.first, file.role
    if certificate is None or not role.identifies:
        return
    kind = key_kind(certificate)
    known = _CYCLONE | _MISTAKEN_FOR_P256 | _UNSUPPORTED
    is_classical = family_of(certificate) is Family.CLASSICAL
    if is_classical and kind not in known and not kind.startswith("algorithm "):
        yield Violation(f"the {role} has a key of kind {kind}, which Cyclone DDS refuses")


@lint_rule(
    "PQS102", Severity.ERROR, "no stack accepts a key of this kind",
    why="Every stack refused Ed25519 for identity CA, participant and permissions CA. Their code"
    " has no name for it in the handshake, and PKCS7_verify cannot check it.",
    fix="Create the key with ecdsa-p256, or with a post-quantum profile for pqsec peers.",
    rows=(
        "identity CA Ed25519", "leaf Ed25519",
        "permissions CA Ed25519 (CMS by OpenSSL 3.5)",
    ),
    measured=SIX_STACKS,
    bad="""
        $ openssl genpkey -algorithm ed25519 -out key.pem
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem
    """,
    good="""
        $ openssl ecparam -genkey -noout -name prime256v1 -out key.pem
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem
    """,
)  # fmt: skip
def unsupported_by_all(file: CertificateFile) -> Iterator[Violation]:
    if file.first is None:
        return
    kind = key_kind(file.first)
    if kind in _UNSUPPORTED or kind.startswith("algorithm "):
        yield Violation(f"the {file.role} has a key of kind {kind}, which no stack accepts")


@lint_rule(
    "PQS103", Severity.WARNING, "a curve that stacks accept by mistake",
    why="Stacks announce this key as P-256, because it also has 256 bits. No version of"
    " DDS-Security lists this curve, and a later version of a stack may refuse it.",
    fix="Create the key with ecdsa-p256.",
    rows=("leaf brainpoolP256r1 / secp256k1 (wrongly let in)",),
    measured=SIX_STACKS,
    bad="""
        $ openssl ecparam -genkey -noout -name secp256k1 -out key.pem
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem
    """,
    good="""
        $ openssl ecparam -genkey -noout -name prime256v1 -out key.pem
        $ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem
    """,
)  # fmt: skip
def mistaken_for_p256(file: CertificateFile) -> Iterator[Violation]:
    if file.first and (kind := key_kind(file.first)) in _MISTAKEN_FOR_P256:
        yield Violation(f"the {file.role} has a key on {kind}, which stacks mistake for P-256")


@lint_rule(
    "PQS104", Severity.ERROR, "Fast DDS does not support this signature algorithm",
    why="Fast DDS reads the algorithm from the certificate's signature and supports only SHA-256"
    " with ECDSA or RSA (PKCS #1 v1.5). Its error message is empty.",
    fix="Sign certificates with SHA-256: use -sha256, and no -sigopt rsa_padding_mode:pss.",
    stacks=FAST,
    rows=("certs signed ecdsa-with-SHA384 or SHA512", "certs signed RSASSA-PSS"),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2",
    bad="$ openssl req -x509 -key key.pem -sha384 -subj /CN=talker -out cert.pem",
    good="$ openssl req -x509 -key key.pem -sha256 -subj /CN=talker -out cert.pem",
)  # fmt: skip
def unsupported_signature_algorithm(file: CertificateFile) -> Iterator[Violation]:
    role = file.role
    name = _NOT_SHA256.get(file.first.signature_algorithm) if file.first else None
    if name and role is not CertificateRole.COUNTERSIGNER:
        yield Violation(f"the certificate of the {role} is signed with {name}, unknown to Fast DDS")


@lint_rule(
    "PQS105", Severity.ERROR, "signed with a broken hash",
    why="An attacker can create two certificates with the same SHA-1 or MD5 digest. Your CA signs"
    " one, and its signature is valid for the other one too.",
    fix="Issue the certificate again with SHA-256.",
    bad="$ openssl req -x509 -key key.pem -sha1 -subj /CN=talker -out cert.pem",
    good="$ openssl req -x509 -key key.pem -sha256 -subj /CN=talker -out cert.pem",
)  # fmt: skip
def broken_hash(file: CertificateFile) -> Iterator[Violation]:
    name = _BROKEN.get(file.first.signature_algorithm) if file.first else None
    if name:
        yield Violation(f"the certificate of the {file.role} is signed with {name}")


@lint_rule(
    "PQS106", Severity.ERROR, "a weak key",
    why="RSA keys below 2048 bits and curves below 256 bits have been broken or can be broken.",
    fix="Create the key with ecdsa-p256, or with rsa-2048 at least.",
    bad="""
        $ openssl req -x509 -newkey rsa:1024 -noenc -keyout key.pem -subj /CN=talker -out cert.pem
    """,
    good="""
        $ openssl req -x509 -newkey rsa:2048 -noenc -keyout key.pem -subj /CN=talker -out cert.pem
    """,
)  # fmt: skip
def weak_key(file: CertificateFile) -> Iterator[Violation]:
    kind = key_kind(file.first) if file.first else ""
    bits = kind.removeprefix("rsa-")
    if kind in WEAK_CURVES or (bits.isdigit() and int(bits) < WEAKEST_RSA):
        yield Violation(f"the key of the {file.role} is weak: {kind}")


@lint_rule(
    "PQS107", Severity.ERROR, "a certificate with an empty subject",
    why="Permissions cannot name this participant. Cyclone DDS refuses the certificate, and Fast"
    " DDS crashes (std::length_error).",
    fix="Issue the certificate with a common name, such as CN=/fleet/robot1.",
    rows=("cert with empty subject",),
    measured=SIX_STACKS,
    bad="$ openssl req -x509 -key key.pem -subj / -out cert.pem",
    good="$ openssl req -x509 -key key.pem -subj /CN=talker -out cert.pem",
)  # fmt: skip
def empty_subject(file: CertificateFile) -> Iterator[Violation]:
    if file.first and not file.first.subject_name:
        yield Violation(f"the certificate of the {file.role} has an empty subject")


@lint_rule(
    "PQS150", Severity.ERROR, "ROS 2 cannot open an encrypted private key",
    why="ROS 2 has no setting to pass the passphrase to the middleware.",
    fix="Leave the key unencrypted, with mode 0600, on an encrypted disk.",
    stacks=(Stack.ROS2,), only_when_asked=True,
    rows=("wrong / missing password",),
    measured="source of rmw_dds_common (security.cpp)",
    bad="$ openssl pkcs8 -topk8 -passout pass:secret -in k/enclaves/talker/key.pem -out key.pem",
    good="$ openssl pkcs8 -topk8 -nocrypt -in k/enclaves/talker/key.pem -out key.pem",
)  # fmt: skip
def encrypted_for_ros(file: KeyOrListFile) -> Iterator[Violation]:
    if file.is_private_key and file.path.name in KEYS and is_encrypted(file.data):
        yield Violation("the participant's private key is encrypted, and ROS 2 cannot open it")
