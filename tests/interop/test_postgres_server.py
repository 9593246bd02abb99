"""Ledgers in a PostgreSQL server of Debian that is killed, restored or not to be trusted."""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from pqsec_pki.errors import KeystoreError, VerificationError
from pqsec_pki.keystore import Keystore, LedgerAddress, audit, write_anchor
from tests.interop.shared_ledger import check_whole, copied, create, issue_to
from tests.postgres import PASSWORD, PROGRAMS, WRITER, Cluster

pytestmark = [pytest.mark.interop, pytest.mark.timeout(300)]


@pytest.fixture
def own(requires) -> Iterator[Cluster]:
    """A server that no other test uses."""
    requires(PROGRAMS, "PostgreSQL", "apt-get install postgresql")
    with Cluster.created() as made:
        yield made


@pytest.fixture
def pqsec(tmp_path):
    """pqsec(*words, **variables) runs the command in a process of its own."""

    def run(*words: str, **variables: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "pqsec_pki", "-k", str(tmp_path / "k"), *words]
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **variables}
        return subprocess.run(
            command, check=False, capture_output=True, text=True, cwd=tmp_path, env=environment
        )

    return run


# Kills

PERSISTENT = """
import sys, time
from pathlib import Path
from pqsec_pki.errors import ExistsError, PqsecError
from tests.interop.shared_ledger import issue_to
root, name, count = sys.argv[1:]
for number in range(int(count)):
    while True:
        try:
            issue_to(Path(root), f"/{name}/n{number}")
        except ExistsError:  # it was committed before the connection was lost
            break
        except PqsecError:
            time.sleep(0.2)
        else:
            break
"""


def persistent(root: Path, name: str, count: int) -> "subprocess.Popen[bytes]":
    """A process that issues so many, however often it fails."""
    return subprocess.Popen([sys.executable, "-c", PERSISTENT, root, name, str(count)])


def settle(*machines: Keystore) -> None:
    for each in machines:
        Keystore.recover(each.root)
    check_whole(*machines)


@pytest.mark.slow
@pytest.mark.parametrize("kills", [2, 12])
def test_a_server_that_is_killed_loses_and_doubles_nothing(own, tmp_path, kills):
    first = create(tmp_path / "first", own.address(own.database()))
    second = copied(first, tmp_path / "second")
    count = 3 * kills
    writers = [persistent(each.root, each.root.name, count) for each in (first, second)]
    for seed in range(kills):
        time.sleep(0.5 + seed * 0.37 % 1)
        own.kill()
        own.start()
    assert [each.wait(240) for each in writers] == [0, 0]
    settle(first, second)
    issued = [each.name for each in first.ledger() if each.kind == "participant"]
    assert len(issued) == len(set(issued)) == 2 * count
    assert [len(each.names()) for each in (first, second)] == [count, count]


@pytest.mark.slow
@pytest.mark.parametrize("kills", [6, 60])
def test_writers_that_are_killed_lose_and_double_nothing(own, tmp_path, kills):
    first = create(tmp_path / "first", own.address(own.database()))
    machines = [first, copied(first, tmp_path / "second")]
    for number in range(kills):
        writers = [persistent(each.root, f"w{number}", 50) for each in machines]
        time.sleep(0.9 + number * 0.37 % 1.1)
        for each in writers:
            each.send_signal(signal.SIGKILL)
            each.wait(60)
        settle(*machines)
    issued = [each for each in first.ledger() if each.kind == "participant"]
    assert len(issued) == sum(len(each.names()) for each in machines)


# Backups


@pytest.mark.slow
def test_a_server_restored_from_an_older_backup_shows(own, tmp_path):
    first = create(tmp_path / "first", own.address(own.database()))
    issue_to(first.root, "/alice")
    second = copied(first, tmp_path / "second")
    own.run("pg_basebackup", "-D", own.folder / "backup", "-h", own.folder, "-p", own.port,
            "-U", "owner", "-c", "fast")  # fmt: skip
    issue_to(first.root, "/bob")
    write_anchor(first, tmp_path / "anchors")
    own.stop("fast")
    shutil.rmtree(own.data)
    (own.folder / "backup").rename(own.data)
    own.start()
    with pytest.raises(VerificationError, match="the end was cut off") as refusal:
        audit(first)
    assert any("bob/cert.pem is not in the ledger" in line for line in refusal.value.lines)
    with pytest.raises(VerificationError, match="the end was cut off"):
        audit(second, anchors=tmp_path / "anchors")
    with pytest.raises(KeystoreError, match="the ledger lacks lines"):
        issue_to(first.root, "/carol")
    assert not first.has("/carol")
    issue_to(second.root, "/carol")  # it signed no head that shows what is gone
    with pytest.raises(KeystoreError, match="the ledger lacks one of the"):
        issue_to(first.root, "/dave")
    with pytest.raises(VerificationError, match="are not those of which this head was signed"):
        audit(first)


# Who the server is, and who asks


@pytest.fixture
def secured(own, tmp_path) -> Cluster:
    """The server with a certificate for localhost; ca.pem and other.pem are two CAs."""
    tls = tmp_path / "tls"
    tls.mkdir()

    def openssl(*words: str) -> None:
        subprocess.run(["openssl", *words], check=True, capture_output=True, cwd=tls)

    key = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes")
    for name in ("ca", "other"):
        about = ("-keyout", f"{name}.key", "-out", f"{name}.pem", "-subj", f"/CN={name}")
        openssl("req", "-x509", *key, *about)
    openssl("req", *key, "-keyout", "server.key", "-out", "server.csr", "-subj", "/CN=db")
    (tls / "names").write_text("subjectAltName=DNS:localhost\n")
    openssl("x509", "-req", "-in", "server.csr", "-CA", "ca.pem", "-CAkey", "ca.key",
            "-CAcreateserial", "-out", "server.crt", "-extfile", "names")  # fmt: skip
    for name in ("server.crt", "server.key"):
        own.write(name, (tls / name).read_text())
    own.sql("ALTER SYSTEM SET ssl = on")
    own.run("pg_ctl", "-D", own.data, "reload")
    while own.sql("SHOW ssl").strip() != "on":
        time.sleep(0.05)
    return own


@pytest.fixture
def password_file(secured, tmp_path) -> Path:
    path = tmp_path / "pgpass"
    path.write_text(f"*:{secured.port}:*:{WRITER}:{PASSWORD}\n")
    path.chmod(0o600)
    return path


def over_tls(cluster: Cluster, database: str, authority: Path, host: str = "localhost") -> str:
    place = f"postgresql://{WRITER}@{host}:{cluster.port}/{database}"
    return f"{place}?sslmode=verify-full&sslrootcert={authority}"


def test_commands_use_a_server_that_tls_authenticates(secured, password_file, pqsec, tmp_path):
    url = over_tls(secured, secured.database(), tmp_path / "tls/ca.pem")
    variables = {"PGPASSFILE": str(password_file)}
    options = ("--no-passphrase", "--profile", "classical")
    made = pqsec("ca", "init", *options, "--ledger", url, **variables)
    assert made.returncode == 0, made.stderr
    for words in (["issue", "/alice"], ["ca", "show"]):
        done = pqsec(*words, **variables)
        assert done.returncode == 0, done.stderr
        assert PASSWORD not in done.stdout + done.stderr
    assert f"ledger         postgresql://{WRITER}@localhost" in done.stdout
    found = [path for path in (tmp_path / "k").rglob("*") if path.is_file()]
    assert not [path for path in found if PASSWORD.encode() in path.read_bytes()]
    password_file.write_text(password_file.read_text().replace(PASSWORD, "another"))
    refused = pqsec("issue", "/bob", **variables)
    assert refused.returncode == 3
    assert "password authentication failed" in refused.stderr
    assert "Traceback" not in refused.stderr + made.stderr
    assert not (tmp_path / "k/enclaves/bob").exists()


IMPOSTORS = {
    "another name": ("127.0.0.1", "ca", "does not match host name"),
    "another CA": ("localhost", "other", "certificate verify failed"),
    "no CA": ("localhost", "missing", "does not exist"),
}


def test_a_server_that_tls_does_not_authenticate_is_refused(
    secured, password_file, monkeypatch, tmp_path
):
    monkeypatch.setenv("PGPASSFILE", str(password_file))
    database = secured.database()
    for host, authority, said in IMPOSTORS.values():
        url = over_tls(secured, database, tmp_path / f"tls/{authority}.pem", host)
        with pytest.raises(KeystoreError, match=said):
            create(tmp_path / "k", LedgerAddress.parse(url))
        assert not (tmp_path / "k/pqsec.json").exists()


@pytest.mark.slow
def test_a_server_without_tls_is_refused(own, tmp_path):
    url = over_tls(own, own.database(), tmp_path / "ca.pem")
    (tmp_path / "ca.pem").write_text("")
    with pytest.raises(KeystoreError, match=r"certificate|SSL"):
        create(tmp_path / "k", LedgerAddress.parse(url))
