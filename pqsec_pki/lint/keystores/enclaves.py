"""Rules about what the enclaves of a keystore must share, and what they must not."""

from collections.abc import Callable, Hashable, Iterator, Mapping
from datetime import datetime
from pathlib import Path

from pqsec_pki._times import said
from pqsec_pki.certificates import Certificate, canonical_name
from pqsec_pki.credentials import (
    ENCLAVES,
    GOVERNANCE,
    IDENTITY_CA,
    PERMISSIONS_CA,
)
from pqsec_pki.lint.roles import CertificateRole
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import CertificateFile, EnclaveFolder, Inventory


@lint_rule(
    "PQS310", Severity.WARNING, "enclaves have different governance",
    why="Participants that protect a domain or topic differently cannot communicate, and no stack"
    " reports why.",
    fix="Use the same governance.p7s for all enclaves: link it, as pqsec and SROS2 do.",
    bad="""
        $ sed 's/>SIGN</>ENCRYPT</' k/enclaves/governance.xml > k/enclaves/strict.xml
        $ pqsec -k k sign-governance k/enclaves/strict.xml
        $ ln -sf ../strict.p7s k/enclaves/talker/governance.p7s
    """,
    good="$ ln -sf ../governance.p7s k/enclaves/talker/governance.p7s",
)  # fmt: skip
def different_governance(inventory: Inventory) -> Iterator[Violation]:
    def text(enclave: EnclaveFolder) -> Hashable:
        document = enclave.governance()
        return document.governance if document else None

    for enclave, other in _unlike_most(inventory, text):
        place = enclave.files[GOVERNANCE].path
        yield Violation(f"differs from the governance of {other.name} and others", path=place)


@lint_rule(
    "PQS311", Severity.WARNING, "enclaves trust different CAs",
    why="Participants that trust different CAs refuse each other.",
    fix="Use the same CA certificates for all enclaves, unless the domains are meant to be"
    " separate.",
    bad="""
        $ pqsec -k other ca init --no-passphrase
        $ cp other/public/permissions_ca.cert.pem k/public/other_ca.cert.pem
        $ ln -sf ../../public/other_ca.cert.pem k/enclaves/talker/permissions_ca.cert.pem
    """,
    good="$ ln -sf ../../public/permissions_ca.cert.pem k/enclaves/talker/permissions_ca.cert.pem",
)  # fmt: skip
def different_cas(inventory: Inventory) -> Iterator[Violation]:
    for name in (IDENTITY_CA, PERMISSIONS_CA):

        def key(enclave: EnclaveFolder, name: str = name) -> Hashable:
            ca = enclave.certificate(name)
            return ca.fingerprint if ca else None

        for enclave, other in _unlike_most(inventory, key):
            place = enclave.files[name].path
            yield Violation(f"differs from the {name} of {other.name} and others", path=place)


@lint_rule(
    "PQS312", Severity.ERROR, "identity CA and permissions CA have the same key",
    why="Some stacks do not check which certificate signed a document (Cyclone DDS 0.10, Fast DDS"
    " 2.9). With one CA for both, any participant can sign its own permissions (CVE-2023-24010).",
    fix="Create two CAs with `pqsec ca rotate`. For a keystore of SROS2, run `pqsec adopt` first.",
    rows=("document signed by leaf or intermediate under the CA, CA file = root",),
    measured="Cyclone DDS 0.10.2, 0.10.5; Fast DDS 2.9.1",
    bad="""
        $ cp -rL k/enclaves/talker robot
        $ cp robot/identity_ca.cert.pem robot/permissions_ca.cert.pem
    """,
    good="$ cp k/public/permissions_ca.cert.pem robot",
)  # fmt: skip
def shared_ca(inventory: Inventory) -> Iterator[Violation]:
    signers = {
        ca.spki for ca in _cas(inventory, PERMISSIONS_CA, CertificateRole.PERMISSIONS_CA).values()
    }
    for path, ca in _cas(inventory, IDENTITY_CA, CertificateRole.IDENTITY_CA).items():
        if ca.spki in signers:
            yield Violation(
                "this key is identity CA and permissions CA (CVE-2023-24010)", path=path
            )


@lint_rule(
    "PQS317", Severity.WARNING,
    "some participants do not have the latest revocation list",
    why="A participant without a list, or with an older one, accepts participants that were revoked"
    " later.",
    fix="Copy the latest crl.pem to all participants and restart them: stacks read it when they"
    " start.",
    bad="""
        $ pqsec -k k revoke /listener --yes
        $ rm k/enclaves/talker/crl.pem
    """,
    good="$ ln -s ../../public/identity_ca.crl.pem k/enclaves/talker/crl.pem",
)  # fmt: skip
def old_list(inventory: Inventory) -> Iterator[Violation]:
    newest: dict[Path, tuple[datetime, EnclaveFolder]] = {}
    for enclave in inventory.enclaves:
        made, root = _latest(enclave), _root(enclave.folder)
        if made and (root not in newest or made > newest[root][0]):
            newest[root] = made, enclave
    for enclave in inventory.enclaves:
        latest, other = newest.get(_root(enclave.folder), (None, enclave))
        own = _latest(enclave)
        if latest and (own is None or own < latest):
            has = f"a revocation list of {said(own)}" if own else "no revocation list"
            words = f"has {has}; {other.name} has one of {said(latest)}"
            yield Violation(words, path=enclave.folder)


@lint_rule(
    "PQS314", Severity.WARNING, "two participants have the same key",
    why="An attacker who gets into one robot has the key of both, and you cannot revoke only one of"
    " them. This happens when an enclave folder is copied to a second robot.",
    fix="Issue each participant with its own key: `pqsec issue NAME`.",
    bad="$ cp -r k/enclaves/talker k/enclaves/second",
    good="$ pqsec -k k issue --force --publish chatter /second",
)  # fmt: skip
def shared_key(inventory: Inventory) -> Iterator[Violation]:
    first: dict[bytes, EnclaveFolder] = {}
    for enclave in inventory.enclaves:
        for key in _own_keys(enclave):
            other = first.setdefault(key, enclave)
            if other is not enclave:
                yield Violation(f"has the same key as {other.name}", path=enclave.folder)
                break


@lint_rule(
    "PQS315", Severity.WARNING, "two certificates have the same serial number",
    why="Revocation lists identify certificates by serial number: a list that revokes one revokes"
    " the other too. RFC 5280 4.1.2.2 requires a unique number for each certificate of a CA.",
    fix="Issue one of them again, and let the CA choose the number (no -set_serial).",
    bad="""
        $ openssl req -x509 -key key.pem -subj /CN=Lab -set_serial 7 -out one.cert.pem
        $ openssl req -x509 -key key.pem -subj /CN=Lab -set_serial 7 -out two.cert.pem
    """,
    good="$ openssl req -x509 -key key.pem -subj /CN=Lab -out two.cert.pem",
)  # fmt: skip
def same_serial(inventory: Inventory) -> Iterator[Violation]:
    first: dict[tuple[Hashable, int], CertificateFile] = {}
    for file in inventory.certificates:
        if certificate := file.first:
            number = (canonical_name(certificate.issuer_der), certificate.serial_number)
            other = first.setdefault(number, file)
            if other.first and other.first.der != certificate.der:
                yield Violation(f"has the same serial number as {other.path}", path=file.path)


def _latest(enclave: EnclaveFolder) -> datetime | None:
    """When its newest revocation list was issued; None if it has none."""
    return max((each.this_update for _, each in enclave.revocation_lists), default=None)


def _own_keys(enclave: EnclaveFolder) -> Iterator[bytes]:
    certificate = enclave.certificate()
    if certificate:
        yield certificate.spki
        if certificate.alternative_spki:
            yield certificate.alternative_spki


def _cas(inventory: Inventory, name: str, role: CertificateRole) -> Mapping[Path, Certificate]:
    """CAs in files for that role, or that enclaves have under `name` (SROS2 links both to one)."""
    found = {each.path: each.first for each in inventory.certificates if each.role is role}
    for enclave in inventory.enclaves:
        if name in enclave.files:
            found[enclave.files[name].path] = enclave.certificate(name)
    return {path: ca for path, ca in found.items() if ca}


def _unlike_most(
    inventory: Inventory, key: Callable[[EnclaveFolder], Hashable]
) -> Iterator[tuple[EnclaveFolder, EnclaveFolder]]:
    """(enclave, another enclave) for each that differs from the majority of its keystore."""
    keystores: dict[Path, dict[Hashable, list[EnclaveFolder]]] = {}
    for enclave in inventory.enclaves:
        value = key(enclave)
        if value is not None:
            keystores.setdefault(_root(enclave.folder), {}).setdefault(value, []).append(enclave)
    for groups in keystores.values():
        most, *others = sorted(groups.values(), key=len, reverse=True)
        for enclave in (each for group in others for each in group):
            yield enclave, most[0]


def _root(folder: Path) -> Path:
    parts = folder.parts
    if ENCLAVES not in parts:
        return folder.parent
    return Path(*parts[: len(parts) - parts[::-1].index(ENCLAVES)])
