"""pqsec renew and needs-renewal: renew certificates and permissions."""

from datetime import timedelta
from pathlib import Path

import click

from pqsec_pki._times import said
from pqsec_pki.cli import (
    _bundles,
    _completion,
    _formats,
    _help,
    _network,
    _passphrases,
    _printing,
    _settings,
)
from pqsec_pki.cli._names import admitted, named
from pqsec_pki.cli._renew_from import refuse_mixed, renew_from
from pqsec_pki.cli._superseded import note_superseded
from pqsec_pki.cli.issue import note_unsigned_governance, print_issued
from pqsec_pki.cli.request import folder_option
from pqsec_pki.enrolment import pins_of
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import State, Status, list_delivery
from pqsec_pki.keystore import status as status_of
from pqsec_pki.lifecycle import Renewal
from pqsec_pki.lifecycle import renew as renew_participants

_NO_TIME = timedelta()
"""The value of --due without TIME; no duration is zero."""


@_help.command(
    examples={
        "Renew everything with less than a third of its life left": "pqsec renew --due",
        "Renew two participants for half a year, with new keys": (
            "pqsec renew /talker /listener --validity 26w --rekey"
        ),
        "Renew all nodes of a robot": "pqsec renew '/fleet/*'",
        "On a robot, renew from its server what is due, and fetch what is new": (
            "pqsec renew --from https://enrol.example:8443 --dir /etc/dds"
        ),
    },
    exit_codes={
        0: "renewed, or nothing was due",
        1: (
            "not renewed: a document is not valid, a key was revoked as compromised, or the server"
            " refused"
        ),
        3: (
            "not renewed: a participant, the keystore or the passphrase is missing or wrong, the"
            " server cannot be reached, or the request waits for an approval"
        ),
    },
)
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=_completion.participants)
@click.option(
    "--due",
    type=_settings.Duration(),
    is_flag=False,
    flag_value=_NO_TIME,
    help="Renew what expires within this time; without a time, what has less than a third of its"
    " life left.",
)
@click.option(
    "--all", "everybody", is_flag=True, help="Renew every participant that is not revoked."
)
@click.option(
    "--rekey/--keep-key",
    default=None,
    help="Generate new keys, or certify the same keys again.  [default: new keys, if the old"
    " ones are in the keystore, and rights that grow need no approvals]",
)
@_bundles.compromised_option
@click.option(
    "--validity",
    type=_settings.Duration(),
    help="Issue for this long from now.  [default: as long as before]",
)
@_passphrases.option
@click.option(
    "--from", "url", metavar="URL", help="On a robot: renew what is in DIR from this server."
)
@folder_option
@_network.server_options
@_settings.command_options
def renew(  # noqa: PLR0913 -- one for each option, by name
    names: tuple[str, ...],
    due: timedelta | None,
    validity: timedelta | None,
    passphrase_file: Path | None,
    *,
    url: str | None,
    folder: Path,
    server_pins: tuple[str, ...],
    server_ca: Path | None,
    fingerprints: tuple[str, ...],
    everybody: bool,
    rekey: bool | None,
    compromised_keys: bool,
) -> None:
    """Renew certificates and permissions, with the same rights as before.

    Name participants ('/robot1/*' is all that match, @hall1 a group), or use --due or
    --all. Either all are renewed or none. If the revocation list is due, a new one is issued too.

    With --from, on a robot that enrolled with `pqsec enrol`, it replaces certificates that are due,
    or all with --rekey, by certificates for new keys. Otherwise it fetches the newest documents and
    list. Each participant is renewed by itself, and stays as it was if that fails. DIR/server.json
    says how to recognise the server, unless options do.
    """
    refuse_mixed(url)
    if url is not None:
        server, pins = (server_pins, server_ca), pins_of(fingerprints) or None
        renew_from(url, names, folder, server, pins, due=due or None, rekey=rekey)
        return
    ways = [bool(names), due is not None, everybody].count(True)
    if not ways:
        raise UsageError("no participant named: give names, --due or --all")
    if ways > 1:
        raise UsageError("names, --due and --all exclude each other")
    keystore, now = _settings.open_keystore(to_change=True), _settings.now()
    names = tuple(admitted(keystore, names))
    standing = status_of(keystore, names or None, now=now, due=due or None)
    chosen = standing.due if due is not None else _renewable(standing, names)
    if not chosen and not standing.list_is_due:
        _printing.emit({"keystore": keystore.root, "issued": []}, ["nothing to renew"])
        return
    terms = Renewal(rekey, validity, due or None, compromised_keys)
    authorities = _passphrases.unlock(keystore, passphrase_file)
    with keystore.hold():  # so that the ledger, as it is then, is not read again
        renewed = renew_participants(keystore, authorities, chosen, terms, now=now)
        if standing.list_is_due:
            _printing.note("a new revocation list was issued because the old one was due")
        note_unsigned_governance(keystore)
        note_superseded(keystore, [each.name for each in renewed], now)
        delivery = list_delivery(keystore, now=now)
    print_issued(keystore, renewed, delivery=delivery)


def _renewable(standing: Status, names: tuple[str, ...]) -> list[str]:
    """All named participants in any state; without names, all that can be renewed."""
    skipped = set() if names else {State.PREVIOUS_CA, State.REVOKED, State.GONE, State.ELSEWHERE}
    return [each.name for each in standing.participants if each.state not in skipped]


@_help.command(
    "needs-renewal",
    examples={
        "Test all participants, for a cron job": "pqsec needs-renewal",
        "Test whether one expires within 30 days": "pqsec needs-renewal /talker --due 30d",
    },
    exit_codes={
        0: "yes: something is due",
        1: "no: nothing is due",
        3: "the keystore or a participant cannot be read",
    },
)
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=_completion.participants)
@click.option(
    "--due",
    type=_settings.Duration(),
    help="Test what expires within this time.  [default: less than a third of its life left]",
)
@_formats.option()
@_settings.command_options
def needs_renewal(names: tuple[str, ...], due: timedelta | None, form: str) -> None:
    """Test whether participants or the revocation list are due for renewal.

    NAME may be a pattern ('/robot1/*') or a group (@hall1). Without a NAME, all
    participants and the revocation list are tested.
    """
    _formats.chosen(form)
    keystore = _settings.open_keystore()
    names = tuple(named(keystore, names))
    standing = status_of(keystore, names or None, now=_settings.now(), due=due)
    found = [each for each in standing.participants if each.state.calls_for_renewal]
    lines = [f"{each.name}  {each.state}, until {said(each.not_after)}" for each in found]
    terms = [] if names else [each for each in standing.shared if each.kind == "crl"]
    lists = [each for each in terms if each.state.calls_for_renewal]
    lines += [f"revocation list  {each.state}, until {said(each.not_after)}" for each in lists]
    participants = [
        {"name": each.name, "state": each.state, "not_after": each.not_after} for each in found
    ]
    value = {
        "needs_renewal": bool(lines),
        "participants": participants,
        "revocation_list": bool(lists),
    }
    items = [{"kind": "participant", **each} for each in participants] + [
        {"kind": "revocation-list", "state": each.state, "not_after": each.not_after}
        for each in lists
    ]
    columns = ("kind", "name", "state", "not_after")
    _formats.emit(form, value, lines or ["nothing needs renewal"], columns=columns, items=items)
    if not lines:
        click.get_current_context().exit(1)
