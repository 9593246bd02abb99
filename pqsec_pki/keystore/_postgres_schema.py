"""The tables of a ledger in PostgreSQL, as SQL for the owner of the database; and its rights.

pqsec itself connects as a role that reads and inserts. So a machine's password allows adding lines,
and only the owner of the database can change one. Waiting requests are not lines.
"""

from collections.abc import Iterable, Iterator

from pqsec_pki.keystore import _table

_FORMAT_1 = """
CREATE TABLE pqsec.ledger (
    number bigint PRIMARY KEY CHECK (number > 0),
    at text NOT NULL,
    operator text,
    kind text NOT NULL,
    name text NOT NULL,
    serial text,
    issuer text,
    sha256 text NOT NULL,
    not_after text,
    details text NOT NULL,
    chain text NOT NULL UNIQUE,
    written_at timestamptz NOT NULL DEFAULT now(),
    written_by name NOT NULL DEFAULT session_user,
    UNIQUE (kind, sha256)
);
CREATE INDEX ledger_name ON pqsec.ledger (kind, name);
-- RFC 5280 4.1.2.2: unique for each CA
CREATE UNIQUE INDEX ledger_serial ON pqsec.ledger (issuer, serial) WHERE kind = 'participant';
CREATE FUNCTION pqsec.lines_stay() RETURNS trigger LANGUAGE plpgsql
    SET search_path = pg_catalog AS
    $$ BEGIN RAISE EXCEPTION 'lines are only added'; END $$;
CREATE TRIGGER ledger_stays BEFORE UPDATE OR DELETE OR TRUNCATE ON pqsec.ledger
    FOR EACH STATEMENT EXECUTE FUNCTION pqsec.lines_stay();
CREATE FUNCTION pqsec.lines_follow() RETURNS trigger LANGUAGE plpgsql
    SET search_path = pg_catalog AS
    $$ BEGIN
        IF NEW.number > 1 AND NOT EXISTS
            (SELECT FROM pqsec.ledger WHERE number = NEW.number - 1)
        THEN RAISE EXCEPTION 'line % does not follow another', NEW.number; END IF;
        RETURN NEW;
    END $$;
CREATE TRIGGER ledger_follows BEFORE INSERT ON pqsec.ledger
    FOR EACH ROW EXECUTE FUNCTION pqsec.lines_follow();
"""
_FORMAT_2 = """
CREATE TABLE pqsec.files (
    sha256 text PRIMARY KEY,
    content bytea NOT NULL,
    written_at timestamptz NOT NULL DEFAULT now()
);
"""
"""Certificates and signed documents, for other machines; the SHA-256 is that of a line."""
_FORMAT_3 = """
CREATE TABLE pqsec.waiting (
    sha256 text PRIMARY KEY,
    known text NOT NULL,
    asked text NOT NULL,
    request bytea NOT NULL
);
"""
"""Requests that wait at servers until somebody decides."""
_FORMAT_4 = """
CREATE TABLE pqsec.writing (one boolean PRIMARY KEY CHECK (one));
INSERT INTO pqsec.writing VALUES (true);
"""
"""One row, which who adds lines locks. Only a role that may update it can: so no reader can keep
writers from adding lines, as with an advisory lock, which every role can take."""
_FORMATS = (_FORMAT_1, _FORMAT_2, _FORMAT_3, _FORMAT_4)
"""The steps from each format to the next."""
FORMAT = len(_FORMATS)


def schema_sql(writers: Iterable[str] = (), readers: Iterable[str] = ()) -> str:
    """SQL that makes the tables, or brings them to this format, and gives the roles their rights.

    It may be repeated.
    """
    parts = [
        "BEGIN;",
        "CREATE SCHEMA IF NOT EXISTS pqsec;",
        "CREATE TABLE IF NOT EXISTS pqsec.format (version integer PRIMARY KEY);",
        *(_step(number, each) for number, each in enumerate(_FORMATS, 1)),
        "REVOKE ALL ON SCHEMA pqsec FROM PUBLIC;",
        *(line for role in readers for line in _reads(role)),
        *(line for role in writers for line in (*_reads(role), *_inserts(role))),
        "COMMIT;",
    ]
    return "\n".join(parts) + "\n"


def _step(number: int, statements: str) -> str:
    return (
        f"DO $migration$ BEGIN\nIF NOT EXISTS (SELECT FROM pqsec.format WHERE version >= {number})"  # noqa: S608
        f" THEN\n{statements}INSERT INTO pqsec.format VALUES ({number});\nEND IF;\nEND $migration$;"
    )


def _reads(role: str) -> Iterator[str]:
    yield f"GRANT USAGE ON SCHEMA pqsec TO {_quoted(role)};"
    yield f"GRANT SELECT ON pqsec.ledger, pqsec.format, pqsec.files TO {_quoted(role)};"


def _inserts(role: str) -> Iterator[str]:
    """Not the columns that the server fills: when a line was written, and by which role."""
    columns = f"number, {_table.COLUMNS}, chain"
    yield f"GRANT INSERT ({columns}) ON pqsec.ledger TO {_quoted(role)};"
    yield f"GRANT SELECT, INSERT (sha256, content) ON pqsec.files TO {_quoted(role)};"
    yield f"GRANT SELECT, INSERT, UPDATE (asked), DELETE ON pqsec.waiting TO {_quoted(role)};"
    yield f"GRANT SELECT, UPDATE ON pqsec.writing TO {_quoted(role)};"


def _quoted(role: str) -> str:
    return '"' + role.replace('"', '""') + '"'
