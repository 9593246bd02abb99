"""pqsec try: run two participants in a real DDS stack."""

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from datetime import datetime
from itertools import permutations
from typing import Any

import click

from pqsec_pki.cli import _completion, _help, _passphrases, _printing, _settings
from pqsec_pki.cli._paragraph import paragraph
from pqsec_pki.errors import UsageError, shown
from pqsec_pki.keystore import Keystore
from pqsec_pki.selfcheck import HandshakeSetup, JoinableDomains
from pqsec_pki.stacks import Stack
from pqsec_pki.trial import (
    MACHINE,
    STACKS,
    UNAUTHENTICATED,
    TopicRoute,
    Trial,
    TrialReport,
    find,
    plugin,
    refuse_untrusted,
    run_trial,
    topic_route,
)

ROS2, FASTDDS = Stack.ROS2.value, Stack.FASTDDS.value
PAIRS = tuple(map(",".join, permutations(STACKS, 2)))
TIMEOUT = 10.0
_PAIR = 2


@_help.command(
    "try",
    examples={
        "Run two participants in Cyclone DDS": "pqsec try cyclonedds /talker /listener",
        "Run them with pqsec's plugin, for post-quantum keys": (
            "pqsec try cyclonedds --plugin /talker /listener"
        ),
        "Run one in Cyclone DDS and the other in Fast DDS": (
            "pqsec try cyclonedds,fastdds --plugin /talker /listener"
        ),
        "Run them in Fast DDS on one topic": (
            "pqsec try fastdds /talker /listener --topic rt/chatter"
        ),
        "Check what a ROS 2 node needs": "pqsec try ros2 --dry-run /talker",
    },
    exit_codes={
        0: "the sample arrived, and only there; with --dry-run, the node would run",
        1: "no: the reasons are printed",
        3: "the stack, the keystore or a participant is missing, or a program cannot be compiled",
    },
)
@click.argument("stack", type=click.Choice([*map(str, STACKS), *PAIRS, ROS2]), metavar="STACK")
@click.argument("names", nargs=-1, metavar="A B", shell_complete=_completion.participants)
@click.option(
    "--topic",
    help="Send on this DDS topic. [default: a topic that both may use]",
    shell_complete=_completion.topics,
)
@click.option(
    "--domain",
    type=click.IntRange(0, 230),
    help="Run on this domain. [default: the first domain that both may join]",
)
@click.option(
    "--timeout",
    type=_settings.FiniteRange(0.5, 600),
    default=TIMEOUT,
    show_default=True,
    metavar="SECONDS",
    help="Wait this long for the sample.",
)
@click.option(
    "--password-file",
    type=_settings.FILE,
    help="Read the passphrase of the participants' keys from the first line of this file.",
)
@click.option(
    "--root",
    type=_settings.FOLDER,
    default=MACHINE,
    metavar="DIR",
    help="Use the stack in this root file system. [default: the installed one]",
)
@click.option("--plugin", is_flag=True, help="Use pqsec's plugin in the stack.")
@click.option(
    "--stock",
    multiple=True,
    metavar="NAME",
    help="With --plugin: run this participant with the stack's own plugin.",
    shell_complete=_completion.participants,
)
@click.option("--anyway", is_flag=True, help="Run also what the stack is known to refuse.")
@click.option(
    "--dry-run", is_flag=True, help="With ros2: check what a node needs, and run nothing."
)
@_settings.command_options
def try_(stack: str, names: tuple[str, ...], *, dry_run: bool, **given: Any) -> int:
    """Run two participants in a real DDS stack on this machine.

    STACK is cyclonedds, fastdds or ros2. The stack must be installed with its headers and a
    C compiler: a small program is compiled the first time. A and B run as processes on a
    loopback network, and A sends a sample to B. A third process without credentials must
    not receive it. With --plugin they use pqsec's plugin, for post-quantum keys, with an
    agent of their own; STACK may then be cyclonedds,fastdds: A runs in the first, B in the
    second. ROS 2 is not run: ros2 needs --dry-run, and accepts any number of participants.
    """
    if dry_run is not (stack == ROS2):
        raise UsageError(
            "ros2 is not run here" if stack == ROS2 else f"--dry-run is not for {stack}",
            hint="`pqsec try ros2 --dry-run NAME` checks all that a node needs",
        )
    _refuse_plugin(stack, names, given)
    if dry_run:
        from pqsec_pki.cli._preflight import report  # noqa: PLC0415 -- for ROS 2 alone

        return report(names)
    return _run(stack, names, given)


def _run(stack: str, names: tuple[str, ...], given: dict[str, Any]) -> int:
    if len(names) != _PAIR:
        raise UsageError(
            f"two participants are needed, but {len(names)} are named",
            hint=f"name two, as in `pqsec try {stack} /talker /listener`",
        )
    keystore, now = _settings.open_keystore(), _settings.now()
    if not given["anyway"]:
        refuse_untrusted(keystore, names, now)
    route = _route(keystore, names, now, topic=given["topic"], domain=given["domain"])
    found = {each: find(each, given["root"]) for each in stack.split(",")}
    first, *other = found.values()
    trial = Trial(
        installation=first,
        receiving=other[0] if other else None,
        keystore=keystore,
        timeout=given["timeout"],
        password=_passphrases.of_key(given["password_file"]),
        anyway=given["anyway"],
        stock=given["stock"],
        now=now,
    )
    with plugin(fastdds=found.get(FASTDDS)) if given["plugin"] else nullcontext() as ours:
        report = run_trial(replace(trial, plugin=ours), route)
    for warning in report.warnings:
        _printing.note(warning)
    _printing.emit(report.to_json(), _lines(report))
    return 0 if report.ok else 1


def _refuse_plugin(stack: str, names: tuple[str, ...], given: dict[str, Any]) -> None:
    """UsageError if --plugin or --stock do not fit the other options."""
    if given["plugin"] and stack == ROS2:
        raise UsageError(
            f"--plugin is not for {stack}",
            hint="--dry-run searches for it in LD_LIBRARY_PATH, as ROS 2 does",
        )
    if stack in PAIRS and (given["stock"] or not given["plugin"]):
        raise UsageError(
            f"{stack} is for pqsec's plugin in both",
            hint="use --plugin, and not --stock: the stacks' own plugins rarely work together",
        )
    if unknown := [each for each in given["stock"] if each not in names or not given["plugin"]]:
        raise UsageError(
            f"--stock {shown(unknown[0])} is not one of the participants, or --plugin is missing",
            hint="use it with --plugin, and with a name exactly as given",
        )


def _route(
    keystore: Keystore,
    names: tuple[str, ...],
    now: datetime,
    *,
    topic: str | None,
    domain: int | None,
) -> TopicRoute:
    """The sender, receiver, topic and domain; finds a topic and domain if none is given."""
    first, second = names
    for name in names:
        keystore.refuse_unknown(name)
    if domain is None:
        setup = HandshakeSetup(keystore=keystore, domain=0, now=now)
        joinable = JoinableDomains.of(setup, names)
        joinable.refuse_split()
        domain = joinable.domain
    if topic is None:
        return topic_route(keystore, (first, second), domain, now)
    if not topic:
        raise UsageError("the topic is empty", hint="omit --topic to use a topic that both may use")
    return TopicRoute(sender=first, receiver=second, domain=domain, topic=topic)


def _lines(report: TrialReport) -> Iterator[str]:
    route, sender, receiver = report.topic_route, report.sender.role.name, report.receiver.role.name
    stacks = " and ".join(each.title for each in report.installations)
    yield (
        f"{stacks}{_plugged(report)}, domain {route.domain}: {sender} sends on"
        f" {shown(route.topic)}, {receiver} receives"
    )
    seconds = f"{report.trial_run.seconds:.1f} s"
    if report.accepted:
        yield f"ok    sample    arrived after {seconds}"
    else:
        yield f"FAIL  sample    did not arrive; stopped after {seconds}"
    yield from _why(report)
    yield from _unauthenticated(report)
    yield from _wire(report)
    if not report.trial_run.alone:
        yield "      network   of this machine: others on the domain may have taken part"


def _plugged(report: TrialReport) -> str:
    """Which participants use pqsec's plugin, as text."""
    both = {report.sender.role.name, report.receiver.role.name} <= set(report.plugged)
    who = "" if both else f" in {', '.join(report.plugged)}"
    return f" with pqsec's plugin{who}" if report.plugged else ""


def _why(report: TrialReport) -> Iterator[str]:
    for found in report.findings:
        yield f"      {', '.join(found.participants)}: {found.said}"
        for what, text in (("cause", found.cause), ("remedy", found.remedy)):
            if text:
                yield from paragraph(f"        {what:<7} ", text)


def _unauthenticated(report: TrialReport) -> Iterator[str]:
    if report.unauthenticated_heard is None:
        why = "not tested" if not report.accepted else "did not start"
        yield f"{'FAIL' if report.accepted else '    '}  outsider  {UNAUTHENTICATED}: {why}"
    elif report.unauthenticated_heard:
        yield f"FAIL  outsider  {UNAUTHENTICATED} received the sample: `pqsec explain` shows why"
    else:
        yield f"ok    outsider  {UNAUTHENTICATED} received nothing"


def _wire(report: TrialReport) -> Iterator[str]:
    wire = report.trial_run.wire
    if report.readable is not None and wire:
        how = "can be read" if report.readable else "cannot be read"
        yield f"      wire      the sample {how} in {wire.packets} captured packets"
