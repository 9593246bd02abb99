"""pqsec bench: measure the handshake of suites, in memory or in a real stack."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import click

from pqsec_pki._progress import stage
from pqsec_pki.algorithms import KEY_AGREEMENTS, PROFILES, SIGNATURES, profile_named
from pqsec_pki.benchmark import (
    CSV_COLUMNS,
    MESH_PLOTS,
    SUITES,
    Environment,
    HandshakeSuite,
    MeasuredSuite,
    Operation,
    every_suite,
    measured_rounds,
    meshes_drawn,
    percentile,
    suites_drawn,
    suites_of,
)
from pqsec_pki.cli import (
    _bench_hosts,
    _bench_plots,
    _completion,
    _formats,
    _help,
    _printing,
    _settings,
    _wire_version,
)
from pqsec_pki.errors import UsageError
from pqsec_pki.stacks import FRAGMENT

INTERRUPTED = 130
"""The exit code after Ctrl-C, as a shell has it: 128 + SIGINT."""
_HEADERS = (
    *(
        "profile",
        "signature",
        "key agreement",
        "version",
        "p50 ms",
        "p95 ms",
        "initiator",
        "responder",
    ),
    *("bytes", "fragments", "memory kB"),
)
_KILO = 1000
_ROUNDS = 50
_OF_MEMORY = {"--signature", "--kem", "--all", "--warm-up", "--fragment-size"}


@_help.command(
    examples={
        "Measure the suites of all profiles": "pqsec bench --rounds 20",
        "Compare two key agreements with one signature": (
            "pqsec bench --signature ml-dsa-65 --kem mlkem768 --kem x25519mlkem768"
        ),
        "Keep all samples, for your own statistics": ("pqsec bench --profile pq --format csv"),
        "Draw time and bytes of all profiles": "pqsec bench --plot plots",
        "Run 3 hosts of Cyclone DDS on a network that loses 5 % of frames": (
            "pqsec bench --stack cyclonedds --profile pq --hosts 3 --loss 5%"
        ),
        "Compare both versions of the messages there": (
            "pqsec bench --stack cyclonedds --profile pq --loss 5% --wire-version 1"
            " --wire-version 2"
        ),
    },
    exit_codes={
        0: "all suites are measured",
        3: "the stack, a right or the plots' library is missing, or a result cannot be written",
        130: "Ctrl-C ended it; what was measured until then is printed",
    },
)
@click.option(
    "--profile",
    "profiles",
    multiple=True,
    type=click.Choice([profile.name for profile in PROFILES], case_sensitive=False),
    help="Measure this profile's keys. [default: all profiles]",
)
@click.option(
    "--signature",
    "signatures",
    multiple=True,
    metavar="NAME",
    help="Measure this kind of key.",
    shell_complete=_completion.signatures,
)
@click.option(
    "--kem",
    "agreements",
    multiple=True,
    metavar="NAME",
    help="Use this key agreement for each.",
    shell_complete=_completion.key_agreements,
)
@click.option("--all", "every", is_flag=True, help="Measure each key with each key agreement.")
@click.option(
    "--rounds",
    type=click.IntRange(1, 100_000),
    help="Measure this many times.  [default: 50 handshakes, 3 runs of hosts]",
)
@click.option(
    "--warm-up",
    type=click.IntRange(0, 100_000),
    default=5,
    help="Run this many handshakes before, which do not count.  [default: 5]",
)
@click.option(
    "--fragment-size",
    "fragment",
    type=click.IntRange(64, 65_000),
    default=FRAGMENT,
    help="Bytes of a sample in one datagram.  [default: 1344, Cyclone DDS's]",
)
@_wire_version.option(
    "Measure messages of this version; with key agreements of stock stacks always 1.",
    multiple=True,
)
@_bench_hosts.options
@click.option(
    "--plot",
    type=_settings.FOLDER,
    metavar="DIR",
    help="Draw the results as SVG files in this folder.",
)
@click.option("--force", is_flag=True, help="Replace such files.")
@_formats.option()
@_settings.command_options
def bench(
    *,
    stack: str | None,
    form: str,
    plot: Path | None,
    force: bool,
    **given: Any,
) -> int:
    """Measure the time, message sizes and memory of the handshake.

    In memory, both sides run in one process, without a DDS stack. New participants of each suite
    run whole handshakes, and each verifies the other as if they had never met. JSON has
    percentiles, all samples and the environment; CSV has one line for each operation of each
    handshake.

    With --stack, participants of a real stack start together, each in a network namespace of its
    own, until each has met all others; then each sends samples. It needs root, or a user
    namespace, and the stack with its headers and a C compiler. Options that are given several
    times are combined. CSV has one line for each measured value.
    """
    form = _formats.chosen(form)
    if given["every"] and (given["profiles"] or given["signatures"] or given["agreements"]):
        raise UsageError("--all measures everything: leave out --profile, --signature and --kem")
    if stack:
        _refuse_in_memory()
        with _bench_plots.plots(plot, MESH_PLOTS, force=force) as draw:
            rows, complete = _bench_hosts.run(stack, form, given)
            draw(lambda: meshes_drawn(rows))
    else:
        _bench_hosts.refuse_without_stack()
        suites = _suites(given)
        with _bench_plots.plots(plot, (SUITES,), force=force) as draw:
            values, complete = _run(suites, form, given)
            draw(lambda: suites_drawn(values))
    if not complete:
        _printing.note("interrupted: this is what was measured until then")
    return 0 if complete else INTERRUPTED


def _refuse_in_memory() -> None:
    """UsageError for an option of handshakes in memory."""
    for option in _settings.given_options().values():
        if option in _OF_MEMORY:
            raise UsageError(
                f"{option} is for handshakes in memory",
                hint="with --stack choose keys by --profile: hosts need a keystore",
            )


def _suites(given: dict[str, Any]) -> list[HandshakeSuite]:
    found = (
        every_suite()
        if given["every"]
        else suites_of(
            [profile_named(name) for name in given["profiles"]],
            [SIGNATURES.named(name) for name in given["signatures"]],
            [KEY_AGREEMENTS.named(name) for name in given["agreements"]],
        )
    )
    versions = dict.fromkeys(map(_wire_version.version_of, given["wire_version"]))
    return list(dict.fromkeys(each.in_version(version) for each in found for version in versions))


def _run(
    suites: Sequence[HandshakeSuite], form: str, given: dict[str, Any]
) -> tuple[list[dict[str, Any]], bool]:
    """Measure and print; the suites of JSON, and whether all were measured."""
    environment = Environment.here(_settings.now())
    rounds, fragment = given["rounds"] or _ROUNDS, given["fragment"]
    found = _measured(suites, rounds, given["warm_up"])
    complete = len(found) == len(suites) and all(len(each.rounds) == rounds for each in found)
    values = [each.to_json(fragment) for each in found]
    value = {
        "environment": environment,
        "complete": complete,
        "fragment_bytes": fragment,
        "suites": values,
    }
    samples = (row for each in found for row in each.rows())
    lines = _lines(environment, found, fragment)
    _formats.emit(form, value, lines, columns=CSV_COLUMNS, items=samples)
    return values, complete


def _measured(suites: Sequence[HandshakeSuite], rounds: int, warm_up: int) -> list[MeasuredSuite]:
    """Each suite in turn, until Ctrl-C."""
    found: list[MeasuredSuite] = []
    with stage(len(suites) * (rounds + warm_up), "handshakes") as here:
        for suite in suites:
            one = measured_rounds(
                suite, rounds=rounds, warm_up=warm_up, now=_settings.now(), each=here.add
            )
            found += [one] if one else []
            if one is None or len(one.rounds) < rounds:
                break
    return found


def _lines(
    environment: Environment, found: Sequence[MeasuredSuite], fragment: int
) -> Iterator[str]:
    yield from _printing.table(_HEADERS, (_row(each, fragment) for each in found))
    yield ""
    yield "version: of the messages. p50, p95: a whole handshake, both sides. initiator, responder:"
    yield "p50 of each side."
    yield f"bytes: of the three tokens. fragments: of request, reply, final, by {fragment} bytes."
    yield "memory: the most that Python held for one handshake, without OpenSSL's own."
    here = environment
    yield f"pqsec {here.pqsec}, {here.python}, cryptography {here.cryptography}, {here.openssl}"
    yield here.hardware


def _row(each: MeasuredSuite, fragment: int) -> tuple[str, ...]:
    whole = each.wall_ms(*Operation)
    sides = (
        percentile(each.wall_ms(*(one for one in Operation if one.side == side)), 50)
        for side in ("initiator", "responder")
    )
    return (
        each.suite.profile or "",
        each.suite.keys,
        each.suite.agreement.name,
        f"{each.suite.version:>7}",
        f"{percentile(whole, 50):>6.2f}",
        f"{percentile(whole, 95):>6.2f}",
        *(f"{side:>9.2f}" for side in sides),
        f"{sum(each.sizes.tokens):>5}",
        "/".join(map(str, each.sizes.fragments(fragment))),
        f"{each.memory / _KILO:>9.0f}",
    )
