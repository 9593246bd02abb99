"""What was measured, as SVG: suites, meetings under loss, and cost against the number of hosts.

The only user of matplotlib, which is an extra of the package. The same values give the same bytes.
"""

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import BytesIO
from math import ceil
from statistics import median
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

Row = Mapping[str, Any]
Case = tuple[str, ...]

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
"""The colours of Okabe and Ito, which colour-blind people can distinguish."""
_STYLES = ("-", "--", ":", "-.")
_COLUMNS = 3
_SIDES, _MESSAGES = ("initiator", "responder"), ("request", "reply", "final")
_KILO = 1000
_RC: Any = {"svg.fonttype": "none", "svg.hashsalt": "pqsec", "font.size": 9, "legend.fontsize": 7}
_FIRST = {"1", "", "None"}
"""The first version of messages, or none."""
_COSTS = (
    ("full_s", "seconds to full mesh"),
    ("cpu_s", "processor seconds, hosts and agent"),
    ("datagrams", "datagrams"),
)


@mpl.rc_context(_RC)
def suites_svg(suites: Sequence[Mapping[str, Any]]) -> bytes:
    """Time and bytes of each suite, from the `suites` of bench's JSON."""
    names = [_suite(each) for each in suites]
    figure = Figure(figsize=(9, 1.2 + 0.4 * len(suites)), layout="constrained")
    times, sizes = figure.subplots(1, 2, sharey=True)
    wall = [each["wall_ms"] for each in suites]
    _bars(times, names, {side: [each[side]["p50"] for each in wall] for side in _SIDES})
    middle = [each["handshake"]["p50"] for each in wall]
    above = [max(0.0, each["handshake"]["p95"] - each["handshake"]["p50"]) for each in wall]
    times.errorbar(middle, names, xerr=[[0] * len(names), above], fmt="none", ecolor="#444")
    times.set_xlabel("milliseconds: medians, whisker to 95 %")
    tokens = zip(*(each["token_bytes"] for each in suites), strict=True)
    _bars(
        sizes,
        names,
        {
            name: [size / _KILO for size in of_all]
            for name, of_all in zip(_MESSAGES, tokens, strict=True)
        },
    )
    sizes.set_xlabel("kilobytes of the messages")
    times.invert_yaxis()
    return _written(figure)


@mpl.rc_context(_RC)
def meetings_svg(rows: Iterable[Row]) -> bytes:
    """The cumulative distribution of the time until two hosts meet, for each loss.

    `rows` have the keys MESH_COLUMNS. Each panel is one kind of hosts; a line that ends below 1
    says that some did not meet.
    """
    shares = _shares(rows)
    panels = defaultdict[Case, list[Case]](list)
    for case in shares:
        panels[case[1:]].append(case)
    figure, every = _panels(len(panels))
    for axes, (panel, cases) in zip(every, panels.items(), strict=False):
        for number, case in enumerate(sorted(cases, key=lambda each: float(each[0]))):
            axes.step(
                *zip(*shares[case], strict=True),
                where="post",
                color=_COLOURS[number % len(_COLOURS)],
                linestyle=_STYLES[number % len(_STYLES)],
                label=f"{float(case[0]):.0%} loss",
            )
        _finish(axes, _title(panel), "seconds", "share of pairs that have met")
        axes.set_ylim(0, 1.02)
    return _written(figure)


def _shares(rows: Iterable[Row]) -> dict[Case, list[tuple[float, float]]]:
    """For each case (time, share of pairs that have met by then), in order."""
    meetings, pairs = defaultdict[Case, list[float]](list), defaultdict[Case, int](int)
    for row in rows:
        if row["measure"] == "met_s":
            meetings[_case(row)].append(float(row["value"]))
        elif row["measure"] == "complete":
            pairs[_case(row)] += int(row["hosts"]) * (int(row["hosts"]) - 1)
    return {
        case: [(time, index / count) for index, time in enumerate((0.0, *sorted(meetings[case])))]
        for case, count in pairs.items()
    }


@mpl.rc_context(_RC)
def hosts_svg(rows: Iterable[Row]) -> bytes:
    """Time, processor and datagrams of a full mesh against the number of hosts.

    Of complete runs, the median with the least and the most, where several numbers of hosts were
    run. `rows` have the keys MESH_COLUMNS.
    """
    found: dict[str, dict[Case, dict[int, list[float]]]] = {
        name: defaultdict(lambda: defaultdict(list)) for name, _ in _COSTS
    }
    for case, hosts, totals in _totals(rows):
        if totals.get("full_s") is not None:
            totals["cpu_s"] = (totals["hosts_cpu_s"] or 0) + (totals["agent_cpu_s"] or 0)
            for name, _ in _COSTS:
                found[name][case][hosts].append(totals[name] or 0)
    figure = Figure(figsize=(12, 5), layout="constrained")
    for axes, (name, label) in zip(figure.subplots(1, len(_COSTS)), _COSTS, strict=True):
        several = {case: each for case, each in found[name].items() if len(each) > 1}
        for number, (case, by_hosts) in enumerate(several.items()):
            _ranges(axes, number, case, by_hosts)
        _finish(axes, "", "hosts", label, legend=False)
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=_COLUMNS)
    return _written(figure)


def _totals(rows: Iterable[Row]) -> Iterator[tuple[Case, int, dict[str, float | None]]]:
    """The numbers of each run, by measure."""
    runs = defaultdict[tuple[Case, int, str], dict[str, float | None]](dict)
    for row in rows:
        if row.get("run") not in (None, "") and row.get("host") in (None, ""):
            key = (_case_of_any_number(row), int(row["hosts"]), str(row["run"]))
            value = row["value"]
            runs[key][row["measure"]] = None if value in (None, "") else float(value)
    for (case, hosts, _), totals in runs.items():
        yield case, hosts, totals


def _ranges(axes: Axes, number: int, case: Case, by_hosts: Mapping[int, Sequence[float]]) -> None:
    hosts = sorted(by_hosts)
    middle = [median(by_hosts[each]) for each in hosts]
    below = [at - min(by_hosts[each]) for at, each in zip(middle, hosts, strict=True)]
    above = [max(by_hosts[each]) - at for at, each in zip(middle, hosts, strict=True)]
    axes.errorbar(
        hosts,
        middle,
        yerr=[below, above],
        capsize=2,
        marker="o",
        markersize=3,
        color=_COLOURS[number % len(_COLOURS)],
        linestyle=_STYLES[number // len(_COLOURS) % len(_STYLES)],
        label=_title(case),
    )


def _case(row: Row) -> Case:
    """The loss, then what else makes two cases different."""
    return (str(float(row["loss"])), *_kind(row), f"{row['hosts']} hosts", *_link(row))


def _case_of_any_number(row: Row) -> Case:
    """The differences of a case from others, except for the number of hosts."""
    return (*_kind(row), f"{float(row['loss']):.0%} loss", *_link(row))


def _kind(row: Row) -> Case:
    kind = (row["stack"], row["profile"] or "unsecured", f"({row['plugins']})")
    return (*kind, *_version(row))


def _version(of: Mapping[str, Any]) -> Case:
    """The version of the messages (text or a number), if it is not the first."""
    return () if str(of["wire_version"]) in _FIRST else (f"version {of['wire_version']}",)


def _link(row: Row) -> Case:
    delay = float(row["delay_ms"])
    return (*([f"{delay:g} ms"] if delay else []), f"MTU {row['mtu']}")


def _title(words: Case) -> str:
    return " ".join(words).replace(" (none)", "").replace(" (pqsec)", "")


def _suite(suite: Mapping[str, Any]) -> str:
    name = ", ".join((suite["signature"], suite["key_agreement"], *_version(suite)))
    return f"{suite['profile']}: {name}" if suite["profile"] else name


def _bars(axes: Axes, names: Sequence[str], parts: Mapping[str, Sequence[float]]) -> None:
    """One bar for each name, of these parts."""
    left = [0.0] * len(names)
    for colour, (label, values) in zip(_COLOURS, parts.items(), strict=False):
        axes.barh(names, values, left=left, color=colour, label=label, height=0.6)
        left = [one + other for one, other in zip(left, values, strict=True)]
    axes.legend(loc="lower right")
    axes.grid(axis="x", color="#ddd")
    axes.set_axisbelow(True)


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    columns = min(max(count, 1), _COLUMNS)
    lines = ceil(max(count, 1) / columns)
    figure = Figure(figsize=(4 * columns, 3 * lines), layout="constrained")
    axes = list(figure.subplots(lines, columns, squeeze=False).flat)
    for unused in axes[count:]:
        unused.set_axis_off()
    return figure, axes


def _finish(axes: Axes, title: str, across: str, up: str, *, legend: bool = True) -> None:
    axes.set_title(title)
    axes.set_xlabel(across)
    axes.set_ylabel(up)
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.grid(color="#ddd")
    if legend and axes.get_legend_handles_labels()[1]:
        axes.legend()


def _written(figure: Figure) -> bytes:
    buffer = BytesIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": "pqsec bench"})
    return buffer.getvalue()
