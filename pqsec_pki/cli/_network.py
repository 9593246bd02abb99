"""Options that enrol and renew share, for the server and the trusted CAs; and their report."""

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pqsec_pki.cli import _printing, _settings
from pqsec_pki.cli._times import end
from pqsec_pki.errors import PqsecError, UsageError

if TYPE_CHECKING:
    from pqsec_pki.est import Obtained, ServerTrust

NEEDS = "enrolment over a network needs the library {library}, which is not installed"

fingerprints_option = click.option(
    "--ca-fingerprint",
    "fingerprints",
    multiple=True,
    metavar="ROLE:SHA256",
    help="Trust this CA as identity, permissions or countersigner; one option for each CA, of a"
    " further set as hybrid/identity. [default: the CAs that are trusted here]",
)


def server_options(command: _settings.Command) -> _settings.Command:
    """Add how the server is known, and which CAs are trusted."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


_OPTIONS: tuple[Callable[[_settings.Command], _settings.Command], ...] = (
    click.option(
        "--server-pin",
        "server_pins",
        multiple=True,
        metavar="SHA256",
        help="Trust the server whose key has this SHA-256, as `pqsec inspect` of its certificate"
        " shows; one option for each key.",
    ),
    click.option(
        "--server-ca",
        type=_settings.FILE,
        metavar="FILE",
        help="Trust the server if a CA in this file issued its certificate, for its name.",
    ),
    fingerprints_option,
)


def server_trust(server_pins: Iterable[str], server_ca: Path | None) -> "ServerTrust | None":
    """The trust of the options; None without them. UsageError for both, or for no SHA-256."""
    from pqsec_pki._files import read  # noqa: PLC0415 -- not for --help
    from pqsec_pki._places import refuse_obeyed  # noqa: PLC0415 -- likewise
    from pqsec_pki.est import ServerTrust, server_pin  # noqa: PLC0415 -- a library of an extra

    pins = frozenset(map(server_pin, server_pins))
    if pins and server_ca:
        raise UsageError("--server-pin and --server-ca exclude each other")
    if not (pins or server_ca):
        return None
    if server_ca is None:
        return ServerTrust(pins, b"")
    refuse_obeyed([server_ca], "which server is trusted")
    return ServerTrust(pins, read(server_ca))


def report(found: "Sequence[Obtained | PqsecError]", folder: Path) -> None:
    """Send the receipt, and print what became of each participant; raise what failed."""
    done = [each for each in found if not isinstance(each, PqsecError)]
    failed = [each for each in found if isinstance(each, PqsecError)]
    if done and (revoked := _send_receipt(folder, done[0].name)):
        failed, done = [revoked, *failed], done[1:]
    if done:
        for problem in dict.fromkeys(problem for each in done for problem in each.future):
            _printing.note(str(problem))
        lines = [
            f"{each.name}  {_words(each)}, until {end(each.certificate.not_after)}  {folder}"
            for each in done
        ]
        _printing.emit({"participants": done}, lines)
    if failed:
        raise FailedError(failed)


class FailedError(PqsecError):
    """The errors of several participants."""

    def __init__(self, errors: Sequence[PqsecError]) -> None:
        super().__init__(str(errors[0]), hint=errors[0].hint)
        self.errors = tuple(errors)
        self.exit_code = max(each.exit_code for each in errors)

    @property
    def lines(self) -> tuple[str, ...]:
        """The lines of all errors."""
        return tuple(line for each in self.errors for line in each.lines)


def _send_receipt(folder: Path, name: str) -> PqsecError | None:
    """Send it as the participant `name`; the error if its certificate, installed before, was
    revoked.
    """
    from pqsec_pki.est import WasRevokedError, deliver_receipt  # noqa: PLC0415 -- of an extra

    try:
        deliver_receipt(folder, name)
    except WasRevokedError as error:
        error.where = error.where or name
        return error
    except PqsecError as error:
        _printing.note(f"the server has no receipt yet; `pqsec renew --from` sends it: {error}")
    return None


def _words(each: "Obtained") -> str:
    if each.renewed:
        return "has a new certificate"
    return "has newer documents" if each.changed else "is up to date"
