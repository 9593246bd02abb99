"""A PostgreSQL server of Debian for tests: a cluster of its own, without rights on this machine."""

import os
import pwd
import secrets
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from pqsec_pki.keystore import LedgerAddress, schema_sql
from tests.ports import free_port

PROGRAMS = max(Path("/usr/lib/postgresql").glob("*/bin"), default=None)
WRITER, PASSWORD = "officer", "pw-of-a-test-7741"
_OPTIONS = {
    "fsync": "off",  # what is tested dies by kill, not by loss of power
    "max_connections": "40",
    "shared_buffers": "8MB",
    "wal_level": "replica",
    "max_wal_senders": "2",
    "logging_collector": "off",
    "password_encryption": "scram-sha-256",
}


@dataclass(frozen=True)
class Cluster:
    """A server's folder, its port, and how to start and stop it."""

    folder: Path
    port: int

    @classmethod
    @contextmanager
    def created(cls) -> Iterator["Cluster"]:
        """A new one, running; it is removed afterwards."""
        folder = Path(tempfile.mkdtemp(prefix="pg"))
        try:
            _give(folder)
            cluster = cls(folder, free_port())
            cluster.run("initdb", "-D", cluster.data, "-A", "trust", "-U", "owner", "--no-sync",
                        "-E", "UTF8", "--locale", "C")  # fmt: skip
            rules = ["local all all trust", "local replication all trust"]
            rules.append("host all all 127.0.0.1/32 scram-sha-256")
            cluster.write("pg_hba.conf", "\n".join(rules) + "\n")
            cluster.start()
            try:
                cluster.sql(f"CREATE ROLE {WRITER} LOGIN PASSWORD '{PASSWORD}'")
                yield cluster
            finally:
                cluster.stop("immediate")
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    @property
    def data(self) -> Path:
        return self.folder / "data"

    def write(self, name: str, text: str) -> Path:
        """Write a file of the server's own into its data folder."""
        path = self.data / name
        path.write_text(text)
        path.chmod(0o600)
        _give(path)
        return path

    def start(self, **more: str) -> None:
        options = {
            **_OPTIONS,
            **more,
            "port": self.port,
            "listen_addresses": "127.0.0.1",
            "unix_socket_directories": self.folder,
        }
        words = " ".join(f"-c {name}='{value}'" for name, value in options.items())
        self.run("pg_ctl", "-D", self.data, "-l", self.folder / "log", "-w", "-o", words, "start")

    def stop(self, mode: str) -> None:
        with suppress(subprocess.CalledProcessError):
            self.run("pg_ctl", "-D", self.data, "-m", mode, "-w", "stop")

    def kill(self) -> None:
        """SIGKILL to all its processes."""
        first = int((self.data / "postmaster.pid").read_text().split()[0])
        os.kill(first, signal.SIGSTOP)  # it begins no process more
        children = Path(f"/proc/{first}/task/{first}/children").read_text().split()
        processes = (first, *map(int, children))
        for process in processes:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
        while any(map(_runs, processes)):
            time.sleep(0.01)
        # Where nobody waits for them, as in a container, the next start takes them for running.
        for path in (self.data / "postmaster.pid", *self.folder.glob(".s.PGSQL.*.lock")):
            path.unlink()

    def run(self, program: str, *arguments: object) -> None:
        """One of PostgreSQL's programs, as a user that may run them."""
        subprocess.run(
            [PROGRAMS / program, *map(str, arguments)],
            check=True,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            cwd=self.folder,
            **_as_user(),
        )

    def sql(self, text: str, database: str = "postgres", user: str = "owner") -> str:
        """What psql answers, without headers; CalledProcessError, with stderr, if it is refused."""
        command = [PROGRAMS / "psql", "-X", "-q", "-A", "-t", "-v", "ON_ERROR_STOP=1"]
        where = ["-h", self.folder, "-p", str(self.port), "-U", user, "-d", database]
        return subprocess.run(
            [*command, *where], input=text, check=True, capture_output=True, text=True
        ).stdout

    def database(self, *, tables: bool = True) -> str:
        """A new database, by its name."""
        name = f"d{secrets.token_hex(6)}"
        self.sql(f"CREATE DATABASE {name}")
        if tables:
            self.sql(schema_sql(writers=[WRITER]), name)
        return name

    def address(self, database: str, user: str = WRITER) -> LedgerAddress:
        """By the socket."""
        return LedgerAddress.parse(
            f"postgresql://{user}@/{database}?host={self.folder}&port={self.port}"
        )


def _runs(process: object) -> bool:
    with suppress(OSError):
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def _give(path: Path) -> None:
    if os.geteuid() == 0:
        shutil.chown(path, "postgres", pwd.getpwnam("postgres").pw_gid)
        if path.is_dir():
            path.chmod(0o711)


def _as_user() -> dict[str, object]:
    """initdb and the server refuse to run as root."""
    if os.geteuid() != 0:
        return {}
    user = pwd.getpwnam("postgres")
    return {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
