"""Roles as values of JSON, as they are in the grants of registration authorities, and back."""

from collections.abc import Mapping
from typing import Any

from pqsec_pki.documents import DomainSet
from pqsec_pki.documents.parts_yaml import Item, Items, Text, YamlMapping
from pqsec_pki.domain._placeholders import OWN, digest_of
from pqsec_pki.domain.desired import Role
from pqsec_pki.errors import MalformedError, UsageError

_ANY = "/any/name"
_BOOLEANS = {"true": True, "false": False}


def role_value(role: Role, domains: DomainSet) -> dict[str, object]:
    """The role with the domains that it has, or these.

    UsageError if it has placeholders for values that only a domain file gives.
    """
    if others := sorted(role.placeholders - {*OWN}):
        raise UsageError(
            f"the role {role.label} needs ${others[0]}, and an order has no values",
            hint="a role for a registration authority may use $name, $base and $parent",
        )
    domains = role.domains or domains
    value: dict[str, object] = {
        "domains": str(domains),
        "placeholders": sorted(role.placeholders),
        "rules": _value(role.item),
    }
    again, _ = role_in(role.label, value)
    if again.grant(_ANY, domains, {}) != role.grant(_ANY, domains, {}):
        raise UsageError(f"the role {role.label} cannot be written into a grant")
    return value


def role_in(label: str, value: Mapping[str, Any]) -> tuple[Role, DomainSet]:
    """The role with that value, and its domains; MalformedError if it is none."""
    try:
        domains, rules = DomainSet.parse(str(value["domains"])), dict(value["rules"])
        item = YamlMapping(1, {key: (_key(key), _item(each)) for key, each in rules.items()})
        placeholders = frozenset(map(str, value["placeholders"]))
        return Role(label, item, placeholders, digest_of(item), domains, None), domains
    except (KeyError, TypeError, ValueError, UsageError, RecursionError) as error:
        raise MalformedError(f"the role {label} of the grant cannot be read: {error}") from error


def _value(item: Item) -> object:
    """YAML's own types of plain texts stay: true and 5 are not 'true' and '5'."""
    match item:
        case Items():
            return [_value(each) for each in item.items]
        case YamlMapping():
            return {key: _value(value) for key, (_, value) in item.entries.items()}
        case Text(text=text, plain=True) if text in _BOOLEANS:
            return _BOOLEANS[text]
        case Text(text=text, plain=True) if text.isascii() and text.isdigit():
            return {_NUMBER: text}
        case Text():
            return item.text


_NUMBER = "$number"
"""The key of a plain number: `$` without a name after it is in no key of a role."""


def _item(value: object) -> Item:
    match value:
        case bool():
            return Text(1, "true" if value else "false", plain=True)
        case str():
            return Text(1, value, plain=False)
        case list():
            return Items(1, [_item(each) for each in value])
        case {"$number": str(number)}:
            return Text(1, number, plain=True)
        case dict():
            return YamlMapping(1, {key: (_key(key), _item(value[key])) for key in value})
        case _:
            raise TypeError("it has other values than a role")


def _key(key: str) -> Text:
    return Text(1, key, plain=False)
