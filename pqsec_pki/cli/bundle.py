"""pqsec bundle: write what one robot needs from a keystore into one file."""

import posixpath
from collections.abc import Iterator, Sequence
from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki._progress import counted
from pqsec_pki.cli import _bundles, _completion, _help, _printing, _settings
from pqsec_pki.cli._names import admitted, named
from pqsec_pki.enrolment import Bundle, BundleFile, bundle_path, write_bundles
from pqsec_pki.errors import FileError, UsageError, located
from pqsec_pki.keystore import (
    BundleNumbers,
    InstallState,
    Keystore,
    State,
    is_several,
    regular_name,
    robot_states,
    status,
)


@_help.command(
    examples={
        "Write a bundle with keys that only one robot can open": (
            "pqsec bundle /talker --seal-for bundle.pub.pem"
        ),
        "Write a bundle without keys, for a robot that generated its own": (
            "pqsec bundle /fleet/robot1 -o robot1.bundle --force"
        ),
        "Write a bundle for all participants that a file names": (
            "pqsec bundle --robot names.txt --no-keys -o robot.bundle"
        ),
        "Write a bundle for each robot that does not run what it should": (
            "pqsec bundle --outdated --no-keys --bundles out"
        ),
    },
    exit_codes={
        0: "the bundle is written",
        1: "not written: `pqsec install` would refuse it",
        3: "a participant does not exist, or the keystore or a file cannot be read or written",
    },
)
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=_completion.participants)
@click.option(
    "--robot",
    type=_settings.FILE,
    metavar="FILE",
    help="Read the names, patterns and groups from FILE, one in a line, instead of NAME...",
)
@click.option(
    "-o",
    "--output",
    type=_settings.FILE,
    help="Write to this file. [default: named after what all NAMEs begin with, or the first]",
)
@click.option(
    "--outdated",
    is_flag=True,
    help="Write only what robots lack, of NAME or of all participants: one file for each, or all"
    " in the file of -o.",
)
@_bundles.folder_option
@_bundles.seal_option
@click.option("--plain-key", is_flag=True, help="Write private keys without encryption.")
@click.option("--no-keys", is_flag=True, help="Leave out private keys.")
@click.option("--force", is_flag=True, help="Replace an existing file.")
@_settings.command_options
def bundle(  # noqa: PLR0913 -- one for each option, by name
    names: tuple[str, ...],
    robot: Path | None,
    output: Path | None,
    folder: Path | None,
    seal_for: Path | None,
    *,
    outdated: bool,
    plain_key: bool,
    no_keys: bool,
    force: bool,
) -> None:
    """Write everything that one robot needs into one file.

    NAME may be a pattern, '/robot1/*' is all nodes of a robot, or a group: @hall1.
    The bundle has each NAME's certificate, permissions, governance, CA certificates and
    revocation list, and its private keys if they were generated here, in each set of credentials;
    never a CA key. A bundle that `pqsec install` would refuse is not written. A bundle with private
    keys must be encrypted with --seal-for, unless you use --plain-key. It also proves that the
    ledger has the certificate and the documents, if the CAs have signed a head of the ledger since.

    With --outdated, robots lack something if the receipt that `pqsec receipt import` recorded
    names other files than the keystore has, or if there is no receipt. Participants that a
    bundle cannot be for, because they are revoked or expired, are left out, and a note says so.
    """
    if (names and robot) or not (names or robot or outdated):
        raise UsageError("no participant named: give names, or --robot FILE")
    if folder and (output or not outdated):
        raise UsageError("--bundles is for --outdated, and excludes -o")
    _refuse_keys(seal_for, named=bool(names or robot), plain_key=plain_key, no_keys=no_keys)
    keystore = _settings.open_keystore()
    given = names or (_names_in(robot) if robot else ())
    wanted = _outdated(keystore, given) if outdated else admitted(keystore, given)
    alone = not wanted or (outdated and not output)
    together = [[name] for name in wanted] if alone else [wanted]
    paths = [output or bundle_path(folder or Path(), _common(each)) for each in together]
    recipient = _bundles.recipient(seal_for)
    files = [
        BundleFile(made, path, recipient, plain_key)
        for made, path in zip(_made(keystore, together, keys=not no_keys), paths, strict=True)
    ]
    write_bundles(files, force=force)
    _print(files, outdated=outdated)


def _made(keystore: Keystore, together: list[list[str]], *, keys: bool) -> Iterator[Bundle]:
    now = _settings.now()
    with BundleNumbers.of(keystore) as numbers:
        for names in counted(together, len(together), "bundles"):
            yield Bundle.of(keystore, names, now=now, keys=keys, numbers=numbers)


def _print(files: Sequence[BundleFile], *, outdated: bool) -> None:
    for each in files:
        if each.has_plain_keys:
            _printing.note(
                f"{each.path} has private keys without encryption: anybody with the file can read"
                " them"
            )
    if any(each.bundle.proof is None for each in files):
        _printing.note(
            "without proof that the ledger has the documents: no signed head is over their lines;"
            " `pqsec log --sign` signs one, or says why not"
        )
    lines = [f"{', '.join(each.bundle.names)}  {each.path}" for each in files]
    if outdated:
        _printing.emit({"bundles": files}, lines or ["every robot runs what it should"])
    else:
        _printing.emit(files[0].to_json(), lines)


def _common(names: Sequence[str]) -> str:
    """/robot1 for /robot1/arm and /robot1/base; the first name if they begin with nothing alike."""
    regular = [regular_name(each) for each in names]
    common = posixpath.commonpath(regular)
    return common if common != "/" else regular[0]


def _refuse_keys(seal_for: Path | None, *, named: bool, plain_key: bool, no_keys: bool) -> None:
    """UsageError for options about private keys that exclude each other."""
    if seal_for and not named:
        raise UsageError(
            "--seal-for encrypts for one robot, and --outdated is for all of them",
            hint="give the names of the robot whose `pqsec bundle-key` wrote FILE, such as"
            " '/robot1/*'",
        )
    if [bool(seal_for), plain_key, no_keys].count(True) > 1 and not (seal_for and no_keys):
        raise UsageError("--plain-key excludes --seal-for and --no-keys")


def _outdated(keystore: Keystore, names: Sequence[str]) -> list[str]:
    """The participants of these, or of all, whose robots do not run what they should."""
    standing = status(keystore, named(keystore, names) if names else None, now=_settings.now())
    participants = sorted(standing.participants, key=lambda each: each.name)
    robots = robot_states(keystore, participants)
    usable = {State.VALID, State.DUE, State.INCOMPLETE}
    valid = {
        each.name
        for each in participants
        if each.state in usable and robots[each.name].state is not InstallState.NONE
    }
    left_out = [f"{each.name} ({each.state})" for each in participants if each.name not in valid]
    if left_out:
        _printing.note(f"left out: {_printing.few(left_out)}")
    return [name for name in robots if name in valid and robots[name].state.calls_for_bundle]


def _names_in(path: Path) -> tuple[str, ...]:
    """The names in the file, one in a line; text after # is a comment."""
    lines = _files.read(path).decode(errors="replace").splitlines()
    written = [name for line in lines if (name := line.partition("#")[0].strip())]
    with located(path):
        names = tuple(name if is_several(name) else regular_name(name) for name in written)
    if not names:
        raise FileError(f"{path} does not name a participant")
    return names
