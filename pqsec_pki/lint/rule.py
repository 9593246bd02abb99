"""What a rule is, and how a family of rules is written.

A family is a module with one table of rules. Each rule is a function that finds violations:

    FAMILY = Family("documents")

    @FAMILY.rule(
        "PQS213", Severity.ERROR, PermissionsFile, "a rule names no domains",
        why="Cyclone DDS crashes on it and Fast DDS refuses the document.",
        fix="Add <domains> as the first element of the rule.",
        stacks=(Target.CYCLONEDDS, Target.FASTDDS),
        rows=("rule without `<domains>`",),
    )
    def rule_without_domains(document: PermissionsFile) -> Iterator[Violation]:
        yield Violation("this rule names no domains", line)

The class that a function takes is its scope: the function is called for every subject of that
class (see `file`, `document` and `subjects`) and of its subclasses. rules.md is generated
from the texts.
Numbers: 0xx frame, 1xx X.509, 2xx documents, 3xx cross-artefact, 4xx naming, 5xx size,
6xx post-quantum, 7xx files.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, TypeVar

from pqsec_pki.problems import Code

S = TypeVar("S")


class Severity(StrEnum):
    """An error does not work or is a vulnerability; a warning is a risk."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


class Target(StrEnum):
    """A stack that is to use the files."""

    CYCLONEDDS = "cyclonedds"
    FASTDDS = "fastdds"
    OPENDDS = "opendds"
    CONNEXT = "connext"
    ROS2 = "ros2"


@dataclass(frozen=True, slots=True)
class Violation:
    """One place where a rule is violated, as the rule's function reports it."""

    message: str
    """One line, for an engineer who is not an expert."""
    line: int | None = None
    """In the file, counted from 1."""
    path: Path | None = None
    """If it differs from the subject's own path."""
    code: Code | None = None
    """The code of the problem, if it is one of the credentials."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One kind of violation: how to find it, why it matters and how to fix it."""

    id: str
    severity: Severity
    title: str
    why: str
    fix: str
    family: str
    scope: type
    check: Callable[[Any], Iterable[Violation]]
    stacks: frozenset[Target]
    """The stacks that it affects; none means all, or that the rule is about security."""
    rows: tuple[str, ...] = ()
    """The measurements that it is based on (rows in docs/reference/rules.md)."""
    measured: str = ""
    """Stacks and versions, or another source."""
    only_when_asked: bool = False
    """Whether it runs only if --target names one of its stacks, because what it reports is
    correct for the other stacks."""

    def matters_to(self, targets: frozenset[Target]) -> bool:
        """Whether the rule runs for these targets; no targets means all."""
        if not targets:
            return not self.only_when_asked
        return not self.stacks or bool(self.stacks & targets)


@dataclass(frozen=True, slots=True)
class Family:
    """The rules of one module."""

    name: str
    rules: list[Rule] = field(default_factory=list)

    def rule(  # noqa: PLR0913 -- the fields of a rule, most of them by name
        self,
        id_: str,
        severity: Severity,
        scope: type[S],
        title: str,
        *,
        why: str,
        fix: str,
        stacks: Iterable[Target] = (),
        rows: Iterable[str] = (),
        measured: str = "",
        only_when_asked: bool = False,
    ) -> Callable[[Callable[[S], Iterable[Violation]]], Callable[[S], Iterable[Violation]]]:
        """Register the decorated function, which finds violations in subjects of class `scope`."""

        def add(check: Callable[[S], Iterable[Violation]]) -> Callable[[S], Iterable[Violation]]:
            rule = Rule(
                id=id_,
                severity=severity,
                title=title,
                why=why,
                fix=fix,
                family=self.name,
                scope=scope,
                check=check,
                stacks=frozenset(stacks),
                rows=tuple(rows),
                measured=measured,
                only_when_asked=only_when_asked,
            )
            self.rules.append(rule)
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

    def __str__(self) -> str:
        place = f"{self.path}:{self.line}" if self.line else str(self.path)
        return f"{place}: {self.rule.severity} {self.rule.id} {self.message}"
