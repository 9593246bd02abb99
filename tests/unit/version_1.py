"""Certificates of version 1, as the tutorials of some DDS products make their CAs."""

from pqsec_pki._asn1 import Signed, TBSCertificate, bits, decode, encode, raw
from pqsec_pki.algorithms import PrivateKey
from pqsec_pki.certificates import Certificate


def in_version_1(certificate: Certificate, key: PrivateKey) -> Certificate:
    """`certificate` without all that version 1 cannot say, signed again with its issuer's `key`."""
    tbs = decode(TBSCertificate, certificate.tbs, "tbs")
    tbs.version, tbs.extensions = 0, None
    content = encode(tbs)
    signed = Signed(
        tbs=raw(content),
        signature_algorithm=tbs.signature,
        signature=bits(key.sign(content)),
    )
    return Certificate.from_der(encode(signed))
