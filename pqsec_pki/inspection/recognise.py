"""Recognises what a file is by its content, not by its name."""

import re
from collections.abc import Iterator
from datetime import datetime

from pqsec_pki._asn1 import (
    CertificationRequestInfo,
    ContentInfo,
    Signed,
    SubjectPublicKeyInfo,
    TBSCertificate,
    TBSCertList,
    encode,
)
from pqsec_pki.algorithms import unpem
from pqsec_pki.errors import MalformedError
from pqsec_pki.inspection import _certificate, _document, _key, _request, _revocation
from pqsec_pki.inspection._key import shape
from pqsec_pki.inspection.description import Description
from pqsec_pki.smime import is_signed
from pqsec_pki.tokens import is_reference

_BEGIN = re.compile(rb"^-----BEGIN ([A-Z0-9 ]{1,64})-----", re.MULTILINE)
_HINT = (
    "known are: certificates, private and public keys, requests and revocation lists in PEM or"
    " DER; governance and permissions, as XML or signed"
)
_BYTE_ORDER_MARKS = (b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff")


def describe(data: bytes, *, now: datetime) -> Description:
    """The description of `data`. MalformedError, with a hint, if its kind is not known.

    InvalidDocumentError if it is XML that breaks the schemas of DDS-Security. It verifies only
    the proof of possession of a certificate request.
    """
    if is_signed(data):
        return _document.describe_signed(data, now)
    if is_reference(data):
        return _key.describe_reference(data)
    if _BEGIN.search(data):
        return _pem(data, now)
    if data.startswith(b"\x30"):
        if found := _der(data, now):
            return found
        raise MalformedError(_other_der(data), hint=_HINT)
    if data.lstrip().startswith((b"<", *_BYTE_ORDER_MARKS)):
        return _document.describe_document(data, now)
    raise MalformedError(_other_text(data), hint=_HINT)


def _der(der: bytes, now: datetime) -> Description | None:
    if signed := shape(Signed, der):
        tbs = encode(signed.tbs)
        # In this order: a list of version 1 could be read as a certificate of version 1.
        if shape(TBSCertList, tbs):
            return _revocation.describe_list(der, now)
        if shape(CertificationRequestInfo, tbs):
            return _request.describe_request(der)
        if shape(TBSCertificate, tbs):
            return _certificate.describe_certificate(der, now)
    if shape(SubjectPublicKeyInfo, der):
        return _key.describe_public_key(der)
    return _key.describe_encrypted_key(der) or _key.describe_private_key(der)


def _pem(data: bytes, now: datetime) -> Description:
    parts = tuple(_block(label, block, now) for label, block in _blocks(data))
    known = [part for part in parts if part.kind != "unknown"]
    if not known:
        raise MalformedError(f"it contains nothing of a known kind: {parts[0].title}", hint=_HINT)
    if len(parts) == 1:
        return parts[0]
    return Description("several", f"{len(parts)} things in one file", parts=parts)


def _blocks(data: bytes) -> Iterator[tuple[str, bytes]]:
    """(label, whole block) of each PEM block; each byte is read only a few times."""
    place = 0
    while begin := _BEGIN.search(data, place):
        end = b"-----END " + begin[1] + b"-----"
        stop = data.find(end, begin.end())
        if stop < 0:
            raise MalformedError(f"the PEM block {begin[1].decode()} has no END line")
        place = stop + len(end)
        yield begin[1].decode(), data[begin.start() : place]


def _block(label: str, block: bytes, now: datetime) -> Description:
    if label.endswith("PRIVATE KEY") and b"Proc-Type: 4,ENCRYPTED" in block:
        return _key.describe_traditional_encrypted_key(label)
    for _, der in unpem(block, label):
        if found := _der(der, now):
            return found
    return Description("unknown", f"a PEM block {label}, of an unknown kind or with other content")


def _other_der(der: bytes) -> str:
    if shape(ContentInfo, der):
        return "a bare CMS signature: DDS documents and their signature are one S/MIME file"
    if b"\x02\x01\x03\x30" in der[:10]:
        return "PKCS#12, perhaps: `openssl pkcs12 -nodes` converts it to PEM"
    return "DER of an unknown kind, or damaged"


def _other_text(data: bytes) -> str:
    if not data.strip():
        return "an empty file"
    if re.search(rb"(?im)^content-type:[ \t]*application/(x-)?pkcs7-mime", data[:4096]):
        return "an opaque S/MIME file: DDS documents are multipart/signed, in clear text"
    return "its content is of no known kind"
