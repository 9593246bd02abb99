"""pqsec ra: registration authorities, which may order that new participants are enrolled."""

from datetime import datetime, timedelta
from pathlib import Path

import click

from pqsec_pki import _files
from pqsec_pki._places import refuse_obeyed, trusted_files
from pqsec_pki.algorithms import PublicKey, public_key_from_pem
from pqsec_pki.approvals import Covered, RegistrationGrant
from pqsec_pki.cli import _formats, _help, _passphrases, _printing, _settings
from pqsec_pki.cli._times import day
from pqsec_pki.cli.plan import DEFAULT_FILE
from pqsec_pki.domain import Desired, read_domain, role_value
from pqsec_pki.errors import UsageError, located, meant
from pqsec_pki.keystore import Registration, SigningCa, enrolled_by, registrations, registrations_of
from pqsec_pki.lifecycle import add_registration, end_registrations

_COLUMNS = (
    *("authority", "state", "begins", "ends", "used", "most", "names", "roles", "longest_hours"),
    "sha256",
)
_HEADERS = ("authority", "state", "until", "used", "of", "names", "roles", "validity")


@_help.group("ra")
@_settings.command_options
def ra() -> None:
    """Let others order that new participants are enrolled, within limits.

    A registration authority (RA) has a key of its own and a grant: which names, in which roles,
    for how long, how many, and until when. What it orders with `pqsec sign-request export`,
    `pqsec sign-request sign` performs if the grant covers it.
    """


@ra.command(
    "add",
    examples={
        "Let a production line enrol 50 robots this month": (
            "pqsec ra add line1 --key line1.pub.pem --allow-name '/fleet/*' --role robot"
            " --max-count 50 --validity 30d"
        ),
    },
    exit_codes={
        0: "granted: the grant is in the ledger, and in a file for the RA",
        1: "not granted: the domain file or the key is not valid",
        3: "not granted: approvals are needed, or the keystore or the passphrase is wrong",
    },
)
@click.argument("name", metavar="RA")
@click.option(
    "--key",
    type=_settings.FILE,
    required=True,
    help="The RA's public key, in PEM.",
)
@click.option(
    "--allow-name",
    "patterns",
    multiple=True,
    required=True,
    metavar="PATTERN",
    help="Participants that it may enrol, for example '/fleet/*'; repeatable.",
)
@click.option(
    "--role",
    "roles",
    multiple=True,
    required=True,
    metavar="ROLE",
    help="A role of the domain file that it may give; repeatable.",
)
@click.option(
    "--max-count",
    "most",
    type=click.IntRange(min=1),
    required=True,
    metavar="N",
    help="How many participants it may enrol.",
)
@click.option(
    "--max-validity",
    "longest",
    type=_settings.Duration(),
    default="90d",
    show_default=True,
    help="How long their certificates may be valid.",
)
@click.option(
    "--from",
    "begins",
    type=_settings.When(),
    metavar="WHEN",
    help="It may order from then on: 2027-01-31, or 30d from now.  [default: now]",
)
@click.option(
    "--validity",
    type=_settings.Duration(),
    required=True,
    help="It may order for this long.",
)
@click.option(
    "--file",
    "file",
    type=_settings.FILE,
    default=DEFAULT_FILE,
    show_default=True,
    help="The domain file with the roles. Their rules are copied into the grant.",
)
@click.option(
    "-o",
    "--output",
    type=_settings.FILE,
    metavar="FILE",
    help="Write the grant to this file, for the RA.  [default: RA.grant]",
)
@click.option("--force", is_flag=True, help="Replace the file.")
@_passphrases.option
@_settings.command_options
def add(  # noqa: PLR0913, PLR0917 -- one for each option, by name
    name: str,
    key: Path,
    patterns: tuple[str, ...],
    roles: tuple[str, ...],
    most: int,
    longest: timedelta,
    begins: datetime | None,
    validity: timedelta,
    file: Path,
    output: Path | None,
    passphrase_file: Path | None,
    *,
    force: bool,
) -> None:
    """Grant a registration authority the right to order enrolments.

    RA is its name. The identity CA signs the grant, and the ledger records it. The RA needs the
    file for `pqsec sign-request export`, and sends it nowhere.
    """
    keystore, now = _settings.open_keystore(to_change=True), _settings.now().replace(microsecond=0)
    keystore.refuse_unapproved(Covered.GROW)
    with keystore.open_ledger() as ledger:
        origin = ledger.origin
    start = begins or now
    grant = RegistrationGrant(
        authority=name,
        key=_public_key(key),
        names=patterns,
        roles=_granted(file, roles),
        begins=start,
        ends=start + validity,
        longest=longest,
        most=most,
        ledger=origin,
    )
    goal = output or Path(f"{name}.grant")
    if not force:
        _files.refuse_existing(goal)
    authorities = _passphrases.unlock(keystore, passphrase_file)
    signed = add_registration(keystore, authorities, grant, now=now)
    with _printing.with_hint("it is granted: `pqsec ra list --grant RA` prints the file"):
        _files.write(goal, signed.to_file(), force=force)
    _printing.emit(
        {"written": goal, "sha256": grant.digest, **grant.to_json()},
        [f"{name} may enrol {grant}", f"{goal}  grant {grant.digest}"],
    )


@ra.command(
    "list",
    examples={
        "Show all grants, and how far they are used": "pqsec ra list",
        "Show the file of a grant again": "pqsec ra list --grant line1",
        "List all that an RA enrolled, for `pqsec revoke`": "pqsec ra list --enrolled line1",
    },
    exit_codes={0: "shown", 3: "the keystore cannot be read, or there is no such grant"},
)
@click.option("--grant", "granted", metavar="RA", help="Print the newest grant of this RA alone.")
@click.option("--enrolled", metavar="RA", help="Print the participants that this RA enrolled.")
@_formats.option()
@_settings.command_options
def list_(granted: str | None, enrolled: str | None, form: str) -> None:
    """Show the grants of registration authorities, and how far they are used."""
    if granted and enrolled:
        raise UsageError("--grant and --enrolled exclude each other")
    if _formats.chosen(form) == _formats.CSV and (granted or enrolled):
        raise UsageError("--format csv lists all grants, without --grant or --enrolled")
    keystore, now = _settings.open_keystore(), _settings.now()
    found = registrations(keystore)
    if name := granted or enrolled:
        own = registrations_of(found, name)
        if enrolled:
            names = enrolled_by(keystore, name)
            _printing.emit({"participants": names}, names)
        else:
            text = own[-1].signed.to_file().decode()
            _printing.emit({"grant": text}, text.splitlines())
        return
    rows = [_row(each, now) for each in found]
    lines = _printing.table(_HEADERS, rows) if rows else ["none: pqsec ra add"]
    _formats.emit(
        form,
        {"registration_authorities": [each.to_json(now) for each in found]},
        lines,
        columns=_COLUMNS,
        items=[{**each.to_json(now), "roles": list(each.grant.roles)} for each in found],
    )


@ra.command(
    "revoke",
    examples={"End all grants of a production line": "pqsec ra revoke line1"},
    exit_codes={0: "ended, now or earlier", 3: "not ended: there is no such RA, or no passphrase"},
)
@click.argument("names", nargs=-1, required=True, metavar="RA...")
@_passphrases.option
@_settings.command_options
def revoke(names: tuple[str, ...], passphrase_file: Path | None) -> None:
    """End the grants of registration authorities.

    The participants that they enrolled stay: `pqsec ra list --enrolled RA` lists them. The
    permissions CA signs a head of the ledger with the lines.
    """
    keystore = _settings.open_keystore(to_change=True)
    authorities = _passphrases.unlock(keystore, passphrase_file, SigningCa.PERMISSIONS)
    ended = end_registrations(keystore, authorities, names, now=_settings.now())
    lines = [
        f"{each.grant.authority}  grant {each.grant.digest} ended, used for {each.used}"
        for each in ended
    ]
    value = {"ended": [{"authority": e.grant.authority, "sha256": e.grant.digest} for e in ended]}
    _printing.emit(value, lines or ["all had ended before"])


def _public_key(path: Path) -> PublicKey:
    refuse_obeyed([path], "whose orders are obeyed")
    with located(path):
        return public_key_from_pem(_files.read(path), str(path))


def _granted(file: Path, roles: tuple[str, ...]) -> dict[str, object]:
    """The roles of the domain file; FileError if another user could change them."""
    with trusted_files("what may be ordered"):
        return roles_in(read_domain(file), roles)


def roles_in(desired: Desired, names: tuple[str, ...]) -> dict[str, object]:
    """The roles as values of a grant; UsageError for one that is not there, or cannot be in it."""
    for name in names:
        if name not in desired.roles:
            raise UsageError(
                f"{desired.path} has no role {name}",
                hint=meant(name, desired.roles) or f"it has {', '.join(desired.roles) or 'none'}",
            )
    with located(desired.path):
        return {name: role_value(desired.roles[name], desired.domains) for name in names}


def _row(each: Registration, now: datetime) -> tuple[str, ...]:
    grant = each.grant
    return (
        *(grant.authority, each.state(now), day(grant.ends), str(each.used)),
        *(str(grant.most), " ".join(grant.names), " ".join(grant.roles)),
        f"{grant.longest / timedelta(days=1):g}d",
    )
