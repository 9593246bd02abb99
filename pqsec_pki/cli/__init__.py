"""The pqsec command. Each command reads its options, calls one room, prints.

Commands are loaded when they run: `pqsec --help` costs no cryptography.
"""

import io
import os
import signal
import sys
import warnings
from importlib import import_module
from keyword import iskeyword
from pathlib import Path

import click

from pqsec_pki import __version__
from pqsec_pki.cli._printing import printable
from pqsec_pki.cli._settings import command_options
from pqsec_pki.errors import FileError, PqsecError, meant, shown

__all__ = ["main", "pqsec"]

COMMANDS = {
    "demo": ("demo", "Make a secured domain of two participants and prove that it works."),
    "ca": ("ca", "Make, show and change the CAs, and the identity CA's revocation list."),
    "plan": (
        "plan",
        "Tell what FILE wants and the keystore has not: what `pqsec apply` would do.",
    ),
    "apply": ("apply", "Make the keystore as FILE wants it: what `pqsec plan` tells is done."),
    "adopt": (
        "adopt",
        "Make a keystore of SROS2, or one in its layout, a keystore of pqsec's, and check it.",
    ),
    "issue": ("issue", "Issue participants: key, certificate and signed permissions."),
    "request": ("request", "Make keys on the robot, and the request for their certificate."),
    "bundle-key": ("request", "Make the key on the robot with which it opens sealed bundles."),
    "bundle": (
        "bundle",
        "Write a bundle: all that one robot needs of the keystore, in one file.",
    ),
    "install": ("install", "Check a bundle, and let it be what this robot runs with."),
    "rollback": ("install", "Go back to what was installed before the last bundle, once."),
    "sign-request": (
        "sign_request",
        "Have requests signed by CAs on a machine without a network.",
    ),
    "renew": (
        "renew",
        "Renew participants: certificate and permissions together, allowed the same as before.",
    ),
    "needs-renewal": (
        "renew",
        "Tell whether participants, or the revocation list, should be renewed.",
    ),
    "revoke": (
        "revoke",
        "Take certificates back: a new revocation list, linked into every enclave.",
    ),
    "status": (
        "status",
        "Show every participant, how long it lasts and its state, the most urgent first.",
    ),
    "log": ("log", "Show the ledger: every certificate, document and revocation made here."),
    "governance": ("governance", "Write the governance document in YAML, with presets."),
    "permissions": (
        "permissions",
        "Write permissions documents in YAML, and import policies of SROS2.",
    ),
    "sign-governance": ("sign", "Check a governance document against its schema and sign it."),
    "sign-permissions": ("sign", "Check a permissions document against its schema and sign it."),
    "validate": ("validate", "Check governance and permissions documents against their schemas."),
    "check": ("check", "Tell what is wrong or risky in keystores, folders and files."),
    "verify": ("verify", "Check who signed a governance or permissions document."),
    "verify-handshake": ("handshake", "Run the authentication handshake between two participants."),
    "export": ("export", "Write the configuration with which a DDS stack runs as a participant."),
    "try": ("try_", "Let two participants meet in a real DDS stack on this machine."),
    "plugin": ("plugin", "Install the security plugin that Cyclone DDS loads."),
    "agent": ("agent", "Look after the agent, which holds the keys for the plugin."),
    "explain": (
        "explain",
        "Tell whether a participant may do something, which rule decided, and why.",
    ),
    "explain-error": (
        "explain_error",
        "Tell what a DDS stack's security error means, and the way out.",
    ),
    "who-may": ("who_may", "Tell who may publish and subscribe to what."),
    "diff": ("diff", "Tell what a change of policy grants and takes away."),
    "inspect": ("inspect", "Tell in words what a certificate, key or document is."),
    "profiles": ("algorithms", "List the profiles: algorithms that are used together."),
    "algorithms": ("algorithms", "List the algorithms, their sizes and which stacks run them."),
}
"""Command -> (module of this room, the help that `pqsec --help` shows)."""


_STREAMS = (("stdin", "r"), ("stdout", "w"), ("stderr", "w"))
"""By their numbers."""


class _Lazy(click.Group):
    """A group whose commands are imported when they are asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        del ctx
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, name: str) -> click.Command | None:
        del ctx
        if name not in COMMANDS:
            return None
        module = import_module(f"pqsec_pki.cli.{COMMANDS[name][0]}")
        function = name.replace("-", "_") + "_" * iskeyword(name)
        command: click.Command = getattr(module, function)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """As click does it, but an unknown command is told which may be meant."""
        if args[0] not in COMMANDS and not args[0].startswith("-"):
            instead = meant(args[0], COMMANDS).replace("did", " Did", 1)
            ctx.fail(f"No such command {shown(args[0])!r}.{instead}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        del ctx
        with formatter.section("Commands"):
            formatter.write_dl([(name, help_) for name, (_, help_) in COMMANDS.items()])


@click.group(cls=_Lazy, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="pqsec")
@command_options
def pqsec() -> None:
    """Keys, certificates and signed policy for post-quantum DDS Security.

    Start with `pqsec demo`, or with `pqsec -k my-domain ca init`.
    """


def main() -> None:
    """Run the command line and exit: 0 done or yes, 1 no, 2 usage, 3 could not be done."""
    # A reader that has seen enough, as `head` has, ends pqsec quietly, as it ends any filter.
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    # A polite kill undoes what was begun, as Ctrl-C does.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    _open_what_is_closed()
    # What pqsec makes it must be able to read: of the umask only the others' part counts.
    os.umask(os.umask(0o077) & 0o077)
    if not sys.warnoptions:  # cryptography's, on odd files: they are for developers
        warnings.simplefilter("ignore")
    if isinstance(sys.stdout, io.TextIOWrapper):  # a path may hold what the terminal cannot show
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        _refuse_nowhere()
        result = pqsec.main(prog_name="pqsec", standalone_mode=False)
    except PqsecError as error:
        _complain(*error.lines, hint=error.hint)
        sys.exit(error.exit_code)
    except click.ClickException as error:
        _complain_of_usage(error)
        sys.exit(error.exit_code)
    except click.Abort:
        _complain("interrupted")
        sys.exit(130)
    sys.exit(result if isinstance(result, int) else 0)


def _open_what_is_closed() -> None:
    """A stream that the shell closed leads nowhere now, and not into the next file opened."""
    while (handle := os.open(os.devnull, os.O_RDWR)) < len(_STREAMS):
        name, mode = _STREAMS[handle]
        setattr(sys, name, os.fdopen(handle, mode))
    os.close(handle)


def _refuse_nowhere() -> None:
    try:
        Path.cwd()
    except OSError as error:
        raise FileError(
            "the folder in which this shell is has been removed", hint="cd to another"
        ) from error


def _complain_of_usage(error: click.ClickException) -> None:
    if isinstance(error, click.exceptions.NoArgsIsHelpError):
        error.show()
        return
    context = error.ctx if isinstance(error, click.UsageError) else None
    command = context.command_path if context else "pqsec"
    _complain(error.format_message(), hint=f"`{command} --help` tells what it takes")


def _complain(*messages: str, hint: str | None = None) -> None:
    for message in messages:
        click.echo(f"pqsec: error: {printable(message)}", err=True)
    if hint:
        click.echo(f"pqsec: hint: {printable(hint)}", err=True)
