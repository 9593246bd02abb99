"""The report as CSV: one table, in which each row names its section."""

import csv
import io
from collections.abc import Iterator
from datetime import UTC, datetime

from pqsec_pki._csv import cell
from pqsec_pki.credentials import PERMISSIONS
from pqsec_pki.migration import MigrationPlan
from pqsec_pki.report.comparing import Changes
from pqsec_pki.report.values import ParticipantRow, Report

HEADER = ("section", "subject", "item", "value", "domains", "until", "source")


def csv_of(report: Report, changes: Changes | None = None) -> str:
    """The report as RFC 4180 text with a header row. Times are ISO 8601, in UTC.

    A cell that a spreadsheet would run has an apostrophe before it. Control and other invisible
    characters are escaped: a terminal would obey some.
    """
    text = io.StringIO()
    writer = csv.writer(text)
    writer.writerow(HEADER)
    for row in _rows(report, changes):
        writer.writerow(map(cell, row))
    return text.getvalue()


_Row = tuple[str, str, str, str, str, str, str]


def _rows(report: Report, changes: Changes | None) -> Iterator[_Row]:
    at = _said(report.at)
    yield "report", report.keystore, f"pqsec {report.version}", report.command, "", at, ""
    for gap in report.gaps:
        yield "gap", gap.section, "not read", gap.reason, "", "", ""
    yield from _changed(changes)
    for person in report.participants or ():
        for each in (person, *person.further):
            yield from _participant(each)
    yield from _rights(report)
    yield from _keys(report)
    yield from _migration(report.migration)
    for group in report.findings.groups if report.findings else ():
        for place in group.places:
            yield "finding", group.rule, group.severity.value, place.message, "", "", str(place)
    for event in report.events or ():
        for name in event.names or ("",):
            line = f"ledger line {event.first}"
            yield (
                "ledger",
                name,
                event.what,
                event.operator,
                "",
                event.at.replace("+00:00", "Z"),
                line,
            )
    for size in report.sizes or ():
        for name in size.names:
            what, count = "bytes of the largest message", str(size.message)
            yield "handshake", name, what, count, "", "", size.profile


def _participant(each: ParticipantRow) -> Iterator[_Row]:
    """Its certificate of one set of credentials, and those before it."""
    until = _said(each.not_after)
    yield (
        *("participant", each.name, each.profile, each.state.value),
        *(each.domains, until, each.serial),
    )
    for end in each.superseded:
        yield "participant", each.name, each.profile, "superseded", "", _said(end), ""


def _rights(report: Report) -> Iterator[_Row]:
    if report.rights is None:
        return
    places = {
        (row.where, topic, action, holder.group.members[0]): holder.place
        for row in report.rights.rows
        for action, holders in (("publish", row.publishers), ("subscribe", row.subscribers))
        for holder in holders
        for topic in row.topics
    }
    groups = {name: each.members[0] for each in report.rights.groups for name in each.members}
    for right in report.rights.every:
        first = groups[right.participant]
        place = places.get((right.where, right.topic, right.action, first), "")
        beside = f"enclaves{first}/{PERMISSIONS}:"
        if first != right.participant and place.startswith(beside):
            place = f"enclaves{right.participant}/{PERMISSIONS}, as {place}"
        until = report.rights.until.get(right.participant)
        yield (
            *("right", right.participant, right.action, right.topic),
            *(right.where, _said(until) if until else "", place),
        )
    for name, reason in report.rights.refused.items():
        yield "left out", name, "has no rights", reason, "", "", ""


def _said(when: datetime) -> str:
    """Such as 2027-02-22T16:44:57Z."""
    return when.astimezone(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")


def _keys(report: Report) -> Iterator[_Row]:
    for authority in report.authorities or ():
        until = _said(authority.not_after)
        yield (
            *("authority", authority.name, authority.kind, authority.state.value),
            *("", until, authority.fingerprint),
        )
    for exposure in report.exposures or ():
        words = f"{exposure.strength}: {exposure.consequence}"
        yield "quantum", exposure.use, exposure.algorithm, words, "", "", exposure.profile
    for robot in report.robots or ():
        at = _said(robot.installed_at) if robot.installed_at else ""
        numbers = f"runs {robot.runs or '-'}, should run {robot.should_run or '-'}"
        words = f"{robot.state.value}: {numbers}"
        yield "robot", robot.name, "installed", words, "", at, " ".join(robot.changed)
    if delivery := report.delivery:
        until = _said(delivery.until) if delivery.until else ""
        yield "revocation list", str(delivery.number), str(delivery), delivery.danger, "", until, ""
        for late in delivery.late:
            held = f"list {late.list_number}" if late.list_number else "no list"
            words = held if late.has_receipt else "no receipt"
            until = _said(late.until) if late.until else ""
            yield "robot", late.name, "lacks the list", words, "", until, late.way.value
    if report.evidence:
        lines = f"{report.evidence.lines} lines"
        yield "evidence", "ledger", lines, report.evidence.head, "", "", ""
        yield "evidence", "approvals", report.evidence.approvals or "none", "", "", "", ""
        for problem in report.evidence.audit:
            yield "evidence", "ledger", "not intact", problem, "", "", ""


def _migration(plan: MigrationPlan | None) -> Iterator[_Row]:
    if plan is None:
        return
    yield "migration", plan.before, "to", plan.target, "", "", ""
    for number, step in enumerate(plan.steps, 1):
        for kind, text in (("step", step.title), ("how", step.how), *step.facts()):
            yield "migration", f"step {number}", kind, text, "", "", ""
    for each in plan.deadlines:
        yield "migration", "date", "", each.what, "", each.day.isoformat(), each.source


def _changed(changes: Changes | None) -> Iterator[_Row]:
    if changes is None:
        return
    if changes.ledger:
        yield "change", "ledger", "", changes.ledger, "", "", changes.since
    for what in changes.unknown:
        words = "not known: one of the two reports lacks them"
        yield "change", what, "", words, "", "", changes.since
    for what, rights in (("granted", changes.granted), ("removed", changes.removed)):
        for each in rights:
            yield (
                *("change", each.participant, f"{what}: {each.action}", each.topic),
                *(each.domains, "", changes.since),
            )
    for what, texts in (
        ("new participant", changes.appeared),
        ("no longer a participant", changes.disappeared),
        ("other certificate or state", changes.changed),
        ("new finding", changes.new_findings),
        ("resolved finding", changes.resolved),
        ("CA or revocation list", changes.authorities),
    ):
        for text in texts:
            yield "change", text, what, "", "", "", changes.since
