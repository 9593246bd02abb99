"""pqsec bench: measure the handshake of suites."""

import sys
from collections.abc import Iterator, Sequence

import click

from pqsec_pki.algorithms import KEY_AGREEMENTS, PROFILES, SIGNATURES, profile_named
from pqsec_pki.benchmark import (
    CSV_COLUMNS,
    Environment,
    HandshakeSuite,
    MeasuredSuite,
    Operation,
    every_suite,
    measured_rounds,
    percentile,
    suites_of,
)
from pqsec_pki.cli import _completion, _formats, _help, _printing, _settings
from pqsec_pki.errors import UsageError

INTERRUPTED = 130
"""The exit code after Ctrl-C, as a shell has it: 128 + SIGINT."""
_HEADERS = (
    *("profile", "signature", "key agreement", "p50 ms", "p95 ms", "initiator", "responder"),
    *("bytes", "fragments", "memory kB"),
)
_KILO = 1000


@_help.command(
    examples={
        "Measure the suites of all profiles": "pqsec bench --rounds 20",
        "Compare two key agreements with one signature": (
            "pqsec bench --signature ml-dsa-65 --kem mlkem768 --kem x25519mlkem768"
        ),
        "Keep all samples, for your own statistics": ("pqsec bench --profile pq --format csv"),
    },
    exit_codes={
        0: "all suites are measured",
        3: "the result cannot be printed",
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
    default=50,
    show_default=True,
    help="Measure this many handshakes of each suite.",
)
@click.option(
    "--warm-up",
    type=click.IntRange(0, 100_000),
    default=5,
    show_default=True,
    help="Run this many before them, which do not count.",
)
@click.option(
    "--fragment-size",
    "fragment",
    type=click.IntRange(64, 65_000),
    default=1344,
    show_default=True,
    help="Bytes of a sample in one datagram; the default is Cyclone DDS's.",
)
@_formats.option()
@_settings.command_options
def bench(  # noqa: PLR0913 -- one for each option, by name
    *,
    profiles: tuple[str, ...],
    signatures: tuple[str, ...],
    agreements: tuple[str, ...],
    every: bool,
    rounds: int,
    warm_up: int,
    fragment: int,
    form: str,
) -> int:
    """Measure the time, message sizes and memory of the handshake.

    In memory, both sides in one process and without a DDS stack: new participants of each suite
    run whole handshakes, and each verifies the other as if they had never met. JSON has
    percentiles, all samples and the environment; CSV has one line for each operation of each
    handshake.
    """
    if every and (profiles or signatures or agreements):
        raise UsageError("--all measures everything: leave out --profile, --signature and --kem")
    suites = (
        every_suite()
        if every
        else suites_of(
            [profile_named(name) for name in profiles],
            [SIGNATURES.named(name) for name in signatures],
            [KEY_AGREEMENTS.named(name) for name in agreements],
        )
    )
    form = _formats.chosen(form)
    environment = Environment.here(_settings.now())
    found = _measured(suites, rounds, warm_up)
    complete = len(found) == len(suites) and all(len(each.rounds) == rounds for each in found)
    value = {
        "environment": environment,
        "complete": complete,
        "fragment_bytes": fragment,
        "suites": [each.to_json(fragment) for each in found],
    }
    rows = (row for each in found for row in each.rows())
    lines = _lines(environment, found, fragment)
    _formats.emit(form, value, lines, columns=CSV_COLUMNS, items=rows)
    if not complete:
        _printing.note("interrupted: this is what was measured until then")
    return 0 if complete else INTERRUPTED


def _measured(suites: Sequence[HandshakeSuite], rounds: int, warm_up: int) -> list[MeasuredSuite]:
    """Each suite in turn, until Ctrl-C, with a progress bar on a terminal."""
    found: list[MeasuredSuite] = []
    hidden, length = not sys.stderr.isatty(), len(suites) * (rounds + warm_up)
    with click.progressbar(
        length=length, label="handshakes", show_pos=True, file=sys.stderr, hidden=hidden
    ) as bar:
        for suite in suites:
            one = measured_rounds(
                suite, rounds=rounds, warm_up=warm_up, now=_settings.now(), each=bar.update
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
    yield "p50, p95: a whole handshake, both sides. initiator, responder: p50 of each side."
    yield f"bytes: of the three tokens. fragments: of request, reply, final, by {fragment} bytes."
    yield "memory: the most that Python held for one handshake, without OpenSSL's own."
    here = environment
    yield f"pqsec {here.pqsec}, {here.python}, cryptography {here.cryptography}, {here.openssl}"
    yield f"{here.processor or here.machine}, {here.cores} cores, load {here.load[0]:.1f}"


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
        f"{percentile(whole, 50):>6.2f}",
        f"{percentile(whole, 95):>6.2f}",
        *(f"{side:>9.2f}" for side in sides),
        f"{sum(each.sizes.tokens):>5}",
        "/".join(map(str, each.sizes.fragments(fragment))),
        f"{each.memory / _KILO:>9.0f}",
    )
