"""All rules, from all modules in this folder and below, and of other packages."""

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules

from pqsec_pki.errors import UsageError
from pqsec_pki.lint import rule
from pqsec_pki.lint.foreign import load_foreign_rules

_HERE = Path(__file__).parent
# Not by the names of files: an installation may have compiled modules only.
for _folder in iter_modules([str(_HERE)]):
    for _module in iter_modules([str(_HERE / _folder.name)]) if _folder.ispkg else ():
        import_module(f"pqsec_pki.lint.{_folder.name}.{_module.name}")

load_foreign_rules()

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
