"""Reads roles, and the items of `participants`, which name a role or have rules of their own."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from pqsec_pki.documents import DomainSet
from pqsec_pki.documents.parts_yaml import (
    Item,
    Readers,
    Text,
    YamlMapping,
    chosen,
    domains,
    fields,
    one_or_more,
    refused,
    table,
    text,
)
from pqsec_pki.domain._members import ParticipantItem, device
from pqsec_pki.domain._placeholders import OWN, digest_of, filled, fit, placeholders_in, without
from pqsec_pki.domain.desired import ROLE_KEYS, Role, rules_of, validity_in


def _unread(item: Item) -> Item:
    """Rules of a role are read after its placeholders are replaced."""
    return item


_TERMS: Readers = {"domains": domains, "validity": validity_in}
_ROLE: Readers = dict.fromkeys(ROLE_KEYS, _unread) | _TERMS


def roles_in(item: Item) -> dict[str, Role]:
    """The roles in `roles`, by name."""
    found = table(item)
    readers: Mapping[str, Callable[[Item], Role]] = {
        key: partial(_role, key) for key in found.entries
    }
    return fields(found, readers)


def _role(label: str, item: Item) -> Role:
    settings = fields(item, _ROLE)
    return _made(label, without(table(item), _TERMS), settings)


def _made(label: str, item: YamlMapping, settings: Mapping[str, Any]) -> Role:
    if not item.entries:
        raise refused(item, "allows nothing: give it publish, subscribe, nodes or rules")
    placeholders = placeholders_in(item)
    if not placeholders:
        item = table(filled(item, {}))  # with $ for $$
        rules_of(item, DomainSet.of(0))  # reports mistakes; any domain will do
    return Role(
        label=label,
        item=item,
        placeholders=placeholders,
        digest=digest_of(item),
        domains=settings.get("domains"),
        validity=settings.get("validity"),
    )


def entry_in(roles: Mapping[str, Role] | None, item: Item) -> ParticipantItem:
    """Read one item of `participants`: names, and their role or rules."""
    readers: Readers = {
        "name": partial(one_or_more, reader=_with_line),
        "csv": text,
        "list": text,
        "request": _file_name,
        "order": _file_name,
        "idevid": device,
        "role": text if roles is None else partial(_named_role, roles),
        "values": _values,
    }
    settings = fields(item, readers | _ROLE)
    sources = [key for key in ("name", "csv", "list") if key in settings]
    if len(sources) != 1:
        raise refused(item, "an item must have exactly one of the keys name, csv and list")
    own = without(table(item), [*readers, *_TERMS])
    if own.entries and "role" in settings:
        raise refused(item, "it has a role: put its rules into the role")
    if own.entries:
        settings["role"] = _made("its own", own, settings)
    if "order" in settings and "request" in settings:
        raise refused(item, "it has a request and an order: an order has the requests")
    if "role" not in settings and "csv" not in settings:
        raise refused(item, "it has no rules: add a role, or publish, subscribe, nodes")
    return ParticipantItem(item.line, roles=roles or {}, settings=settings)


def _with_line(item: Item) -> tuple[str, int]:
    return text(item), item.line


def _named_role(roles: Mapping[str, Role], item: Item) -> Role:
    if not roles:
        raise refused(item, "there are no roles in the file")
    return roles[chosen(item, roles)]


def _values(item: Item) -> dict[str, str]:
    found = table(item)
    taken = [key for key, _ in found.entries.values() if key.text in OWN]
    if taken:
        raise refused(taken[0], f"${taken[0].text} is a reserved name")
    return fields(found, dict.fromkeys(found.entries, _value))


def _value(item: Item) -> str:
    return fit(Text(item.line, text(item), plain=False))


def _file_name(item: Item) -> str:
    found = text(item)
    if not found:
        raise refused(item, "the file name is empty")
    return found
