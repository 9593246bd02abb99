"""The DDS domains of a rule."""

import re
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import UsageError

MAX_DOMAIN = 230
"""Cyclone DDS refuses documents that name a domain above this one."""

MAX_DOMAIN_ID = (1 << 31) - 1
"""DomainId_t of the DDS API is a signed 32 bit number."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DomainRange:
    """Domains `first` to `last`, both included; without `last` the range has no end.

    Cyclone DDS and Fast DDS read a range without an end as only `first`, contrary to
    DDS-Security 1.1, 9.4.1.2.
    """

    first: int
    last: int | None = None
    no_min: bool = False
    """Whether the document has no <min>, so that it starts at 0."""

    def __post_init__(self) -> None:
        _check_id(self.first)
        if self.last is not None:
            _check_id(self.last)

    def __contains__(self, domain: int) -> bool:
        return self.first <= domain and (self.last is None or domain <= self.last)

    def __str__(self) -> str:
        return f"{self.first}-{'' if self.last is None else self.last}"


@dataclass(frozen=True, slots=True, kw_only=True)
class DomainSet:
    """Domain ids and ranges in the order of the document; never empty."""

    parts: tuple[int | DomainRange, ...]

    def __post_init__(self) -> None:
        if not self.parts:
            raise UsageError("a rule must name at least one domain")
        for part in self.parts:
            if not isinstance(part, DomainRange):
                _check_id(part)

    @classmethod
    def of(cls, *parts: int | DomainRange) -> Self:
        """The set of `parts`, in a form that every stack reads alike.

        UsageError for a domain above 230, a range without an end and an empty range.
        """
        for part in parts:
            _readable_everywhere(part)
        return cls(parts=parts)

    @classmethod
    def parse(cls, text: str) -> Self:
        """The inverse of str(): domain ids and ranges such as "0,2-5".

        UsageError for anything else, and as in `of`.
        """
        return cls.of(*(_part(part) for part in text.split(",")))

    @property
    def is_read_alike(self) -> bool:
        """Whether every stack reads all of it alike: `of` takes it, and `parse` its text."""
        try:
            self.of(*self.parts)
        except UsageError:
            return False
        return True

    @property
    def noun(self) -> str:
        """`domain` for one, else `domains`."""
        return "domain" if len(self.parts) == 1 and isinstance(self.parts[0], int) else "domains"

    @property
    def words(self) -> str:
        """The domains with the noun: `domain 0`, `domains 0-3`."""
        return f"{self.noun} {self}"

    def ids(self) -> list[int]:
        """The domains in the set that a stack can join (0 to 230), ascending."""
        return [domain for domain in range(MAX_DOMAIN + 1) if domain in self]

    def __contains__(self, domain: int) -> bool:
        return any(
            domain in part if isinstance(part, DomainRange) else domain == part
            for part in self.parts
        )

    def __str__(self) -> str:
        return ",".join(map(str, self.parts))


def _part(text: str) -> int | DomainRange:
    found = re.fullmatch(r"\s*([0-9]{1,10})(?:-([0-9]{1,10}))?\s*", text)
    if not found:
        raise UsageError(f"{text!r} is not a domain", hint="write 0, or 0-3, or 0,2-5")
    first, last = found.groups()
    return DomainRange(first=int(first), last=int(last)) if last else int(first)


def _check_id(domain: int) -> None:
    if not 0 <= domain <= MAX_DOMAIN_ID:
        raise UsageError(f"a domain id is between 0 and {MAX_DOMAIN_ID}")


def _readable_everywhere(part: int | DomainRange) -> None:
    last = part.last if isinstance(part, DomainRange) else part
    if last is None:
        raise UsageError(
            f"domains {part} has no end: Cyclone DDS and Fast DDS read it as one domain",
            hint=f"end it with {MAX_DOMAIN}, the largest domain id",
        )
    if last > MAX_DOMAIN:
        raise UsageError(f"domain {last} is above {MAX_DOMAIN}, Cyclone DDS's largest")
    if isinstance(part, DomainRange) and part.first > last:
        raise UsageError(f"domains {part} is an empty range")
