"""`pqsec bench --stack`: the options that only it has, and its runs."""

from collections.abc import Iterator, Sequence
from itertools import product
from statistics import median
from typing import Any

import click

from pqsec_pki._progress import stage
from pqsec_pki.algorithms import PROFILES, profile_named
from pqsec_pki.benchmark import (
    MESH_COLUMNS,
    Environment,
    MeasuredMeshes,
    MeshCase,
    MeshPlan,
    MeshRun,
    Plugins,
    measured_meshes,
    percentile,
)
from pqsec_pki.cli import _formats, _printing, _settings, _wire_version
from pqsec_pki.errors import UsageError
from pqsec_pki.handshake import WireVersion
from pqsec_pki.trial import HOSTS, MACHINE, STACKS, Link, find, refuse_without_hosts

_ROUNDS = 3
_OF_STACK = {
    *("--plugins", "--hosts", "--loss", "--delay", "--mtu", "--timeout", "--samples", "--root"),
}
_HEADERS = (
    *("profile", "plugins", "version", "hosts", "loss", "delay", "mtu", "complete", "full s", "to"),
    *("met p50", "p95", "datagrams", "repeats", "samples lost"),
)
_OPTIONS = (
    click.option(
        "--stack",
        type=click.Choice([*map(str, STACKS)]),
        help="Run hosts of this stack on a network of their own.",
    ),
    click.option(
        "--plugins",
        multiple=True,
        type=click.Choice([each.value for each in Plugins]),
        default=(Plugins.PQSEC.value,),
        help="With --stack: run pqsec's plugins, the stack's own, or none.  [default: pqsec]",
    ),
    click.option(
        "--hosts",
        multiple=True,
        type=click.IntRange(2, HOSTS),
        default=(2,),
        help="With --stack: run so many hosts.  [default: 2]",
    ),
    click.option(
        "--loss",
        multiple=True,
        type=_settings.Percent(),
        default=("0%",),
        help="With --stack: lose so many percent of frames.  [default: 0%]",
    ),
    click.option(
        "--delay",
        multiple=True,
        type=_settings.FiniteRange(0, 10_000),
        default=(0.0,),
        metavar="MS",
        help="With --stack: delay each frame by so many milliseconds.  [default: 0]",
    ),
    click.option(
        "--mtu",
        multiple=True,
        type=click.IntRange(256, 9000),
        default=(1500,),
        help="With --stack: the longest IP packet in a frame.  [default: 1500]",
    ),
    click.option(
        "--timeout",
        type=_settings.FiniteRange(1, 3600),
        default=60.0,
        metavar="SECONDS",
        help="With --stack: end a run when its hosts have not met by then.  [default: 60]",
    ),
    click.option(
        "--samples",
        type=click.IntRange(0, 10_000),
        default=20,
        help="With --stack: send so many from each host to all others.  [default: 20]",
    ),
    click.option(
        "--root",
        type=_settings.FOLDER,
        default=MACHINE,
        metavar="DIR",
        help="With --stack: use the one in this root file system.  [default: the installed one]",
    ),
)


def options(command: _settings.Command) -> _settings.Command:
    """Add --stack and the options that need it."""
    for each in reversed(_OPTIONS):
        command = each(command)
    return command


def refuse_without_stack() -> None:
    """UsageError for an option that needs --stack."""
    for option in _settings.given_options().values():
        if option in _OF_STACK:
            raise UsageError(
                f"{option} is for hosts of a stack", hint=f"name one: --stack {STACKS[0]}"
            )


def run(stack: str, form: str, given: dict[str, Any]) -> tuple[list[dict[str, object]], bool]:
    """Measure and print; the rows of CSV, and whether all runs were finished."""
    environment = Environment.here(_settings.now())
    rounds = given["rounds"] or _ROUNDS
    cases = list(_cases(given["profiles"] or [each.name for each in PROFILES], given))
    installation = find(stack, given["root"])
    refuse_without_hosts()
    plan = MeshPlan(
        installation=installation,
        cases=cases,
        rounds=rounds,
        timeout=given["timeout"],
        samples=given["samples"],
        now=_settings.now(),
    )
    length = len(plan.cases) * rounds
    with stage(length, "runs") as here:
        runs = measured_meshes(plan, here.add)
    found = MeasuredMeshes(stack=stack, version=installation.version, runs=runs)
    complete = len(runs) == length
    value = {"environment": environment, "complete": complete, **found.to_json()}
    lines = _lines(environment, installation.title, found)
    rows = list(found.rows(environment))
    _formats.emit(form, value, lines, columns=MESH_COLUMNS, items=rows)
    for each in runs:
        _note(each)
    return rows, complete


def _cases(profiles: Sequence[str], given: dict[str, Any]) -> Iterator[MeshCase]:
    """UsageError if a version of the messages is asked for that none of them has."""
    kinds = [
        (plugins, profile, version)
        for plugins in map(Plugins, given["plugins"])
        for profile in ([None] if plugins is Plugins.NONE else profiles)
        for version in _versions(plugins, profile, given["wire_version"])
    ]
    _refuse_without_version(given, {version for *_, version in kinds})
    axes = (given[name] for name in ("hosts", "loss", "delay", "mtu"))
    for hosts, loss, delay, mtu in product(*axes):
        link = Link(loss=loss, delay=delay / 1000, mtu=mtu)
        for plugins, profile, version in dict.fromkeys(kinds):
            yield MeshCase(
                plugins=plugins, profile=profile, hosts=hosts, link=link, wire_version=version
            )


def _versions(
    plugins: Plugins, profile: str | None, asked: Sequence[str]
) -> list[WireVersion | None]:
    """Versions of the messages: `asked`, or the first for key agreements of stock stacks."""
    if plugins is not Plugins.PQSEC or profile is None:
        return [None]
    has_both = profile_named(profile).key_agreement.binds_transcript
    return [_wire_version.version_of(each) if has_both else WireVersion.FIRST for each in asked]


def _refuse_without_version(given: dict[str, Any], found: set[WireVersion | None]) -> None:
    second = WireVersion.SECOND
    if str(second) not in given["wire_version"] or second in found:
        return
    name = f"{_wire_version.NAME} {second}"
    if Plugins.PQSEC.value not in given["plugins"]:
        raise UsageError(
            f"{name} is for pqsec's plugins: the stacks' own know version 1 only",
            hint=f"choose --plugins {Plugins.PQSEC}, or leave out {_wire_version.NAME}",
        )
    raise UsageError(
        f"messages of profile {' and '.join(given['profiles'])} have only version 1",
        hint=f"choose another profile, or leave out {_wire_version.NAME}",
    )


def _lines(environment: Environment, title: str, found: MeasuredMeshes) -> Iterator[str]:
    cases = dict.fromkeys(each.case for each in found.runs)
    rows = (_row(case, [each for each in found.runs if each.case == case]) for case in cases)
    yield from _printing.table(_HEADERS, rows)
    yield ""
    yield "version: of pqsec's messages. complete: hosts that met all others, in all runs."
    yield "full: seconds until the last had met all, median and longest of complete runs."
    yield "met: seconds until a host had met another."
    yield "datagrams: sent by all hosts until then; repeats: of handshake messages; median of runs."
    yield f"{title}, pqsec {environment.pqsec}, {environment.system}"
    yield environment.hardware


def _row(case: MeshCase, runs: Sequence[MeshRun]) -> tuple[str, ...]:
    full = [each.full for each in runs if each.full is not None]
    met = [when for each in runs for when in each.meetings]
    lost = [each.result.samples_lost for each in runs if each.result.samples_lost is not None]
    totals = [each.totals for each in runs]
    return (
        case.profile or "",
        case.plugins.value,
        f"{case.wire_version or '':>7}",
        f"{case.hosts:>5}",
        _printing.percent(case.link.loss),
        f"{case.link.delay * 1000:.3g}",
        str(case.link.mtu),
        f"{sum(each.result.complete for each in runs)}/{case.hosts * len(runs)}",
        *(_seconds(full, 50), _seconds(full, 100)),
        *(_seconds(met, 50), _seconds(met, 95)),
        *(
            f"{median(int(each[name] or 0) for each in totals):g}"
            for name in ("datagrams", "handshake_repeats")
        ),
        f"{sum(lost)}" if lost else "",
    )


def _seconds(values: Sequence[float], percent: float) -> str:
    return f"{percentile(values, percent):>6.2f}" if values else ""


def _note(run: MeshRun) -> None:
    """The first message of a host that did not meet all others."""
    if not run.complete:
        others = run.case.hosts - 1
        silent = [each for each in run.result.hosts if len(each.met) < others]
        said = next((each.log[0] for each in silent if each.log), "the stack printed no reason")
        _printing.note(f"run {run.number} of {run.case} is incomplete: {said}")
