"""Create certificate requests (PKCS#10, RFC 2986), with proof of possession of the keys.

request.py reads them.
"""

from pqsec_pki._asn1 import (
    AlgorithmIdentifier,
    CertificationRequestInfo,
    Signed,
    bits,
    decode,
    encode,
    raw,
)
from pqsec_pki.algorithms import PrivateKey
from pqsec_pki.certificates import _alternative
from pqsec_pki.certificates.authority import common_name
from pqsec_pki.certificates.request import CertificateRequest


def certificate_request(
    name: str, key: PrivateKey, alternative: PrivateKey | None = None
) -> CertificateRequest:
    """A request for a certificate of CN=`name` for `key`, and its alternative key.

    UsageError if the name is invalid.
    """
    info = CertificationRequestInfo(
        version=0,
        subject=raw(common_name(name)),
        subject_public_key_info=raw(key.public_key.spki),
        attributes=[],
    )
    if alternative:
        _alternative.add_request_proof(info, alternative)
    content = encode(info)
    identifier = decode(AlgorithmIdentifier, key.algorithm.identifier, "AlgorithmIdentifier")
    signature = bits(key.sign(content))
    whole = Signed(tbs=raw(content), signature_algorithm=identifier, signature=signature)
    return CertificateRequest.from_der(encode(whole))
