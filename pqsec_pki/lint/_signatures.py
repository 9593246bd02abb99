"""Signed documents, the CA that should have signed each, and problems of their signatures."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from weakref import WeakKeyDictionary

from pqsec_pki.certificates import Certificate, name_text
from pqsec_pki.credentials import (
    CERTIFICATE,
    GOVERNANCE,
    IDENTITY_CA,
    PERMISSIONS,
    PERMISSIONS_ALT_CA,
    PERMISSIONS_CA,
    TrustAnchors,
)
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.lint._roles import Role, key_kind, key_of, role_of
from pqsec_pki.lint.file import File
from pqsec_pki.lint.subjects import Enclave, Inventory
from pqsec_pki.problems import Code, Problem
from pqsec_pki.smime import Listed, ListedSigner, signers_in, verify

_PSS = bytes.fromhex("06092a864886f70d01010a")
"""DER of its object identifier."""
_BROKEN = {"1.3.14.3.2.26": "SHA-1", "1.2.840.113549.2.5": "MD5", "1.2.840.113549.2.2": "MD2"}


@dataclass(frozen=True)
class Pair:
    """A document, and the certificates that should have signed it."""

    file: File
    ca: Certificate
    alternative_ca: Certificate | None
    anchors: TrustAnchors | None
    """The enclave's CAs, if the document is in an enclave and they can be read."""
    others: tuple[tuple[str, Certificate], ...]
    """(description, other certificate of the enclave), which may have signed it."""


def pairs(inventory: Inventory) -> tuple[Pair, ...]:
    """Each document with each CA that it is checked against, without duplicates."""
    found = _PAIRS.get(inventory)
    if found is None:
        first: dict[tuple[Path, str], Pair] = {}
        for pair in (*_in_enclaves(inventory), *_outside(inventory)):
            first.setdefault((pair.file.path, pair.ca.fingerprint), pair)
        found = _PAIRS[inventory] = tuple(first.values())
    return found


def listed(file: File) -> Listed | None:
    """The signatures and certificates in the document; None if it cannot be read."""
    return _listed(file)[0] if file.is_signed else None


def signers(file: File) -> tuple[ListedSigner, ...]:
    """The signers that the document names; none if it cannot be read."""
    found = listed(file)
    return found.signers if found else ()


def trouble(file: File) -> str | None:
    """Why the document cannot be read, if it cannot."""
    return _listed(file)[1]


def text(file: File) -> bytes | None:
    """The signed text; None if it is not text/plain, which PKCS7_TEXT requires."""
    return file.signed_text[0]


def broken_digests(file: File) -> tuple[str, ...]:
    """The broken digests that it is signed with: a second document can have the same."""
    return tuple(_BROKEN[each.digest] for each in signers(file) if each.digest in _BROKEN)


def is_by(signer: ListedSigner, certificate: Certificate) -> bool:
    """Whether the signature names `certificate` as its signer."""
    if signer.key_identifier is not None:
        return signer.key_identifier == certificate.subject_key_identifier
    if signer.serial_number != certificate.serial_number:
        return False
    return signer.issuer == name_text(certificate.issuer)


def uncheckable(pair: Pair) -> str | None:
    """Why pqsec cannot check the CA's signature; None if it can."""
    if not _is_ours(pair):
        return None
    if key_of(pair.ca) is None:
        return f"a key of kind {key_kind(pair.ca)}"
    [signer] = signers(pair.file)
    if not signer.has_attributes:
        return "no signed attributes"
    if _PSS in signer.identifier:
        return "RSASSA-PSS"
    return f"the digest {signer.digest}" if "." in signer.digest else None


def plain_problems(pair: Pair) -> Iterator[str]:
    """Problems of the signature that names the CA."""
    others = {Code.COUNTERSIGNATURE_BAD, Code.SIGNATURE_MISSING}
    return (str(each) for each in _problems(pair) if each.code not in others)


def counter_problems(pair: Pair) -> Iterator[str]:
    """Problems of countersignatures."""
    return (str(each) for each in _problems(pair) if each.code is Code.COUNTERSIGNATURE_BAD)


def countersigners(file: File, ca: Certificate | None = None) -> tuple[ListedSigner, ...]:
    """The countersigners; with `ca`, only those of signatures that name it as signer."""
    signed = (each for each in signers(file) if ca is None or is_by(each, ca))
    return tuple(each for signer in signed for each in signer.countersigners)


def embedded(file: File) -> Iterator[Certificate]:
    """The certificates in the document that its signatures name as signers."""
    found = listed(file)
    for der in found.certificates if found else ():
        with suppress(PqsecError):
            certificate = Certificate.from_der(der)
            if any(is_by(signer, certificate) for signer in signers(file)):
                yield certificate


def _in_enclaves(inventory: Inventory) -> Iterator[Pair]:
    for enclave in inventory.enclaves:
        ca, anchors = enclave.certificate(PERMISSIONS_CA), enclave.anchors
        for name in (PERMISSIONS, GOVERNANCE):
            if ca and name in enclave.files:
                alternative = enclave.certificate(PERMISSIONS_ALT_CA)
                yield Pair(enclave.files[name], ca, alternative, anchors, tuple(_near(enclave)))


def _near(enclave: Enclave) -> Iterator[tuple[str, Certificate]]:
    for role, name in (("the identity CA", IDENTITY_CA), ("the participant itself", CERTIFICATE)):
        if certificate := enclave.certificate(name):
            yield role, certificate


def _outside(inventory: Inventory) -> Iterator[Pair]:
    """Documents outside of enclaves, if there is exactly one permissions CA."""
    in_enclaves = {file.path for each in inventory.enclaves for file in each.files.values()}
    roles = [(role_of(each), each.first) for each in inventory.certificates if each.first]
    signers = {each.fingerprint: each for role, each in roles if role is Role.PERMISSIONS_CA}
    counters = [each for role, each in roles if role is Role.COUNTERSIGNER]
    if len(signers) != 1:
        return
    for file in inventory.files:
        if file.is_signed and file.path not in in_enclaves:
            [ca] = signers.values()
            yield Pair(file, ca, counters[0] if counters else None, None, ())


def _is_ours(pair: Pair) -> bool:
    """Whether there is one signature and it names the CA; other rules cover other cases."""
    named = signers(pair.file)
    return len(named) == 1 and is_by(named[0], pair.ca) and text(pair.file) is not None


def _problems(pair: Pair) -> tuple[Problem, ...]:
    if not _is_ours(pair) or uncheckable(pair):
        return ()
    known = _REFUSALS.setdefault(pair.file, {})
    second = pair.alternative_ca.fingerprint if pair.alternative_ca else None
    key = (pair.ca.fingerprint, second)
    if key not in known:
        known[key] = _refusal(pair)
    return known[key]


def _refusal(pair: Pair) -> tuple[Problem, ...]:
    try:
        if pair.anchors:
            pair.anchors.signatures(pair.file.data)
        else:
            verify(pair.file.data, pair.ca, alternative_ca=pair.alternative_ca)
    except VerificationError as error:
        return error.problems
    return ()


# Cached, because several rules need them and all enclaves share one governance. An entry is
# removed together with its subject.
_PAIRS: WeakKeyDictionary[Inventory, tuple[Pair, ...]] = WeakKeyDictionary()
_LISTED: WeakKeyDictionary[File, tuple[Listed | None, str | None]] = WeakKeyDictionary()
_REFUSALS: WeakKeyDictionary[File, dict[tuple[str, str | None], tuple[Problem, ...]]] = (
    WeakKeyDictionary()
)


def _listed(file: File) -> tuple[Listed | None, str | None]:
    """(its signatures and certificates, None), or (None, why it cannot be read)."""
    found = _LISTED.get(file)
    if found is None:
        try:
            found = signers_in(file.data), None
        except PqsecError as error:
            found = None, str(error)
        _LISTED[file] = found
    return found
