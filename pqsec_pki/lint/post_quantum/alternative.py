"""Rules about alternative signatures and countersignatures, which pqsec peers require."""

from collections.abc import Iterator

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
from pqsec_pki.lint._keys import alternative_key_of
from pqsec_pki.lint.enclaves.files import has_keys_on_robot
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.lint.signed import countersigners, is_by
from pqsec_pki.lint.subjects import EnclaveFolder, Inventory


@lint_rule(
    "PQS603", Severity.ERROR, "the alternative signature is not valid",
    why="The certificate may be forged. Stock stacks ignore this signature and accept the"
    " certificate; pqsec peers refuse it.",
    fix="Renew the participant: `pqsec renew NAME`.",
    bad="$ cp elsewhere/forged.cert.pem k/enclaves/talker/cert.pem",
    good="$ pqsec -k k issue --force --publish chatter /talker",
)  # fmt: skip
def invalid_alternative_signature(enclave: EnclaveFolder) -> Iterator[Violation]:
    certificate, key = enclave.certificate(), alternative_key_of(enclave.certificate(IDENTITY_CA))
    if certificate is None or key is None or not _has_signature(certificate):
        return
    try:
        if certificate.alternative:
            certificate.alternative.verify(key)
    except PqsecError as error:
        yield Violation(f"the certificate's alternative signature: {error}")


@lint_rule(
    "PQS604", Severity.ERROR, "the certificate has no alternative key or signature",
    why="The CA has an alternative key, and pqsec peers require this signature. Without it, an"
    " attacker who breaks ECDSA could create this certificate.",
    fix="Renew the participant: `pqsec renew NAME`.",
    bad=r"""
        $ openssl req -x509 -key k/enclaves/talker/key.pem -subj '/CN=\/talker' -days 365 \
          -CA k/public/identity_ca.cert.pem -CAkey k/private/identity_ca.key.pem \
          -addext basicConstraints=critical,CA:FALSE -out k/enclaves/talker/cert.pem
    """,
    good="$ pqsec -k k issue --force --publish chatter /talker",
)  # fmt: skip
def no_alternative(enclave: EnclaveFolder) -> Iterator[Violation]:
    certificate = enclave.certificate()
    if certificate is None or alternative_key_of(enclave.certificate(IDENTITY_CA)) is None:
        return
    missing = [
        name
        for name, there in (
            ("key", alternative_key_of(certificate)),
            ("signature", _has_signature(certificate)),
        )
        if not there
    ]
    if missing:
        yield Violation(
            f"the certificate lacks an alternative {' and '.join(missing)}; its CA has one"
        )


@lint_rule(
    "PQS605", Severity.ERROR, "a countersignature is missing",
    why="The permissions CA has a post-quantum countersigner. pqsec peers refuse a document without"
    " its signature; an attacker may have removed it.",
    fix="Sign the document again.",
    bad=r"""
        $ openssl smime -sign -text -in k/enclaves/talker/permissions.xml \
          -signer k/public/permissions_ca.cert.pem -inkey k/private/permissions_ca.key.pem \
          -out k/enclaves/talker/permissions.p7s
    """,
    good="$ pqsec -k k sign-permissions --force k/enclaves/talker/permissions.xml",
)  # fmt: skip
def no_countersignature(inventory: Inventory) -> Iterator[Violation]:
    for each in inventory.signed_documents:
        ca, signers = each.alternative_ca, countersigners(each.file)
        if ca and not any(is_by(signer, ca) for signer in signers):
            yield Violation(f"lacks the countersignature of {ca.subject_name}", path=each.file.path)


@lint_rule(
    "PQS606", Severity.ERROR, "a countersignature is not valid",
    why="The post-quantum signature does not match the signature of this document.",
    fix="Find out who changed the document, and sign it again.",
    bad="$ cp elsewhere/forged.p7s k/enclaves/talker/permissions.p7s",
    good="$ pqsec -k k sign-permissions --force k/enclaves/talker/permissions.xml",
)  # fmt: skip
def invalid_countersignature(inventory: Inventory) -> Iterator[Violation]:
    for each in inventory.signed_documents:
        for problem in each.counter_problems:
            yield Violation(problem, path=each.file.path)


@lint_rule(
    "PQS607", Severity.ERROR, "the certificate of the countersigner is missing",
    why="The documents are countersigned, and nobody can check this without the certificate. A"
    " document without the countersignature would be accepted too.",
    fix=f"Link public/{PERMISSIONS_ALT_CA} into the enclave, as `pqsec issue` does.",
    bad="""
        $ cp -rL k/enclaves/talker robot
        $ rm robot/permissions_ca.alt.cert.pem
    """,
    good="$ cp k/public/permissions_ca.alt.cert.pem robot",
)  # fmt: skip
def no_countersigner(enclave: EnclaveFolder) -> Iterator[Violation]:
    file = enclave.files.get(PERMISSIONS_ALT_CA)
    if enclave.certificate(PERMISSIONS_ALT_CA) or (file and file.unreadable):
        return
    files = (enclave.files.get(name) for name in (PERMISSIONS, GOVERNANCE))
    ca = enclave.certificate(PERMISSIONS_CA)
    if any(file and countersigners(file, ca) for file in files):
        yield Violation(f"documents are countersigned, but {PERMISSIONS_ALT_CA} is missing")
    elif alternative_key_of(enclave.certificate(IDENTITY_CA)):
        yield Violation(
            f"the identity CA has an alternative key, but {PERMISSIONS_ALT_CA} is missing"
        )


@lint_rule(
    "PQS608", Severity.ERROR, "the alternative private key is missing",
    why="The certificate has an alternative key, and pqsec peers require the participant to sign"
    " with it.",
    fix=f"Copy {ALT_KEY} with the other files of the enclave, or issue the participant again.",
    bad="""
        $ cp -rL k/enclaves/talker robot
        $ rm robot/alt.key.pem
    """,
    good="$ cp k/enclaves/talker/alt.key.pem robot",
)  # fmt: skip
def no_alternative_key(enclave: EnclaveFolder) -> Iterator[Violation]:
    if has_keys_on_robot(enclave):
        return
    if alternative_key_of(enclave.certificate()) and ALT_KEY not in enclave.files:
        yield Violation(f"{ALT_KEY} is missing, and the certificate has an alternative key")


def _has_signature(certificate: Certificate) -> bool:
    return certificate.alternative is not None and certificate.alternative.signature is not None
