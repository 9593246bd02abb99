"""The second version of the messages: the same values in fewer octets (wire.md, 5.1).

A message is converted when it is written and when it is read, so states, hashes and signatures know
only the values of the first version. The digest of an introduction covers the version, so a message
cannot be converted on its way.
"""

import zlib
from collections.abc import Collection, Mapping
from enum import IntEnum
from functools import lru_cache

from pqsec_pki._der import leading
from pqsec_pki.algorithms import pem, unpem
from pqsec_pki.errors import MalformedError, VerificationError, library_call
from pqsec_pki.handshake._checks import check
from pqsec_pki.handshake.wire import BinaryProperty
from pqsec_pki.problems import Code
from pqsec_pki.smime import joined, parts_of

VERSION = "ver"
"""The binary property that only messages of the second version have."""
MAX_CREDENTIALS = 160 << 10
"""Bytes of `id`, inflated: as S/MIME and PEM they are within the limit for a token."""
_RAW = -15
"""zlib's parameter for DEFLATE without header and checksum (RFC 1951), with a window of 32 KiB."""
_INTRODUCTION = ("id", "pd", "alg")
_ALSO = {
    "Req": {"dh1": "dh1", "ch1": "challenge1"},
    "Reply": {"dh2": "dh2", "ch2": "challenge2", "sig": "signature"},
    "Final": {"sig": "signature"},
}
"""End of the class id -> names of the other properties, and those in the first version."""
CREDENTIALS_DICTIONARY = b"""\
          <partitions>
            <partition></partition>
          </partitions>
          <id_range>
            <min>0</min>
            <max>0</max>
          </id_range>
<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" \
xsi:noNamespaceSchemaLocation="http://www.omg.org/spec/DDS-SECURITY/20170901/\
omg_shared_ca_permissions.xsd">
  <permissions>
    <grant name="/">
      <subject_name>CN=/</subject_name>
      <validity>
        <not_before>2026-01-01T00:00:00Z</not_before>
        <not_after>2027-01-01T00:00:00Z</not_after>
      </validity>
      <allow_rule>
        <domains>
          <id>0</id>
        </domains>
        <publish>
          <topics>
            <topic>rt/</topic>
          </topics>
        </publish>
        <subscribe>
          <topics>
            <topic>rt/</topic>
          </topics>
        </subscribe>
      </allow_rule>
      <default>DENY</default>
    </grant>
  </permissions>
</dds>
"""
"""The preset dictionary of `id`: a permissions document as pqsec writes it."""


class WireVersion(IntEnum):
    """The versions of the three messages. They are equally secure, and never mixed."""

    FIRST = 1
    SECOND = 2

    @property
    def mark(self) -> tuple[BinaryProperty, ...]:
        """The property that hash_c1 and hash_c2 cover besides those of the introduction."""
        return () if self is WireVersion.FIRST else ((VERSION, b"%d" % self),)


FIRST_ONLY = (WireVersion.FIRST,)
"""The default for messages to send and to accept: the version of stock stacks."""


def version_of(found: Mapping[str, bytes]) -> WireVersion:
    """The version of a message with the properties `found`; VerificationError if unknown."""
    if VERSION not in found:
        return WireVersion.FIRST
    if found[VERSION] != WireVersion.SECOND.mark[0][1]:
        raise VerificationError("a message of an unknown version", code=Code.C28)
    return WireVersion.SECOND


def check_version(found: WireVersion, allowed: Collection[WireVersion]) -> None:
    """VerificationError unless it is `allowed`: by the policy, or by the first message."""
    if found not in allowed:
        numbers = " or ".join(f"{each}" for each in allowed)
        words = f"a message of version {found}; allowed here: {numbers}"
        raise VerificationError(words, code=Code.C28)


def names(class_id: str) -> tuple[str, ...]:
    """The binary properties of a message of the second version, in order."""
    also = _ALSO[_kind(class_id)]
    return (VERSION, *(_INTRODUCTION if len(also) > 1 else ()), *also)


def compacted(class_id: str, values: Mapping[str, bytes]) -> tuple[BinaryProperty, ...]:
    """The binary properties in the second version; `values` are those of the first, by name."""
    items = list(WireVersion.SECOND.mark)
    if "c.id" in values:
        algorithms = b"\0".join((values["c.dsign_algo"], values["c.kagree_algo"]))
        credentials = _deflated(values["c.id"], values["c.perm"])
        items += zip(_INTRODUCTION, (credentials, values["c.pdata"], algorithms), strict=True)
    return (*items, *((name, values[first]) for name, first in _ALSO[_kind(class_id)].items()))


def expanded(class_id: str, found: Mapping[str, bytes]) -> dict[str, bytes]:
    """The inverse, without what only the first version repeats; `found` has all of `names`.

    VerificationError if a value cannot be expanded.
    """
    values = {first: found[name] for name, first in _ALSO[_kind(class_id)].items()}
    if "id" in found:
        with check(Code.C27):
            values["c.id"], values["c.perm"] = _inflated(found["id"])
            values["c.pdata"] = found["pd"]
            values["c.dsign_algo"], values["c.kagree_algo"] = _two_names(found["alg"])
    return values


@lru_cache(maxsize=16)
def check_carried(certificate: bytes, permissions: bytes) -> int:
    """The bytes of `id` with these two; MalformedError unless the second version can carry them.

    `certificate` is PEM, and `permissions` the signed document. Cached, because our own are the
    same for every peer.
    """
    try:
        carried = _deflated(certificate, canonical(permissions))
        _inflated(carried)
    except MalformedError as error:
        words = f"version {WireVersion.SECOND:d} of the messages cannot carry our own documents"
        hint = error.hint or "allow only version 1"
        raise MalformedError(f"{words}: {error}", hint=hint) from error
    return len(carried)


@lru_cache(maxsize=16)
def canonical(permissions: bytes) -> bytes:
    """The signed document `permissions` as the second version carries it; errors as parts_of.

    It is the canonical file without an embedded certificate, which only stock stacks need.
    Cached, because our own is the same for every peer.
    """
    return joined(*parts_of(permissions.rstrip(b"\0")))


@lru_cache(maxsize=16)
def _deflated(certificate: bytes, permissions: bytes) -> bytes:
    der = unpem(certificate, "certificate")[0][1]
    compressor = zlib.compressobj(9, wbits=_RAW, memLevel=9, zdict=CREDENTIALS_DICTIONARY)
    return compressor.compress(b"".join((der, *parts_of(permissions)))) + compressor.flush()


def _inflated(data: bytes) -> tuple[bytes, bytes]:
    """The certificate (PEM) and the signed document; MalformedError if they are not canonical."""
    inflater = zlib.decompressobj(wbits=_RAW, zdict=CREDENTIALS_DICTIONARY)
    words = "the credentials are not deflated with pqsec's dictionary"
    with library_call(lambda _: MalformedError(words)):
        whole = inflater.decompress(data, MAX_CREDENTIALS + 1)
    if len(whole) > MAX_CREDENTIALS:
        raise MalformedError(f"credentials larger than {MAX_CREDENTIALS} bytes")
    if not inflater.eof or inflater.unused_data:
        raise MalformedError("the deflated credentials end too soon, or bytes follow them")
    der, cms, document = leading(whole, 2, "certificate with a signature")
    return pem("CERTIFICATE", der), joined(cms, document)


def _two_names(data: bytes) -> list[bytes]:
    found = data.split(b"\0")
    if len(found) != 2:  # noqa: PLR2004 -- c.dsign_algo and c.kagree_algo
        raise MalformedError(f"{len(found)} names of algorithms, not two")
    return found


def _kind(class_id: str) -> str:
    return class_id.partition("+")[2]
