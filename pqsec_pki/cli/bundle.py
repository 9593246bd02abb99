"""pqsec bundle: write what one robot needs from a keystore into one file."""

from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki.cli import _bundles, _completion, _help, _printing, _settings
from pqsec_pki.cli._names import admitted
from pqsec_pki.enrolment import Bundle, bundle_path, write_bundle
from pqsec_pki.errors import FileError, UsageError, located
from pqsec_pki.keystore import is_several, regular_name


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
    help="Write to this file. [default: named after the first NAME]",
)
@_bundles.seal_option
@click.option("--plain-key", is_flag=True, help="Write private keys without encryption.")
@click.option("--no-keys", is_flag=True, help="Leave out private keys.")
@click.option("--force", is_flag=True, help="Replace an existing file.")
@_settings.command_options
def bundle(  # noqa: PLR0913 -- one for each option, by name
    names: tuple[str, ...],
    robot: Path | None,
    output: Path | None,
    seal_for: Path | None,
    *,
    plain_key: bool,
    no_keys: bool,
    force: bool,
) -> None:
    """Write everything that one robot needs into one file.

    NAME may be a pattern, '/robot1/*' is all nodes of a robot, or a group: @hall1.
    The bundle has each NAME's certificate, permissions, governance, CA certificates and
    revocation list, and its private keys if they were generated here; never a CA key. A
    bundle that `pqsec install` would refuse is not written. A bundle with private keys must
    be encrypted with --seal-for, unless you use --plain-key.
    """
    if bool(names) == bool(robot):
        raise UsageError("no participant named: give names, or --robot FILE")
    if [bool(seal_for), plain_key, no_keys].count(True) > 1 and not (seal_for and no_keys):
        raise UsageError("--plain-key excludes --seal-for and --no-keys")
    keystore = _settings.open_keystore()
    wanted = admitted(keystore, names or _names_in(robot))
    goal = output or bundle_path(Path(), regular_name(wanted[0]))
    now = _settings.now()
    made = Bundle.of(keystore, wanted, now=now, keys=not no_keys)
    recipient = _bundles.recipient(seal_for)
    write_bundle(made, goal, recipient, force=force, plain_key=plain_key)
    if made.has_keys and plain_key:
        _printing.note(
            f"{goal} has private keys without encryption: anybody with the file can read them"
        )
    value = {
        "bundle": goal,
        "names": made.names,
        "number": made.number,
        "keys": made.has_keys,
        "sealed": seal_for is not None,
        "ca_sha256": made.fingerprints,
    }
    _printing.emit(value, [f"{', '.join(made.names)}  {goal}"])


def _names_in(path: Path | None) -> tuple[str, ...]:
    """The names in the file, one in a line; text after # is a comment."""
    lines = _files.read(path).decode(errors="replace").splitlines() if path else []
    written = [name for line in lines if (name := line.partition("#")[0].strip())]
    with located(path):
        names = tuple(name if is_several(name) else regular_name(name) for name in written)
    if not names:
        raise FileError(f"{path} does not name a participant")
    return names
