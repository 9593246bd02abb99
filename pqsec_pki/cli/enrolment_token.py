"""pqsec enrolment-token: the secrets with which robots enrol over a network."""

from datetime import datetime, timedelta
from pathlib import Path

import click

from pqsec_pki._files import read, refuse_existing, write
from pqsec_pki._libraries import needs_libraries
from pqsec_pki._places import refuse_obeyed
from pqsec_pki._times import said
from pqsec_pki.certificates import Certificate
from pqsec_pki.cli import _formats, _help, _network, _printing, _settings
from pqsec_pki.cli.serve import config_option, trusted_settings
from pqsec_pki.domain import read_domain
from pqsec_pki.enrolment import pins_in_use
from pqsec_pki.errors import UsageError, located, shown
from pqsec_pki.est import EnrolmentToken
from pqsec_pki.keystore import Keystore, matching
from pqsec_pki.keystore import status as status_of
from pqsec_pki.server import (
    ServerSettings,
    TokenState,
    read_settings,
    record_token,
    revoke_tokens,
    token_states,
)

_COLUMNS = (
    "id",
    "names",
    "uses",
    "used",
    "replaces",
    "after_revocation",
    "made_at",
    "not_after",
    "end",
)


@_help.group("enrolment-token")
@_settings.command_options
def enrolment_token() -> None:
    """Create, list and revoke tokens, with which robots enrol over a network."""


@enrolment_token.command(
    "create",
    examples={
        "Create a token for one robot": (
            "pqsec enrolment-token create /fleet/robot1 -o robot1.token"
        ),
        "Create one with which 20 robots enrol": (
            "pqsec enrolment-token create '/fleet/*' --uses 20 -o fleet.token"
        ),
        "Create one for a robot that was stolen and came back": (
            "pqsec enrolment-token create /fleet/robot1 --replace --after-revocation -o back.token"
        ),
    },
    exit_codes={
        0: "the token is in the file, and its hash in the ledger",
        1: "the configuration is not valid",
        3: "the file exists, NAME was revoked, or the keystore cannot be changed",
    },
)
@click.argument("name", metavar="NAME")
@click.option(
    "-o",
    "--output",
    "goal",
    required=True,
    type=_settings.FILE,
    metavar="FILE",
    help="Write the token to this file, for its owner only.",
)
@click.option(
    "--uses",
    type=click.IntRange(1, 100_000),
    default=1,
    show_default=True,
    help="How many requests it admits.",
)
@click.option(
    "--validity",
    type=_settings.Duration(),
    help="How long it may be used, as 12h or 7d.  [default: token_validity of FILE, or 7d]",
)
@click.option(
    "--replace",
    "replaces",
    is_flag=True,
    help="Let it replace the certificate of a robot that has one for another key.",
)
@click.option(
    "--after-revocation",
    is_flag=True,
    help="With --replace: let it bring back a robot that was revoked, with a new key.",
)
@config_option
@_settings.command_options
def create(  # noqa: PLR0913 -- one for each option, by name
    name: str,
    goal: Path,
    file: Path,
    uses: int,
    validity: timedelta | None,
    *,
    replaces: bool,
    after_revocation: bool,
) -> None:
    """Create a token, with which a robot enrols.

    NAME is a participant of the domain file, or a pattern such as '/fleet/*'. The token is a
    secret: its holder can enrol as NAME until it is used up, ends or is revoked. It also has what
    the robot needs to trust the server and the CAs.

    A participant that was revoked is admitted only by a token that was made since, with --replace
    --after-revocation: on the robot, `pqsec enrol --force` makes a new key.
    """
    if after_revocation and not replaces:
        raise UsageError("--after-revocation is for --replace")
    settings, now = trusted_settings(file), _settings.now()
    refuse_existing(goal, replaceable=False)
    known = read_domain(settings.domain).members
    keystore = Keystore.open(settings.keystore, to_change=True)
    token = EnrolmentToken.new(
        server=settings.url,
        server_pins=_server_pins(settings),
        cas=pins_in_use(keystore),
        names=name,
        profile=",".join(each.name for each in keystore.profiles),
        not_after=now + (validity or settings.token_validity),
    )
    # The ledger first: a token that is only in the file would not be valid.
    record_token(
        keystore,
        token,
        uses=uses,
        replaces=replaces,
        after_revocation=after_revocation,
        now=now,
    )
    write(goal, token.to_bytes(), private=True)
    named = [one for each in name.split() for one in matching(each, known)]
    if not named:
        _printing.note(
            f"the token admits no participant: {settings.domain} does not name {shown(name)}"
        )
    elif not replaces and all(map(keystore.has, named)):
        _printing.note(
            f"{_printing.few(named)}: there is a certificate, which a token replaces only if it is"
            " made with --replace"
        )
    _note_revoked(keystore, name, now, after_revocation=after_revocation)
    if after_revocation:
        _printing.note(f"on the robot: `pqsec enrol --force` makes a new key for {shown(name)}")
    line = f"{token.id}  {name}  until {said(token.not_after)}  {goal}"
    value = {"id": token.id, "names": name, "uses": uses, "file": goal}
    _printing.emit({**value, "not_after": token.not_after}, [line])


@enrolment_token.command(
    "list",
    examples={"List the tokens": "pqsec enrolment-token list"},
    exit_codes={
        0: "the tokens are listed",
        1: "the configuration is not valid",
        3: "the keystore cannot be read",
    },
)
@config_option
@_formats.option()
@_settings.command_options
def list_(file: Path, form: str) -> None:
    """List all tokens: the names that each admits, how often it was used, and its state."""
    _formats.chosen(form)
    _print(token_states(Keystore.open(read_settings(file).keystore)), form)


@enrolment_token.command(
    "revoke",
    examples={
        "Revoke a token that was lost": "pqsec enrolment-token revoke 0123456789abcdef",
    },
    exit_codes={
        0: "the tokens admit no more requests",
        1: "the configuration is not valid",
        3: "there is no such token, or the keystore cannot be changed",
    },
)
@click.argument("ids", nargs=-1, required=True, metavar="ID...")
@config_option
@_settings.command_options
def revoke(ids: tuple[str, ...], file: Path) -> None:
    """Revoke tokens. What robots got with them before stays; `pqsec revoke` revokes that."""
    keystore = Keystore.open(trusted_settings(file).keystore, to_change=True)
    _print(revoke_tokens(keystore, ids, now=_settings.now()))


def _note_revoked(keystore: Keystore, names: str, now: datetime, *, after_revocation: bool) -> None:
    """Note which participants the token does not admit, because they were revoked."""
    revoked = [each.name for each in status_of(keystore, now=now).participants if each.revoked]
    found = dict.fromkeys(one for each in names.split() for one in matching(each, revoked))
    if found and not after_revocation:
        _printing.note(f"the token does not admit {_printing.few(found)}: revoked")


def _server_pins(settings: ServerSettings) -> frozenset[str]:
    refuse_obeyed((each.chain for each in settings.tls), "which server robots trust")
    with needs_libraries(_network.NEEDS):
        from pqsec_pki.est import spki_pin  # noqa: PLC0415 -- a library of an extra

        found = set()
        for each in settings.tls:
            with located(each.chain):
                found.add(spki_pin(Certificate.from_pem(read(each.chain))))
        return frozenset(found)


def _print(tokens: list[TokenState], form: str = _formats.TABLE) -> None:
    now = _settings.now()
    rows = [
        (
            each.id,
            each.names,
            f"{each.used} of {each.uses}",
            said(each.not_after),
            each.end(now) or "open",
        )
        for each in tokens
    ]
    lines = _printing.table(("ID", "NAMES", "USED", "UNTIL", "STATE"), rows) if rows else []
    values = [each.to_json(now) for each in tokens]
    lines = lines or ["no tokens: `pqsec enrolment-token create` makes one"]
    _formats.emit(form, {"tokens": values}, lines, columns=_COLUMNS, items=values)
