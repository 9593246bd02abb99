"""Read certificates and revocation lists from PEM files, without ambiguity.

If a file has several values where one is expected, it is refused: another reader could use
another one. Values are cached, since all participants of a domain have the same CAs and list.
"""

from functools import lru_cache

from pqsec_pki.algorithms import exact_der, unpem
from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.errors import MalformedError, located

_MAX_REMEMBERED = 64 << 10
"""Bytes; larger files are read each time."""


def certificates_in(data: bytes, where: str) -> tuple[Certificate, ...]:
    """All certificates in PEM `data`; MalformedError, naming `where`, if stacks could differ."""
    with located(where):
        return _remembered(data) if len(data) <= _MAX_REMEMBERED else _certificates(data)


def only_certificate(data: bytes, where: str) -> Certificate:
    """The only certificate in PEM `data`; MalformedError if there are several, or none."""
    found = certificates_in(data, where)
    if len(found) > 1:
        raise MalformedError(f"{len(found)} certificates, not one", where=where)
    return found[0]


def only_list(data: bytes, where: str) -> RevocationList:
    """The only revocation list in PEM `data`; MalformedError if there is not one."""
    with located(where):
        if data.count(b"-----BEGIN") != 1:
            raise MalformedError("not one revocation list in PEM")
        return _list(data)


def _certificates(data: bytes) -> tuple[Certificate, ...]:
    if der := exact_der("CERTIFICATE", data):  # as pqsec wrote it, so all readers agree
        return (Certificate.shared(der),)
    blocks = unpem(data, "certificate")
    if not blocks:
        raise MalformedError("no certificate in PEM")
    if len(blocks) != data.count(b"-----BEGIN"):
        raise MalformedError("not certificates in PEM, and nothing else")
    if any(label != "CERTIFICATE" for label, _ in blocks):
        raise MalformedError("not certificates alone")
    return tuple(Certificate.shared(der) for _, der in blocks)


_remembered = lru_cache(maxsize=64)(_certificates)
"""The certificates in a file, cached: all participants of a domain have the same CAs."""


@lru_cache(maxsize=8)
def _list(data: bytes) -> RevocationList:
    """A revocation list, cached: all participants of a domain have the same, which may be long."""
    return RevocationList.from_pem(data)
