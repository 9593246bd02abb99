"""The report as one HTML file: no request to any other place, and no text that is markup.

The page has a content security policy that allows only its own style and script, by their hashes.
Every text in it is escaped by jinja2, and invisible characters are shown as escapes, so that a
name can neither be markup nor hide or reorder what is beside it.
"""

import base64
import hashlib
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from datetime import datetime
from functools import cache
from itertools import groupby
from typing import TYPE_CHECKING

from pqsec_pki._assets import asset
from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.documents import ros
from pqsec_pki.errors import shown
from pqsec_pki.keystore import InstallState, RobotState
from pqsec_pki.lint import Severity
from pqsec_pki.report.comparing import Changes
from pqsec_pki.report.picture import is_routine, matrix_of, picture_of
from pqsec_pki.report.values import (
    Ending,
    Exposure,
    ParticipantGroup,
    Report,
    RightsRow,
    RightsSection,
    Strength,
)

if TYPE_CHECKING:
    from jinja2 import Environment

MOST_NAMES = 2_000
"""Names in a list of the page; a list of more says how many are left out. JSON has all."""
MOST_ROWS = 200
"""Rows of events, places and changes likewise."""
MOST_MONTHS = 24
"""Bars of the chart; later months are in one bar, so that it fits on A4."""


def html_of(report: Report, changes: Changes | None = None) -> str:
    """The page. The same report and changes give the same text."""
    style, script = (_text(f"report.{each}") for each in ("css", "js"))
    policy = (
        f"default-src 'none'; style-src '{_hash(style)}'; script-src '{_hash(script)}';"
        " base-uri 'none'; form-action 'none'"
    )
    template = _environment().get_template("report.html.j2")
    return template.render(
        report=report,
        changes=changes,
        style=_raw(style),
        script=_raw(script),
        policy=policy,
        matrix=matrix_of(report.rights) if report.rights else [],
        picture=picture_of(report.rights) if report.rights else None,
        number_of=_numbers(report.rights),
        repeated=_repeated(report.rights),
        robots=_robots_alike(report.robots or ()),
        months=_months(report.endings or (), report.at),
        exposures=_by_use(report.exposures or ()),
        severities=list(Severity),
        strengths=list(Strength),
        broken=[each for each in report.exposures or () if each.strength is Strength.BROKEN],
        most_names=MOST_NAMES,
        most_rows=MOST_ROWS,
    )


def _repeated(rights: RightsSection | None) -> set[str]:
    """Labels of several groups: their members have other rights, for example on other domains."""
    count = Counter(each.label for each in (rights.groups if rights else ()))
    return {label for label, times in count.items() if times > 1}


def _numbers(rights: RightsSection | None) -> Callable[[ParticipantGroup | RightsRow], int]:
    """The number of each group, and of each row."""
    every = (rights.groups, rights.rows) if rights else ()
    numbers = {id(each): number for those in every for number, each in enumerate(those)}
    return lambda each: numbers[id(each)]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Month:
    """A bar of the chart, and its rows in the table."""

    label: str
    over: bool
    endings: tuple[Ending, ...]

    @property
    def count(self) -> int:
        """How many certificates, lists and grants end in it."""
        return sum(len(each.names) for each in self.endings)


def _months(endings: Sequence[Ending], now: datetime) -> list[_Month]:
    found = [
        _Month(label=label, over=all(each.at < now for each in alike), endings=tuple(alike))
        for label, group in groupby(endings, key=lambda each: f"{each.at:%Y-%m}")
        if (alike := list(group))
    ]
    if len(found) <= MOST_MONTHS:
        return found
    kept, late = found[: MOST_MONTHS - 1], found[MOST_MONTHS - 1 :]
    rest = tuple(each for month in late for each in month.endings)
    return [*kept, _Month(label=f"{late[0].label} and later", over=False, endings=rest)]


def _by_use(exposures: Iterable[Exposure]) -> list[Exposure]:
    """Traffic with the same consequence as one row."""
    merged: dict[tuple[object, ...], list[Exposure]] = {}
    for each in exposures:
        key = (each.use, each.algorithm, each.profile, each.strength, each.consequence)
        merged.setdefault(key, []).append(each)
    return [
        Exposure(
            use=alike[0].use,
            algorithm=alike[0].algorithm,
            profile=alike[0].profile,
            strength=alike[0].strength,
            consequence=alike[0].consequence,
            names=tuple(name for each in alike for name in each.names),
        )
        for alike in merged.values()
    ]


def _robots_alike(robots: Iterable[RobotState]) -> list[list[RobotState]]:
    """Robots in the same state, with the same differences; those that lack something first."""
    alike: dict[tuple[object, ...], list[RobotState]] = {}
    for each in robots:
        alike.setdefault((each.state, each.changed, each.runs, each.should_run), []).append(each)
    rank = [InstallState.OUTDATED, InstallState.UNKNOWN, InstallState.CURRENT, InstallState.NONE]
    return sorted(alike.values(), key=lambda those: rank.index(those[0].state))


def _hash(text: str) -> str:
    """The source expression of CSP level 2 for an inline style or script."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


@cache
def _text(name: str) -> str:
    return asset("templates", "report", name).read_text("utf-8")


def _raw(text: str) -> object:
    """`text` of our own, as it is."""
    from markupsafe import Markup  # noqa: PLC0415 -- comes and loads with jinja2

    return Markup(text)  # noqa: S704 -- a file of this package, of which the hash is in the page


def _visible(value: object) -> object:
    """A text with control, bidirectional and other invisible characters as escapes."""
    if isinstance(value, str) and not hasattr(value, "__html__"):
        return value if value.isprintable() else shown(value, len(value))
    return value


@cache
def _environment() -> "Environment":
    from jinja2 import (  # noqa: PLC0415 -- `pqsec --help` must not load it
        Environment,
        FunctionLoader,
        StrictUndefined,
    )

    environment = Environment(
        loader=FunctionLoader(_text),
        autoescape=True,
        finalize=_visible,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["moment"] = said
    environment.filters["day"] = "{:%Y-%m-%d}".format
    environment.tests["routine"] = is_routine
    environment.filters["ros"] = ros.said
    environment.filters["number"] = "{:,}".format
    return environment
