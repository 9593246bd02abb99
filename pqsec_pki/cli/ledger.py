"""pqsec ledger: where the ledger is."""

import click

from pqsec_pki.cli import _help, _printing, _settings
from pqsec_pki.keystore import LedgerAddress, schema_sql
from pqsec_pki.lifecycle import IN_A_FILE, move_ledger


@_help.group()
@_settings.command_options
def ledger() -> None:
    """Keep the ledger in PostgreSQL, for CAs on several machines."""


@ledger.command(
    examples={
        "Write the SQL for a database, and for a role that adds lines": (
            "pqsec ledger schema --writer officer"
        ),
    },
    exit_codes={0: "the SQL is written", 3: "the SQL cannot be written"},
)
@click.option(
    "--writer",
    "writers",
    multiple=True,
    metavar="ROLE",
    help="Let this role read and add lines; may be repeated.",
)
@click.option(
    "--reader",
    "readers",
    multiple=True,
    metavar="ROLE",
    help="Let this role read; may be repeated.",
)
@_settings.command_options
def schema(writers: tuple[str, ...], readers: tuple[str, ...]) -> None:
    """Write the SQL that makes the tables, or brings older ones up to date.

    The owner of the database runs it with psql, once and after an update of pqsec; it may be
    repeated. pqsec itself needs a role that reads and inserts. Only the owner can change or remove
    a line.
    """
    sql = schema_sql(writers, readers)
    _printing.emit({"sql": sql}, sql.splitlines())


@ledger.command(
    examples={
        "Use one ledger for several machines": (
            "pqsec ledger move postgresql://officer@db.example.com/pqsec"
        ),
        "Keep it in the keystore again": "pqsec ledger move sqlite",
    },
    exit_codes={
        0: "the ledger is there, with all lines",
        2: "TO is not an address, or it has a password",
        3: (
            "the database does not answer, has another ledger or lacks the tables; or the ledger is"
            " there already; or the keystore cannot be changed"
        ),
    },
)
@click.argument("to", metavar="TO")
@_settings.command_options
def move(to: str) -> None:
    """Move the ledger into a database, or back into the keystore.

    TO is postgresql://USER@HOST/DATABASE, or `sqlite` for the file in private/. All lines are read
    back before the switch, which is one change: done wholly or not at all. A database with the same
    lines and newer ones is joined: so a copy of the keystore on another machine gets its ledger.
    After a move to `sqlite`, other machines are refused.

    The password is in a password file (PGPASSFILE) or a service file of PostgreSQL, not in TO. The
    server is authenticated by TLS (sslmode=verify-full), unless it is on this machine or TO says
    otherwise.
    """
    target = None if to == IN_A_FILE else LedgerAddress.parse(to)
    keystore = _settings.open_keystore(to_change=True)
    done = move_ledger(keystore, target, now=_settings.now())
    words = "joined" if done.joined else "moved"
    _printing.emit(done.to_json(), [f"{words}: the ledger is in {done.place}, {done.lines} lines"])
