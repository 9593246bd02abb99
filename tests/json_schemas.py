"""JSON Schema's validators, imported when the first test asks for one.

jsonschema imports a grammar of URIs that takes seconds to compile. It is
postponed until a format is checked that needs it: only bills of materials have such.
"""

import importlib
import json
import sys
from functools import cache
from types import ModuleType
from typing import Any

from pqsec_pki._assets import asset

GRAMMAR = "rfc3987_syntax"


def postpone_grammar() -> None:
    """Before jsonschema is imported: have its grammar compiled when it is used."""
    if GRAMMAR not in sys.modules:
        sys.modules[GRAMMAR] = later = ModuleType(GRAMMAR)
        later.is_valid_syntax = _is_valid_syntax  # type: ignore[attr-defined]


def _is_valid_syntax(*words: str) -> bool:
    if sys.modules[GRAMMAR].is_valid_syntax is _is_valid_syntax:
        del sys.modules[GRAMMAR]
    grammar: Any = importlib.import_module(GRAMMAR)
    return bool(grammar.is_valid_syntax(*words))


def validator(schema: Any) -> Any:
    """A validator for a schema, which must be one."""
    postpone_grammar()
    from jsonschema import Draft202012Validator  # noqa: PLC0415 -- see above

    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


@cache
def schema_of(kind: str) -> Any:
    """The validator that editors have for files of that kind."""
    return validator(json.loads(asset("schemas", f"{kind}.schema.json").read_text()))
