"""How stacks read domains and times, and which documents they cannot read.

Fast DDS reads times as local times (measured, all versions), and OpenDDS compares them with a
clock that is wrong by the zone's offset (read). Here both are taken to run on a machine in UTC.
"""

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

from pqsec_pki.access._patterns import opendds_reads_beyond
from pqsec_pki.documents import (
    MAX_DOMAIN,
    Criteria,
    DomainRange,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    Permissions,
    is_blank,
)

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LAST_SECOND = ((1 << 63) - 1) // 10**9
"""Cyclone DDS counts nanoseconds in 64 bits: April 2262."""
_WIDEST_ZONE = timedelta(hours=12)
"""Of Cyclone DDS; XML has zones up to 14:00."""


def standard_includes(domains: DomainSet, domain: int) -> bool:
    """9.4.1.2: a range without an end contains all domains from its first."""
    return domain in domains


def cyclonedds_includes(domains: DomainSet, domain: int) -> bool:
    """A range without an end contains only its first domain (measured)."""
    return any(_begins_or_holds(part, domain, part.last) for part in _ranges(domains))


def fastdds_includes(domains: DomainSet, domain: int) -> bool:
    """A range without an end, or that ends at 0, contains only its first domain (measured)."""
    return any(_begins_or_holds(part, domain, part.last or None) for part in _ranges(domains))


def _ranges(domains: DomainSet) -> Iterator[DomainRange]:
    for part in domains.parts:
        yield part if isinstance(part, DomainRange) else DomainRange(first=part)


def _begins_or_holds(part: DomainRange, domain: int, last: int | None) -> bool:
    return domain == part.first if last is None else part.first <= domain <= last


def standard_in_force(grant: Grant, now: datetime) -> bool:
    """9.4.1.3.2.2: from its first to its last second."""
    return grant.not_before <= now <= grant.not_after


def fastdds_in_force(grant: Grant, now: datetime) -> bool:
    """As its times are written, whatever their zones, with a clock of whole seconds (measured)."""
    clock, written = now.replace(microsecond=0, tzinfo=None), grant.written
    begin, end = written.not_before, written.not_after
    return begin.replace(tzinfo=None) <= clock <= end.replace(tzinfo=None)


def cyclonedds_in_force(grant: Grant, now: datetime) -> bool:
    """Between the two times.

    A time outside 1970 to 2262 counts as long past, and one in a zone beyond 12:00 (measured).
    """
    begin, end = _seconds(grant.written.not_before), _seconds(grant.written.not_after)
    return begin < (now - _EPOCH).total_seconds() < end


def _seconds(time: datetime) -> float:
    """Since 1970; as long past where Cyclone DDS cannot read it."""
    seconds, offset = (time - _EPOCH).total_seconds(), time.utcoffset() or timedelta()
    written = seconds + offset.total_seconds()
    readable = 0 <= min(seconds, written) <= max(seconds, written) <= _LAST_SECOND
    return seconds if readable and abs(offset) <= _WIDEST_ZONE else float("-inf")


def no_flaw(_governance: Governance, _permissions: Permissions) -> str:
    """The standard reads every document that is valid by its schema."""
    return ""


def cyclonedds_flaw(governance: Governance, permissions: Permissions) -> str:
    """It refuses domains above 230, in governance ranges without domains, and grants without a
    subject (measured)."""
    governed = [rule.domains for rule in governance.domain_rules]
    for domains in [*governed, *(rule.domains for rule in _rules(permissions))]:
        for part in _ranges(domains):
            if max(part.first, part.last or 0) > MAX_DOMAIN:
                return f"Cyclone DDS refuses documents that name a domain above {MAX_DOMAIN}"
    for part in (part for domains in governed for part in _ranges(domains)):
        if _is_empty(part):
            return "Cyclone DDS refuses governance with an empty range of domains"
        if part.no_min:
            return "Cyclone DDS refuses governance with a range of domains without <min>"
    if not all(grant.subject_name for grant in permissions.grants):
        return "Cyclone DDS refuses permissions with an empty subject_name"
    return ""


def fastdds_flaw(_governance: Governance, permissions: Permissions) -> str:
    """It refuses permissions with an empty topic, also one to relay, and grants without a subject
    (measured)."""
    topics = (topic for criteria in _criteria(permissions) for topic in criteria.topics)
    if any(map(is_blank, topics)):
        return "Fast DDS refuses permissions with an empty topic"
    if any(is_blank(grant.subject_name) for grant in permissions.grants):
        return "Fast DDS refuses permissions with an empty subject_name"
    return ""


def opendds_flaw(governance: Governance, permissions: Permissions) -> str:
    """If a bracket in a pattern is not closed, the answers are undefined (measured)."""
    patterns = list(_expressions(governance))
    for criteria in _criteria(permissions):
        patterns += (*criteria.topics, *criteria.partitions)
    found = next(filter(opendds_reads_beyond, patterns), None)
    if found is None:
        return ""
    return f"a bracket of {found!r} is not closed: OpenDDS reads beyond it, its answer is undefined"


def _expressions(governance: Governance) -> Iterator[str]:
    for rule in governance.domain_rules:
        yield from (topic.topic_expression for topic in rule.topic_rules)


def _criteria(permissions: Permissions) -> Iterator[Criteria]:
    for rule in _rules(permissions):
        yield from (*rule.publish, *rule.subscribe, *rule.relay)


def _is_empty(part: DomainRange) -> bool:
    return part.last is not None and part.last < part.first


def _rules(permissions: Permissions) -> Iterator[PermissionRule]:
    for grant in permissions.grants:
        yield from grant.rules
