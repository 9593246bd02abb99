"""Signed governance and permissions: sign() and verify().

The signer is known before the file is read: the permissions CA, pinned by its
certificate. Certificates inside the file are for stock stacks; verify() ignores them.
"""

from collections.abc import Iterator
from dataclasses import field
from datetime import datetime
from enum import StrEnum
from functools import cached_property
from itertools import islice

from pqsec_pki._asn1 import TLV, SignedData, SignerInfo, raw
from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import Family, SignatureAlgorithm
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import MalformedError, PqsecError, VerificationError
from pqsec_pki.problems import Code, Problem
from pqsec_pki.smime import _ber, _canonical, _cms, _mime, _reading, _signer_info
from pqsec_pki.smime._signer_info import DATA, Signer
from pqsec_pki.smime.signed_file import SignedFile

MAX_COUNTERSIGNATURES = 16
"""pqsec writes one. Each one takes a verification, and no signature covers their number."""
MAX_CARRIED = 32 << 10
"""Bytes of a CMS structure for `joined`, whose input is not verified. One with two signatures by
the largest keys has 10 kB."""
MAX_CARRIED_VALUES = 512
"""ASN.1 values in it, because each costs about a microsecond. One with two signatures has 80."""
_CLASSICAL = {Family.CLASSICAL, Family.HYBRID}
_PQ = {Family.PQ, Family.HYBRID}


class Require(StrEnum):
    """Which signatures a file must have; all that it has must be valid in any case."""

    ANY = "any"
    CLASSICAL = "classical"
    PQ = "pq"
    BOTH = "both"


@dataclass(frozen=True, slots=True)
class FoundSignature:
    """A signature that was verified."""

    algorithm: SignatureAlgorithm
    countersignature: bool
    signed_at: datetime | None
    number: int | None = None
    """The sequence number (RFC 2985 5.3.5): a keystore signs later documents with larger ones."""

    def to_json(self) -> dict[str, object]:
        """Its values, for JSON."""
        return {
            "algorithm": self.algorithm.name,
            "family": self.algorithm.family.value,
            "countersignature": self.countersignature,
            "signed_at": self.signed_at,
        }


@dataclass(frozen=True)  # no slots, for cached properties
class Verified:
    """A signed document whose signatures were verified."""

    document: bytes
    """The XML, with CRLF line ends as it was signed."""
    signatures: tuple[FoundSignature, ...]
    unchecked: int
    """Number of countersignatures that were not checked, since their certificate was not given."""
    lines_before: int
    """Number of lines of the file that was read before the document."""
    _parts: tuple[bytes, SignerInfo, list[SignerInfo], TLV | None] = field(
        repr=False, compare=False
    )

    @cached_property
    def message(self) -> bytes:
        """The S/MIME file in pqsec's canonical form, with verified content only.

        Install and pass on this file, not the one received. Unchecked countersignatures are in it
        only if no certificate was given to check any.
        """
        return _canonical.file_of(*self._parts)


def sign(  # noqa: PLR0913 -- the rarer ones by name
    document: bytes,
    signer: Signer,
    *,
    countersigner: Signer | None = None,
    embed_certificate: bool = True,
    number: int | None = None,
    now: datetime,
) -> bytes:
    """The S/MIME file of `document` (LF line ends on disk).

    `countersigner` signs the signature, in an unsigned attribute that stock stacks
    skip. Stock stacks (Cyclone DDS 0.10, Fast DDS 2.9) need the signer's certificate
    embedded; peers that pin it do not. `number` is the document's sequence number, by which robots
    know an older one. MalformedError if no stack can read the file:
    `document` has a NUL, or is over 8 MiB with its signature.
    """
    content = _mime.content_of(document)
    info = _signer_info.make(signer, content, now=now, number=number)
    counters = (
        [_signer_info.make(countersigner, info.signature, now=now, counter=True)]
        if countersigner
        else []
    )
    certificate = raw(signer.certificate.der) if embed_certificate else None
    message = _canonical.file_of(content, info, counters, certificate)
    _reading.read(message)
    return message


def verify(
    message: bytes | SignedFile,
    ca: Certificate,
    *,
    alternative_ca: Certificate | None = None,
    require: Require = Require.ANY,
    pinned: bool = False,
) -> Verified:
    """The document in `message` if `ca` itself signed it; VerificationError otherwise.

    A countersignature by `alternative_ca` is checked if present; with `pinned` it is required.
    `require` refuses a file without a classical or post-quantum signature, so that neither
    can be stripped. certificates.verify_authority checks whether `ca` is a CA and valid now.
    """
    try:
        file = SignedFile.of(message)
        reading, data = file.reading, file.cms
        info = _signer(data)
        document = reading.document
        problems = list(_problems(info, reading.content, ca))
        counters = _counters(info)
        signatures, refused = _check_counters(counters, info, alternative_ca)
        main = FoundSignature(
            ca.public_key.algorithm,
            countersignature=False,
            signed_at=_signer_info.signing_time(info),
            number=_signer_info.sequence_number(info),
        )
    except VerificationError:
        raise
    except PqsecError as error:
        ambiguous = isinstance(error, _reading.AmbiguousError)
        code = Code.READERS_DISAGREE if ambiguous else Code.NOT_SIGNED
        raise VerificationError(str(error), code=code, hint=error.hint) from error
    problems += refused
    found = (main, *(signature for _, signature in signatures))
    missing = list(_missing(found, require))
    problems += missing
    if pinned and alternative_ca and not (signatures or refused or missing):
        words = f"there is no countersignature by {alternative_ca.subject_name}"
        problems.append(Problem(words, Code.SIGNATURE_MISSING))
    if problems:
        raise VerificationError(*problems)
    kept = [counter for counter, _ in signatures] if alternative_ca else counters
    certificate = raw(ca.der) if data.certificates else None
    unchecked = len(counters) - len(signatures)
    parts = reading.content, info, kept, certificate
    return Verified(document, found, unchecked, reading.lines_before, parts)


def document_in(message: bytes | SignedFile) -> bytes:
    """The document in `message`, not verified: only for display.

    MalformedError if it is not S/MIME; AmbiguousError if DDS stacks would find another one.
    """
    return SignedFile.of(message).document


def is_canonical(message: bytes | SignedFile) -> bool:
    """Whether S/MIME `message` is in pqsec's canonical form. Nothing is verified."""
    file = SignedFile.of(message)
    try:
        info = _signer(file.cms)
        certificate = file.cms.certificates[0] if file.cms.certificates else None
        content = file.reading.content
        canonical = _canonical.file_of(content, info, _counters(info), certificate)
    except PqsecError:
        return False
    return canonical == file.message


def parts_of(message: bytes | SignedFile) -> tuple[bytes, bytes]:
    """The CMS structure (canonical DER, no certificate embedded) and the document (LF line ends).

    `joined` makes a file of them. Nothing is verified. MalformedError if S/MIME `message` cannot
    be divided like this, since its signed part has other headers or line ends than pqsec writes.
    """
    file = SignedFile.of(message)
    info, document = _signer(file.cms), file.document.replace(b"\r\n", b"\n")
    if file.reading.content != _mime.content_of(document):
        raise MalformedError(
            "the signed part is not in pqsec's canonical form",
            hint="sign the document again with `pqsec`",
        )
    return _canonical.cms_of(info, _counters(info), None), document


def joined(cms: bytes, document: bytes) -> bytes:
    """The canonical S/MIME file of the parts of `parts_of`; nothing is verified.

    Different parts make different files. MalformedError if the parts are not in canonical form,
    or the CMS structure is larger than MAX_CARRIED or has more than MAX_CARRIED_VALUES.
    """
    if len(cms) > MAX_CARRIED:
        raise MalformedError(f"a CMS structure larger than {MAX_CARRIED} bytes is not carried")
    _ber.limit_values(cms, MAX_CARRIED_VALUES)
    info = _signer(_cms.parse(cms))
    unclear = b"\r" in document or b"\0" in document
    if unclear or _canonical.cms_of(info, _counters(info), None) != cms:
        raise MalformedError("the parts of the signed document are not in canonical form")
    return _canonical.joined(_mime.content_of(document), info, cms)


def _signer(data: SignedData) -> SignerInfo:
    """The only signer. Every stack was measured to refuse two, in any order."""
    infos = data.signer_infos.as_list()
    if len(infos) != 1:
        raise MalformedError(f"{len(infos)} signers; DDS stacks take exactly one")
    if data.encapsulated_content.content is not None:
        raise MalformedError("the CMS structure has content of its own")
    if data.encapsulated_content.content_type.dotted_string != DATA:
        raise MalformedError("the CMS structure is not about plain data")
    return infos[0]


def _counters(info: SignerInfo) -> list[SignerInfo]:
    counters = list(islice(_signer_info.countersignatures(info), MAX_COUNTERSIGNATURES + 1))
    if len(counters) > MAX_COUNTERSIGNATURES:
        raise MalformedError(f"more than {MAX_COUNTERSIGNATURES} countersignatures")
    return counters


def _problems(info: SignerInfo, content: bytes, ca: Certificate) -> Iterator[Problem]:
    if not _signer_info.names(info, ca):
        yield Problem(
            f"not signed by {ca.subject_name} but by another certificate", Code.WRONG_SIGNER
        )
        return
    yield from _signer_info.problems(info, content, ca)


def _check_counters(
    counters: list[SignerInfo], info: SignerInfo, ca: Certificate | None
) -> tuple[list[tuple[SignerInfo, FoundSignature]], list[Problem]]:
    """The valid countersignatures by `ca`, and the problems of the others."""
    good: list[tuple[SignerInfo, FoundSignature]] = []
    bad: list[Problem] = []
    for counter in counters:
        if ca is None or not _signer_info.names(counter, ca):
            continue
        problems = list(_signer_info.problems(counter, info.signature, ca, counter=True))
        bad += [
            Problem(f"the countersignature: {problem}", Code.COUNTERSIGNATURE_BAD)
            for problem in problems
        ]
        if not problems:
            when = _signer_info.signing_time(counter)
            found = FoundSignature(ca.public_key.algorithm, True, when)  # noqa: FBT003 -- field
            good.append((counter, found))
    return good, bad


def _missing(found: tuple[FoundSignature, ...], require: Require) -> Iterator[Problem]:
    families = {each.algorithm.family for each in found}
    if require in {Require.CLASSICAL, Require.BOTH} and not families & _CLASSICAL:
        yield Problem(
            "there is no classical signature, and one is required", Code.SIGNATURE_MISSING
        )
    if require in {Require.PQ, Require.BOTH} and not families & _PQ:
        yield Problem(
            "there is no post-quantum signature that could be checked, and one is required",
            Code.SIGNATURE_MISSING,
        )
