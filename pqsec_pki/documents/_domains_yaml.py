"""Reads and writes the domains of a policy in YAML.

The short forms, `0`, `0-3` and `0,2-5`, allow only what every stack accepts. The long forms,
{id: 300}, {min: 5} and {min: 1, max: 9}, allow everything that XML allows.
"""

import re

from pqsec_pki.documents._yaml import Item, Text, YamlMapping, refused
from pqsec_pki.documents._yaml_reading import build, fields, number, one_or_more
from pqsec_pki.documents.domains import DomainRange, DomainSet
from pqsec_pki.errors import UsageError, shown

_LONG = {"id": number, "min": number, "max": number}


def domains(item: Item) -> DomainSet:
    """The domains of a text, a mapping or a list of both."""
    parts = tuple(part for parts in one_or_more(item, _parts) for part in parts)
    return build(item, DomainSet, parts=parts)


def domains_read_alike(item: Item) -> DomainSet:
    """Likewise, in a form that every stack reads alike: what a keystore has as its default."""
    found = domains(item)
    return build(item, lambda: DomainSet.of(*found.parts))


def _parts(item: Item) -> tuple[int | DomainRange, ...]:
    if isinstance(item, YamlMapping):
        return (_long(item),)
    written = item.text if isinstance(item, Text) else ""
    if re.search(r"(?<![0-9])0[0-9]", written):
        raise refused(item, f"'{shown(written)}' begins with 0: YAML reads an octal number")
    return build(item, DomainSet.parse, text=written).parts


def _long(item: YamlMapping) -> int | DomainRange:
    ends = fields(item, _LONG)
    if set(ends) == {"id"}:
        return build(item, _checked_id, domain=ends["id"])
    if "id" in ends or not ends:
        raise refused(item, "write either {id: 7}, or {min: 0, max: 7}")
    return build(item, DomainRange, first=ends.get("min", 0), last=ends.get("max"))


def _checked_id(domain: int) -> int:
    return DomainRange(first=domain).first


def domains_as_yaml(value: DomainSet) -> object:
    """The YAML that `domains` reads as `value`, in the short form if there is one."""
    parts = [_part_as_yaml(part) for part in value.parts]
    return parts[0] if len(parts) == 1 else parts


def _part_as_yaml(part: int | DomainRange) -> object:
    try:
        DomainSet.of(part)
    except UsageError:
        if isinstance(part, DomainRange):
            ends = {"min": part.first, "max": part.last}
            return {end: domain for end, domain in ends.items() if domain is not None}
        return {"id": part}
    return str(part) if isinstance(part, DomainRange) else part
