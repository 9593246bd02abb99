"""pqsec try: do these two meet in a real DDS stack?"""

from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import asdict, replace
from datetime import datetime
from typing import Any

import click

from pqsec_pki.cli import _passphrases, _printing, _settings
from pqsec_pki.cli._paragraph import paragraph
from pqsec_pki.errors import UsageError, shown
from pqsec_pki.keystore import Keystore
from pqsec_pki.selfcheck.shared_domains import JoinableDomains
from pqsec_pki.trial import (
    MACHINE,
    STACKS,
    UNAUTHENTICATED,
    Report,
    TopicRoute,
    Trial,
    find,
    plugin,
    refuse_untrusted,
    run_trial,
    topic_route,
)

ROS2, PLUGGABLE = "ros2", "cyclonedds"
TIMEOUT = 10.0
_COUPLE = 2


@click.command("try")
@click.argument("stack", type=click.Choice([*STACKS, ROS2]), metavar="STACK")
@click.argument("names", nargs=-1, metavar="A B")
@click.option("--topic", help="A sends on this DDS topic. [default: one they may use together]")
@click.option(
    "--domain",
    type=click.IntRange(0, 230),
    help="The domain they meet on. [default: the first that both may join]",
)
@click.option(
    "--timeout",
    type=click.FloatRange(0.5, 600),
    default=TIMEOUT,
    show_default=True,
    metavar="SECONDS",
    help="How long to wait for the sample.",
)
@click.option(
    "--password-file", type=_settings.FILE, help="Whose first line opens the participants' keys."
)
@click.option(
    "--root",
    type=_settings.FOLDER,
    default=MACHINE,
    metavar="DIR",
    help="Use the stack in this root file system. [default: the one that is installed]",
)
@click.option("--plugin", is_flag=True, help="Run pqsec's plugin in Cyclone DDS.")
@click.option(
    "--stock",
    multiple=True,
    metavar="NAME",
    help="With --plugin: this participant runs Cyclone DDS's own all the same.",
)
@click.option("--anyway", is_flag=True, help="Try also what the stack is known to refuse.")
@click.option(
    "--dry-run", is_flag=True, help="For ros2: check what it would need, and run nothing."
)
@_settings.command_options
def try_(stack: str, names: tuple[str, ...], *, dry_run: bool, **given: Any) -> int:
    """Let two participants meet in a real DDS stack on this machine.

    STACK is cyclonedds or fastdds, and is installed with its headers and a compiler: the
    first time, a small program is compiled. A and B run as processes on a loopback, and one
    sends the other a sample; a third one, without credentials, must get nothing. The exit
    code is 0 if both is so, and 1 if not. With --plugin they run pqsec's plugin, for
    post-quantum keys, with an agent of their own. ROS 2 is not run: ros2 takes --dry-run
    only, and any number of participants.

    \b
    pqsec try cyclonedds /talker /listener
    pqsec try cyclonedds --plugin /talker /listener
    pqsec try fastdds /talker /listener --topic rt/chatter
    pqsec try ros2 --dry-run /talker
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
    if len(names) != _COUPLE:
        raise UsageError(
            f"two participants are to meet, and here are {len(names)}",
            hint=f"name two, as in `pqsec try {stack} /talker /listener`",
        )
    keystore, now = _settings.open_keystore(), _settings.now()
    if not given["anyway"]:
        refuse_untrusted(keystore, names, now)
    way = _way(keystore, names, now, topic=given["topic"], domain=given["domain"])
    trial = Trial(
        installation=find(stack, given["root"]),
        keystore=keystore,
        timeout=given["timeout"],
        password=_passphrases.of_key(given["password_file"]),
        anyway=given["anyway"],
        stock=given["stock"],
        now=now,
    )
    with plugin() if given["plugin"] else nullcontext() as ours:
        report = run_trial(replace(trial, plugin=ours), way)
    for warning in report.warnings:
        _printing.note(warning)
    _printing.emit(_as_json(report), _lines(report))
    return 0 if report.ok else 1


def _refuse_plugin(stack: str, names: tuple[str, ...], given: dict[str, Any]) -> None:
    """UsageError where it makes no sense."""
    if given["plugin"] and stack != PLUGGABLE:
        raise UsageError(
            f"--plugin is not for {stack}",
            hint="--dry-run looks for it as ROS 2 would, in LD_LIBRARY_PATH"
            if stack == ROS2
            else f"it is for {PLUGGABLE}",
        )
    if strange := [each for each in given["stock"] if each not in names or not given["plugin"]]:
        raise UsageError(
            f"--stock {shown(strange[0])} makes no sense",
            hint="with --plugin, it is for one of the two participants, named as there",
        )


def _way(
    keystore: Keystore,
    names: tuple[str, ...],
    now: datetime,
    *,
    topic: str | None,
    domain: int | None,
) -> TopicRoute:
    """Who sends to whom, on what and where, with what the user left out found."""
    first, second = names
    for name in names:
        keystore.refuse_unknown(name)
    if domain is None:
        joinable = JoinableDomains.of(keystore, names, now)
        joinable.refuse_split()
        domain = joinable.domain
    if topic is None:
        return topic_route(keystore, (first, second), domain, now)
    if not topic:
        raise UsageError("a topic has a name", hint="leave --topic out, and one is found")
    return TopicRoute(sender=first, receiver=second, domain=domain, topic=topic)


def _as_json(report: Report) -> dict[str, Any]:
    wire = report.trial_run.wire
    return {
        "stack": report.installation.build.stack,
        "stack_version": report.installation.version,
        "library": str(report.installation.library.path),
        "plugin": list(report.plugged),
        "domain": report.topic_route.domain,
        "topic": report.topic_route.topic,
        "sender": report.sender.role.name,
        "receiver": report.receiver.role.name,
        "ok": report.ok,
        "accepted": report.accepted,
        "seconds": round(report.trial_run.seconds, 2),
        "unauthenticated_heard": report.unauthenticated_heard,
        "readable": report.readable,
        "packets": wire.packets if wire else None,
        "own_network": report.trial_run.alone,
        "findings": [asdict(each) for each in report.findings],
        "warnings": list(report.warnings),
    }


def _lines(report: Report) -> Iterator[str]:
    way, sender, receiver = report.topic_route, report.sender.role.name, report.receiver.role.name
    yield (
        f"{report.installation.title}{_plugged(report)}, domain {way.domain}: {sender} sends on"
        f" {shown(way.topic)}, {receiver} receives"
    )
    seconds = f"{report.trial_run.seconds:.1f} s"
    if report.accepted:
        yield f"ok    sample    arrived after {seconds}"
    else:
        yield f"FAIL  sample    did not arrive, and it was over after {seconds}"
    yield from _why(report)
    yield from _unauthenticated(report)
    yield from _wire(report)
    if not report.trial_run.alone:
        yield "      network   that of this machine: others on the domain may have taken part"


def _plugged(report: Report) -> str:
    """Who runs pqsec's plugin, in words."""
    both = {report.sender.role.name, report.receiver.role.name} <= set(report.plugged)
    who = "" if both else f" in {', '.join(report.plugged)}"
    return f" with pqsec's plugin{who}" if report.plugged else ""


def _why(report: Report) -> Iterator[str]:
    for found in report.findings:
        yield f"      {', '.join(found.participants)}: {found.said}"
        for what, text in (("cause", found.cause), ("remedy", found.remedy)):
            if text:
                yield from paragraph(f"        {what:<7} ", text)


def _unauthenticated(report: Report) -> Iterator[str]:
    if report.unauthenticated_heard is None:
        why = "not put to the test" if not report.accepted else "did not come up"
        yield f"{'FAIL' if report.accepted else '    '}  outsider  {UNAUTHENTICATED}: {why}"
    elif report.unauthenticated_heard:
        yield f"FAIL  outsider  {UNAUTHENTICATED} got the sample: `pqsec explain` shows why"
    else:
        yield f"ok    outsider  {UNAUTHENTICATED} got nothing"


def _wire(report: Report) -> Iterator[str]:
    wire = report.trial_run.wire
    if report.readable is not None and wire:
        how = "can be read" if report.readable else "cannot be read"
        yield f"      wire      the sample {how} in {wire.packets} captured packets"
