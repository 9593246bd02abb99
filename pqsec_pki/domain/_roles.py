"""Roles, and the items of `participants` that have one or say themselves what they may do."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from pqsec_pki.documents import DomainSet
from pqsec_pki.documents.parts_yaml import (
    Item,
    Readers,
    Table,
    Text,
    chosen,
    domains,
    fields,
    one_or_more,
    refused,
    table,
    text,
)
from pqsec_pki.domain._members import Entry
from pqsec_pki.domain._placeholders import OWN, digest_of, fit, placeholders_in, without
from pqsec_pki.domain.desired import ROLE_KEYS, Role, rules_of, validity_in


def _as_it_is(item: Item) -> Item:
    """What a role says is read once its blanks are filled."""
    return item


_SAID: Readers = {"domains": domains, "validity": validity_in}
_ROLE: Readers = dict.fromkeys(ROLE_KEYS, _as_it_is) | _SAID


def roles_in(item: Item) -> dict[str, Role]:
    """What `roles` says, by the names they have there."""
    found = table(item)
    readers: Mapping[str, Callable[[Item], Role]] = {
        key: partial(_role, key) for key in found.entries
    }
    return fields(found, readers)


def _role(label: str, item: Item) -> Role:
    said = fields(item, _ROLE)
    return _made(label, without(table(item), _SAID), said)


def _made(label: str, item: Table, said: Mapping[str, Any]) -> Role:
    if not item.entries:
        raise refused(item, "allows nothing: give it publish, subscribe, nodes or rules")
    placeholders = placeholders_in(item)
    if not placeholders:
        rules_of(item, DomainSet.of(0))  # what it allows, wherever that will be
    return Role(
        label=label,
        item=item,
        placeholders=placeholders,
        digest=digest_of(item),
        domains=said.get("domains"),
        validity=said.get("validity"),
    )


def entry_in(roles: Mapping[str, Role] | None, item: Item) -> Entry:
    """One item of `participants`: names, and the role they have or what they may do."""
    readers: Readers = {
        "name": partial(one_or_more, reader=_with_line),
        "csv": text,
        "list": text,
        "request": _file_name,
        "role": text if roles is None else partial(_named_role, roles),
        "values": _values,
    }
    said = fields(item, readers | _ROLE)
    sources = [key for key in ("name", "csv", "list") if key in said]
    if len(sources) != 1:
        raise refused(item, "an item has one of the keys name, csv and list")
    own = without(table(item), [*readers, *_SAID])
    if own.entries and "role" in said:
        raise refused(item, "it has a role, so what it may do stands there")
    if own.entries:
        said["role"] = _made("its own", own, said)
    if "role" not in said and "csv" not in said:
        raise refused(item, "what it may do is missing: a role, or publish, subscribe, nodes")
    return Entry(item.line, roles=roles or {}, said=said)


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
        raise refused(taken[0], f"${taken[0].text} is known already")
    return fields(found, dict.fromkeys(found.entries, _value))


def _value(item: Item) -> str:
    return fit(Text(item.line, text(item), plain=False))


def _file_name(item: Item) -> str:
    found = text(item)
    if not found:
        raise refused(item, "no file is named")
    return found
