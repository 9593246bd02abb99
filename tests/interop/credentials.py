"""Certificates of key kinds that no profile brings together."""

from collections.abc import Mapping
from datetime import datetime, timedelta

from pqsec_pki.algorithms import SIGNATURES, private_key_pem
from pqsec_pki.certificates import Authority

DAY = timedelta(days=1)

Files = Mapping[str, bytes]
"""Some of a participant's files, by name."""


def enrolled(ca: str, kind: str, now: datetime, *names: str) -> list[Files]:
    """What identity CA, certificate and key of /lab/`name` are where keys have these kinds."""
    authority = Authority.create("Identity CA", SIGNATURES.named(ca), now=now, validity=90 * DAY)
    return [_issued(authority, kind, now, f"/lab/{name}") for name in names]


def _issued(authority: Authority, kind: str, now: datetime, name: str) -> Files:
    key = SIGNATURES.named(kind).generate()
    certificate = authority.issue(name, key.public_key, now=now, validity=30 * DAY)
    return {
        "identity_ca.cert.pem": authority.certificate.pem,
        "cert.pem": certificate.pem,
        "key.pem": private_key_pem(key),
    }
