"""Rules about files: who can read keys or change files, and keys in wrong places."""

import re
import stat
from collections.abc import Iterator, Mapping

from pqsec_pki.algorithms import is_encrypted
from pqsec_pki.lint.file import KeyOrListFile
from pqsec_pki.lint.roles import CertificateRole
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import Inventory

_OTHERS = stat.S_IRWXG | stat.S_IRWXO
_KEY_NAME = re.compile(r"[\w.-]+\.(pem|key)", re.ASCII)
_CA_KEY = re.compile(r"(identity_|permissions_)?ca\.(alt\.)?key\.pem")
PRIVATE, _PUBLIC = "private", "public"


@lint_rule(
    "PQS701", Severity.ERROR, "others can read a private key",
    why="A program that reads the key can act as the participant or the CA. sros2 0.13 writes keys"
    " with mode 0644.",
    fix="Run `chmod 600` on it. If the machine has other users, issue again with a new key.",
    bad="$ chmod 644 k/enclaves/talker/key.pem",
    good="$ chmod 600 k/enclaves/talker/key.pem",
)  # fmt: skip
def readable_key(file: KeyOrListFile) -> Iterator[Violation]:
    if file.is_private_key and file.permission_bits & _OTHERS:
        yield Violation(f"a private key has mode {file.permission_bits:04o}; it must be 0600")


@lint_rule(
    "PQS702", Severity.WARNING, "others can open the folder of the CA keys",
    why="If one key in it is written with the wrong mode, everybody can read it.",
    fix="Run `chmod 700` on it.",
    bad="$ chmod 755 k/private",
    good="$ chmod 700 k/private",
)  # fmt: skip
def open_private_folder(inventory: Inventory) -> Iterator[Violation]:
    for folder, mode in inventory.folders.items():
        if folder.name == PRIVATE and mode & _OTHERS:
            yield Violation(
                f"the folder has mode {stat.S_IMODE(mode):04o}; it must be 0700", path=folder
            )


@lint_rule(
    "PQS703", Severity.ERROR, "a CA's private key is in an enclave",
    why="Enclaves are copied to robots. An attacker who gets into one robot can issue certificates"
    " and permissions for all.",
    fix="Remove the key. If the enclave has been copied anywhere, replace the CAs.",
    bad="$ cp k/private/identity_ca.key.pem k/enclaves/talker",
    good="$ rm k/enclaves/talker/identity_ca.key.pem",
)  # fmt: skip
def ca_key_in_enclave(inventory: Inventory) -> Iterator[Violation]:
    owners = _ca_keys(inventory)
    for enclave in inventory.enclaves:
        for name, file in enclave.files.items():
            if not file.is_private_key:
                continue
            owner = owners.get(file.private_key.spki)
            if owner or _CA_KEY.fullmatch(name):
                yield Violation(f"the private key of the {owner or 'CA'} is in an enclave",
                            path=enclave.folder / name)  # fmt: skip


@lint_rule(
    "PQS704", Severity.ERROR, "a private key is in a public place",
    why="Files in public/, and files with a certificate, are easily given to others.",
    fix="Remove the key. If anybody else has the file, issue again with a new key.",
    bad="$ cp k/enclaves/talker/key.pem k/public/talker.key.pem",
    good="$ rm k/public/talker.key.pem",
)  # fmt: skip
def public_key_place(file: KeyOrListFile) -> Iterator[Violation]:
    if not file.is_private_key:
        return
    if _PUBLIC in file.path.parts[-2:-1]:
        yield Violation("a private key is in the folder public")
    elif "CERTIFICATE" in file.labels:
        yield Violation("a private key and a certificate are in one file")


@lint_rule(
    "PQS705", Severity.ERROR, "everybody can change a file or folder",
    why="Any program on the machine can replace the file, or the CAs that it trusts.",
    fix="Run `chmod o-w` on it, and compare it with a copy that nobody else could change.",
    bad="$ chmod 666 k/enclaves/talker/cert.pem",
    good="$ chmod 644 k/enclaves/talker/cert.pem",
)  # fmt: skip
def world_writable(inventory: Inventory) -> Iterator[Violation]:
    for file in inventory.files:
        if file.mode & stat.S_IWOTH:
            yield Violation(f"everybody can change the file (mode {file.permission_bits:04o})",
                        path=file.path)  # fmt: skip
    for folder, mode in inventory.folders.items():
        if mode & stat.S_IWOTH and not mode & stat.S_ISVTX:
            yield Violation(f"everybody can replace files in it (mode {stat.S_IMODE(mode):04o})",
                        path=folder)  # fmt: skip


@lint_rule(
    "PQS706", Severity.WARNING, "a copy of a private key was left behind",
    why="It stays when the key is replaced. It is copied to robots and stored in backups.",
    fix="Delete it (shred FILE).",
    bad="$ cp k/enclaves/talker/key.pem k/enclaves/talker/key.pem.bak",
    good="$ shred -u k/enclaves/talker/key.pem.bak",
)  # fmt: skip
def forgotten_copy(file: KeyOrListFile) -> Iterator[Violation]:
    if file.is_private_key and not _KEY_NAME.fullmatch(file.path.name):
        yield Violation("looks like a forgotten copy of a private key")


@lint_rule(
    "PQS707", Severity.WARNING, "a CA's private key is not encrypted",
    why="An attacker who gets this file from a backup or a lost disk can issue certificates or"
    " permissions for your domain.",
    fix="Encrypt it: openssl pkcs8 -topk8 -v2 aes-256-cbc -iter 600000 (3.5 or later for ML-DSA"
    " keys). `pqsec ca init` asks for a passphrase, except with --no-passphrase.",
    bad="""
        $ pqsec -k open ca init --no-passphrase
    """,
    good="""
        $ mv k open elsewhere/
        $ mkdir home
        $ echo 'correct horse battery staple' > home/passphrase
        $ pqsec -k k ca init --passphrase-file home/passphrase
    """,
)  # fmt: skip
def open_ca_key(inventory: Inventory) -> Iterator[Violation]:
    owners = _ca_keys(inventory)
    for file in inventory.files:
        if not file.is_private_key or is_encrypted(file.data):
            continue
        owner = owners.get(file.private_key.spki)
        if owner or _CA_KEY.fullmatch(file.path.name):
            yield Violation(
                f"the private key of the {owner or 'CA'} is not encrypted", path=file.path
            )


@lint_rule(
    "PQS708", Severity.WARNING, "a private key has weak encryption",
    why="With 'Proc-Type: 4,ENCRYPTED', an attacker needs one round of MD5 to test a passphrase."
    " With the encryption that pqsec writes, it is 600000 rounds of HMAC-SHA-256.",
    fix="Encrypt it again: openssl pkcs8 -topk8 -v2 aes-256-cbc -iter 600000.",
    rows=("traditional PEM, encrypted or not",),
    bad="$ openssl ec -aes256 -passout pass:secret -in k/enclaves/talker/key.pem -out key.pem",
    good=r"""
        $ openssl pkcs8 -topk8 -v2 aes-256-cbc -iter 600000 -passout pass:secret \
          -in k/enclaves/talker/key.pem -out key.pem
    """,
)  # fmt: skip
def weakly_encrypted(file: KeyOrListFile) -> Iterator[Violation]:
    if file.is_private_key and b"Proc-Type: 4,ENCRYPTED" in file.data:
        yield Violation("a private key in traditional PEM: its passphrase is easy to guess")


def _ca_keys(inventory: Inventory) -> Mapping[bytes | None, CertificateRole]:
    """DER SubjectPublicKeyInfo -> role of the CA with that key."""
    found: dict[bytes | None, CertificateRole] = {}
    for file in inventory.certificates:
        role = file.role
        if file.first and role is not CertificateRole.PARTICIPANT:
            found[file.first.spki] = role
            if file.first.alternative_spki:
                found[file.first.alternative_spki] = role
    return found
