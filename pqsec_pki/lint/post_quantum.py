"""Rules about post-quantum keys and signatures, and how stock stacks handle them."""

from collections.abc import Iterator

from pqsec_pki.algorithms import Family as Strength
from pqsec_pki.algorithms import PublicKey, SignatureAlgorithm
from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import (
    ALT_KEY,
    GOVERNANCE,
    IDENTITY_CA,
    PERMISSIONS,
    PERMISSIONS_ALT_CA,
    PERMISSIONS_CA,
)
from pqsec_pki.errors import PqsecError
from pqsec_pki.lint import _signatures
from pqsec_pki.lint._roles import Role, family_of, key_kind, role_of
from pqsec_pki.lint.cross import has_keys_on_robot
from pqsec_pki.lint.rule import Family, Severity, Target, Violation
from pqsec_pki.lint.subjects import CertificateFile, Enclave, Inventory

FAMILY = Family("post-quantum")
STOCK = (Target.CYCLONEDDS, Target.FASTDDS, Target.OPENDDS, Target.CONNEXT, Target.ROS2)
_ALL = "Cyclone DDS 0.10.2, 0.10.5, 11.0.1; Fast DDS 2.9.1, 3.1.2, 3.6.2"


@FAMILY.rule(
    "PQS601", Severity.ERROR, CertificateFile, "no stock stack accepts a post-quantum identity",
    why="Every stack refused ML-DSA and composite keys for identity CA and participant, also with"
    " OpenSSL 3.5. The code of the stacks supports only RSA and ECDSA.",
    fix="Use the transition profile: classical keys that stacks accept, with ML-DSA keys next to"
    " them.",
    stacks=STOCK, only_when_asked=True,
    rows=("identity all ML-DSA-65", "ML-DSA CA, EC leaf", "EC CA, ML-DSA leaf"),
    measured=_ALL + "; OpenDDS by source",
)  # fmt: skip
def identity_for_no_stack(file: CertificateFile) -> Iterator[Violation]:
    role = role_of(file)
    if file.first and role.identifies and family_of(file.first) is not Strength.CLASSICAL:
        yield Violation(
            f"the {role} has a key of kind {key_kind(file.first)}, for pqsec peers only"
        )


@FAMILY.rule(
    "PQS602", Severity.ERROR, CertificateFile, "no stock stack can verify these documents",
    why="Stacks verify with PKCS7_verify, which supports only RSA and ECDSA, also in OpenSSL 3.5"
    " and 4.0: 'provider signature not supported'.",
    fix="Use the transition profile: an ECDSA signature, and an ML-DSA signature over it.",
    stacks=STOCK, only_when_asked=True,
    rows=("governance/permissions CMS-signed ML-DSA-65",),
    measured=_ALL + "; OpenDDS by source",
)  # fmt: skip
def documents_for_no_stack(file: CertificateFile) -> Iterator[Violation]:
    role = role_of(file)
    if file.first and role.signs_documents and family_of(file.first) is not Strength.CLASSICAL:
        yield Violation(
            f"the {role} signs documents with {key_kind(file.first)}, for pqsec peers only"
        )


@FAMILY.rule(
    "PQS603", Severity.ERROR, Enclave, "the alternative signature is not valid",
    why="The certificate may be forged. Stock stacks ignore this signature and accept the"
    " certificate; pqsec peers refuse it.",
    fix="Renew the participant: `pqsec renew NAME`.",
)  # fmt: skip
def alternative_does_not_hold(enclave: Enclave) -> Iterator[Violation]:
    certificate, key = enclave.certificate(), _alternative_key(enclave.certificate(IDENTITY_CA))
    if certificate is None or key is None or not _has_signature(certificate):
        return
    try:
        if certificate.alternative:
            certificate.alternative.verify(key)
    except PqsecError as error:
        yield Violation(f"the certificate's alternative signature: {error}")


@FAMILY.rule(
    "PQS604", Severity.ERROR, Enclave, "the certificate has no alternative key or signature",
    why="The CA has an alternative key, and pqsec peers require this signature. Without it, an"
    " attacker who breaks ECDSA could create this certificate.",
    fix="Renew the participant: `pqsec renew NAME`.",
)  # fmt: skip
def no_alternative(enclave: Enclave) -> Iterator[Violation]:
    certificate = enclave.certificate()
    if certificate is None or _alternative_key(enclave.certificate(IDENTITY_CA)) is None:
        return
    missing = [
        name
        for name, there in (
            ("key", _alternative_key(certificate)),
            ("signature", _has_signature(certificate)),
        )
        if not there
    ]
    if missing:
        yield Violation(
            f"the certificate lacks an alternative {' and '.join(missing)}; its CA has one"
        )


@FAMILY.rule(
    "PQS605", Severity.ERROR, Inventory, "a countersignature is missing",
    why="The permissions CA has a post-quantum countersigner. pqsec peers refuse a document without"
    " its signature; an attacker may have removed it.",
    fix="Sign the document again.",
)  # fmt: skip
def stripped(inventory: Inventory) -> Iterator[Violation]:
    for pair in _signatures.pairs(inventory):
        ca, signers = pair.alternative_ca, _signatures.countersigners(pair.file)
        if ca and not any(_signatures.is_by(signer, ca) for signer in signers):
            yield Violation(f"lacks the countersignature of {ca.subject_name}", path=pair.file.path)


@FAMILY.rule(
    "PQS606", Severity.ERROR, Inventory, "a countersignature is not valid",
    why="The post-quantum signature does not match the signature of this document.",
    fix="Find out who changed the document, and sign it again.",
)  # fmt: skip
def counter_does_not_hold(inventory: Inventory) -> Iterator[Violation]:
    for pair in _signatures.pairs(inventory):
        for problem in _signatures.counter_problems(pair):
            yield Violation(problem, path=pair.file.path)


@FAMILY.rule(
    "PQS607", Severity.ERROR, Enclave, "the certificate of the countersigner is missing",
    why="The documents are countersigned, and nobody can check this without the certificate. A"
    " document without the countersignature would be accepted too.",
    fix=f"Link public/{PERMISSIONS_ALT_CA} into the enclave, as `pqsec issue` does.",
)  # fmt: skip
def no_countersigner(enclave: Enclave) -> Iterator[Violation]:
    file = enclave.files.get(PERMISSIONS_ALT_CA)
    if enclave.certificate(PERMISSIONS_ALT_CA) or (file and file.unreadable):
        return
    files = (enclave.files.get(name) for name in (PERMISSIONS, GOVERNANCE))
    ca = enclave.certificate(PERMISSIONS_CA)
    if any(file and _signatures.countersigners(file, ca) for file in files):
        yield Violation(f"documents are countersigned, but {PERMISSIONS_ALT_CA} is missing")
    elif _alternative_key(enclave.certificate(IDENTITY_CA)):
        yield Violation(
            f"the identity CA has an alternative key, but {PERMISSIONS_ALT_CA} is missing"
        )


@FAMILY.rule(
    "PQS608", Severity.ERROR, Enclave, "the alternative private key is missing",
    why="The certificate has an alternative key, and pqsec peers require the participant to sign"
    " with it.",
    fix=f"Copy {ALT_KEY} with the other files of the enclave, or issue the participant again.",
)  # fmt: skip
def no_alternative_key(enclave: Enclave) -> Iterator[Violation]:
    if has_keys_on_robot(enclave):
        return
    if _alternative_key(enclave.certificate()) and ALT_KEY not in enclave.files:
        yield Violation(f"{ALT_KEY} is missing, and the certificate has an alternative key")


@FAMILY.rule(
    "PQS609", Severity.WARNING, Inventory, "a key is weaker than the profile requires",
    why="The profile of a keystore sets the security level for all its keys.",
    fix="Issue the participant again, or create the keystore again with the profile that you want.",
)  # fmt: skip
def below_profile(inventory: Inventory) -> Iterator[Violation]:
    if inventory.keystore is None:
        return
    profile = inventory.keystore.profile
    wanted = {
        Role.PARTICIPANT: (profile.participant_key, profile.alternative_key),
        Role.IDENTITY_CA: (profile.identity_key, profile.alternative_key),
        Role.PERMISSIONS_CA: (profile.permissions_key, None),
        Role.COUNTERSIGNER: (profile.alternative_key, None),
    }
    for file in inventory.certificates:
        role = role_of(file)
        rows = wanted.get(role, (None, None))
        for what, found, row in zip(("key", "alternative key"), _keys(file), rows, strict=True):
            if row and (level := _level(found)) < row.level:
                words = f"the {role}'s {what} is of security level {level}, not {row.level}"
                yield Violation(
                    f"{words} as in profile {profile.name} ({row.name})", path=file.path
                )


@FAMILY.rule(
    "PQS610", Severity.INFO, Inventory, "no key here resists a quantum computer",
    why="An attacker who records the traffic now can read it when ECDH is broken (harvest now,"
    " decrypt later). This is not reported for a keystore created with `--profile classical`.",
    fix="For data that is still sensitive in ten years, use profile transition. It works with stock"
    " stacks, and between pqsec peers the key agreement is hybrid.",
)  # fmt: skip
def classical_only(inventory: Inventory) -> Iterator[Violation]:
    certificates = [each.first for each in inventory.certificates if each.first]
    if inventory.keystore or not inventory.enclaves or not certificates:
        return
    if all(family_of(each) is Strength.CLASSICAL and not each.alternative for each in certificates):
        yield Violation("all keys here are classical")


def _alternative_key(certificate: Certificate | None) -> PublicKey | None:
    try:
        return certificate.alternative_key if certificate else None
    except PqsecError:
        return None


def _has_signature(certificate: Certificate) -> bool:
    return certificate.alternative is not None and certificate.alternative.signature is not None


def _keys(file: CertificateFile) -> tuple[SignatureAlgorithm | None, SignatureAlgorithm | None]:
    if file.first is None:
        return None, None
    second = _alternative_key(file.first)
    try:
        return file.first.public_key.algorithm, second.algorithm if second else None
    except PqsecError:
        return None, second.algorithm if second else None


def _level(row: SignatureAlgorithm | None) -> int:
    return row.level if row else 0
