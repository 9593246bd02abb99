"""Rules of other installed packages: the entry points `pqsec.lint_rules`.

An entry point is a module that defines rules with `lint_rule`. Its name, in capitals, begins their
ids: `lab` defines LAB001 and so on, and is their family. Who installs a package trusts its code.
"""

import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from importlib.metadata import EntryPoint
from typing import Any

from pqsec_pki._packages import foreign_errors, offered, package_of
from pqsec_pki.errors import PqsecError
from pqsec_pki.lint import rule
from pqsec_pki.lint.rule import Rule, Violation

GROUP = "pqsec.lint_rules"
_NAME = re.compile("(?!pqs$)[a-z]{2,8}")


def load_foreign_rules() -> None:
    """Add their rules to `rule.RULES`; ForeignPackageError for a package that cannot."""
    for entry in offered(GROUP):
        known, package = dict(rule.RULES), package_of(entry)
        with foreign_errors(f"the package {package} cannot add rules"):
            entry.load()
            added = {id_: each for id_, each in rule.RULES.items() if known.get(id_) is not each}
            _refuse(next(_faults(entry, added), None))
        for id_, each in added.items():
            rule.RULES[id_] = replace(each, check=partial(_guarded, package, each))


def _refuse(fault: str | None) -> None:
    if fault:
        raise ValueError(fault)


def _faults(entry: EntryPoint, added: dict[str, Rule]) -> Iterator[str]:
    if not _NAME.fullmatch(entry.name):
        yield f"the name {entry.name!r} is not 2 to 8 small letters, or is pqs"
    if not added:
        yield f"{entry.value} defines no rule"
    for id_, each in added.items():
        if not re.fullmatch(f"{entry.name.upper()}[0-9]{{3}}", id_):
            yield f"the id {id_} is not {entry.name.upper()} and three digits"
        if not isinstance(each.scope, type):
            yield f"the argument of {id_} is annotated with no class"


def _guarded(package: str, wrapped: Rule, subject: Any) -> Iterable[Violation]:
    """The rule's findings. Its failure ends the check: it must not look like no finding."""
    with foreign_errors(f"rule {wrapped.id} of the package {package} failed", PqsecError):
        found: list[Any] = list(wrapped.check(subject))
        wrong = (each for each in found if not isinstance(each, Violation))
        _refuse(next((f"a {type(each).__name__} is not a Violation" for each in wrong), None))
    return found
