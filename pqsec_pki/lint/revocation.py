"""Rules about revocation lists: their own file, and how they apply to the enclave.

Each variant was measured in Cyclone DDS 0.10.2, 0.10.5 and 11.0.1 and Fast DDS 2.9.1,
3.1.2 and 3.6.2. A stack with an invalid list refuses every participant.
"""

from collections.abc import Iterator
from functools import lru_cache

from pqsec_pki.certificates import RevocationList
from pqsec_pki.credentials import IDENTITY_CA
from pqsec_pki.errors import PqsecError
from pqsec_pki.lint import x509
from pqsec_pki.lint._roles import key_of
from pqsec_pki.lint.file import File
from pqsec_pki.lint.rule import Family, Severity, Target, Violation
from pqsec_pki.lint.subjects import Enclave, Inventory

FAMILY = Family("x509")
_ALL = "Cyclone DDS 0.10.2, 0.10.5, 11.0.1; Fast DDS 2.9.1, 3.1.2, 3.6.2"
_BAD_LIST = "CRL expired / wrong CA / bad signature"
_RENEW = "Issue a new revocation list (`pqsec ca crl`), and copy it to all participants."


@FAMILY.rule(
    "PQS140", Severity.ERROR, File, "a revocation list cannot be read",
    why="A stack that is configured with this list refuses to start.",
    fix=_RENEW,
)  # fmt: skip
def unreadable(file: File) -> Iterator[Violation]:
    if file.is_revocation_list:
        _, reason = _read(file.data)
        if reason:
            yield Violation(f"the revocation list in it cannot be read: {reason}")


@FAMILY.rule(
    "PQS141", Severity.ERROR, File, "a revocation list has expired",
    why="After nextUpdate, stacks refuse every participant, revoked or not.",
    fix=_RENEW, rows=(_BAD_LIST,), measured=_ALL,
)  # fmt: skip
def expired(file: File) -> Iterator[Violation]:
    revoked = _list_in(file)
    if revoked and revoked.next_update and file.now > revoked.next_update:
        yield Violation(f"the revocation list expired on {revoked.next_update:%Y-%m-%d %H:%M} UTC")


@FAMILY.rule(
    "PQS148", Severity.WARNING, File, "a revocation list expires soon",
    why="After nextUpdate, stacks refuse every participant, revoked or not.",
    fix=_RENEW,
)  # fmt: skip
def ends_soon(file: File) -> Iterator[Violation]:
    revoked = _list_in(file)
    end = revoked.next_update if revoked else None
    if revoked and end and x509.ends_soon(file.now, revoked.this_update, end):
        yield Violation(f"the revocation list expires on {end:%Y-%m-%d %H:%M} UTC")


@FAMILY.rule(
    "PQS142", Severity.ERROR, File, "a revocation list is not in force yet",
    why="Before thisUpdate, stacks refuse every participant.",
    fix="Correct the clock, or issue a new revocation list.",
    measured="`openssl verify -crl_check` 3.0.19 and 3.5: 'CRL is not yet valid'",
)  # fmt: skip
def not_yet(file: File) -> Iterator[Violation]:
    revoked = _list_in(file)
    if revoked and file.now < revoked.this_update:
        yield Violation(
            f"the revocation list is valid from {revoked.this_update:%Y-%m-%d %H:%M} UTC"
        )


@FAMILY.rule(
    "PQS143", Severity.WARNING, File, "a revocation list has no nextUpdate",
    why="RFC 5280 5.1.2.5 requires it. Without it, an old list is accepted forever. An attacker who"
    " holds back the new list keeps a revoked participant in the domain.",
    fix="Issue revocation lists with a nextUpdate.",
)  # fmt: skip
def endless(file: File) -> Iterator[Violation]:
    revoked = _list_in(file)
    if revoked and revoked.next_update is None:
        yield Violation("the revocation list has no nextUpdate")


@FAMILY.rule(
    "PQS144", Severity.WARNING, File, "a revocation list in a file of certificates",
    why="Fast DDS 3 enforces a list in the identity CA's file; Cyclone DDS and OpenDDS ignore it."
    " No stack reads a list in the permissions CA's file.",
    fix="Put the list into crl.pem and configure the stack with that file.",
    rows=(
        "CRL appended to identity_ca.pem, b revoked",
        "CRL in permissions CA file revoking it (ignored)",
    ),
    measured=_ALL,
)  # fmt: skip
def misplaced(file: File) -> Iterator[Violation]:
    if file.is_revocation_list and "CERTIFICATE" in file.labels:
        yield Violation(
            "a revocation list among certificates: Fast DDS 3 enforces it, others do not"
        )


@FAMILY.rule(
    "PQS145", Severity.ERROR, Enclave, "the identity CA did not sign a revocation list",
    why="If another CA signed the list, or the signature is invalid, stacks refuse every"
    " participant.",
    fix=_RENEW, rows=(_BAD_LIST,), measured=_ALL,
)  # fmt: skip
def of_another_ca(enclave: Enclave) -> Iterator[Violation]:
    ca = enclave.certificate(IDENTITY_CA)
    key = key_of(ca) if ca else None
    if ca is None or key is None:
        return
    for file, revoked in lists_of(enclave):
        if not key.algorithm.accepts(revoked.identifier) and revoked.issuer_der == ca.subject_der:
            continue  # such as RSASSA-PSS, which pqsec does not check
        try:
            revoked.verify(ca)
        except PqsecError as error:
            yield Violation(str(error), path=file.path)


@FAMILY.rule(
    "PQS146", Severity.ERROR, Inventory, "the participant's own certificate is revoked",
    why="The participant does not start, and its peers refuse it.",
    fix="Issue the participant again with a new key.",
    rows=("own cert revoked", "peer b revoked, CRL at a"), measured=_ALL,
)  # fmt: skip
def own(inventory: Inventory) -> Iterator[Violation]:
    if inventory.keystore is None:
        yield from _revoked(inventory)


@FAMILY.rule(
    "PQS149", Severity.INFO, Inventory, "a revoked participant is still in the keystore",
    why="Peers refuse the participant, as intended. Its files are of no use, and somebody else may"
    " have its private key.",
    fix="Delete its enclave. To allow it again, run `pqsec issue` with --force --after-revocation.",
)  # fmt: skip
def left_in_keystore(inventory: Inventory) -> Iterator[Violation]:
    if inventory.keystore:
        yield from _revoked(inventory)


@FAMILY.rule(
    "PQS147", Severity.WARNING, Enclave, "OpenDDS does not read revocation lists",
    why="OpenDDS still accepts a revoked participant: its documentation lists 'CRL and OCSP' as not"
    " implemented.",
    fix="Issue certificates with a short validity, or replace the identity CA.",
    stacks=(Target.OPENDDS,), only_when_asked=True,
    measured="OpenDDS 3.13.3, and the plugins of 3.34: a revoked sender was heard",
)  # fmt: skip
def opendds_reads_none(enclave: Enclave) -> Iterator[Violation]:
    for file, _ in lists_of(enclave):
        yield Violation("OpenDDS does not read this revocation list", path=file.path)


def _revoked(inventory: Inventory) -> Iterator[Violation]:
    for enclave in inventory.enclaves:
        certificate = enclave.certificate()
        for _, revoked in lists_of(enclave) if certificate else ():
            if certificate and (found := revoked.revocation_of(certificate)):
                words = f"its certificate was revoked on {found.revoked_at:%Y-%m-%d}"
                yield Violation(words, path=enclave.folder)


def lists_of(enclave: Enclave) -> Iterator[tuple[File, RevocationList]]:
    """(file, revocation list) for each readable list of the enclave."""
    for file in enclave.files.values():
        revoked = _list_in(file)
        if revoked and "CERTIFICATE" not in file.labels:
            yield file, revoked


def _list_in(file: File) -> RevocationList | None:
    return _read(file.data)[0] if file.is_revocation_list else None


@lru_cache(maxsize=8)
def _read(data: bytes) -> tuple[RevocationList | None, str | None]:
    """(list, None) or (None, why it cannot be read). Cached: all enclaves share one list."""
    try:
        return RevocationList.from_pem(data), None
    except PqsecError as error:
        return None, str(error)
