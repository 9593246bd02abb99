"""Permissions in YAML, for people to write, with one grant for each participant.

    validity: 1y
    grants:
      - name: /talker
        publish: [rt/chatter]
      - name: /listener
        nodes:
          - node: /listener
            subscribe: [chatter]

A grant with `publish`, `subscribe`, `relay` or `nodes` is one allow rule; any other grant has a
list of `rules`, each `allow:` or `deny:`. Nothing else is allowed, unless the grant has
`default: ALLOW`.
"""

from datetime import datetime, timedelta
from functools import partial
from string import Template
from typing import Any

from pqsec_pki import _times
from pqsec_pki._assets import asset
from pqsec_pki._dataclass import dataclass
from pqsec_pki.documents._domains_yaml import domains
from pqsec_pki.documents._rules_yaml import ALLOWED, Readers, built_rule, rule, rules_as_yaml
from pqsec_pki.documents._yaml import Item, Text, dump, refused
from pqsec_pki.documents._yaml_reading import (
    build,
    each,
    fields,
    one_of,
    peeked,
    read,
    table,
    text,
    time,
)
from pqsec_pki.documents.domains import DomainSet
from pqsec_pki.documents.permissions import DefaultAction, Grant, PermissionRule, Permissions
from pqsec_pki.errors import UsageError

BACKDATE = timedelta(days=1)
"""How long before now a validity begins that is given as a duration, as with certificates: clocks
may be slow, and Fast DDS reads the times as local times."""


@dataclass(frozen=True, slots=True)
class _Defaults:
    """The values that all grants share."""

    now: datetime
    domains: DomainSet
    validity: tuple[datetime, datetime]


def permissions_from_yaml(data: bytes, *, now: datetime) -> Permissions:
    """The permissions in the YAML document; a validity such as `1y` counts from `now`.

    InvalidDocumentError lists everything that is wrong.
    """
    return read(data, partial(_permissions, now))


def permissions_to_yaml(value: Permissions) -> bytes:
    """The document, in DDS names, that `permissions_from_yaml` reads as `value`."""
    return dump({"grants": [_grant_as_yaml(grant) for grant in value.grants]})


def new_permissions(
    names: list[str], domains: DomainSet, validity: str, *, nodes: bool = True
) -> bytes:
    """A commented document with a grant for each name, for people to edit.

    With `nodes`, each grant has a ROS 2 node; otherwise it has empty lists of topics.
    """
    whole = asset("templates", "permissions.yaml").read_text("utf-8")
    head, of_node, of_topics = whole.split("---\n")
    grant = Template(of_node if nodes else of_topics)
    written = Template(head).substitute(domains=str(domains), validity=validity)
    quoted = [dump(name).decode().split("\n")[0] for name in names]
    return "".join([written, *(grant.substitute(name=name) for name in quoted)]).encode()


# Reading


def _permissions(now: datetime, item: Item) -> Permissions:
    validity = partial(_validity, now)
    defaults = _Defaults(
        now=now,
        domains=peeked(item, "domains", domains, DomainSet.of(0)),
        validity=peeked(item, "validity", validity, lasting(now, timedelta(365))),
    )
    readers: Readers = {
        "domains": domains,
        "validity": validity,
        "grants": partial(each, reader=partial(_grant, defaults)),
    }
    given = fields(item, readers, required=("grants",))
    return build(item, Permissions, grants=given["grants"])


def _grant(defaults: _Defaults, item: Item) -> Grant:
    common: Readers = {
        "name": text,
        "subject": text,
        "validity": partial(_validity, defaults.now),
        "domains": domains,
        "default": partial(one_of, DefaultAction),
    }
    rules, given = rules_in(defaults.domains, item, common)
    if not given.keys() & {"name", "subject"}:
        raise refused(item, "a grant needs a name, the enclave path of its participant: /talker")
    subject = given.get("subject", f"CN={given.get('name')}")
    before, after = given.get("validity", defaults.validity)
    return build(
        item,
        Grant,
        name=given.get("name", subject),
        subject_name=subject,
        not_before=before,
        not_after=after,
        rules=rules,
        default=given.get("default", DefaultAction.DENY),
        line=item.line,
    )


def rules_in(
    default_domains: DomainSet, item: Item, common: Readers
) -> tuple[tuple[PermissionRule, ...], dict[str, Any]]:
    """The rules of a grant, and the values of its other keys, read by the readers in `common`."""
    keys = table(item).entries
    short = [key for key in ALLOWED if key in keys]
    if "rules" not in keys and not short:
        raise refused(item, "the grant allows nothing: give it publish, subscribe or nodes")
    if "rules" in keys and short:
        key, _ = keys[short[0]]
        raise refused(key, f"the grant has `rules`: write `{key.text}` in one, under `allow:`")
    if "rules" not in keys:
        given = fields(item, common | ALLOWED)
        allowed = {key: given.pop(key) for key in ALLOWED if key in given}
        domain_set = given.get("domains", default_domains)
        return (built_rule(item, domain_set, allowed, allow=True),), given
    domain_set = peeked(item, "domains", domains, default_domains)
    given = fields(item, {**common, "rules": partial(each, reader=partial(rule, domain_set))})
    return given.pop("rules"), given


# Validity


def _validity(now: datetime, item: Item) -> tuple[datetime, datetime]:
    """A duration, or its two ends; without a beginning the validity has begun already."""
    if isinstance(item, Text):
        return build(item, lasting, now=now, duration=duration(item))
    ends = fields(item, {"not_before": time, "not_after": time}, required=("not_after",))
    before, after = ends.get("not_before", now - BACKDATE), ends["not_after"]
    return before, after


def duration(item: Item) -> timedelta:
    """1y, 26w, 90d or 12h. A year has 365 days."""
    written = item.text if isinstance(item, Text) else ""
    found = _times.duration(written)
    if found is None:
        raise refused(item, f"'{written}' is not a duration: write 1y, 26w, 90d or 12h")
    return found


def lasting(now: datetime, duration: timedelta) -> tuple[datetime, datetime]:
    """BACKDATE before now, and the end of the duration; UsageError for an end after 9999."""
    try:
        return now - BACKDATE, now + duration
    except OverflowError:
        raise UsageError(f"{duration.days} days are too long") from None


# Writing


def _grant_as_yaml(grant: Grant) -> dict[str, object]:
    given: dict[str, object] = {"name": grant.name}
    if grant.subject_name != f"CN={grant.name}":
        given["subject"] = grant.subject_name
    given["validity"] = {"not_before": grant.not_before, "not_after": grant.not_after}
    if grant.default is not DefaultAction.DENY:
        given["default"] = grant.default.value
    return given | rules_as_yaml(grant.rules)
