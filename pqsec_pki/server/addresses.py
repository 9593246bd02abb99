"""Which addresses count as one client."""

from functools import lru_cache
from ipaddress import IPv6Address, ip_address

_NETWORK = 64
"""A host of IPv6 may have all addresses of a network."""


@lru_cache(maxsize=2048)
def key_of(address: str) -> str:
    """What limits count together: an address of IPv4, or a network of IPv6."""
    try:
        found = ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if isinstance(found, IPv6Address):
        if found.ipv4_mapped:
            return str(found.ipv4_mapped)
        return f"{int(found) >> (128 - _NETWORK):x}"
    return str(found)
