"""The pqsec command. Each command reads its options, calls one room and prints.

Commands are imported when they run: `pqsec --help` does not load cryptography.
"""

import io
import os
import signal
import sys
import warnings
from contextlib import suppress
from importlib import import_module
from keyword import iskeyword
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pqsec_pki import __version__
from pqsec_pki.cli import _failures, _output, _progress
from pqsec_pki.cli._completion import VARIABLE
from pqsec_pki.cli._help import Group
from pqsec_pki.cli._settings import CommandSettings, command_options
from pqsec_pki.errors import FileError, ForeignAlgorithmWarning, PqsecError, meant, shown

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

__all__ = ["main", "pqsec"]

COMMANDS = {
    "demo": ("demo", "Create a secured domain with two participants and run their handshake."),
    "ca": ("ca", "Create, show and change the CAs and the revocation list."),
    "plan": ("plan", "Show the changes that `pqsec apply` would make."),
    "apply": ("apply", "Change the keystore to match a domain file."),
    "approve": (
        "approve",
        "Approve a plan that somebody proposed with `pqsec plan -o` or `pqsec propose`.",
    ),
    "propose": ("propose", "Propose one command to those who must approve it."),
    "domain": ("domain", "Write a domain file from keystores and policies."),
    "adopt": ("adopt", "Turn a keystore of SROS2 or OpenSSL into a pqsec keystore, and check it."),
    "issue": ("issue", "Issue participants: key, certificate and signed permissions."),
    "request": ("request", "Generate keys and certificate requests on the robot."),
    "bundle-key": ("request", "Generate the robot's key for opening sealed bundles."),
    "bundle": ("bundle", "Write everything that one robot needs into one file."),
    "install": ("install", "Check a bundle and install it on this robot."),
    "rollback": ("install", "Restore what was installed before the last bundle."),
    "enrol": ("enrol", "Enrol this robot at a server: make its keys, install what it answers."),
    "receipt": (
        "receipt",
        "Record what robots run, from the receipts that `pqsec install` writes.",
    ),
    "serve": ("serve", "Let robots enrol and renew over a network."),
    "enrolment-token": (
        "enrolment_token",
        "Create, list and revoke tokens, with which robots enrol over a network.",
    ),
    "requests": ("requests", "Decide about robots that asked the server without a token."),
    "sign-request": ("sign_request", "Sign requests with CAs on an offline machine."),
    "ra": ("ra", "Let others order that new participants are enrolled, within limits."),
    "renew": ("renew", "Renew certificates and permissions, with the same rights as before."),
    "needs-renewal": (
        "renew",
        "Test whether participants or the revocation list are due for renewal.",
    ),
    "permit": ("permit", "Add or remove single rights of participants; their keys stay."),
    "revoke": (
        "revoke",
        "Revoke certificates, and put the new revocation list into every enclave.",
    ),
    "status": ("status", "Show each participant's state and expiry, the most urgent first."),
    "log": ("log", "Show or verify the ledger of everything issued, signed and revoked."),
    "ledger": ("ledger", "Keep the ledger in PostgreSQL, for CAs on several machines."),
    "governance": ("governance", "Write and convert governance documents in YAML."),
    "permissions": (
        "permissions",
        "Write and convert permissions documents in YAML, and import SROS2 policies.",
    ),
    "schema": ("schema", "Write the JSON Schema of a file, for editors."),
    "sign-governance": ("sign", "Check a governance document against its schema, and sign it."),
    "sign-permissions": ("sign", "Check a permissions document against its schema, and sign it."),
    "validate": ("validate", "Check governance and permissions documents against their schemas."),
    "migrate": ("migrate", "Plan and rehearse the change to a post-quantum profile."),
    "cbom": ("cbom", "Write a cryptographic bill of materials (CBOM) in CycloneDX 1.7."),
    "check": ("check", "Report errors and risks in keystores, folders and files."),
    "report": (
        "report",
        "Write a report of the keystore: who may command what, what ends when, and what changed.",
    ),
    "verify": ("verify", "Check who signed a governance or permissions document."),
    "verify-handshake": ("handshake", "Run the authentication handshake between two participants."),
    "export": ("export", "Write the configuration that a DDS stack needs to run as a participant."),
    "try": ("try_", "Run two participants in a real DDS stack on this machine."),
    "plugin": ("plugin", "Install the security plugin that DDS stacks load."),
    "agent": ("agent", "Control the agent, which holds the keys for the plugin."),
    "explain": (
        "explain",
        "Show whether a participant may do something, and which rule decides.",
    ),
    "explain-error": (
        "explain_error",
        "Explain a security error of a DDS stack, and how to fix it.",
    ),
    "who-may": ("who_may", "Show which participants may publish and subscribe to each topic."),
    "diff": ("diff", "Show the rights that a policy change grants and removes."),
    "inspect": ("inspect", "Describe a certificate, key, request or document."),
    "uninstall": (
        "uninstall",
        "List what pqsec has on this machine, and how each is removed.",
    ),
    "bench": ("bench", "Measure the time, message sizes and memory of the handshake."),
    "estimate": (
        "estimate",
        "Predict what the handshakes of a fleet cost, and how long they take.",
    ),
    "profiles": ("algorithms", "List the profiles: algorithms that are used together."),
    "algorithms": ("algorithms", "List the algorithms, their sizes and which stacks run them."),
}
"""Command -> (module in this room, one-line help for `pqsec --help`)."""

GROUPS = {
    "Issue and maintain": (
        "demo ca adopt issue permit renew needs-renewal revoke status log ledger plan propose"
        " approve apply domain"
    ),
    "Robots with their own keys, and offline CAs": (
        "request bundle-key bundle install rollback enrol receipt sign-request ra serve"
        " enrolment-token requests"
    ),
    "Write and sign policies": (
        "governance permissions schema sign-governance sign-permissions validate"
    ),
    "Check and explain": (
        "check report verify verify-handshake explain who-may diff cbom migrate inspect bench"
        " estimate profiles algorithms"
    ),
    "Use with a DDS stack": "export try explain-error plugin agent uninstall",
}
"""Heading, as in README -> commands below it, in `pqsec --help`."""

_STREAMS = (("stdin", "r"), ("stdout", "w"), ("stderr", "w"))
"""Name and mode of each standard stream, by file descriptor number."""


class _Lazy(Group):
    """A group that imports a command when it is used."""

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
        """Resolve like click, with similar names in the error for an unknown command."""
        unknown = args[0] not in COMMANDS and not args[0].startswith("-")
        if unknown and not ctx.resilient_parsing:
            instead = meant(args[0], COMMANDS).replace("did", " Did", 1)
            if args[0] == "completion":
                instead = f" `{VARIABLE}=bash_source pqsec` prints it for bash."
            ctx.fail(f"No such command {shown(args[0])!r}.{instead}")
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Invoke like click, which would end silently, with 1, where a peer closed a connection."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError as error:
            raise FileError(
                "the other side of a connection closed it", hint="run the command again"
            ) from error

    def shell_complete(self, ctx: click.Context, incomplete: str) -> "list[CompletionItem[Any]]":
        """The commands and options that begin so, without importing any command."""
        from click.shell_completion import CompletionItem  # noqa: PLC0415 -- for a shell alone

        commands = [
            CompletionItem(name, help=text)
            for name, (_, text) in COMMANDS.items()
            if name.startswith(incomplete)
        ]
        return commands + click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        del ctx
        for heading, names in GROUPS.items():
            with formatter.section(heading):
                formatter.write_dl([(name, COMMANDS[name][1]) for name in names.split()])


@click.group(cls=_Lazy, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="pqsec")
@command_options
def pqsec() -> None:
    """Keys, certificates and signed policy for post-quantum DDS Security.

    Start with `pqsec demo`, or with `pqsec -k my-domain ca init`.
    """


def main() -> None:
    """Run the command line and exit: 0 done or yes, 1 no, 2 usage, 3 could not be done."""
    _prepare_process()
    try:
        _run()
    except _output.ReaderGoneError:
        _output.end()


def _run() -> None:
    if os.environ.get(VARIABLE):
        with suppress(PqsecError, click.ClickException, OSError):  # they would be in the prompt
            pqsec.main(prog_name="pqsec", standalone_mode=False)
        sys.exit(1)
    settings = CommandSettings()
    try:
        _refuse_removed_folder()
        with _progress.shown():
            result = pqsec.main(prog_name="pqsec", standalone_mode=False, obj=settings)
    except PqsecError as error:
        _failures.print_error(error, as_json=_failures.is_json(settings))
        sys.exit(error.exit_code)
    except click.ClickException as error:
        _failures.print_usage_error(error, as_json=_failures.is_json(settings))
        sys.exit(error.exit_code)
    except click.Abort:
        _failures.print_messages("interrupted")
        sys.exit(130)
    sys.exit(result if isinstance(result, int) else 0)


def _prepare_process() -> None:
    """Signals, standard streams, umask and warnings, before a command runs."""
    # SIGTERM rolls back the change in progress, as Ctrl-C does.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    _open_closed_streams()
    _output.watch()
    # pqsec must be able to read its own files: ignore the owner's bits of the umask.
    os.umask(os.umask(0o077) & 0o077)
    if not sys.warnoptions:  # cryptography warns about unusual files: for developers only
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", ForeignAlgorithmWarning)
        warnings.showwarning = _warn
    if isinstance(
        sys.stdout, io.TextIOWrapper
    ):  # a path may have characters that the terminal cannot show
        sys.stdout.reconfigure(errors="backslashreplace")


def _warn(message: Warning | str, *_: object, **__: object) -> None:
    with _progress.hidden():
        click.echo(f"pqsec: warning: {message}", err=True)


def _open_closed_streams() -> None:
    """Connect closed standard streams to /dev/null, so that no opened file gets their number."""
    while (handle := os.open(os.devnull, os.O_RDWR)) < len(_STREAMS):
        name, mode = _STREAMS[handle]
        setattr(sys, name, os.fdopen(handle, mode, closefd=False))  # `_output` may replace it
    os.close(handle)


def _refuse_removed_folder() -> None:
    try:
        Path.cwd()
    except OSError as error:
        raise FileError(
            "the current folder has been removed", hint="change to another folder"
        ) from error
