"""Limits before the client is known: connections, and requests in a time; memory is bounded."""

import time
from collections import Counter, OrderedDict
from collections.abc import Callable
from dataclasses import field
from typing import Any

from pqsec_pki._dataclass import dataclass
from pqsec_pki.server.configuration import ServerLimits

MOST_KEYS = 20_000
"""Addresses that are remembered; the one seen longest ago is forgotten first."""
_MINUTE = 60.0
_CONNECTIONS = 2
"""In a minute, as a multiple of requests: a client that asks too often first gets 429, and then no
connection."""


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
class Shares:
    """Objects of a limited kind that clients hold, and that a server may take from them.

    An address holds objects, each with an amount.
    """

    total: int = 0
    _held: dict[str, dict[Any, int]] = field(default_factory=dict)
    _sums: Counter[str] = field(default_factory=Counter)

    def add(self, key: str, held: Any, amount: int = 1) -> None:
        """Add `amount` to what `key` holds of `held`."""
        mine = self._held.setdefault(key, {})
        mine[held] = mine.get(held, 0) + amount
        self._sums[key] += amount
        self.total += amount

    def remove(self, key: str, held: Any) -> None:
        """Remove `held`, if it is there."""
        mine = self._held.get(key, {})
        amount = mine.pop(held, 0)
        self.total -= amount
        self._sums[key] -= amount
        if not mine:
            self._held.pop(key, None)
            del self._sums[key]

    def in_turn(self) -> Any:
        """Remove and return the oldest object of the next address; None if there is none.

        Each address has its turn, however much it holds.
        """
        if not self._held:
            return None
        key = next(iter(self._held))
        found = next(iter(self._held[key]))
        self.remove(key, found)
        if key in self._held:
            self._held[key] = self._held.pop(key)  # the last now
        return found

    def to_give_up(self) -> Any:
        """Remove and return the oldest object of the address with most; None if there is none.

        An address with little keeps it, however much others want.
        """
        if not self._held:
            return None
        key = max(self._sums, key=self._sums.__getitem__)
        found = next(iter(self._held[key]))
        self.remove(key, found)
        return found


@dataclass(slots=True)
class Connections:
    """Counts open connections, of all and of each address.

    If there are too many, one whose request is not complete is closed for a new one.
    """

    limits: ServerLimits
    _often: Rate = field(init=False)
    _addresses: dict[Any, str] = field(default_factory=dict)
    _open: Counter[str] = field(default_factory=Counter)
    _idle: Shares = field(default_factory=Shares)

    def __post_init__(self) -> None:
        self.use(self.limits)

    def use(self, limits: ServerLimits) -> None:
        """Apply these limits from now on."""
        self.limits = limits
        self._often = Rate(_CONNECTIONS * limits.requests_of_address)

    @property
    def total(self) -> int:
        """How many are open."""
        return len(self._addresses)

    def admits(self, address: str) -> bool:
        """Whether that address may have one more."""
        room = self._open[address] < self.limits.connections_of_address
        return room and not self._often.wait(address)

    def to_close(self) -> Any:
        """The connection to close for a new one, no longer counted; None if there is none."""
        found = self._idle.to_give_up()
        self.closed(found)
        return found

    def opened(self, link: Any, address: str) -> None:
        """One from there is open."""
        self._addresses[link] = address
        self._open[address] += 1

    def idle(self, link: Any) -> None:
        """Record that the client of `link` has to send something."""
        if (address := self._addresses.get(link)) is not None:  # of a Unix socket it is empty
            self._idle.add(address, link)

    def busy(self, link: Any) -> None:
        """Record that the client of `link` waits for an answer."""
        if (address := self._addresses.get(link)) is not None:
            self._idle.remove(address, link)

    def closed(self, link: Any) -> None:
        """Record that `link` was closed; callers may call this twice."""
        if (address := self._addresses.pop(link, None)) is not None:
            self._idle.remove(address, link)
            self._open[address] -= 1
            if not self._open[address]:
                del self._open[address]
