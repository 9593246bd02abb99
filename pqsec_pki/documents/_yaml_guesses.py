"""What YAML makes of text without quotes: NO is false, 010 is eight, 2026-01-01 a date."""

import re
from functools import cache
from typing import Any

TAG = "tag:yaml.org,2002:"
"""What YAML's own types are called after."""

# What YAML 1.1, and with the last two 1.2, makes of text without quotes.
_GUESSES = {"bool": "true or false", "int": "a number", "float": "a number", "null": "nothing",
            "timestamp": "a date", "merge": "a merge key", "value": "a default key"}  # fmt: skip
_OCTAL_1_2 = re.compile(r"0o[0-7]+\Z")
_FLOAT_1_2 = re.compile(r"[-+]?[0-9]+[eE][-+]?[0-9]+\Z")


def guess(text: str) -> str | None:
    """What YAML would make of this text without quotes, if not text."""
    import yaml  # noqa: PLC0415 - `pqsec --help` must not load yaml

    tag = _resolver().resolve(yaml.ScalarNode, text, (True, False)).removeprefix(TAG)
    return None if tag == "str" else _GUESSES.get(tag, "no text")


@cache
def _resolver() -> Any:
    import yaml  # noqa: PLC0415 - `pqsec --help` must not load yaml

    class Resolver(yaml.resolver.Resolver):
        """What YAML 1.1 or 1.2 would make of plain text."""

    add_guesses(Resolver)
    return Resolver()


def add_guesses(resolver: Any) -> None:
    """Let a resolver of yaml, which knows YAML 1.1, guess as those of 1.2 do too."""
    resolver.add_implicit_resolver(f"{TAG}int", _OCTAL_1_2, ["0"])
    resolver.add_implicit_resolver(f"{TAG}float", _FLOAT_1_2, list("-+0123456789"))
