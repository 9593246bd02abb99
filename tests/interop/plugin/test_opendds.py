"""OpenDDS with our plugin, in a build of it that PQSEC_OPENDDS_ROOT names.

OpenDDS is in no package registry, so this is run by hand. ACE_ROOT and TAO_ROOT as for the build.
"""

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

from pqsec_pki.vendors.fastdds_adapter import here
from pqsec_pki.vendors.opendds_adapter import OPENDDS_LINK, install_opendds
from pqsec_pki.vendors.opendds_library import OpenDds, find_opendds
from pqsec_pki.vendors.own_plugin import OPENDDS

pytestmark = pytest.mark.interop

VARIABLE = "PQSEC_OPENDDS_ROOT"
HERE = Path(__file__).parent
TOPIC, DOMAIN, SECONDS, LONGEST = "Square", "0", 40, 300
TEXT = "a marker that nobody else may read"
QUIET = 4.0
"""Seconds in which a sender that is heard sends twenty samples."""
LIBRARIES = ("OpenDDS_Rtps_Udp", "OpenDDS_Rtps", "OpenDDS_Dcps", "TAO_PortableServer")
LIBRARIES += ("TAO_AnyTypeCode", "TAO", "ACE")


def pqsec(*words: object) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "pqsec_pki", *map(str, words)],
        capture_output=True,
        text=True,
        timeout=LONGEST,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@dataclass(frozen=True)
class Build:
    """An OpenDDS, and our plugin for it."""

    stack: OpenDds
    plugin: Path
    folder: Path

    @property
    def path(self) -> str:
        return ":".join(map(str, self.stack.libraries))

    def program(self, name: str, *flags: str) -> Path:
        """A peer, compiled as the user's build would."""
        root, *_ = self.stack.include
        include = [f"-I{each}" for each in self.stack.include]
        ace = Path(os.environ.get("ACE_ROOT", root / "ACE_wrappers"))
        environment = {**os.environ, "LD_LIBRARY_PATH": self.path, "DDS_ROOT": str(root)}
        environment |= {"PATH": f"{ace}/bin:{root}/bin:{os.environ['PATH']}"}
        shutil.copy(HERE / "opendds_peer.idl", self.folder)
        shutil.copy(HERE / "opendds_peer.cpp", self.folder)
        idl = ["-I.", *include, "-DOPENDDS_SECURITY"]
        made = ["opendds_peerC", "opendds_peerTypeSupportC", "opendds_peerTypeSupportImpl"]
        compiler = ["c++", "-std=gnu++11", "-w", "-fpermissive", "-pthread", "-D__ACE_INLINE__"]
        compiler += [*idl, *flags]
        commands = [
            [*compiler, "-o", name, "opendds_peer.cpp", *(f"{each}.o" for each in made)]
            + [f"-L{each}" for each in self.stack.libraries]
            + [f"-l{each}" for each in LIBRARIES]
        ]
        if not (self.folder / f"{made[-1]}.o").exists():
            commands[:0] = [
                ["opendds_idl", *idl, "opendds_peer.idl"],
                ["tao_idl", *idl, "-SS", "opendds_peer.idl"],
                ["tao_idl", *idl, "-SS", "opendds_peerTypeSupport.idl"],
                *([*compiler, "-c", f"{each}.cpp"] for each in made),
            ]
        for command in commands:
            done = subprocess.run(
                command,
                cwd=self.folder,
                env=environment,
                capture_output=True,
                timeout=600,
                check=False,
            )
            assert done.returncode == 0, done.stderr.decode()[-2000:]
        return self.folder / name


@pytest.fixture(scope="module")
def build(requires, tmp_path_factory) -> Build:
    said = requires(os.environ.get(VARIABLE), "a build of OpenDDS", f"set {VARIABLE} to its folder")
    stack = find_opendds(Path(said), os.environ)
    folder = tmp_path_factory.mktemp("opendds")
    install_opendds(stack, folder / "plugin", here())
    return Build(stack, folder / "plugin", folder)


@pytest.fixture(scope="module")
def program(build) -> Path:
    """A peer that sets properties itself, and knows nothing of our plugin."""
    return build.program("peer")


@pytest.fixture(scope="module")
def domain(tmp_path_factory) -> Callable[[str], Path]:
    """domain("own") is a keystore of profile pq, with one participant revoked."""

    def make(name: str) -> Path:
        root = tmp_path_factory.mktemp(name) / "k"
        key = ("-k", root)
        pqsec(*key, "ca", "init", "--profile", "pq", "--no-passphrase", "--name", "Lab")
        governance = root / "enclaves/governance.xml"
        text = governance.read_text()  # 3.13.3 cannot protect RTPS messages
        kind = "rtps_protection_kind"
        governance.write_text(re.sub(f"<{kind}>.*</{kind}>", f"<{kind}>NONE</{kind}>", text))
        pqsec(*key, "sign-governance", governance, "--force")
        pqsec(*key, "issue", "/alice", "/mallory", "--publish", TOPIC)
        pqsec(*key, "issue", "/carol", "--publish", "Circle")
        pqsec(*key, "issue", "/bob", "--subscribe", TOPIC)
        pqsec(*key, "revoke", "/mallory", "--yes")
        return root

    return cache(make)


@pytest.fixture(autouse=True)
def _agent(monkeypatch):
    """Each process has one of its own."""
    monkeypatch.setenv("PQSEC_AGENT", "private")


@dataclass(frozen=True)
class Ended:
    code: int
    log: str

    @property
    def heard(self) -> bool:
        return f"heard {TEXT}" in self.log


@pytest.fixture
def exported(build, domain, tmp_path) -> Callable[..., Path]:
    """exported("/bob") is the folder of that participant's export."""

    def make(name: str, whose: str = "own") -> Path:
        folder = tmp_path / f"{whose}{name.replace('/', '-')}"
        plugin = ("--plugin", "--plugins", build.plugin)
        pqsec("-k", domain(whose), "export", "opendds", name, *plugin, "--anyway", "-o", folder)
        return folder

    return make


def properties(folder: Path, *, with_list: bool) -> Path:
    """Those of the header, as a program would set them that does not include it."""
    header = (folder / "pqsec_participant.h").read_text()
    pairs = re.findall(r'add\(properties, "([^"]*)", "([^"]*)"\);', header)
    pairs = [(name, value) for name, value in pairs if with_list or "crl" not in name]
    path = folder / "properties"
    path.write_text("".join(f"{name}={value}\n" for name, value in pairs))
    return path


def words_of(program: Path, folder: Path, act: str, topic: str, seconds: int) -> list[str]:
    """A sender names no revocation list: its own plugin would refuse it if it is revoked."""
    path = properties(folder, with_list=act == "receive")
    found = [program, folder / "opendds.ini", act, DOMAIN, topic, TEXT, seconds, path]
    return list(map(str, found))


def begun(build: Build, words: list[str], *, ours: bool = True, log=subprocess.PIPE):
    first = [str(build.plugin / OPENDDS_LINK.parent)] if ours else []
    environment = {**os.environ, "LD_LIBRARY_PATH": ":".join([*first, build.path])}
    return subprocess.Popen(
        words, env=environment, cwd=build.folder, stdout=log, stderr=subprocess.STDOUT, text=True
    )


def met(build: Build, sender: list[str], receiver: list[str], *, ours=(True, True)) -> list[Ended]:
    """Both run, until the receiver is over; `ours` is who finds our plugin first."""
    of_sender, of_receiver = ours
    running = [begun(build, receiver, ours=of_receiver), begun(build, sender, ours=of_sender)]
    ended = []
    for each in running:
        try:
            log, _ = each.communicate(timeout=LONGEST)
        finally:
            each.kill()
        ended.append(Ended(each.returncode, log))
    return ended[::-1]


def test_a_pair_meets_by_the_library_folder(build, program, exported):
    """Programs that know nothing of the plugin."""
    alice, bob = map(exported, ("/alice", "/bob"))
    sender, receiver = met(
        build,
        words_of(program, alice, "send", TOPIC, SECONDS),
        words_of(program, bob, "receive", TOPIC, SECONDS),
    )
    assert receiver.heard, (sender.log, receiver.log)
    assert (sender.code, receiver.code) == (0, 0), (sender.log, receiver.log)


def test_a_pair_meets_by_the_exported_header(build, program, exported):
    """The receiver loads the plugin by the directive in its header."""
    alice, bob = map(exported, ("/alice", "/bob"))
    with_header = build.program("with_header", "-DPQSEC_HEADER", f"-I{bob}")
    sender, receiver = met(
        build,
        words_of(program, alice, "send", TOPIC, SECONDS),
        words_of(with_header, bob, "receive", TOPIC, SECONDS),
        ours=(True, False),
    )
    assert receiver.heard, (sender.log, receiver.log)


STRANGERS = {
    "a CA of the same name": ("other", "/alice", TOPIC, True),
    "revoked": ("own", "/mallory", TOPIC, True),
    "a topic without permission": ("own", "/carol", TOPIC, True),
    "without our plugin": ("own", "/alice", TOPIC, False),
}


@pytest.mark.parametrize("case", STRANGERS)
def test_nothing_is_heard_from(case, build, program, exported):
    whose, name, topic, ours = STRANGERS[case]
    bob, other = exported("/bob"), exported(name, whose)
    sender, receiver = met(
        build,
        words_of(program, other, "send", topic, 15),
        words_of(program, bob, "receive", TOPIC, 15),
        ours=(ours, True),
    )
    assert "joined" in receiver.log
    assert not receiver.heard, (sender.log, receiver.log)
    if case == "revoked":
        assert "was revoked on" in receiver.log
    if case == "a CA of the same name":
        assert "is not signed by this CA" in receiver.log + sender.log
    if case == "a topic without permission":
        assert "no topic" in sender.log
    if not ours:
        assert "no participant" in sender.log


def test_another_build_gets_no_plugin(build, program, exported, tmp_path):
    """The adapter tells it, and OpenDDS creates no participant."""
    bob = exported("/bob")
    there = shutil.copytree(build.plugin, tmp_path / "plugin", symlinks=True)
    adapter = there / OPENDDS
    path = str(build.stack.library.path).encode()
    octets = adapter.read_bytes()
    assert octets.count(path + b"\0") >= 1
    adapter.write_bytes(octets.replace(path + b"\0", b"/" + b"x" * (len(path) - 1) + b"\0"))
    words = words_of(program, bob, "receive", TOPIC, 3)
    environment = {**os.environ, "LD_LIBRARY_PATH": f"{there / OPENDDS_LINK.parent}:{build.path}"}
    done = subprocess.run(
        words, env=environment, capture_output=True, text=True, timeout=LONGEST, check=False
    )
    assert "run `pqsec plugin install opendds` again" in done.stderr
    assert (done.returncode, done.stdout.split("\n")[0]) == (1, "no participant")


@contextmanager
def session(build: Build, words: list[str], log: Path) -> Iterator[subprocess.Popen]:
    with log.open("w") as file, begun(build, words, log=file) as process:
        try:
            yield process
        finally:
            process.kill()


def wait(log: Path, words: str) -> None:
    end = time.monotonic() + LONGEST
    while words not in log.read_text() and time.monotonic() < end:
        time.sleep(0.1)
    assert words in log.read_text()


def test_a_program_is_told_of_a_revoked_peer_in_mid_session_and_parts_from_it(
    build, domain, exported, tmp_path
):
    """Both processes live on, and what the peer still sends is not received."""
    root = domain("session")
    alice, bob = exported("/alice", "session"), exported("/bob", "session")
    listening = build.program("listening", "-DPQSEC_LISTENER")
    commands = [
        words_of(listening, alice, "send", TOPIC, LONGEST),
        words_of(listening, bob, "receive", TOPIC, LONGEST),
    ]
    heard, other = tmp_path / "bob.log", tmp_path / "alice.log"
    with (
        session(build, commands[1], heard) as receiver,
        session(build, commands[0], other) as sender,
    ):
        wait(heard, f"heard {TEXT}")
        pqsec("-k", root, "revoke", "/alice", "--yes")
        wait(heard, "told of")
        time.sleep(QUIET)
        logs = heard.read_text(), other.read_text()
        assert (sender.poll(), receiver.poll()) == (None, None), logs
    after = heard.read_text().partition("told of")[2]
    assert after.count("heard") < 5, after
