"""The canonical form of a signed file: pqsec writes no other form.

It leaves out everything that no signature covers: other parts and headers, revocation
lists, unknown unsigned attributes, the order of sets, BER encodings.
"""

from collections.abc import Iterable

from pqsec_pki._asn1 import (
    TLV,
    ContentInfo,
    EncapsulatedContentInfo,
    IssuerAndSerialNumber,
    Oid,
    SetOf,
    SignedData,
    SignerInfo,
    attribute,
    encode,
)
from pqsec_pki.algorithms import digest_of
from pqsec_pki.smime import _cms, _mime
from pqsec_pki.smime._signer_info import COUNTERSIGNATURE, DATA


def file_of(
    content: bytes, info: SignerInfo, counters: Iterable[SignerInfo], certificate: TLV | None
) -> bytes:
    """The file of the signature `info` over `content`, countersigned by `counters`.

    `certificate` is the signer's, which is embedded if given. UnknownAlgorithmError if the
    digest is not supported.
    """
    return joined(content, info, cms_of(info, counters, certificate))


def joined(content: bytes, info: SignerInfo, der: bytes) -> bytes:
    """The file of the CMS structure `der`, whose signature is `info`, over `content`."""
    digest = digest_of(info.digest_algorithm.algorithm.dotted_string)
    return _mime.join(content, der, digest.micalg)


def cms_of(info: SignerInfo, counters: Iterable[SignerInfo], certificate: TLV | None) -> bytes:
    """The CMS structure (DER) of that file; the parameters are those of `file_of`."""
    signer = _bare(info)
    if countersigned := {encode(_bare(each)) for each in counters}:
        signer.unsigned_attributes = [attribute(COUNTERSIGNATURE, *countersigned)]
    data = SignedData(
        version=signer.version,
        digest_algorithms=SetOf([signer.digest_algorithm]),
        encapsulated_content=EncapsulatedContentInfo(content_type=Oid(DATA), content=None),
        certificates=None if certificate is None else [certificate],
        crls=None,
        signer_infos=SetOf([signer]),
    )
    return encode(ContentInfo(content_type=Oid(_cms.SIGNED_DATA), content=data))


def _bare(info: SignerInfo) -> SignerInfo:
    """`info` with the version for its kind, sorted signed attributes, and no unsigned ones."""
    return SignerInfo(
        version=1 if isinstance(info.sid, IssuerAndSerialNumber) else 3,  # RFC 5652 5.3
        sid=info.sid,
        digest_algorithm=info.digest_algorithm,
        signed_attributes=sorted(info.signed_attributes or [], key=encode),
        signature_algorithm=info.signature_algorithm,
        signature=info.signature,
        unsigned_attributes=None,
    )
