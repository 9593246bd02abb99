"""JSON Schema's validators, imported when the first test asks for one.

jsonschema compiles grammars as it is imported: a fourth of the time that each worker would take to
collect the tests.
"""

import json
from functools import cache
from typing import Any

from pqsec_pki._assets import asset


def validator(schema: Any) -> Any:
    """A validator for a schema, which must be one."""
    from jsonschema import Draft202012Validator  # noqa: PLC0415 -- see above

    Draft202012Validator.check_schema(schema)
    return Draft202012Validator(schema)


@cache
def schema_of(kind: str) -> Any:
    """The validator that editors have for files of that kind."""
    return validator(json.loads(asset("schemas", f"{kind}.schema.json").read_text()))
