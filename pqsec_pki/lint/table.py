"""All rules, from all modules in this folder and below."""

from importlib import import_module
from pathlib import Path

from pqsec_pki.errors import UsageError
from pqsec_pki.lint import rule

_HERE = Path(__file__).parent
FOLDERS = tuple(sorted(path.parent.name for path in _HERE.glob("*/__init__.py")))
"""The folders with rules."""
for _folder in FOLDERS:
    for _path in sorted((_HERE / _folder).glob("[a-z]*.py")):
        import_module(f"pqsec_pki.lint.{_folder}.{_path.stem}")

RULES = dict(sorted(rule.RULES.items()))
"""By id, sorted."""


def rule_named(id_: str) -> rule.Rule:
    """The rule with that id; UsageError if there is none."""
    try:
        return RULES[id_.upper()]
    except KeyError:
        raise UsageError(
            f"there is no rule {id_}",
            hint="docs/reference/rules.md lists all rules: PQS001 and so on",
        ) from None
