"""What changed since an earlier report, which was written as JSON."""

import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.access import is_known
from pqsec_pki.errors import MalformedError, PqsecError
from pqsec_pki.keystore import Keystore, Line
from pqsec_pki.report.history import events_of
from pqsec_pki.report.signature import MAX_REPORT
from pqsec_pki.report.values import FORMAT, FindingsSection, LedgerEvent, Report, Right

Kind = TypeVar("Kind", dict[str, Any], list[Any])
Value = TypeVar("Value")


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportState:
    """The values of one report that a comparison needs."""

    participants: dict[str, str] | None
    """Name -> serial number and state; None if that report does not have them."""
    rights: frozenset[Right] | None
    """None likewise."""
    topics: frozenset[str]
    """The topics and patterns that a rule named."""
    findings: dict[tuple[str, str, str], str] | None
    """(rule, path, message) -> severity; None likewise."""
    authorities: frozenset[tuple[str, str]] | None
    """(name, fingerprint); None likewise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EarlierReport(ReportState):
    """The state in an earlier report, with its position in the ledger."""

    path: str
    at: str
    head: str
    lines: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Changes:
    """The differences, each as a list; what one of the reports lacks is named in `unknown`."""

    since: str
    """The time of the earlier report."""
    ledger: str
    """What is wrong with the ledger since then; empty if the earlier head is still in it."""
    events: tuple[LedgerEvent, ...]
    appeared: tuple[str, ...]
    disappeared: tuple[str, ...]
    changed: tuple[str, ...]
    """Participants whose certificate or state is another one."""
    granted: tuple[Right, ...]
    removed: tuple[Right, ...]
    new_findings: tuple[str, ...]
    resolved: tuple[str, ...]
    authorities: tuple[str, ...]
    unknown: tuple[str, ...]

    @property
    def count(self) -> int:
        """How many differences there are."""
        return sum(
            map(
                len,
                (
                    *(self.events, self.appeared, self.disappeared, self.changed, self.granted),
                    *(self.removed, self.new_findings, self.resolved, self.authorities),
                ),
            )
        )


def read_earlier(path: Path) -> EarlierReport:
    """The report in the JSON file `path`; MalformedError if it is not one."""
    data = read(path, limit=MAX_REPORT)
    try:
        return _earlier(str(path), json.loads(data))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise MalformedError(
            "not a report of pqsec as JSON",
            where=path,
            hint="make one with `pqsec report --format json -o FILE`",
        ) from error


def _earlier(path: str, found: dict[str, Any]) -> EarlierReport:
    if found["format"] != "pqsec-report" or found["format_version"] != FORMAT:
        raise ValueError("another format")
    evidence, rights, findings = (
        _none_or(dict, found[each]) for each in ("evidence", "rights", "findings")
    )
    participants, authorities = (
        _none_or(list, found[each]) for each in ("participants", "authorities")
    )
    return EarlierReport(
        path=path,
        at=_text(found["at"]),
        head=_text(evidence["head"]) if evidence else "",
        lines=_count(evidence["lines"]) if evidence else 0,
        participants=None
        if participants is None
        else {
            _text(each["name"]): _state(_serials(each), _text(each["state"]))
            for each in participants
        },
        rights=None
        if rights is None
        else frozenset(Right(*map(_text, each)) for each in rights["every"]),
        topics=frozenset(map(_text, rights["topics"])) if rights else frozenset(),
        findings=None
        if findings is None
        else {
            (_text(group["rule"]), _text(each["path"]), _text(each["message"])): _text(
                group["severity"]
            )
            for group in findings["groups"]
            for each in group["places"]
        },
        authorities=None
        if authorities is None
        else frozenset((_text(each["name"]), _text(each["fingerprint"])) for each in authorities),
    )


def _none_or(kind: type[Kind], value: object) -> Kind | None:
    if not (value is None or isinstance(value, kind)):
        raise TypeError(f"not a {kind.__name__}")
    return value


def _count(value: object) -> int:
    if type(value) is not int or value < 0:  # a bool is an int
        raise TypeError("not a number of lines")
    return value


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError("not a text")
    return value


def _serials(row: dict[str, Any]) -> list[str]:
    """The serial numbers of a participant in a report: a report of before had no further sets."""
    return [_text(each["serial"]) for each in (row, *row.get("further", []))]


def _state(serials: Sequence[str], state: str) -> str:
    return f"serial {' and '.join(serials)}, {state}"


def changes_since(earlier: EarlierReport, report: Report, keystore: Keystore) -> Changes:
    """What changed in the keystore, of which `report` was made."""
    now = _state_of(report)
    ledger, events = _events_since(earlier, keystore)
    there, before = _both(now.participants, earlier.participants, {})
    return Changes(
        since=earlier.at,
        ledger=ledger,
        events=events,
        appeared=tuple(sorted(there.keys() - before.keys())),
        disappeared=tuple(sorted(before.keys() - there.keys())),
        changed=tuple(
            f"{name}: {before[name]}; now {state}"
            for name, state in sorted(there.items())
            if name in before and before[name] != state
        ),
        granted=_less(now.rights, earlier.rights, earlier.topics),
        removed=_less(earlier.rights, now.rights, now.topics),
        new_findings=tuple(_words(now.findings, earlier.findings)),
        resolved=tuple(_words(earlier.findings, now.findings)),
        authorities=tuple(_authorities(now, earlier)),
        unknown=tuple(_unknown(now, earlier)),
    )


def _state_of(report: Report) -> ReportState:
    """The state in a report that was just made."""
    participants, rights, authorities = report.participants, report.rights, report.authorities
    return ReportState(
        participants=None
        if participants is None
        else {
            each.name: _state([each.serial, *(row.serial for row in each.further)], each.state)
            for each in participants
        },
        rights=None if rights is None else frozenset(rights.every),
        topics=frozenset(rights.topics) if rights else frozenset(),
        findings=None if report.findings is None else _findings(report.findings),
        authorities=None
        if authorities is None
        else frozenset((each.name, each.fingerprint) for each in authorities),
    )


def _events_since(
    earlier: EarlierReport, keystore: Keystore
) -> tuple[str, tuple[LedgerEvent, ...]]:
    """(what is wrong with the ledger, no events), or ("", the events)."""
    try:
        lines = keystore.lines()
    except PqsecError as error:
        return str(error), ()
    broken = _ledger_problem(earlier, lines)
    return broken, () if broken else events_of(lines, after=earlier.lines)


def _authorities(now: ReportState, earlier: ReportState) -> Iterator[str]:
    new, old = _both(now.authorities, earlier.authorities, frozenset())
    yield from (f"new: {name}, {digest}" for name, digest in sorted(new - old))
    yield from (f"no longer: {name}, {digest}" for name, digest in sorted(old - new))


def _unknown(now: ReportState, earlier: ReportState) -> Iterator[str]:
    """The parts that one of the reports lacks."""
    values = {
        "participants": (now.participants, earlier.participants),
        "CAs and revocation list": (now.authorities, earlier.authorities),
        "rights": (now.rights, earlier.rights),
        "findings": (now.findings, earlier.findings),
    }
    return (what for what, both in values.items() if None in both)


def _both(one: Value | None, other: Value | None, empty: Value) -> tuple[Value, Value]:
    """Both values, to compare them; `empty` for both if one report lacks its own."""
    return (empty, empty) if one is None or other is None else (one, other)


def _ledger_problem(earlier: EarlierReport, lines: list[Line]) -> str:
    """Whether the earlier head is at its place in the ledger."""
    if not earlier.head:
        return "the earlier report has no head of the ledger"
    if earlier.lines == 0 or (
        earlier.lines <= len(lines) and lines[earlier.lines - 1].chain == earlier.head
    ):
        return ""
    return (
        f"the ledger was truncated or rewritten: its line {earlier.lines} is not the one of the"
        " earlier report"
    )


def _findings(section: FindingsSection) -> dict[tuple[str, str, str], str]:
    return {
        (group.rule, each.path, each.message): group.severity.value
        for group in section.groups
        for each in group.places
    }


def _less(
    these: frozenset[Right] | None, those: frozenset[Right] | None, topics: frozenset[str]
) -> tuple[Right, ...]:
    """The rights in `these` and not in `those`, whose rules name `topics`.

    A topic that no rule of the other report names is not a difference if a pattern there covers it:
    it has no row of its own, but the participant may use it.
    """
    if these is None or those is None:
        return ()
    held: dict[tuple[str, str, str], list[str]] = defaultdict(list)
    for each in those:
        held[each.participant, each.action, each.where].append(each.topic)
    found = (
        each
        for each in these - those
        if each.topic in topics
        or not is_known(each.topic, held[each.participant, each.action, each.where])
    )
    return tuple(sorted(found, key=str))


def _words(
    these: dict[tuple[str, str, str], str] | None, those: dict[tuple[str, str, str], str] | None
) -> Iterator[str]:
    if these is None or those is None:
        return
    for (rule, path, message), severity in sorted(these.items()):
        if (rule, path, message) not in those:
            yield f"{severity} {rule} {path}: {message}"
