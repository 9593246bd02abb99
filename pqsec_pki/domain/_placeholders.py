"""Placeholders of a role: `$name` in its texts, replaced for each participant."""

import hashlib
import json
import re
from collections.abc import Collection, Iterator, Mapping
from string import Template

from pqsec_pki.documents.parts_yaml import Item, Items, Text, YamlMapping, refused

OWN = ("name", "base", "parent")
"""Placeholders that each participant has: /fleet/robot1, robot1 and /fleet."""


_UNFIT = re.compile(r"[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML cannot contain (XML 1.0, 2.2)."""


def fit(item: Text) -> str:
    """The text; InvalidDocumentError for a character that XML cannot contain."""
    if found := _UNFIT.search(item.text):
        raise refused(item, f"XML cannot contain the character {found[0]!r}")
    return item.text


def own_values(name: str) -> dict[str, str]:
    """The values of OWN for the participant called `name`; the parent of /talker is empty."""
    parent, _, base = name.rpartition("/")
    return {"name": name, "base": base, "parent": parent}


def placeholders_in(item: Item) -> frozenset[str]:
    """The placeholder names; InvalidDocumentError for a `$` without a name, and as of `fit`."""
    found: set[str] = set()
    for each in _texts(item):
        template = Template(fit(each))
        if not template.is_valid():
            raise refused(each, "a $ without a name after it; write $$ for the character")
        found.update(template.get_identifiers())
    return frozenset(found)


def filled(item: Item, values: Mapping[str, str]) -> Item:
    """The item with its placeholders replaced; line numbers are kept."""
    match item:
        case Text():
            text = Template(item.text).substitute(values)
            return item if text == item.text else Text(item.line, text, plain=False)
        case Items():
            return Items(item.line, [filled(each, values) for each in item.items])
        case YamlMapping():
            entries = item.entries.items()
            return YamlMapping(
                item.line, {k: (key, filled(value, values)) for k, (key, value) in entries}
            )


def without(item: YamlMapping, keys: Collection[str]) -> YamlMapping:
    """The mapping without these keys."""
    entries = {key: entry for key, entry in item.entries.items() if key not in keys}
    return YamlMapping(item.line, entries)


def digest_of(item: Item) -> str:
    """SHA-256, in hex, of the item's content, independent of lines, comments and key order."""
    return hashlib.sha256(json.dumps(_plain(item), sort_keys=True).encode()).hexdigest()


def _plain(item: Item) -> object:
    match item:
        case Text():
            return item.text
        case Items():
            return [_plain(each) for each in item.items]
        case YamlMapping():
            return {key: _plain(value) for key, (_, value) in item.entries.items()}


def _texts(item: Item) -> Iterator[Text]:
    match item:
        case Text():
            yield item
        case Items():
            for each in item.items:
                yield from _texts(each)
        case YamlMapping():
            for _, value in item.entries.values():
                yield from _texts(value)
