"""pqsec bundle: what one robot needs of a keystore, in one file."""

from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki.cli import _bundles, _printing, _settings
from pqsec_pki.enrolment import Bundle, flat_name
from pqsec_pki.errors import FileError, UsageError, located
from pqsec_pki.keystore import regular_name


@click.command()
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option(
    "--robot",
    type=_settings.FILE,
    metavar="FILE",
    help="The participants of a robot, one name in a line, in place of NAME...",
)
@click.option(
    "-o", "--output", type=_settings.FILE, help="Where to write. [default: of the first name]"
)
@_bundles.seal_option
@click.option("--plain-key", is_flag=True, help="Write private keys that anybody can read.")
@click.option("--no-keys", is_flag=True, help="Leave private keys out.")
@click.option("--force", is_flag=True, help="Replace the file if it is there.")
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
    """Write a bundle: all that one robot needs of the keystore, in one file.

    Each NAME's certificate, permissions, governance, CA certificates and revocation list,
    and its private keys if they were made here; never a CA's key. `pqsec install` takes
    it, so what it would refuse is not written. With private keys it is sealed for its
    robot, or you say --plain-key.
    """
    if bool(names) == bool(robot):
        raise UsageError("say whom the bundle is for: names, or --robot FILE")
    if [bool(seal_for), plain_key, no_keys].count(True) > 1 and not (seal_for and no_keys):
        raise UsageError("--plain-key excludes --seal-for and --no-keys")
    wanted = names or _names_in(robot)
    goal = output or Path(f"{flat_name(regular_name(wanted[0]))}.bundle")
    keystore = _settings.open_keystore()
    now = _settings.now()
    made = Bundle.of(keystore, wanted, now=now, keys=not no_keys)
    recipient = _bundles.recipient(seal_for)
    _bundles.write(made, goal, recipient, force=force, plain_key=plain_key)
    if made.has_keys and plain_key:
        _printing.note(f"{goal} holds private keys that anybody can read who gets it")
    value = {
        "bundle": str(goal),
        "names": made.names,
        "keys": made.has_keys,
        "sealed": seal_for is not None,
        "ca_sha256": made.fingerprints,
    }
    _printing.emit(value, [f"{', '.join(made.names)}  {goal}"])


def _names_in(path: Path | None) -> tuple[str, ...]:
    """One name in a line; what follows a # is for people."""
    lines = _files.read(path).decode(errors="replace").splitlines() if path else []
    written = [name for line in lines if (name := line.partition("#")[0].strip())]
    with located(path):
        names = tuple(map(regular_name, written))
    if not names:
        raise FileError(f"{path} names no participant")
    return names
