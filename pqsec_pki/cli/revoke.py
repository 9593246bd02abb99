"""pqsec revoke: revoke certificates of participants."""

from collections.abc import Iterable, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import click

from pqsec_pki._files import read
from pqsec_pki.approvals import Covered
from pqsec_pki.certificates import Certificate, Reason, RevocationList
from pqsec_pki.cli import _completion, _help, _passphrases, _printing, _settings
from pqsec_pki.cli._confirmation import confirm
from pqsec_pki.cli._names import named
from pqsec_pki.cli._times import day
from pqsec_pki.credentials import CERTIFICATE
from pqsec_pki.errors import UsageError, located
from pqsec_pki.keystore import Entry, Keystore, SigningCa, list_delivery, robot_states
from pqsec_pki.keystore import status as status_of
from pqsec_pki.lifecycle import LIST_VALIDITY, Revoked, revocable
from pqsec_pki.lifecycle import revoke as revoke_subjects


class _Reason(click.Choice):  # type: ignore[type-arg] # generic in newer clicks only
    """A reason as RFC 5280 spells it; upper and lower case are the same in what is given."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The reason. Raises click's error for another word."""
        spelled = {each.lower(): each for each in self.choices}
        return super().convert(spelled.get(str(value).lower(), value), param, ctx)


list_validity_option = click.option(
    "--validity",
    type=_settings.Duration(),
    default=LIST_VALIDITY,
    help="Issue a list that is valid this long; stacks refuse all peers after that.  [default: 1y]",
)


@_help.command(
    examples={
        "Revoke a stolen robot": ("pqsec revoke /fleet/robot1 --reason keyCompromise --yes"),
        "Revoke all nodes of a robot": "pqsec revoke '/fleet/*' --yes",
        "Revoke a certificate that the ledger does not have": (
            "pqsec revoke --certificate cert.pem --yes"
        ),
        "Revoke what a participant had before it was renewed or replaced": (
            "pqsec revoke /talker --superseded --yes"
        ),
        "Issue a list that is valid for 90 days": "pqsec revoke /talker --validity 90d --yes",
    },
    exit_codes={
        0: "revoked, now or earlier; or no certificate was superseded",
        3: "not revoked: a participant, the keystore or the passphrase is missing or wrong",
    },
)
@click.argument(
    "subjects",
    nargs=-1,
    metavar="[NAME|SERIAL]...",
    shell_complete=_completion.participants,
)
@click.option(
    "--certificate",
    "files",
    multiple=True,
    type=_settings.FILE,
    metavar="FILE",
    help="Revoke this certificate of the identity CA, which the ledger need not have; repeatable.",
)
@click.option(
    "--reason",
    type=_Reason([reason.value for reason in Reason]),
    help="Record this reason in the list (RFC 5280 5.3.1).  [default: unspecified; with"
    " --superseded: superseded]",
)
@click.option(
    "--superseded",
    is_flag=True,
    help="Of each NAME, revoke the valid certificates before the current one, and keep that.",
)
@list_validity_option
@click.option("--yes", is_flag=True, help="Do not ask for confirmation.")
@_passphrases.option
@_settings.command_options
def revoke(  # noqa: PLR0913 -- one for each option, by name
    subjects: tuple[str, ...],
    files: tuple[Path, ...],
    reason: str | None,
    validity: timedelta,
    passphrase_file: Path | None,
    *,
    superseded: bool,
    yes: bool,
) -> None:
    """Revoke certificates, and put the new revocation list into every enclave.

    NAME revokes all unexpired certificates of that participant, SERIAL one certificate; a
    pattern such as '/robot1/*' is all that match it, @hall1 a group. The certificates are
    shown first. The result says which robots do not have the new list yet, what they still
    accept, until when, and how they get it.
    """
    keystore, now = _settings.open_keystore(to_change=True), _settings.now()
    keystore.refuse_unapproved(Covered.REVOKE)
    if not subjects and not files:
        raise UsageError("nothing to revoke", hint="give names, serial numbers, or --certificate")
    chosen = named(keystore, subjects)
    certificates = certificates_in(files)
    if superseded and files:
        raise UsageError("--superseded and --certificate exclude each other")
    if superseded or not yes:
        found = revocable(keystore, chosen, certificates, superseded=superseded, now=now)
        if not found:
            _nothing(keystore, chosen)
            return
        _note_running(keystore, chosen, superseded=superseded, now=now)
        if not yes:
            _ask(found)
    authorities = _passphrases.unlock_with_signers(keystore, passphrase_file, SigningCa.IDENTITY)
    with keystore.hold():  # so that the ledger, as it is then, is not read again
        revoked, made = revoke_subjects(
            keystore,
            authorities,
            chosen,
            certificates=certificates,
            reason=Reason(reason or (Reason.SUPERSEDED if superseded else Reason.UNSPECIFIED)),
            superseded=superseded,
            now=now,
            validity=validity,
        )
        delivery = list_delivery(keystore, now=now)
    if not all(each.listed for each in revoked):
        _printing.note(
            "certificates of an earlier CA are not in a list: participants that still trust that CA"
            " accept them; copy the files of the current CA to every robot"
        )
    value = {"revoked": revoked, "list": keystore.revocation_list_path, **made.to_json()}
    _printing.emit(
        {**value, "delivery": delivery},
        [*map(_line, revoked), list_line(keystore, made), *(delivery.lines if delivery else ())],
    )


def _nothing(keystore: Keystore, names: Sequence[str]) -> None:
    words = f"no valid certificate of {_printing.few(names)} was superseded: nothing to revoke"
    value = {"revoked": [], "list": keystore.revocation_list_path, "delivery": None}
    _printing.emit(value, [words])


def _note_running(
    keystore: Keystore, names: Sequence[str], *, superseded: bool, now: datetime
) -> None:
    """Note which robots run a certificate that is revoked as superseded, by their receipts."""
    if not superseded:
        return
    robots = robot_states(keystore, status_of(keystore, names, now=now).participants)
    if behind := [name for name, each in robots.items() if CERTIFICATE in each.changed]:
        _printing.note(
            f"by its newest receipt, each of these still runs an earlier certificate:"
            f" {_printing.few(behind)}; the others refuse it until it installs the current one"
        )


def certificates_in(paths: Iterable[Path]) -> list[Certificate]:
    """The certificates in these files."""
    found = []
    for path in paths:
        with located(path):
            found.append(Certificate.from_pem(read(path)))
    return found


def _ask(certificates: list[Entry]) -> None:
    count = _printing.counted(len(certificates), "certificate")
    names = _printing.few(dict.fromkeys(each.name for each in certificates))
    confirm(
        lambda: _printing.emit(
            None,
            [
                f"revoke: {each.name}  {each.serial}  until {day(each.ends)}"
                for each in certificates
            ],
        ),
        "Revoke these? It cannot be undone.",
        what=f"{count} of {names} would be revoked",
        hint="--yes revokes; `pqsec status` with the same names shows them",
    )


def list_line(keystore: Keystore, made: RevocationList) -> str:
    """The list as one line."""
    due = f", next due by {day(made.next_update)}" if made.next_update else ""
    what = _printing.counted(len(made.revoked), "certificate")
    return f"list {made.number}: {what}{due}  {keystore.revocation_list_path}"


def _line(each: Revoked) -> str:
    word = "was already revoked," if each.before else "revoked"
    return f"{each.name}  {each.serial}  {word} {day(each.since)} ({each.reason})"
