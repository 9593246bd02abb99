"""Rules about revocation lists and the enclaves that use them."""

from collections.abc import Iterator

from pqsec_pki._times import said
from pqsec_pki.credentials import IDENTITY_CA
from pqsec_pki.errors import PqsecError
from pqsec_pki.lint._keys import key_of
from pqsec_pki.lint.certificates.revocation import NEW_LIST
from pqsec_pki.lint.rule import SIX_STACKS, Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import EnclaveFolder, Inventory
from pqsec_pki.stacks import Stack

_BAD_LIST = "CRL expired / wrong CA / bad signature"


@lint_rule(
    "PQS145", Severity.ERROR, "the identity CA did not sign a revocation list",
    why="If another CA signed the list, or the signature is invalid, stacks refuse every"
    " participant.",
    fix=NEW_LIST, rows=(_BAD_LIST,), measured=SIX_STACKS,
    bad="""
        $ cp -rL k/enclaves/talker robot
        $ pqsec -k other ca init --no-passphrase
        $ pqsec -k other ca crl --out robot/crl.pem
    """,
    good="$ pqsec -k k ca crl --out robot/crl.pem --force",
)  # fmt: skip
def of_another_ca(enclave: EnclaveFolder) -> Iterator[Violation]:
    ca = enclave.certificate(IDENTITY_CA)
    key = key_of(ca) if ca else None
    if ca is None or key is None:
        return
    for file, revoked in enclave.revocation_lists:
        if not key.algorithm.accepts(revoked.identifier) and revoked.names_issuer(ca):
            continue  # such as RSASSA-PSS, which pqsec does not check
        try:
            revoked.verify(ca)
        except PqsecError as error:
            yield Violation(str(error), path=file.path)


@lint_rule(
    "PQS146", Severity.ERROR, "the participant's own certificate is revoked",
    why="The participant does not start, and its peers refuse it.",
    fix="Issue the participant again with a new key.",
    rows=("own cert revoked", "peer b revoked, CRL at a"), measured=SIX_STACKS,
    bad="""
        $ cp -rL k/enclaves/talker robot
        $ pqsec -k k revoke /talker --yes
        $ cp k/public/identity_ca.crl.pem robot/crl.pem
    """,
    good="""
        $ pqsec -k k issue --force --after-revocation --publish chatter /talker
        $ mv robot elsewhere/
        $ cp -rL k/enclaves/talker robot
    """,
)  # fmt: skip
def own(inventory: Inventory) -> Iterator[Violation]:
    if inventory.keystore is None:
        yield from _revoked(inventory)


@lint_rule(
    "PQS149", Severity.INFO, "a revoked participant is still in the keystore",
    why="Peers refuse the participant, as intended. Its files are of no use, and somebody else may"
    " have its private key.",
    fix="Delete its enclave. To allow it again, run `pqsec issue` with --force --after-revocation.",
    bad="$ pqsec -k k revoke /listener --yes",
    good="$ mv k/enclaves/listener elsewhere/",
)  # fmt: skip
def revoked_in_keystore(inventory: Inventory) -> Iterator[Violation]:
    if inventory.keystore:
        yield from _revoked(inventory)


@lint_rule(
    "PQS147", Severity.WARNING, "OpenDDS does not read revocation lists",
    why="OpenDDS still accepts a revoked participant: its documentation lists 'CRL and OCSP' as not"
    " implemented.",
    fix="Issue certificates with a short validity, or replace the identity CA.",
    stacks={Stack.OPENDDS: "3.13.3, 3.34"}, only_when_asked=True,
    measured="OpenDDS 3.13.3, and the plugins of 3.34: a revoked sender was heard",
    bad="$ pqsec -k k revoke /listener --yes",
    good="""
        $ mv k/enclaves/listener elsewhere/
        $ rm k/enclaves/talker/crl.pem
    """,
)  # fmt: skip
def ignored_by_opendds(enclave: EnclaveFolder) -> Iterator[Violation]:
    for file, _ in enclave.revocation_lists:
        yield Violation("OpenDDS does not read this revocation list", path=file.path)


def _revoked(inventory: Inventory) -> Iterator[Violation]:
    for enclave in inventory.enclaves:
        certificate = enclave.certificate()
        for _, revoked in enclave.revocation_lists if certificate else ():
            if certificate and (found := revoked.revocation_of(certificate)):
                words = f"its certificate was revoked on {said(found.revoked_at)}"
                yield Violation(words, path=enclave.folder)
