"""The address of a ledger in PostgreSQL: what is taken, and that it has no secret."""

import os
import socket
import sys
import threading

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import Keystore, LedgerAddress, settings_file
from pqsec_pki.keystore._postgres import PostgresLedger, _defaults
from pqsec_pki.keystore._postgres_schema import schema_sql
from tests.unit.tls_sides import certificate

SECRET = "hunter2-of-a-test"


@pytest.mark.parametrize(
    "text",
    [
        "postgresql://officer@db.example.com/pqsec",
        "postgres://officer@db.example.com:5433/pqsec?sslmode=verify-full&sslrootcert=/a/b.pem",
        "postgresql://officer@one,two:5433/pqsec",
        "postgresql:///?service=pqsec",
        "postgresql://officer@%2Frun%2Fpostgresql/pqsec",
        "postgresql://officer@[::1]:5432/pqsec",
    ],
)
def test_urls_of_postgresql_are_taken_as_they_are(text):
    assert LedgerAddress.parse(text).url == text
    assert "?" not in LedgerAddress.parse(text).place


@pytest.mark.parametrize(
    "text",
    [
        f"postgresql://officer:{SECRET}@db/pqsec",
        f"postgresql://officer@db/pqsec?password={SECRET}",
        f"postgresql://officer@db/pqsec?passw%6Frd={SECRET}",
        f"postgresql://officer@db/pqsec?sslpassword={SECRET}",
        f"postgresql://officer@db/pqsec?options={SECRET}",
        f"mysql://officer:{SECRET}@db/pqsec",
        f"host=db password={SECRET}",
        f"postgresql://officer:{SECRET}/@db",
        "",
        "sqlite3",
    ],
)
def test_other_addresses_are_refused_and_not_repeated(text):
    with pytest.raises(UsageError) as refusal:
        LedgerAddress.parse(text)
    assert SECRET not in f"{refusal.value} {refusal.value.hint}"


@pytest.mark.parametrize(
    ("text", "mode"),
    [
        ("postgresql://u@db.example.com/x", "verify-full"),
        ("postgresql://u@localhost,db.example.com/x", "verify-full"),
        ("postgresql://u@localhost/x?host=db.example.com", "verify-full"),
        ("postgresql://u@127.0.0.1.example.com/x", "verify-full"),
        ("postgresql://u@db.example.com/x?sslmode=disable", None),
        ("postgresql://u@localhost:5433/x", None),
        ("postgresql://u@/x?host=/run/postgresql", None),
        ("postgresql:///?service=x", None),
    ],
)
def test_a_server_on_another_machine_is_authenticated_unless_the_address_says_otherwise(
    text, mode, monkeypatch
):
    monkeypatch.delenv("PGSSLMODE", raising=False)
    found = _defaults(LedgerAddress.parse(text))
    assert found.get("sslmode") == mode
    assert found["target_session_attrs"] == "read-write"


def test_a_server_that_the_environment_names_is_authenticated(monkeypatch):
    for name in ("PGSSLMODE", "PGSERVICE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PGHOST", "db.example.com")
    assert _defaults(LedgerAddress.parse("postgresql:///x"))["sslmode"] == "verify-full"
    monkeypatch.setenv("PGHOST", "/run/postgresql")
    assert "sslmode" not in _defaults(LedgerAddress.parse("postgresql:///x"))


def test_a_service_that_says_nothing_about_tls_gets_no_unencrypted_word(tmp_path, monkeypatch):
    monkeypatch.delenv("PGSSLMODE", raising=False)
    root, service = tmp_path / "root.pem", tmp_path / "service"
    root.write_bytes(certificate("ecdsa-p256")[0])
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        service.write_text(f"[x]\nhost=127.0.0.1\nport={port}\nuser=u\nsslrootcert={root}\n")
        monkeypatch.setenv("PGSERVICEFILE", str(service))
        heard = []

        def answer():
            link, _ = server.accept()
            with link:
                heard.append(link.recv(8))  # whether we have TLS
                link.sendall(b"N")
                heard.append(link.recv(1 << 16))

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(KeystoreError):
            PostgresLedger(LedgerAddress.parse("postgresql:///?service=x"))
        thread.join()
    assert heard == [b"\x00\x00\x00\x08\x04\xd2\x16\x2f", b""]
    assert "PGSSLMODE" not in os.environ


def test_without_psycopg_the_missing_library_is_named(tmp_path, monkeypatch):
    for name in ("psycopg", "pqsec_pki.keystore._postgres"):
        monkeypatch.setitem(sys.modules, name, None)
    data = settings_file(
        [profile_named("classical")], DomainSet.of(0), LedgerAddress.parse("postgresql://u@h/d")
    )
    (tmp_path / "pqsec.json").write_bytes(data)
    (tmp_path / "private").mkdir(mode=0o700)
    with pytest.raises(KeystoreError, match="is not installed") as refusal:
        Keystore.open(tmp_path).lines()
    assert refusal.value.hint == "pip install 'psycopg[binary]>=3.2,<4'"


@pytest.mark.parametrize(
    ("old", "new"),
    [('"format": 4', '"format": 3'), ("postgresql:", "mysql:"), ("u@h", f"u:{SECRET}@h")],
)
def test_settings_with_another_address_are_refused(tmp_path, old, new):
    data = settings_file(
        [profile_named("classical")], DomainSet.of(0), LedgerAddress.parse("postgresql://u@h/d")
    )
    (tmp_path / "pqsec.json").write_bytes(data.replace(old.encode(), new.encode()))
    (tmp_path / "private").mkdir(mode=0o700)
    with pytest.raises(KeystoreError) as refusal:
        Keystore.open(tmp_path).lines()
    assert SECRET not in f"{refusal.value} {refusal.value.hint}"


def test_names_of_roles_are_quoted():
    assert 'TO "a""; DROP TABLE x; --";' in schema_sql(writers=['a"; DROP TABLE x; --'])
