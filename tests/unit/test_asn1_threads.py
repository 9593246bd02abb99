"""ASN.1 structures are made when they are first needed, also where two threads need them."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, BrokenBarrierError

from cryptography.hazmat import asn1

from pqsec_pki import _asn1
from pqsec_pki._asn1 import OneAsymmetricKey, decode
from pqsec_pki.algorithms import SIGNATURES

MEETING = 0.2
"""Seconds that one thread waits inside for the other."""


def test_two_threads_decode_the_first_value_of_a_structure(monkeypatch):
    """Of two CA keys, decrypted at once, one was refused with "wrong passphrase" now and then."""
    make, inside, made = asn1.sequence, Barrier(2), []

    def sequence(kind):
        made.append(kind)
        try:
            inside.wait(MEETING)  # where both come in, they do it at the same time
        except BrokenBarrierError:
            inside.reset()
        return make(kind)

    der = SIGNATURES.named("ecdsa-p256").generate().pkcs8
    anew = _asn1._sequence(
        type("Anew", (), {"__annotations__": dict(OneAsymmetricKey.__annotations__)})
    )
    monkeypatch.setattr(asn1, "sequence", sequence)
    with ThreadPoolExecutor(2) as pool:
        keys = list(pool.map(lambda _: decode(anew, der, "private key"), range(2)))
    assert [each.version for each in keys] == [0, 0]
    assert made.count(anew) == 1
