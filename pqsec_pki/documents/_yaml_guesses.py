"""How YAML reads text without quotes: NO is false, 010 is eight, 2026-01-01 is a date."""

import re
from functools import cache
from typing import Any

TAG = "tag:yaml.org,2002:"
"""The prefix of YAML's own types."""

# The types of text without quotes in YAML 1.1, and with the last two in 1.2.
_GUESSES = {"bool": "true or false", "int": "a number", "float": "a number", "null": "nothing",
            "timestamp": "a date", "merge": "a merge key", "value": "a default key"}  # fmt: skip
_OCTAL_1_2 = re.compile(r"0o[0-7]+\Z")
_FLOAT_1_2 = re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+\Z")


def guess(text: str) -> str | None:
    """The type that YAML would give this text without quotes; None if it is text."""
    import yaml  # noqa: PLC0415 - `pqsec --help` must not load yaml

    tag = _resolver().resolve(yaml.ScalarNode, text, (True, False)).removeprefix(TAG)
    return None if tag == "str" else _GUESSES.get(tag, "not text")


@cache
def _resolver() -> Any:
    import yaml  # noqa: PLC0415 - `pqsec --help` must not load yaml

    class Resolver(yaml.resolver.Resolver):
        """Finds the type that YAML 1.1 or 1.2 gives plain text."""

    add_guesses(Resolver)
    return Resolver()


def add_guesses(resolver: Any) -> None:
    """Add the types of YAML 1.2 to a resolver of yaml, which has those of YAML 1.1."""
    resolver.add_implicit_resolver(f"{TAG}int", _OCTAL_1_2, ["0"])
    resolver.add_implicit_resolver(f"{TAG}float", _FLOAT_1_2, list("-+0123456789"))
