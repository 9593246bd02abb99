"""Create certificate requests (PKCS#10, RFC 2986), with proof of possession of the keys.

request.py reads them.
"""

from collections.abc import Sequence
from typing import TypeAlias

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
from pqsec_pki.certificates import _alternative, _beside
from pqsec_pki.certificates.authority import common_name
from pqsec_pki.certificates.request import CertificateRequest

KeyPair: TypeAlias = tuple[PrivateKey, PrivateKey | None]
"""A key and its alternative key, if the profile has one."""


def certificate_request(
    name: str,
    key: PrivateKey,
    alternative: PrivateKey | None = None,
    *,
    further: Sequence[KeyPair] = (),
) -> CertificateRequest:
    """A request for a certificate of CN=`name` for `key`, and its alternative key.

    It carries requests for the keys of `further` sets of credentials, each with its alternative
    key. UsageError if the name is invalid.
    """
    spki = key.public_key.spki
    carried = [_signed(name, *each, first=spki) for each in further]
    return CertificateRequest.from_der(_signed(name, key, alternative, further=carried))


def _signed(
    name: str,
    key: PrivateKey,
    alternative: PrivateKey | None,
    *,
    further: list[bytes] | None = None,
    first: bytes | None = None,
) -> bytes:
    """A request in DER, which carries `further` ones, or belongs beside that for key `first`."""
    info = CertificationRequestInfo(
        version=0,
        subject=raw(common_name(name)),
        subject_public_key_info=raw(key.public_key.spki),
        attributes=[],
    )
    if further:
        _beside.add_further(info, further)
    if first:
        _beside.add_first_key(info, first)
    if alternative:
        _alternative.add_request_proof(info, alternative)
    content = encode(info)
    identifier = decode(AlgorithmIdentifier, key.algorithm.identifier, "AlgorithmIdentifier")
    signature = bits(key.sign(content))
    return encode(Signed(tbs=raw(content), signature_algorithm=identifier, signature=signature))
