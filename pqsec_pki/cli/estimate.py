"""pqsec estimate: predict what the handshakes of a fleet cost."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from math import isfinite
from pathlib import Path

import click

from pqsec_pki._files import refuse_existing, write
from pqsec_pki.algorithms import PROFILES, Profile, profile_named
from pqsec_pki.cli import _help, _printing, _settings, _wire_version
from pqsec_pki.errors import MalformedError, UsageError
from pqsec_pki.estimation import (
    TIMES,
    VALIDITY,
    Estimate,
    Scenario,
    costs_of,
    estimated,
    mean_of,
    read_costs,
    sizes_in,
    sizes_of,
    svg_of,
)
from pqsec_pki.handshake import MessageSizes, WireVersion
from pqsec_pki.stacks import IPFRAG_HIGH_THRESH, SMALL_FRAGMENT


@_help.command(
    examples={
        "Predict 500 robots on a network that loses 2 % of frames": (
            "pqsec estimate --participants 500 --profile pq --loss 2% --cores 4"
        ),
        "Predict the participants of the keystore, and draw the result": (
            "pqsec estimate --loss 1% --plot mesh.svg"
        ),
        "Predict 40 processes that share a machine of two cores": (
            "pqsec estimate --participants 40 --hosts 1 --cores 2"
        ),
    },
    exit_codes={
        0: "the estimate is printed",
        3: "the keystore or a file cannot be read, or the plot cannot be written",
    },
)
@click.option(
    "--participants",
    type=click.IntRange(2, 100_000),
    help="Predict so many participants.  [default: those of the keystore]",
)
@click.option(
    "--profile",
    type=click.Choice([each.name for each in PROFILES], case_sensitive=False),
    help="Predict this profile.  [default: pq, or each of the keystore's]",
)
@click.option(
    "--loss",
    type=_settings.Percent(),
    default="0%",
    show_default=True,
    help="Lose so many percent of frames: 0.05 is 0.05%.",
)
@click.option(
    "--fragment",
    type=click.IntRange(64, 65_000),
    default=SMALL_FRAGMENT,
    show_default=True,
    help="Bytes of a sample in one datagram; the default is that of `pqsec export`.",
)
@click.option(
    "--cores",
    type=click.IntRange(1, 1024),
    default=4,
    show_default=True,
    help="Cores of each host.",
)
@click.option(
    "--hosts",
    type=click.IntRange(1),
    help="Share the participants among so many hosts.  [default: each has its own]",
)
@click.option(
    "--start-within",
    type=_settings.FiniteRange(0, 300),
    default=0.0,
    show_default=True,
    help="Seconds over which the participants start.",
)
@click.option(
    "--ipfrag-high-thresh",
    "threshold",
    type=click.IntRange(1, 1 << 40),
    default=IPFRAG_HIGH_THRESH,
    show_default=True,
    help="Bytes of net.ipv4.ipfrag_high_thresh on each host.",
)
@click.option(
    "--costs",
    "measured",
    type=_settings.FILE,
    metavar="BENCH.json",
    help="Take processor times from the JSON of `pqsec bench`.",
)
@_wire_version.option("Predict messages of this version.")
@click.option("--seed", type=int, default=1, show_default=True, help="Of the simulation.")
@click.option(
    "--plot",
    type=_settings.FILE,
    metavar="FILE.svg",
    help="Draw how many pairs have met over time.",
)
@click.option("--force", is_flag=True, help="Replace that file.")
@_settings.command_options
def estimate(  # noqa: PLR0913 -- one for each option, by name
    *,
    participants: int | None,
    profile: str | None,
    loss: float,
    fragment: int,
    cores: int,
    hosts: int | None,
    start_within: float,
    threshold: int,
    measured: Path | None,
    wire_version: str,
    seed: int,
    plot: Path | None,
    force: bool,
) -> None:
    """Predict what the handshakes of a fleet cost, and how long they take.

    All participants start, find each other and make a handshake with each other, as in Cyclone
    DDS. Two models answer, a closed form and a simulation; both are printed. Without
    --participants, the keystore's participants and the sizes of their own documents count; of
    several sets of credentials, each is predicted, as if all met with it.
    """
    if plot:
        _refuse_plot(plot, force=force)
    version = _wire_version.version_of(wire_version)
    predicted = dict[str, Estimate]()
    for name in _profiles(participants, profile, version, plot):
        sizes = _fleet(participants, name, version)
        scenario = Scenario(
            participants=participants or len(sizes),
            sizes=mean_of(sizes),
            each=sizes,
            costs=read_costs(measured, name, version) if measured else costs_of(name, version),
            loss=loss,
            fragment=fragment,
            cores=cores,
            hosts=hosts or 0,
            start_within=start_within,
            threshold=threshold,
        )
        second = _second(participants, name, version) if loss else None
        predicted[name] = estimated(scenario, seed, second)
    if plot:
        write(plot, svg_of(*predicted.values()).encode(), force=force)
    first, *further = (
        {"profile": name, "wire_version": version, **each.to_json()}
        for name, each in predicted.items()
    )
    _printing.emit({**first, "further": further}, _lines_of_all(predicted, version))


def _lines_of_all(predicted: Mapping[str, Estimate], version: WireVersion) -> Iterator[str]:
    for number, (name, each) in enumerate(predicted.items()):
        if number:
            yield ""
        yield from _lines(f"{name}, messages of version {version}", each)


def _refuse_plot(plot: Path, *, force: bool) -> None:
    if plot.suffix != ".svg":
        raise UsageError("the plot is SVG: name a file as mesh.svg")
    if not force:
        refuse_existing(plot)


def _second(participants: int | None, profile: str, version: WireVersion) -> MessageSizes | None:
    """The mean sizes in the second version, if the fleet does not have it and could have."""
    if version is WireVersion.SECOND:
        return None
    with suppress(UsageError, MalformedError):
        return mean_of(_fleet(participants, profile, WireVersion.SECOND))
    return None


def _profiles(
    participants: int | None, profile: str | None, version: WireVersion, plot: Path | None
) -> list[str]:
    """The profiles to predict: one, or without a name those of the keystore's sets."""
    if participants:
        chosen = [profile_named(profile or "pq")]
    else:
        known = _settings.open_keystore(instead="--participants COUNT").profiles
        chosen = [each for each in known if profile in {None, each.name}]
        if not chosen:
            has = ", ".join(each.name for each in known)
            raise UsageError(
                f"the keystore has profile{'s' if len(known) > 1 else ''} {has}",
                hint="for another profile, name a number: --participants",
            )
    for each in chosen:
        _refuse_second(each, version)
    names = [each.name for each in chosen]
    if plot and len(names) > 1:
        raise UsageError(f"--plot draws one profile: name one with --profile: {', '.join(names)}")
    return names


def _fleet(
    participants: int | None, profile: str, version: WireVersion
) -> tuple[MessageSizes, ...]:
    """The sizes of one participant for all, or of each in that set of the keystore."""
    if participants:
        chosen = profile_named(profile)
        _refuse_second(chosen, version)
        return (sizes_of(chosen, version),)
    keystore = _settings.open_keystore().of_profile(profile)
    _refuse_second(keystore.profile, version)
    sizes = tuple(sizes_in(keystore, version))
    if len(sizes) < 2:  # noqa: PLR2004 -- one has no peer
        where = f"set {profile} of the keystore" if keystore.set_name else "keystore"
        raise UsageError(
            f"the {where} has {_printing.counted(len(sizes), 'participant')}, not two",
            hint="name a number: --participants",
        )
    return sizes


def _refuse_second(profile: Profile, version: WireVersion) -> None:
    if version is WireVersion.SECOND and not profile.key_agreement.binds_transcript:
        raise UsageError(
            f"messages of profile {profile.name} have only version 1",
            hint=f"leave out {_wire_version.NAME}, or name another set's with --profile",
        )


def _lines(profile: str, found: Estimate) -> Iterator[str]:
    yield from _scenario_lines(profile, found.scenario)
    yield from _printing.table(("", "closed form", "simulation"), _rows(found))
    for advice in found.advice:
        then = f": full mesh in {_seconds(advice.median)}" if advice.median else ""
        yield f"to do: {advice.change}{then}"
    for note in found.notes:
        yield f"note: {note}"
    yield VALIDITY


def _scenario_lines(profile: str, scenario: Scenario) -> Iterator[str]:
    count, megabytes = scenario.participants, scenario.bytes / 1e6
    hosts = _printing.counted(scenario.host_count, "host")
    cores = _printing.counted(scenario.cores, "core")
    who = f"{count} participants on {hosts} of {cores}, profile {profile}"
    sizes = "/".join(map(str, scenario.sizes))
    frames = "/".join(map(str, map(scenario.frames, scenario.sizes)))
    yield f"{who}, {_printing.percent(scenario.loss)} of all frames lost"
    yield ""
    yield f"handshakes      {scenario.pairs}"
    yield f"messages        {sizes} bytes in {frames} frames"
    yield f"bytes           {megabytes:.4g} MB, {megabytes / count:.3g} MB of each participant"
    yield f"processor       {scenario.busy:.3g} s of all cores of each host"
    yield f"                {scenario.costs.source}"
    yield f"reassembly      {scenario.in_reassembly} of {scenario.threshold} bytes in a host"
    yield ""


def _rows(found: Estimate) -> Iterator[tuple[str, str, str]]:
    closed, simulation = found.closed, found.simulation
    for label, share in (("median", 0.5), ("95 %", 0.95)):
        simulated = simulation.mesh(share) if simulation.is_whole else None
        yield f"full mesh, {label}", _seconds(closed.mesh(share)), _seconds(simulated, "-")
    yield "a pair, median", _seconds(closed.pair(0.5)), _seconds(simulation.pair(0.5))
    for time in TIMES:
        yield f"apart after {time} s", f"{closed.apart(time):.3%}", f"{simulation.apart(time):.3%}"


def _seconds(value: float | None, missing: str = "over 600 s") -> str:
    return f"{value:.1f} s" if value is not None and isfinite(value) else missing
