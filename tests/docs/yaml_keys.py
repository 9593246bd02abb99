"""The tables of docs/reference/yaml-keys.md: the keys of YAML files, from their JSON Schemas."""

import json
import re
from collections.abc import Iterator
from typing import Any

from pqsec_pki._assets import asset
from pqsec_pki.documents import PRESETS
from tests.docs.rows import table

Schema = dict[str, Any]
_NODES = """Names are ROS 2 names, not patterns: `chatter` is in the node's namespace, `~/status`
below the node, `/map` is absolute."""
_PLACEHOLDERS = """In any text of a role, `$word` is filled for each participant:

| Placeholder | Value for `/fleet/robot07` |
|---|---|
| `$name` | `/fleet/robot07` |
| `$base` | `robot07` |
| `$parent` | `/fleet` (empty for `/talker`) |
| any other | the column of that name, else the key of `values`; one is required |
| `$$` | the character `$` |

The value of a column is not a pattern: `*`, `?`, `[` and `\\` are allowed only in roles and
`values`."""
_ABOUT = """The keys of governance and permissions ([Policies in YAML](../how-to/policies.md)) and
of `domain.yaml` ([One file for a whole domain](../how-to/domain.md)), and of `serve.yaml`
([Enrolment over a network](../how-to/network.md)). `pqsec schema` prints the schemas, also those
of `.pqsec-check.yaml` and [`pqsec.toml`](plugin.md#what-the-plugin-requires), for editors
([how](../how-to/editors.md))."""


def parts() -> Iterator[str]:
    """The title, and the sections."""
    governance, permissions, domain = map(_schema, ("governance", "permissions", "domain"))
    yield from ("# Keys of the YAML files", _ABOUT)
    whole = _keys(governance, governance["$defs"]["rule"])
    rules = _keys(governance, governance["then"])
    yield from (
        "## Governance",
        table(_HEADS, [*whole, *(row for row in rules if row not in whole)]),
    )
    (topic,) = (each for each in governance["$defs"]["topic"]["anyOf"] if "properties" in each)
    yield from ("### A topic of governance", table(_HEADS, _keys(governance, topic)))
    yield from ("### Presets", table(("Preset", "Purpose", "Protects", "Costs"), _presets()))
    yield from ("## Permissions", table(_HEADS, _keys(permissions, permissions)))
    yield from ("### A grant", table(_HEADS, _keys(permissions, permissions["$defs"]["grant"])))
    (node,) = (each for each in permissions["$defs"]["node"]["anyOf"] if "properties" in each)
    yield from ("### A node", _NODES, table(_HEADS, _keys(permissions, node)))
    yield from ("## The domain file", table(_HEADS, _keys(domain, domain)))
    yield from ("### A role", table(_HEADS, _keys(domain, domain["$defs"]["role"])))
    item = _keys(domain, domain["$defs"]["participants"])
    yield from ("### An item of participants", table(_HEADS, item))
    yield from ("### Placeholders", _PLACEHOLDERS)
    serve = _schema("serve")
    yield from ("## The server's configuration", table(_HEADS, _keys(serve, serve)))
    yield from ("### A factory", table(_HEADS, _keys(serve, serve["$defs"]["factory"])))
    yield from ("### Limits", table(_HEADS, _keys(serve, serve["$defs"]["limits"])))
    check, plugin = map(_schema, ("check", "plugin"))
    (accepted,) = (each["items"] for each in check["properties"].values())
    yield from (
        "## An item of `ignore` in .pqsec-check.yaml",
        table(_HEADS, _keys(check, accepted)),
    )
    yield from ("## The plugin's pqsec.toml", table(_HEADS, _keys(plugin, plugin)))


_HEADS = ("Key", "Meaning", "Values")


def _schema(kind: str) -> Schema:
    found: Schema = json.loads(asset("schemas", f"{kind}.schema.json").read_text())
    return found


def _keys(schema: Schema, mapping: Schema) -> list[tuple[str, str, str]]:
    found = mapping["properties"].items()
    return [(f"`{name}`", _meaning(schema, key), _values(schema, key)) for name, key in found]


def _meaning(schema: Schema, key: Schema) -> str:
    words: str = key.get("description") or _referred(schema, key).get("description", "")
    coded = re.sub(r"(?<!\S)(\{[^}]*\}+)", r"`\1`", words)
    parts = re.split("(`[^`]*`)", coded)
    return "".join(part if part.startswith("`") else part.replace("*", r"\*") for part in parts)


def _values(schema: Schema, key: Schema) -> str:
    referred = _referred(schema, key)
    referred = next((each for each in referred.get("anyOf", ()) if "enum" in each), referred)
    if "enum" in referred:
        return ", ".join(f"`{value}`" for value in referred["enum"])
    return "`true`, `false`" if referred.get("type") == "boolean" else ""


def _referred(schema: Schema, key: Schema) -> Schema:
    """What `$ref` leads to, or the key itself."""
    found = key
    while "$ref" in found:
        path, found = found["$ref"], schema
        for step in path.removeprefix("#/").split("/"):
            found = found[step]
    return found


def _presets() -> Iterator[tuple[str, ...]]:
    for preset in PRESETS:
        yield (f"`{preset.name}`", preset.summary, preset.protects, preset.costs)
