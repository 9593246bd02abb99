"""What a rule is, and how one is written.

A rule is a function that finds violations, decorated with what a reader should know about it:

    @lint_rule(
        "PQS217", Severity.ERROR, "a rule without domains",
        why="Cyclone DDS crashes on it and Fast DDS refuses the document.",
        fix="Add <domains> as the first element of the rule.",
        bad="<allow_rule/>",
        good="<allow_rule><domains><id>0</id></domains></allow_rule>",
        rows=("rule without `<domains>`",),
    )
    def rule_without_domains(document: PermissionsFile) -> Iterator[Violation]:
        yield Violation("this rule names no domains", line)

The class of its argument is the rule's scope: the function is called for every subject of that
class (see `file`, `document` and `subjects`) and of its subclasses. `bad` and `good` are a short
example: a piece of XML, a suppression file, or commands. rules.md is generated from the
texts, and `tests/cli/test_rule_examples.py` tries each example. `table` finds all modules here.
"""

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import field
from enum import StrEnum
from inspect import cleandoc
from pathlib import Path
from typing import Any, Self, TypeAlias, TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki.problems import Code
from pqsec_pki.stacks import Stack

Check = TypeVar("Check", bound=Callable[[Any], Iterable[Any]])
Affected: TypeAlias = Mapping[Stack, str]
"""The stacks for which a finding holds, each with its versions; "" means that none was found for
which it does not. An empty one means all stacks, or that the finding is about security."""

RULES: dict[str, "Rule"] = {}
"""By id, in the order in which modules were imported; `table` sorts them."""
CYCLONE: Affected = {Stack.CYCLONEDDS: "0.10.2, 0.10.5, 11.0.1"}
FAST: Affected = {Stack.FASTDDS: "2.9.1, 3.1.2, 3.6.2"}
"""The versions in which most rules were measured."""


def stacks_text(affected: Affected) -> str:
    """Such as `Cyclone DDS 0.10.2, 11.0.1; OpenDDS`."""
    return "; ".join(f"{stack.product} {affected[stack]}".strip() for stack in affected)


CYCLONES = stacks_text(CYCLONE)
SIX_STACKS = stacks_text({**CYCLONE, **FAST})
FAMILIES = {
    "0": "frame",
    "1": "x509",
    "2": "documents",
    "3": "cross-artefact",
    "4": "naming",
    "5": "size",
    "6": "post-quantum",
    "7": "files",
    "8": "configuration",
}
"""Hundreds of a rule's number -> the family that reports name."""


class Severity(StrEnum):
    """An error does not work or is a vulnerability; a warning is a risk."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


@dataclass(frozen=True, slots=True)
class Violation:
    """One place where a rule is violated, as the rule's function reports it."""

    message: str
    """One line, for an engineer who is not an expert."""
    line: int | None = None
    """The line in the file, counted from 1."""
    path: Path | None = None
    """The path, if it differs from the subject's own path."""
    code: Code | None = None
    """The code of the problem, if it is one of the credentials."""
    stacks: Affected | None = field(default=None, hash=False)
    """The stacks for which it holds, if they are not those of its rule."""
    severity: Severity | None = None
    """If it is not that of the rule."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One kind of violation: how to find it, why it matters and how to fix it."""

    id: str
    severity: Severity
    title: str
    why: str
    fix: str
    bad: str
    """A short example of a violation: XML, a suppression file, or commands after `$`."""
    good: str
    """The example of `bad`, corrected. Commands continue after those of `bad`."""
    scope: type
    check: Callable[[Any], Iterable[Violation]]
    stacks: Affected = field(hash=False)
    """The stacks and versions for which it holds."""
    rows: tuple[str, ...] = ()
    """The measurements that it is based on (rows in docs/reference/rules.md)."""
    measured: str = ""
    """Stacks and versions, or another source."""
    only_when_asked: bool = False
    """Whether it runs only if --target names one of its stacks, because what it reports is
    correct for the other stacks."""

    @property
    def family(self) -> str:
        """The family that reports name; of a rule of another package, how its id begins."""
        return FAMILIES[self.id[3]] if self.id.startswith("PQS") else self.id[:-3].lower()

    def to_json(self) -> dict[str, object]:
        """The rule for --json."""
        return {
            "rule": self.id,
            "severity": self.severity.value,
            "family": self.family,
            "title": self.title,
            "why": self.why,
            "fix": self.fix,
            "bad": self.bad,
            "good": self.good,
            "stacks": sorted(self.stacks),
            "versions": dict(sorted(self.stacks.items())),
            "measured": self.measured,
            "only_when_asked": self.only_when_asked,
        }

    def matters_to(self, targets: Collection[str]) -> bool:
        """Whether it holds for one of these targets; no targets means all."""
        return is_about(self.stacks, targets) if targets else not self.only_when_asked

    def runs_for(self, targets: Collection[str]) -> bool:
        """Whether it can find anything for them: some findings hold for other stacks than it."""
        return not self.only_when_asked or self.matters_to(targets)


def is_about(affected: Affected, targets: Collection[str]) -> bool:
    """Whether what holds for `affected` matters to one of these targets; no targets means all."""
    return not (affected and targets) or any(stack in targets for stack in affected)


def lint_rule(  # noqa: PLR0913 -- the fields of a rule, most of them by name
    id_: str,
    severity: Severity,
    title: str,
    *,
    why: str,
    fix: str,
    bad: str,
    good: str,
    stacks: Affected | Iterable[Stack] = (),
    rows: Iterable[str] = (),
    measured: str = "",
    only_when_asked: bool = False,
) -> Callable[[Check], Check]:
    """Register the decorated function as a rule; the class of its argument is the scope.

    `stacks` without versions are meant with all of them. Without `measured`, the versions were run.
    """
    affected = stacks if isinstance(stacks, Mapping) else dict.fromkeys(stacks, "")

    def add(check: Check) -> Check:
        if id_ in RULES:
            raise ValueError(f"two rules are called {id_}")
        scope, *_ = check.__annotations__.values()
        RULES[id_] = Rule(
            id=id_,
            severity=severity,
            title=title,
            why=why,
            fix=fix,
            bad=cleandoc(bad),
            good=cleandoc(good),
            scope=scope,
            check=check,
            stacks=affected,
            rows=tuple(rows),
            measured=measured or (stacks_text(affected) if any(affected.values()) else ""),
            only_when_asked=only_when_asked,
        )
        return check

    return add


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """A violated rule and where: what `pqsec check` prints."""

    rule: Rule
    path: Path
    line: int | None
    message: str
    code: Code | None = None
    """The reason for which the enclave's credentials are refused, if this is it."""
    stacks: Affected = field(default_factory=dict, hash=False)
    """The stacks and versions for which it holds."""
    severity: Severity

    @classmethod
    def of(cls, rule: Rule, found: Violation, path: Path) -> Self:
        """The finding for a violation of the rule, in the file at `path`."""
        return cls(
            rule=rule,
            path=found.path or path,
            line=found.line,
            message=found.message,
            code=found.code,
            stacks=rule.stacks if found.stacks is None else found.stacks,
            severity=found.severity or rule.severity,
        )

    def to_json(self) -> dict[str, object]:
        """The finding for --json."""
        return {
            "rule": self.rule.id,
            "severity": self.severity,
            "code": self.code,
            "path": self.path,
            "line": self.line,
            "message": self.message,
            "stacks": dict(sorted(self.stacks.items())),
            "title": self.rule.title,
            "fix": self.rule.fix,
        }

    @property
    def place(self) -> str:
        """The path, with the line if there is one: FILE:12."""
        return f"{self.path}:{self.line}" if self.line else str(self.path)

    @property
    def stacks_in_brackets(self) -> str:
        """The stacks and versions for which it holds, in brackets after a space, if some."""
        return f" [{stacks_text(self.stacks)}]" if self.stacks else ""

    def __str__(self) -> str:
        return (
            f"{self.place}: {self.severity} {self.rule.id} {self.message}{self.stacks_in_brackets}"
        )
