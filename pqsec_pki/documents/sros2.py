"""Policies of SROS2 (`*.policy.xml`, version 0.2.0) as permissions.

The grants are those of SROS2's own templates: for each enclave first what is denied, then what
is allowed, with topics in the same order. Includes (XInclude) may only name files in the policy's
folder.
"""

from collections.abc import Iterable, Iterator
from datetime import datetime
from fnmatch import fnmatchcase

from pqsec_pki.documents import ros
from pqsec_pki.documents._sros2_reading import Block, PolicyProfiles, read_policy
from pqsec_pki.documents.domains import DomainSet
from pqsec_pki.documents.permissions import Criteria, Grant, PermissionRule, Permissions
from pqsec_pki.documents.ros import Endpoints

__all__ = ["PolicyProfiles", "lacking", "permissions_of", "read_policy"]


def permissions_of(  # noqa: PLR0913 - each has a name
    enclaves: Iterable[PolicyProfiles],
    *,
    domains: DomainSet,
    not_before: datetime,
    not_after: datetime,
    discovery: bool = True,
    node_minimum: bool = False,
) -> Permissions:
    """The grants of the enclaves.

    With `discovery` a last rule allows each to use ros_discovery_info, as SROS2 adds for all
    current RMWs. With `node_minimum` there is no such rule: the rule that allows the policy's
    topics also has each other topic that Jazzy nodes need to start, unless the policy denies it.
    """
    grants = [
        Grant(
            name=enclave.path,
            subject_name=f"CN={enclave.path}",
            not_before=not_before,
            not_after=not_after,
            rules=tuple(_rules(enclave, domains, discovery=discovery, minimum=node_minimum)),
            line=enclave.line,
        )
        for enclave in enclaves
    ]
    return Permissions(grants=tuple(grants))


def lacking(enclave: PolicyProfiles) -> tuple[str, ...]:
    """The DDS topics that Jazzy nodes of the enclave need and the policy does not allow."""
    missing = _missing(enclave, (block for block in enclave.blocks if block.allow))
    topics = dict.fromkeys((*missing.publish, *missing.subscribe))
    return tuple(topic for topic in topics if topic != ros.DISCOVERY)


def _missing(enclave: PolicyProfiles, blocks: Iterable[Block]) -> Endpoints:
    """What its nodes need to start, without what the blocks name."""
    needs = [ros.node_minimum(node) for node in enclave.nodes]
    named = [block.topics for block in blocks]
    return Endpoints(
        publish=_without((each.publish for each in needs), _merged(each.publish for each in named)),
        subscribe=_without(
            (each.subscribe for each in needs), _merged(each.subscribe for each in named)
        ),
    )


def _without(needs: Iterable[tuple[str, ...]], patterns: tuple[str, ...]) -> tuple[str, ...]:
    each_once = dict.fromkeys(topic for need in needs for topic in need)
    return tuple(
        topic for topic in each_once if not any(fnmatchcase(topic, each) for each in patterns)
    )


def _rules(
    enclave: PolicyProfiles, domains: DomainSet, *, discovery: bool, minimum: bool
) -> Iterator[PermissionRule]:
    for allow in (False, True):
        named = [block.topics for block in enclave.blocks if block.allow is allow]
        publish = _merged(topics.publish for topics in named)
        subscribe = _merged(topics.subscribe for topics in named)
        if allow and minimum:
            missing = _missing(enclave, enclave.blocks)
            publish, subscribe = publish + missing.publish, subscribe + missing.subscribe
        if publish or subscribe:
            yield _rule(domains, publish, subscribe, allow=allow)
    if discovery and not minimum:
        yield _rule(domains, (ros.DISCOVERY,), (ros.DISCOVERY,), allow=True)


def _rule(
    domains: DomainSet, publish: tuple[str, ...], subscribe: tuple[str, ...], *, allow: bool
) -> PermissionRule:
    criteria = [(Criteria(topics=topics),) if topics else () for topics in (publish, subscribe)]
    return PermissionRule(allow=allow, domains=domains, publish=criteria[0], subscribe=criteria[1])


def _merged(blocks: Iterable[tuple[str, ...]]) -> tuple[str, ...]:
    """The topics of the blocks, without duplicates; blocks are ordered by their first topics."""
    ordered = sorted((block for block in blocks if block), key=lambda block: block[0])
    return tuple(dict.fromkeys(topic for block in ordered for topic in block))
