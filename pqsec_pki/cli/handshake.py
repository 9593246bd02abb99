"""pqsec verify-handshake: would these two authenticate each other?"""

import os
from collections.abc import Iterator, Sequence
from typing import Any

import click
from click.core import ParameterSource

from pqsec_pki.algorithms import KEY_AGREEMENTS, Profile
from pqsec_pki.cli import _printing, _settings
from pqsec_pki.cli._documents import plain
from pqsec_pki.errors import UnknownAlgorithmError, UsageError
from pqsec_pki.keystore import Keystore
from pqsec_pki.selfcheck import PQSEC, HandshakeParty, HandshakeSetup, Report, Stack, stack_named
from pqsec_pki.selfcheck.shared_domains import JoinableDomains, meet_on

MATRIX_ROUNDS = 5
_COUPLE = 2
_TOLD = 6
"""Topics, and domains, in a line."""
_NO_TOPIC = "They share no topic: neither may subscribe to anything that the other may publish."
_MEETING = {"--domain", "--kem", "--as"}
_TAKES = {
    "two participants": _MEETING,
    "--all": _MEETING | {"--jobs"},
    "--matrix": {"--rounds"},
    "--trace": _MEETING | {"--force", "--insecure-show-secrets"},
    "--attack": {"--domain", "--kem"},
}
"""What can be asked for, and the options that mean something there."""


@click.command("verify-handshake")
@click.argument("names", nargs=-1, metavar="[A B]")
@click.option("--all", is_flag=True, help="Every two participants that share a domain.")
@click.option("--matrix", is_flag=True, help="Every profile with every key agreement, measured.")
@click.option(
    "--trace",
    metavar="FILE",
    type=_settings.FILE,
    help="Write every message, byte for byte and in words, to FILE (- is stdout).",
)
@click.option("--attack", metavar="NAME|all", help="Attack the two, and see all refused.")
@click.option("--kem", metavar="NAME", help="Another key agreement than the profile's.")
@click.option(
    "--domain",
    type=click.IntRange(0, 230),
    help="The domain they meet on. [default: the first that both may join]",
)
@click.option(
    "--as",
    "stacks",
    metavar="STACK",
    multiple=True,
    help="B behaves as that DDS stack; given twice, A and then B. With --all, both ways round.",
)
@click.option(
    "--jobs", type=click.IntRange(1, 256), help="Processes for --all. [default: one for each CPU]"
)
@click.option(
    "--rounds",
    type=click.IntRange(1, 1000),
    default=MATRIX_ROUNDS,
    show_default=True,
    help="Handshakes of each suite for --matrix.",
)
@click.option("--force", is_flag=True, help="Replace FILE of --trace.")
@click.option(
    "--insecure-show-secrets",
    is_flag=True,
    help="Put the secrets that both end with into the trace, and plaintext. Never private keys.",
)
@_settings.command_options
@click.pass_context
def verify_handshake(context: click.Context, /, names: tuple[str, ...], **given: Any) -> None:
    """Run the authentication handshake between two participants.

    All three messages between A and B, in memory: both certificate chains, both
    permissions documents, and the key exchange up to one encrypted message each way.
    Exit 1, with the failing step, if they would not meet. What they may then say to each
    other is told too: two that share no topic meet all the same.

    \b
    pqsec verify-handshake /talker /listener
    pqsec verify-handshake /talker /listener --as cyclonedds
    pqsec verify-handshake /talker /listener --trace trace.txt
    pqsec verify-handshake /talker /listener --attack all
    pqsec verify-handshake --all
    pqsec verify-handshake --matrix
    """
    mode = _mode(context, names)
    runs = {"--all": _all, "--matrix": _matrix, "--trace": _trace, "--attack": _attack}
    if not runs.get(mode, _two)(names, given):
        context.exit(1)


def _mode(context: click.Context, names: tuple[str, ...]) -> str:
    """Which of _TAKES is asked for; UsageError where things do not go together."""
    known = set(_TAKES).union(*_TAKES.values())
    given = {
        option.opts[0]
        for option in context.command.params
        if context.get_parameter_source(str(option.name)) is ParameterSource.COMMANDLINE
    } & known
    mode, *others = [mode for mode in _TAKES if mode in given] or ["two participants"]
    if others:
        raise UsageError(f"{mode} and {others[0]} exclude each other")
    for option in sorted(given - _TAKES[mode] - {mode}):
        right = " or ".join(each for each, takes in _TAKES.items() if option in takes)
        raise UsageError(f"{option} is for {right}, not for {mode}")
    due = 0 if mode in {"--all", "--matrix"} else _COUPLE
    if len(names) != due:
        raise UsageError(
            f"{mode} takes no participants, and here are {len(names)}"
            if due == 0
            else f"a handshake is between two participants, and here are {len(names)}",
            hint="name two, as in `pqsec verify-handshake /talker /listener`, or say --all alone",
        )
    return mode


def _two(names: tuple[str, ...], given: dict[str, Any]) -> bool:
    report = _report(names, given)
    _printing.emit(report.to_json(), lines_of(report))
    return report.ok


def _report(names: tuple[str, ...], given: dict[str, Any]) -> Report:
    setup, parties, joinable = _invited(names, given)
    return meet_on(joinable, setup, *parties, anywhere=given["domain"] is None)


def _invited(
    names: tuple[str, ...], given: dict[str, Any]
) -> tuple[HandshakeSetup, tuple[HandshakeParty, HandshakeParty], JoinableDomains]:
    """Two who are to meet, where, and on what; and where they could."""
    keystore, now = _keystore(given["kem"]), _settings.now()
    for name in names:
        keystore.refuse_unknown(name)
    joinable = JoinableDomains.of(keystore, names, now)
    setup = HandshakeSetup(
        keystore=keystore,
        domain=joinable.domain if given["domain"] is None else given["domain"],
        now=now,
        agreement=None if given["kem"] is None else KEY_AGREEMENTS.named(given["kem"]),
    )
    first, second = _stacks(given["stacks"])
    return (
        setup,
        (HandshakeParty(name=names[0], stack=first), HandshakeParty(name=names[1], stack=second)),
        joinable,
    )


def _all(names: tuple[str, ...], given: dict[str, Any]) -> bool:
    del names
    from pqsec_pki.cli._handshake_pairs import try_all  # noqa: PLC0415 -- not for every mode
    from pqsec_pki.selfcheck.pairs import AllPairsJob  # noqa: PLC0415

    keystore = _keystore(given["kem"])
    first, second = _stacks(given["stacks"])
    job = AllPairsJob(
        root=keystore.root,
        now=_settings.now(),
        domain=given["domain"],
        key_agreement=given["kem"],
        stacks=(first.name, second.name),
    )
    return try_all(job, keystore.names(), given["jobs"] or os.cpu_count() or 1)


def _matrix(names: tuple[str, ...], given: dict[str, Any]) -> bool:
    del names
    from pqsec_pki.cli._handshake_matrix import show_matrix  # noqa: PLC0415

    show_matrix(given["rounds"])
    return True


def _trace(names: tuple[str, ...], given: dict[str, Any]) -> bool:
    from pqsec_pki.cli import _handshake_trace  # noqa: PLC0415

    path, force = given["trace"], given["force"]
    if not force:
        _handshake_trace.refuse_taken(path)
    report = _report(names, given)
    shown = given["insecure_show_secrets"]
    _handshake_trace.tell(report, lines_of(report), path, show_secrets=shown, force=force)
    return report.ok


def _attack(names: tuple[str, ...], given: dict[str, Any]) -> bool:
    from pqsec_pki.cli import _handshake_attacks  # noqa: PLC0415

    attacks = _handshake_attacks.attacks_named(given["attack"])
    setup, parties, joinable = _invited(names, given)
    if given["domain"] is None:
        joinable.refuse_split()
    return _handshake_attacks.try_attacks(setup, parties, attacks)


def _keystore(kem: str | None) -> Keystore:
    """The keystore that is meant, which may have to do with a weaker key agreement."""
    keystore = _settings.open_keystore()
    if kem is not None:
        _warn_of_a_weaker(kem, keystore.profile)
    return keystore


def _stacks(names: tuple[str, ...]) -> tuple[Stack, Stack]:
    """How the first and the second participant behave."""
    if len(names) > _COUPLE:
        raise UsageError("--as is for two participants: give it twice at most")
    first, second = [PQSEC, PQSEC, *map(stack_named, names)][-2:]
    return first, second


def _warn_of_a_weaker(kem: str, profile: Profile) -> None:
    try:
        profile.changed({"key_agreement": kem})
    except UnknownAlgorithmError:
        raise
    except UsageError as error:
        _printing.note(f"{error}; trying it all the same")


def lines_of(report: Report) -> list[str]:
    """The report for a person."""
    width = max(len(step.name) for step in report.steps)
    lines = [
        f"{'ok  ' if step.ok else 'FAIL'}  {step.name.ljust(width)}  {step.detail}"
        for step in report.steps
    ]
    if failed := report.failed:
        hint = [f"hint: {failed.hint}"] if failed.hint else []
        return [*lines, "", f"They would not meet: {failed.name} failed.", *hint]
    sizes = ", ".join(f"{name} {size} B" for name, size in report.token_bytes.items())
    return [
        *lines,
        "",
        *_talk_lines(report),
        f"signatures {report.signature}, key agreement {report.key_agreement}",
        f"{sizes}; {report.milliseconds:.1f} ms for both sides",
    ]


def _talk_lines(report: Report) -> Iterator[str]:
    """Where they meet, and what they may say to each other there."""
    if report.domain is None:
        return
    others = [str(each) for each in report.shared if each != report.domain]
    also = f"; both may join {_shortened(others)} too" if others else ""
    yield f"They meet on domain {report.domain}{also}."
    for talk in report.talks:
        topics = _shortened(talk.topics) if talk.topics else "no topic"
        yield f"{talk.sender} to {talk.receiver}: {topics}"
    if not any(talk.topics for talk in report.talks):
        yield _NO_TOPIC


def _shortened(names: Sequence[str]) -> str:
    more = f" and {len(names) - _TOLD} more" if len(names) > _TOLD else ""
    return ", ".join(map(plain, names[:_TOLD])) + more
