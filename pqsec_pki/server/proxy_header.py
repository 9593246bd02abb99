"""The PROXY header: what a TCP balancer sends before a connection that it passes on.

By HAProxy's specification "The PROXY protocol, versions 1 & 2"; clauses are of that document.
Version 1 is a line of text, version 2 binary.
"""

import re
from ipaddress import IPv4Address, IPv6Address, ip_address
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError

MOST_OCTETS = 4096
"""Octets of a header of version 2: 52 with addresses of TCP, so all TLVs that exist fit."""
_LINE = 107
"""Octets of a header of version 1, with its end (clause 2.1)."""
_PROXY = b"PROXY "
_TCP = {"TCP4": IPv4Address, "TCP6": IPv6Address}
_PORT = re.compile("0|[1-9][0-9]{0,4}")
_LAST_PORT = 0xFFFF
_SIGNATURE = b"\r\n\r\n\0\r\nQUIT\n"
_FIXED = 16
"""Octets of version 2 before the addresses (clause 2.2)."""
_LOCAL, _OF_CLIENT = 0x20, 0x21
"""Version 2 with its commands LOCAL and PROXY."""
_CLIENT = {0x11: 4, 0x21: 16}
"""Octets of the client's address, by the family: TCP over IPv4 and IPv6."""
_ADDRESSES = {0x00: 0, 0x11: 12, 0x12: 12, 0x21: 36, 0x22: 36, 0x31: 216, 0x32: 216}
"""Octets of all addresses, for each family that there is."""


@dataclass(frozen=True, slots=True)
class ProxyHeader:
    """A header."""

    length: int
    """Octets: what follows is the client's."""
    client: str
    """The client's address; empty for the balancer's own connection, and for what is not TCP."""

    @classmethod
    def of(cls, data: bytes) -> Self | None:
        """The header that the octets begin with; None if more of it is to come.

        MalformedError as soon as they cannot become a header that is short enough.
        """
        if data.startswith(_SIGNATURE[: len(data)]):
            return cls._of_binary(data)
        if data.startswith(_PROXY[: len(data)]):
            return cls._of_text(data)
        raise MalformedError("the connection does not begin with a PROXY header")

    @classmethod
    def _of_text(cls, data: bytes) -> Self | None:
        line, end, _ = data[:_LINE].partition(b"\r\n")
        if not end:
            if len(data) >= _LINE:
                raise MalformedError(f"the PROXY header has no end in its first {_LINE} octets")
            return None
        return cls(len(line) + 2, _client_in(line.decode("ascii", "replace").split(" ")[1:]))

    @classmethod
    def _of_binary(cls, data: bytes) -> Self | None:
        if len(data) < _FIXED:
            return None
        command, family = data[12:14]
        if command not in {_LOCAL, _OF_CLIENT}:
            raise _broken()
        size = int.from_bytes(data[14:16])
        if _FIXED + size > MOST_OCTETS:
            raise MalformedError(f"the PROXY header has more than {MOST_OCTETS} octets")
        if command == _OF_CLIENT and size < _ADDRESSES.get(family, MOST_OCTETS):
            raise _broken()
        if len(data) < _FIXED + size:
            return None
        # LOCAL has no addresses, whatever its family; TLVs behind addresses are skipped.
        octets = _CLIENT.get(family, 0) if command == _OF_CLIENT else 0
        client = str(ip_address(data[_FIXED : _FIXED + octets])) if octets else ""
        return cls(_FIXED + size, client)


def _client_in(words: list[str]) -> str:
    """The address in a header of version 1, without its first word."""
    match words:
        case ["UNKNOWN", *_]:  # the rest is ignored
            return ""
        case [family, client, goal, *ports] if family in _TCP and len(ports) == 2:  # noqa: PLR2004
            if not all(_PORT.fullmatch(each) and int(each) <= _LAST_PORT for each in ports):
                raise _broken()
            try:
                found, _ = (_TCP[family](each) for each in (client, goal))
            except ValueError:
                raise _broken() from None
            if "%" not in client + goal:
                return str(found)
    raise _broken()


def _broken() -> MalformedError:
    return MalformedError("the PROXY header is not of version 1 or 2")
