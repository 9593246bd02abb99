"""pqsec renew and needs-renewal: certificates and permissions for another while."""

from datetime import timedelta
from pathlib import Path

import click

from pqsec_pki.cli import _bundles, _passphrases, _printing, _settings
from pqsec_pki.cli.issue import tell, tell_of_governance
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Renewal, State, Status
from pqsec_pki.keystore import renew as renew_participants
from pqsec_pki.keystore import status as status_of

_THIRD = timedelta()
"""Stands for --due without a value; no duration is that short."""


@click.command()
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option(
    "--due",
    type=_settings.Duration(),
    is_flag=False,
    flag_value=_THIRD,
    help="Whatever ends within this time; without one, what has less than a third of its life"
    " left.",
)
@click.option("--all", "everybody", is_flag=True, help="Every participant that is not revoked.")
@click.option(
    "--rekey/--keep-key",
    default=None,
    help="Make new keys, or certify again those in the certificate.  [default: new ones, where"
    " the old ones lie here]",
)
@_bundles.compromised_option
@click.option(
    "--validity", type=_settings.Duration(), help="From now on.  [default: as long as before]"
)
@_passphrases.option
@_settings.command_options
def renew(  # noqa: PLR0913 -- one for each option, by name
    names: tuple[str, ...],
    due: timedelta | None,
    validity: timedelta | None,
    passphrase_file: Path | None,
    *,
    everybody: bool,
    rekey: bool | None,
    compromised_keys: bool,
) -> None:
    """Renew participants: certificate and permissions together, allowed the same as before.

    Name them, or say --due, or --all. All are renewed, or none. A revocation list that is
    due is made anew with them.
    """
    if [bool(names), due is not None, everybody].count(True) != 1:
        raise UsageError("say whom to renew: names, or --due, or --all")
    keystore, now = _settings.open_keystore(to_change=True), _settings.now()
    standing = status_of(keystore, names or None, now=now, due=due or None)
    chosen = standing.due if due is not None else _all_but_the_dead(standing, names)
    if not chosen and not standing.list_is_due:
        _printing.emit({"keystore": str(keystore.root), "issued": []}, ["nothing to renew"])
        return
    terms = Renewal(rekey, validity, due or None, compromised_keys)
    authorities = _passphrases.unlock(keystore, passphrase_file)
    renewed = renew_participants(keystore, authorities, chosen, terms, now=now)
    if standing.list_is_due:
        _printing.note("the revocation list was due and is made anew: give it to every robot")
    tell_of_governance(keystore)
    tell(keystore, renewed)


def _all_but_the_dead(standing: Status, names: tuple[str, ...]) -> list[str]:
    """Whoever was named, whatever may be wrong with them; else all that can be renewed."""
    skipped = set() if names else {State.PREVIOUS_CA, State.REVOKED, State.GONE}
    return [each.name for each in standing.participants if each.state not in skipped]


@click.command("needs-renewal")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option(
    "--due",
    type=_settings.Duration(),
    help="What ends within this time.  [default: less than a third of its life is left]",
)
@_settings.command_options
def needs_renewal(names: tuple[str, ...], due: timedelta | None) -> None:
    """Tell whether participants, or the revocation list, should be renewed.

    Exit code 0 if any of them should, 1 if none. Without a NAME it is about all, and the
    list.
    """
    keystore = _settings.open_keystore()
    standing = status_of(keystore, names or None, now=_settings.now(), due=due)
    found = [each for each in standing.participants if each.state.calls_for_renewal]
    lines = [f"{each.name}  {each.state}, until {each.not_after:%Y-%m-%d %H:%M}" for each in found]
    terms = [] if names else [each for each in standing.shared if each.kind == "crl"]
    lists = [each for each in terms if each.state.calls_for_renewal]
    lines += [f"revocation list  {each.state}, until {each.not_after:%Y-%m-%d}" for each in lists]
    value = {
        "needs_renewal": bool(lines),
        "participants": [
            {"name": each.name, "state": each.state, "not_after": each.not_after.isoformat()}
            for each in found
        ],
        "revocation_list": bool(lists),
    }
    _printing.emit(value, lines or ["nothing needs renewal"])
    if not lines:
        click.get_current_context().exit(1)
