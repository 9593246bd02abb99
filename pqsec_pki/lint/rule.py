"""What a rule is, and how a family of rules is written down.

A family is a module with one table of rules, each the function that looks for a flaw:

    FAMILY = Family("documents")

    @FAMILY.rule(
        "PQS213", Severity.ERROR, PermissionsFile, "a rule names no domains",
        why="Cyclone DDS crashes on it and Fast DDS refuses the document.",
        mend="Add <domains> as the first element of the rule.",
        stacks=(Target.CYCLONEDDS, Target.FASTDDS),
        rows=("rule without `<domains>`",),
    )
    def rule_without_domains(document: PermissionsFile) -> Iterator[Violation]:
        yield Violation("this rule names no domains", line)

The class a function takes is its scope: it is asked about every subject of that class (see
`file`, `document` and `subjects`), and of classes that inherit from it. The page of the rule
is made of its text.
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
    """How bad it is. An error does not work, or is a hole; a warning is a risk."""

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


class Target(StrEnum):
    """A stack that has to live with the files."""

    CYCLONEDDS = "cyclonedds"
    FASTDDS = "fastdds"
    OPENDDS = "opendds"
    CONNEXT = "connext"
    ROS2 = "ros2"


@dataclass(frozen=True, slots=True)
class Violation:
    """One place where a rule is broken, as the rule's function tells it."""

    message: str
    """One line, for an engineer who is no expert."""
    line: int | None = None
    """In the file, counted from 1."""
    path: Path | None = None
    """Where that is not the subject's own path."""
    code: Code | None = None
    """Of the problem with the credentials that this is, if it is one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """One flaw: how to see it, why it matters and what to do."""

    id: str
    severity: Severity
    title: str
    why: str
    fix: str
    family: str
    scope: type
    check: Callable[[Any], Iterable[Violation]]
    stacks: frozenset[Target]
    """Those that trip on it; none means that all do, or that it is about security."""
    rows: tuple[str, ...] = ()
    """The rows of the measurements it stands on (docs/rules.md)."""
    measured: str = ""
    """Stacks and versions, or where else it is known from."""
    only_when_asked: bool = False
    """Whether it is left out unless --target names one of its stacks: what it complains
    of is right for others."""

    def matters_to(self, targets: frozenset[Target]) -> bool:
        """Whether it is asked when these targets were named; none means all."""
        if not targets:
            return not self.only_when_asked
        return not self.stacks or bool(self.stacks & targets)


@dataclass(frozen=True, slots=True)
class Family:
    """The rules of one module."""

    name: str
    rules: list[Rule] = field(default_factory=list)

    def rule(  # noqa: PLR0913 -- what a rule has to say, most of it by name
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
        """Enter the decorated function, which finds the flaw in subjects of class `scope`."""

        def enter(check: Callable[[S], Iterable[Violation]]) -> Callable[[S], Iterable[Violation]]:
            made = Rule(
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
            self.rules.append(made)
            return check

        return enter


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """A rule that is broken somewhere: what `pqsec check` prints."""

    rule: Rule
    path: Path
    line: int | None
    message: str
    code: Code | None = None
    """What an enclave's credentials are refused for, if this is why (`problems.Code`)."""

    def __str__(self) -> str:
        place = f"{self.path}:{self.line}" if self.line else str(self.path)
        return f"{place}: {self.rule.severity} {self.rule.id} {self.message}"
