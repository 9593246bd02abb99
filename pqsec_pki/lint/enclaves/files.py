"""Rules about the files that an enclave must have, and their content."""

from collections.abc import Iterator

from pqsec_pki.credentials import CERTIFICATE, GOVERNANCE, KEY, PERMISSIONS, REQUEST, SIX
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import EnclaveFolder


@lint_rule(
    "PQS301", Severity.ERROR, "a file is missing in an enclave",
    why="Every stack needs all six files. ROS 2 only reports that security files were not found.",
    fix="Issue the participant again, or copy the missing files.",
    measured="source of rmw_dds_common (security.cpp)",
    bad="""
        $ cp -rL k/enclaves/talker robot
        $ rm robot/key.pem
    """,
    good="$ cp k/enclaves/talker/key.pem robot",
)  # fmt: skip
def incomplete(enclave: EnclaveFolder) -> Iterator[Violation]:
    there = {*enclave.files, *enclave.broken_links}
    missing = [name for name in SIX if name not in there and not _is_elsewhere(enclave, name)]
    if missing:
        yield Violation(f"lacks {', '.join(missing)}")


@lint_rule(
    "PQS302", Severity.ERROR, "a broken link",
    why="A copy of an enclave without the files behind its links contains only broken links.",
    fix="Follow the links when you copy (cp -rL, rsync -L), or restore the shared files.",
    bad="$ cp -r k/enclaves/talker robot",
    good="""
        $ mv robot elsewhere/
        $ cp -rL k/enclaves/talker robot
    """,
)  # fmt: skip
def broken_link(enclave: EnclaveFolder) -> Iterator[Violation]:
    for name in sorted(enclave.broken_links):
        yield Violation("the link is broken", path=enclave.folder / name)


@lint_rule(
    "PQS318", Severity.ERROR, "a file does not contain what its name says",
    why="Under each of the six names, stacks expect a certificate in PEM or one of the two"
    " documents. This file contains something else. Files that must match it were not checked"
    " against it.",
    fix="Replace the file (`openssl x509 -inform DER` converts DER to PEM), or issue the"
    " participant again.",
    bad="""
        $ cp -rL k/enclaves/talker robot
        $ openssl x509 -in k/enclaves/talker/cert.pem -outform DER -out robot/cert.pem
    """,
    good="$ openssl x509 -in k/enclaves/talker/cert.pem -outform PEM -out robot/cert.pem",
)  # fmt: skip
def misnamed(enclave: EnclaveFolder) -> Iterator[Violation]:
    for name, file in enclave.files.items():
        is_certificate = name == CERTIFICATE or name.endswith(f".{CERTIFICATE}")
        if is_certificate and "CERTIFICATE" not in file.labels and not file.unreadable:
            yield Violation("contains no certificate in PEM", path=enclave.folder / name)
    if enclave.governance(PERMISSIONS):
        yield Violation("is governance, not permissions", path=enclave.folder / PERMISSIONS)
    if enclave.permissions(GOVERNANCE):
        yield Violation("is permissions, not governance", path=enclave.folder / GOVERNANCE)


def _is_elsewhere(enclave: EnclaveFolder, name: str) -> bool:
    """Whether a PKCS #11 address (.p11, for ROS 2) replaces the file, or the robot has it."""
    if name == KEY and has_keys_on_robot(enclave):
        return True
    return (enclave.folder / name).with_suffix(".p11").exists()


def has_keys_on_robot(enclave: EnclaveFolder) -> bool:
    """Whether the enclave was issued for a request, so that only the robot has the keys."""
    return REQUEST in enclave.files and KEY not in enclave.files
