"""Limits before it is known who asks: connections, and requests in a time; memory is bounded."""

import time
from collections import Counter, OrderedDict
from collections.abc import Callable
from dataclasses import field
from ipaddress import IPv6Address, ip_address

from pqsec_pki._dataclass import dataclass

MOST_KEYS = 20_000
"""Addresses that are remembered; the one seen longest ago is forgotten first."""
_NETWORK = 64
"""A host of IPv6 may have all addresses of a network."""
_MINUTE = 60.0


@dataclass(slots=True)
class Rate:
    """At most `most` events in a minute for each key, all at once or spread (a token bucket)."""

    most: int
    clock: Callable[[], float] = time.monotonic
    _left: OrderedDict[str, tuple[float, float]] = field(default_factory=OrderedDict)
    """Events that are left, and when that was."""

    def wait(self, key: str) -> int:
        """0 if this event may be; else how many seconds to wait, from 1 on."""
        now = self.clock()
        left, since = self._left.pop(key, (float(self.most), now))
        left = min(float(self.most), left + (now - since) * self.most / _MINUTE)
        allowed = left >= 1
        self._left[key] = (left - allowed, now)
        if len(self._left) > MOST_KEYS:
            self._left.popitem(last=False)
        return 0 if allowed else 1 + int((1 - left) * _MINUTE / self.most)


@dataclass(slots=True)
class RecentKeys:
    """The keys that were added last."""

    _keys: OrderedDict[str, None] = field(default_factory=OrderedDict)

    def add(self, key: str) -> None:
        """Remember it; the one added longest ago is forgotten if there are too many."""
        self._keys[key] = None
        self._keys.move_to_end(key)
        if len(self._keys) > MOST_KEYS:
            self._keys.popitem(last=False)

    def __contains__(self, key: str) -> bool:
        return key in self._keys


@dataclass(slots=True)
class Connections:
    """Counts open connections, of all and of each address."""

    most: int
    most_of_address: int
    open: Counter[str] = field(default_factory=Counter)

    @property
    def total(self) -> int:
        """How many are open."""
        return self.open.total()

    def admit(self, address: str) -> bool:
        """Whether one more may be open from there; then it is counted."""
        if self.total >= self.most or self.open[address] >= self.most_of_address:
            return False
        self.open[address] += 1
        return True

    def closed(self, address: str) -> None:
        """One from there is open no more."""
        self.open[address] -= 1
        if self.open[address] <= 0:
            del self.open[address]


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
