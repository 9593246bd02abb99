"""pqsec verify-handshake: run the authentication handshake between participants."""

import os
from dataclasses import replace
from typing import Any

import click

from pqsec_pki.algorithms import KEY_AGREEMENTS, KeyAgreement, Profile
from pqsec_pki.cli import _completion, _help, _printing, _settings, _wire_version
from pqsec_pki.cli._handshake_lines import lines_of
from pqsec_pki.cli._names import admitted
from pqsec_pki.errors import UnknownAlgorithmError, UsageError
from pqsec_pki.handshake import StockPeers, WireVersion, stock_name
from pqsec_pki.keystore import Keystore, is_several, regular_name
from pqsec_pki.selfcheck import (
    PQSEC,
    STACKS,
    HandshakeParty,
    HandshakeReport,
    HandshakeSetup,
    JoinableDomains,
    SimulatedStack,
    stack_named,
)
from pqsec_pki.selfcheck import verify_handshake as run_between

MATRIX_ROUNDS = 5
_PAIR = 2
_PAIR_OPTIONS = {"--domain", "--kem", "--as", "--set", _wire_version.NAME}
_STOCK = "--stock"
_MODE_OPTIONS = {
    "two participants": _PAIR_OPTIONS | {_STOCK},
    "--all": _PAIR_OPTIONS | {"--jobs"},
    "--matrix": {"--rounds"},
    "--trace": _PAIR_OPTIONS | {"--force", "--insecure-show-secrets"},
    "--attack": {"--domain", "--kem", "--set", _STOCK, _wire_version.NAME},
}
"""Mode -> options that it accepts."""


@_help.command(
    "verify-handshake",
    examples={
        "Run the handshake between two participants": "pqsec verify-handshake /talker /listener",
        "Test whether it succeeds if /listener runs Cyclone DDS": (
            "pqsec verify-handshake /talker /listener --as cyclonedds"
        ),
        "Write every message, byte by byte": (
            "pqsec verify-handshake /talker /listener --trace trace.txt"
        ),
        "Test that forged messages are refused": (
            "pqsec verify-handshake /talker /listener --attack all"
        ),
        "Run all pairs of the keystore": "pqsec verify-handshake --all",
        "Run all pairs of a robot's nodes and another participant": (
            "pqsec verify-handshake --all '/fleet/*' /talker"
        ),
        "Run it with the shorter messages of version 2": (
            "pqsec verify-handshake /talker /listener --wire-version 2"
        ),
        "Measure all profiles and key agreements": "pqsec verify-handshake --matrix",
    },
    exit_codes={
        0: "the handshake succeeds; with --attack, all forged messages are refused",
        1: "a step of the handshake fails; with --attack, a forged message is accepted",
        3: "the keystore or a participant cannot be read, or FILE cannot be written",
    },
)
@click.argument("names", nargs=-1, metavar="[A B|NAME...]", shell_complete=_completion.participants)
@click.option(
    "--all",
    is_flag=True,
    help="Run all pairs that share a domain, of all or of these.",
)
@click.option("--matrix", is_flag=True, help="Measure every profile with every key agreement.")
@click.option(
    "--trace",
    metavar="FILE",
    type=_settings.FILE,
    help="Write every message, decoded and byte for byte, to FILE (- is stdout).",
)
@click.option(
    "--attack",
    metavar="NAME|all",
    help="Attack the handshake, and check that both refuse.",
    shell_complete=_completion.attacks,
)
@click.option(
    "--kem",
    metavar="NAME",
    help="Use another key agreement than the profile's.",
    shell_complete=_completion.key_agreements,
)
@click.option(
    "--domain",
    type=click.IntRange(0, 230),
    help="Run on this domain. [default: the first domain that both may join]",
)
@click.option(
    "--as",
    "stacks",
    metavar="STACK",
    multiple=True,
    help="Let B behave like this DDS stack; given twice, A and then B. With --all, in both orders.",
    shell_complete=_completion.among(each.name for each in STACKS),
)
@click.option(
    "--set",
    "profile",
    metavar="PROFILE",
    help="Use the credentials of this profile. [default: those of each set, one after the other;"
    " with --as a stock stack, those that it can use]",
)
@click.option(
    _STOCK,
    metavar="NAME",
    multiple=True,
    help="Let each side choose among its sets as pqsec's plugin does, if this participant, or those"
    " of a pattern ('/fleet/*'), may be met with the first set. May be given several times.",
)
@_wire_version.option("Send messages of this version between pqsec peers; 2 is the shorter one.")
@click.option(
    "--jobs",
    type=click.IntRange(1, 256),
    help="Use this many processes for --all. [default: one per CPU]",
)
@click.option(
    "--rounds",
    type=click.IntRange(1, 1000),
    default=MATRIX_ROUNDS,
    show_default=True,
    help="Run this many handshakes of each suite for --matrix.",
)
@click.option("--force", is_flag=True, help="Replace an existing FILE of --trace.")
@click.option(
    "--insecure-show-secrets",
    is_flag=True,
    help="Write the shared secrets and plaintext into the trace. Private keys are never written.",
)
@_settings.command_options
@click.pass_context
def verify_handshake(context: click.Context, /, names: tuple[str, ...], **given: Any) -> None:
    """Run the authentication handshake between two participants.

    All three messages between A and B are exchanged in memory. Both certificate chains
    and permissions documents are checked, and after the key exchange one encrypted message
    is sent each way. The failing step is printed, and the topics that the two share. A
    handshake also succeeds without a common topic. With --all, a NAME may be a pattern
    ('/robot1/*') or a group (@hall1).
    """
    if any(map(is_several, names)):
        names = tuple(admitted(_settings.open_keystore(), names))
    mode = _mode(names)
    runs = {"--all": _all, "--matrix": _matrix, "--trace": _trace, "--attack": _attack}
    if not runs.get(mode, _one_pair)(names, given):
        context.exit(1)


def _mode(names: tuple[str, ...]) -> str:
    """The mode, a key of _MODE_OPTIONS. UsageError for options that exclude each other."""
    known = set(_MODE_OPTIONS).union(*_MODE_OPTIONS.values())
    given = known.intersection(_settings.given_options().values())
    mode, *others = [mode for mode in _MODE_OPTIONS if mode in given] or ["two participants"]
    if others:
        raise UsageError(f"{mode} and {others[0]} exclude each other")
    for option in sorted(given - _MODE_OPTIONS[mode] - {mode}):
        right = " or ".join(each for each, accepted in _MODE_OPTIONS.items() if option in accepted)
        raise UsageError(f"{option} is for {right}, not for {mode}")
    if mode == "--matrix" and names:
        raise UsageError(f"{mode} takes no participants, but {len(names)} are named")
    enough = not names or len(names) >= _PAIR if mode == "--all" else len(names) == _PAIR
    if mode != "--matrix" and not enough:
        more = "--all with the same names runs all their pairs" if len(names) > _PAIR else ""
        raise UsageError(
            f"a handshake needs two participants, but {_named(len(names))}",
            hint=more or "name two, as in `pqsec verify-handshake /talker /listener`",
        )
    return mode


def _named(count: int) -> str:
    return f"{count} {'is' if count == 1 else 'are'} named"


def _one_pair(names: tuple[str, ...], given: dict[str, Any]) -> bool:
    if stock := _stock(given):
        report = _report(_settings.open_keystore(), names, given, stock)
        _printing.emit(report.to_json(), [*lines_of(report)])
        return report.ok
    sets = _sets(given)
    (profile, first), *others = [(each.profile.name, _report(each, names, given)) for each in sets]
    further = [{"profile": name, **report.to_json()} for name, report in others]
    lines = [*lines_of(first)]
    for name, report in others:
        lines += ["", f"set {name}", *lines_of(report)]
    _printing.emit({**first.to_json(), "profile": profile, "further": further}, lines)
    return first.ok and all(report.ok for _, report in others)


def _report(
    keystore: Keystore,
    names: tuple[str, ...],
    given: dict[str, Any],
    stock: StockPeers | None = None,
) -> HandshakeReport:
    return run_between(
        keystore,
        *names,
        now=_settings.now(),
        domain=given["domain"],
        stacks=_stacks(given["stacks"]),
        agreement=_agreement(given["kem"]),
        versions=_versions(keystore.sets[-1] if stock else keystore, given),
        stock=stock,
    )


def _all(names: tuple[str, ...], given: dict[str, Any]) -> bool:
    from pqsec_pki.cli._handshake_pairs import try_all  # noqa: PLC0415 -- not for every mode
    from pqsec_pki.selfcheck import AllPairsJob  # noqa: PLC0415

    keystore = _one_set(given)
    first, second = _stacks(given["stacks"])
    job = AllPairsJob(
        root=keystore.root,
        profile=keystore.profile.name,
        now=_settings.now(),
        domain=given["domain"],
        key_agreement=given["kem"],
        stacks=(first.name, second.name),
        versions=_versions(keystore, given),
    )
    chosen = list(dict.fromkeys(map(regular_name, names))) or keystore.names()
    for name in chosen:
        keystore.refuse_unknown(name)
    return try_all(job, chosen, given["jobs"] or os.cpu_count() or 1)


def _matrix(names: tuple[str, ...], given: dict[str, Any]) -> bool:
    del names
    from pqsec_pki.cli._handshake_matrix import show_matrix  # noqa: PLC0415

    show_matrix(given["rounds"])
    return True


def _trace(names: tuple[str, ...], given: dict[str, Any]) -> bool:
    from pqsec_pki.cli import _handshake_trace  # noqa: PLC0415

    path, force = given["trace"], given["force"]
    if not force:
        _handshake_trace.refuse_existing_file(path)
    report = _report(_one_set(given), names, given)
    shown = given["insecure_show_secrets"]
    _handshake_trace.write_trace(report, lines_of(report), path, show_secrets=shown, force=force)
    return report.ok


def _attack(names: tuple[str, ...], given: dict[str, Any]) -> bool:
    from pqsec_pki.cli import _handshake_attacks  # noqa: PLC0415

    attacks = _handshake_attacks.attacks_named(given["attack"])
    keystore, stock = _settings.open_keystore(), _stock(given)
    if stock is None and len(keystore.profiles) > 1 and given["profile"] is None:
        stock = StockPeers()
    keystore = keystore if stock else _one_set(given)
    now, domain = _settings.now(), given["domain"]
    agreement = _agreement(given["kem"])
    setup = HandshakeSetup(
        keystore=keystore,
        domain=domain or 0,
        now=now,
        agreement=agreement,
        versions=_versions(keystore.sets[-1] if stock else keystore, given),
        stock=stock,
    )
    joinable = JoinableDomains.of(setup, names)
    if domain is None:
        joinable.refuse_split()
        setup = replace(setup, domain=joinable.domain)
    first, second = (HandshakeParty(name=name) for name in names)
    return _handshake_attacks.try_attacks(setup, (first, second), attacks)


def _stock(given: dict[str, Any]) -> StockPeers | None:
    """Whom --stock names; None without it. UsageError if there is nothing to choose."""
    if not given["stock"]:
        return None
    if given["profile"] is not None:
        raise UsageError(f"{_STOCK} and --set exclude each other")
    if len(_settings.open_keystore().profiles) == 1:
        raise UsageError(f"{_STOCK} is for a keystore with several sets of credentials")
    return StockPeers(tuple(map(stock_name, given["stock"])))


def _sets(given: dict[str, Any]) -> list[Keystore]:
    """The sets of credentials; prints a note if --kem breaks a promise of a profile."""
    keystore, profile = _settings.open_keystore(), given["profile"]
    found = [keystore.of_profile(profile)] if profile else [*keystore.sets]
    if not profile and any(each.is_stock for each in _stacks(given["stacks"])):
        found = [each for each in found if each.profile.runs_in_stock] or found[:1]
    if given["kem"] is not None:
        for each in found:
            _note_broken_promise(given["kem"], each.profile)
    return found


def _one_set(given: dict[str, Any]) -> Keystore:
    """The only set; UsageError if there are several, and none is named."""
    found, *others = _sets(given)
    if others:
        names = ", ".join(each.profile.name for each in (found, *others))
        raise UsageError(f"the keystore has several sets: name one with --set: {names}")
    return found


def _agreement(kem: str | None) -> KeyAgreement | None:
    return None if kem is None else KEY_AGREEMENTS.named(kem)


def _versions(keystore: Keystore, given: dict[str, Any]) -> tuple[WireVersion, ...]:
    """The version that was chosen; UsageError if these handshakes have no such messages."""
    version = _wire_version.version_of(given["wire_version"])
    agreement = _agreement(given["kem"]) or keystore.profile.key_agreement
    stock = any(each.is_stock for each in _stacks(given["stacks"]))
    _wire_version.refuse_unknown(version, agreement, stock=stock)
    return (version,)


def _stacks(names: tuple[str, ...]) -> tuple[SimulatedStack, SimulatedStack]:
    """The stacks that the first and the second participant behave like."""
    if len(names) > _PAIR:
        raise UsageError("--as is given more than twice: there are two participants")
    first, second = [PQSEC, PQSEC, *map(stack_named, names)][-2:]
    return first, second


def _note_broken_promise(kem: str, profile: Profile) -> None:
    try:
        profile.changed({"key_agreement": kem})
    except UnknownAlgorithmError:
        raise
    except UsageError as error:
        _printing.note(f"{error}; the handshake runs anyway")
