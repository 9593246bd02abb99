"""Which addresses count as one client, and which are of balancers."""

from collections.abc import Iterable
from functools import lru_cache
from ipaddress import IPv4Address, IPv4Network, IPv6Address, IPv6Network, ip_address, ip_network

Network = IPv4Network | IPv6Network
_NETWORK = 64
"""A host of IPv6 may have all addresses of a network."""


@lru_cache(maxsize=2048)
def key_of(address: str) -> str:
    """The unit that limits count: an address of IPv4, or a network of IPv6."""
    found = _address(address)
    if isinstance(found, IPv6Address):
        return f"{int(found) >> (128 - _NETWORK):x}"
    return str(found or address)


def network(text: str) -> Network:
    """An address, or a network as 192.0.2.0/24; ValueError for others, and for all addresses."""
    found = ip_network(text)
    if not found.prefixlen or getattr(found.network_address, "ipv4_mapped", None):
        raise ValueError(text)
    return found


def is_in(address: str, networks: Iterable[Network]) -> bool:
    """Whether the address is of one of the networks."""
    found = _address(address)
    return found is not None and any(found in each for each in networks)


def _address(text: str) -> IPv4Address | IPv6Address | None:
    """The address, of IPv4 also if it is written as of IPv6; None if it is none."""
    try:
        found = ip_address(text.partition("%")[0])
    except ValueError:
        return None
    return (found.ipv4_mapped if isinstance(found, IPv6Address) else None) or found
