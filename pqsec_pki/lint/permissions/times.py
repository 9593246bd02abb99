"""Rules about how the times of a grant are written, which each stack reads differently."""

import re
from collections.abc import Iterator
from datetime import UTC, datetime

from pqsec_pki.lint.document import PermissionsFile
from pqsec_pki.lint.permissions._names import shown
from pqsec_pki.lint.rule import CYCLONE, FAST, Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR, WARNING, INFO = Severity
LAST_YEAR = 2261
_CYCLONE, _FAST = Stack.CYCLONEDDS, Stack.FASTDDS
_TIMES = ("not_before", "not_after")
_INSTANT = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?(?P<zone>Z|[+-]\d\d:\d\d)?", re.ASCII)


@lint_rule(
    "PQS262", ERROR, "a grant that is never valid",
    why="It ends before it starts.",
    fix="Set not_before to a time before not_after.",
    rows=("expired / future",), measured="all six stacks",
    bad="""
        <validity>
          <not_before>2027-06-01T00:00:00Z</not_before>
          <not_after>2026-05-01T00:00:00Z</not_after>
        </validity>
    """,
    good="""
        <validity>
          <not_before>2026-05-01T00:00:00Z</not_before>
          <not_after>2027-06-01T00:00:00Z</not_after>
        </validity>
    """,
)  # fmt: skip
def never_valid(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        if grant.not_before >= grant.not_after:
            yield document.at(grant.line, f"{shown(grant)}: not_after is not later than not_before")


@lint_rule(
    "PQS263", ERROR, f"a time after {LAST_YEAR}",
    why="Cyclone DDS counts nanoseconds in 64 bits. It reads a later time as a time in the past and"
    " refuses the participant.",
    fix=f"Set the end before {LAST_YEAR + 1}; one or two years ahead is better.",
    stacks=CYCLONE, rows=("not_after year ≥ 2262 (9999, 2300)",),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1",
    bad="<not_after>2300-01-01T00:00:00Z</not_after>",
    good="<not_after>2027-06-01T00:00:00Z</not_after>",
)  # fmt: skip
def too_late(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all(*_TIMES):
        year = re.match(r"\d{4,}(?=-)", node.value, re.ASCII)
        if year and int(year[0][:9]) > LAST_YEAR:
            yield document.at(node, f"Cyclone DDS reads the year {year[0][:9]} as past")


@lint_rule(
    "PQS264", ERROR, "a time that cannot be read",
    why="Cyclone DDS silently accepts a not_before that it cannot read: the grant is then valid"
    " from any time on. Fast DDS refuses the document.",
    fix="Write the time as 2030-01-31T00:00:00Z.",
    rows=("garbage not_before (silently accepted!)", "date only", "`2026-01-01 00:00:00`"),
    measured="all six stacks",
    bad="<not_before>2026-05-01</not_before>",
    good="<not_before>2026-05-01T00:00:00Z</not_before>",
)  # fmt: skip
def unreadable_time(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all(*_TIMES):
        if not _is_time(node.value):
            shown = node.value[:40]
            yield document.at(
                node, f"<{node.tag}>: {shown!a} is not a time such as 2030-01-31T00:00:00Z"
            )


@lint_rule(
    "PQS265", INFO, "a time without a time zone",
    why="The standard reads it as UTC. Fast DDS reads every time as local time of the robot.",
    fix="End the time with Z, and leave one day of margin at both ends.",
    rows=("no zone / `Z` / `+00:00` / `.000` / surrounding spaces",), measured="all six stacks",
    bad="<not_before>2026-05-01T00:00:00</not_before>",
    good="<not_before>2026-05-01T00:00:00Z</not_before>",
)  # fmt: skip
def without_zone(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all(*_TIMES):
        found = _INSTANT.fullmatch(node.value)
        if found and not found["zone"]:
            yield document.at(node, f"<{node.tag}> has no time zone; end it with Z")


@lint_rule(
    "PQS266", WARNING, "a time in a zone other than UTC",
    why="Fast DDS ignores the zone and reads the time as local time, which can differ by hours.",
    fix="Write the time in UTC, with Z.",
    stacks=FAST,
    rows=("TZ=America/Los_Angeles, not_before = now-1h Z",
          "TZ=America/Los_Angeles, not_after expired 1 h ago Z"),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2",
    bad="<not_before>2026-05-01T02:00:00+02:00</not_before>",
    good="<not_before>2026-05-01T00:00:00Z</not_before>",
)  # fmt: skip
def other_zone(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all(*_TIMES):
        found = _INSTANT.fullmatch(node.value)
        if found and found["zone"] not in {None, "Z", "+00:00", "-00:00"}:
            yield document.at(node, f"Fast DDS ignores the zone {found['zone']}; write UTC with Z")


def _is_time(text: str) -> bool:
    if not _INSTANT.fullmatch(text):
        return False
    try:
        datetime.fromisoformat(text).replace(tzinfo=UTC)
    except ValueError:
        return False
    return True
