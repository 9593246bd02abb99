"""`pqsec` for tests that run hundreds of commands: a process that has imported it forks.

Python and its imports are most of a short command. The server imports all commands once and
forks a child for each; the client hands it the command line, the folder, the variables, the
umask and the three streams. What runs is the same `main`. That `pqsec` starts by itself is
tested by the wheel, the e2e tests and the bare machines.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path

CLIENT = """\
#!{python} -IS
import json, os, signal, socket, sys
umask = os.umask(0)
os.umask(umask)
server = socket.socket(socket.AF_UNIX)
server.connect({path!r})
words = [sys.argv[1:], os.getcwd(), dict(os.environ), umask]
socket.send_fds(server, [json.dumps(words).encode() + b"\\n"], [0, 1, 2])
answers = server.makefile()
if child := answers.readline():
    signal.signal(signal.SIGTERM, lambda number, _: os.kill(int(child), number))
code = answers.readline()
sys.exit(int(code) if code else "pqsec ended without an exit code")
"""
MAX_COMMAND = 1 << 20
"""Octets of a command line with its variables."""
PATIENCE = 300
"""Seconds for one command."""


def serve(path: str, *modules: str) -> None:
    """Fork a child for each command that comes to the socket, until killed."""
    from pqsec_pki.cli import COMMANDS, main  # noqa: PLC0415 -- the client needs none of this

    for module in (*(f"pqsec_pki.cli.{name}" for name, _ in COMMANDS.values()), *modules):
        import_module(module)
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # children need nobody who waits for them
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(path)
        listener.listen(16)
        print(flush=True)  # ready
        while True:
            client, _ = listener.accept()
            with client:
                if os.fork() == 0:
                    listener.close()
                    _run(client, main)


def _run(client: socket.socket, main) -> None:
    """Run one command in this process, send its process ID and its exit code, and end."""
    code = 1
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    try:
        client.send(f"{os.getpid()}\n".encode())
        text, streams, _, _ = socket.recv_fds(client, MAX_COMMAND, 3)
        while not text.endswith(b"\n"):
            text += client.recv(MAX_COMMAND)
        words, folder, variables, umask = json.loads(text)
        for number, stream in enumerate(streams):
            os.dup2(stream, number)
            os.close(stream)
        os.chdir(folder)
        os.umask(umask)
        os.environ.clear()
        os.environ.update(variables)
        sys.argv = ["pqsec", *words]
        main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else int(bool(end.code))
    except BaseException:  # noqa: BLE001 -- as the interpreter does
        traceback.print_exc()
    finally:
        with suppress(OSError):
            sys.stdout.flush()
            sys.stderr.flush()
        with suppress(OSError):  # the client was killed
            client.send(f"{code}\n".encode())
        os._exit(code)


@contextmanager
def forking_pqsec(program: Path) -> Iterator[None]:
    """While it is open, `program` is a pqsec that runs as a fork of one server."""
    path = str(program.with_suffix(".socket"))
    program.write_text(CLIENT.format(python=sys.executable, path=path))
    program.chmod(0o755)
    with _server(path):
        yield


class Forks:
    """Runs pqsec as forks of one server, as `subprocess.run` does with processes of their own."""

    def __init__(self, path: str) -> None:
        self._path = path

    @classmethod
    @contextmanager
    def started(cls, *modules: str) -> Iterator["Forks"]:
        """With a server that has imported these modules too."""
        with tempfile.TemporaryDirectory() as folder, _server(f"{folder}/socket", *modules):
            yield cls(f"{folder}/socket")

    def run(
        self, words: Sequence[str], *, cwd: Path, env: Mapping[str, str]
    ) -> subprocess.CompletedProcess[str]:
        umask = os.umask(0)
        os.umask(umask)
        request = json.dumps([list(words), str(cwd), dict(env), umask]).encode() + b"\n"
        with (
            socket.socket(socket.AF_UNIX) as server,
            Path(os.devnull).open() as nothing,
            tempfile.TemporaryFile("w+") as out,
            tempfile.TemporaryFile("w+") as err,
        ):
            server.settimeout(PATIENCE)
            server.connect(self._path)
            streams = [each.fileno() for each in (nothing, out, err)]
            socket.send_fds(server, [request], streams)
            with server.makefile() as answers:
                answers.readline()
                code = answers.readline()
            assert code, "pqsec ended without an exit code"
            said = [each.seek(0) or each.read() for each in (out, err)]
        return subprocess.CompletedProcess(list(words), int(code), *said)


@contextmanager
def _server(path: str, *modules: str) -> Iterator[None]:
    command = [sys.executable, "-m", "tests.docs.forking", path, *modules]
    with subprocess.Popen(
        command, cwd=Path(__file__).parents[2], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE
    ) as server:
        assert server.stdout
        assert server.stdout.readline() == b"\n", "the server of commands has not started"
        try:
            yield
        finally:
            server.kill()


if __name__ == "__main__":
    warnings.resetwarnings()
    serve(*sys.argv[1:])
