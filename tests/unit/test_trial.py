"""The trial without a stack: what is found, compiled, played, understood and reported."""

import os
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest

from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import FileError, UsageError
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.trial import (
    Act,
    BuildError,
    MissingStackError,
    TopicRoute,
    TrialReport,
    TrialRole,
    TrialRun,
    TrialSetup,
    built,
    find,
    run_peers,
    running,
    topic_route,
    unique_text,
)
from pqsec_pki.trial.findings import findings
from pqsec_pki.trial.network import Wire
from pqsec_pki.trial.peer import MAX_LOG, PeerOutcome
from pqsec_pki.trial.words import words
from pqsec_pki.vendors.cyclone_plugins import find_cyclone_plugins
from tests.unit.keystores import NOW, made

# Finding a stack


TOOLS = ("idlc", "gcc", "g++")
LIBRARIES = "lib/x86_64-linux-gnu"
HEADERS = {
    "libddsc.so": ("dds/version.h", "DDS_VERSION"),
    "libfastrtps.so": ("x86_64-linux-gnu/fastrtps/config.h", "FASTRTPS_VERSION_STR"),
    "libfastdds.so": ("fastdds/config.hpp", "FASTDDS_VERSION_STR"),
}
"""Library -> the header that tells its version, and the macro that is it."""
CYCLONE = ("usr", "libddsc.so", "0.10.4", "libddsc.so.0debian")
CYCLONE_11 = ("usr/local", "libddsc.so", "11.0.1", "libddsc.so.11")
FASTDDS_2 = ("usr", "libfastrtps.so", "2.9.1", "libfastrtps.so.2.9")
FASTDDS_3 = ("usr/local", "libfastdds.so", "3.2.3", "libfastdds.so.3.2")


@pytest.fixture
def root(tmp_path, library):
    """root(CYCLONE) is a root file system with the headers and library of that version, and
    tools; `.headers(...)` and `.library(...)` add one of both."""

    class Root:
        def __call__(self, *stacks, tools=TOOLS) -> Path:
            for name in tools:
                self.put(f"usr/bin/{name}", "#!/bin/sh\n")
            for prefix, name, version, soname in stacks:
                self.headers(prefix, name, version)
                self.library(prefix, name, version, soname)
            return self.path

        @property
        def path(self) -> Path:
            return tmp_path / "root"

        def put(self, name, text):
            path = self.path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
            path.chmod(0o755)

        def headers(self, prefix, name, version):
            header, macro = HEADERS[name]
            self.put(f"{prefix}/include/{header}", f'#define {macro} "{version}"\n')
            if name == "libddsc.so":
                self.put(f"{prefix}/bin/idlc", "#!/bin/sh\n")

        def library(self, prefix, name, version, soname):
            folder = self.path / prefix / (LIBRARIES if prefix == "usr" else "lib")
            if name == "libddsc.so":
                library.cyclone(folder, version, soname)
            else:
                library.installed(folder, name, version, soname)
            return folder

    return Root()


@pytest.mark.parametrize(
    ("stack", "installed", "title"),
    [
        ("cyclonedds", [CYCLONE], "Cyclone DDS 0.10.4"),
        ("cyclonedds", [CYCLONE_11], "Cyclone DDS 11.0.1"),
        ("fastdds", [FASTDDS_2], "Fast DDS 2.9.1"),
        ("fastdds", [FASTDDS_3], "Fast DDS 3.2.3"),
        ("fastdds", [FASTDDS_2, FASTDDS_3], "Fast DDS 3.2.3"),
        ("fastdds", [FASTDDS_2, ("usr", *FASTDDS_3[1:])], "Fast DDS 3.2.3"),
    ],
)
def test_a_stack_is_found_by_its_headers(root, stack, installed, title):
    assert find(stack, root(*installed)).title == title


def test_of_two_cyclones_one_is_taken_whole(root):
    """Its headers were taken, the other's library was linked, and the label was the headers'."""
    found = find("cyclonedds", root(CYCLONE, CYCLONE_11))
    local = root.path / "usr/local"
    assert found.title == "Cyclone DDS 11.0.1"
    assert found.library.path == local / "lib/libddsc.so.11.0.1"
    assert found.plugins == local / "lib"
    idlc, compiler = (found.tool(command, "/tmp/x") for command in found.build.commands)
    assert "/usr/local/bin/idlc" in idlc
    assert {"-I/usr/local/include", "-L/usr/local/lib", str(local / "lib")} <= set(compiler)


def test_a_library_for_another_processor_is_passed_over(root, library, requires):
    """As of a machine that compiles for its robots: its folder comes first."""
    requires(library.can("-m32") or None, "gcc -m32", "apt-get install gcc")
    path = root(CYCLONE)
    library.cyclone(path / "usr/lib/aarch64-linux-gnu", "0.10.5", "libddsc.so.0debian", "-m32")
    found = find("cyclonedds", path)
    assert (found.version, found.plugins) == ("0.10.4", path / "usr" / LIBRARIES)
    assert find_cyclone_plugins(path) == path / "usr" / LIBRARIES


def test_headers_without_a_library_of_theirs_are_refused(root):
    """A compiler takes them, and links the library of the other."""
    root(CYCLONE)
    root.headers("usr/local", "libddsc.so", "11.0.1")
    with pytest.raises(MissingStackError, match=r"headers of Cyclone DDS 11\.0\.1") as refusal:
        find("cyclonedds", root.path)
    assert "usr/local/lib" in str(refusal.value)
    assert "remove the headers" in refusal.value.hint


@pytest.mark.parametrize(("headers", "library_of"), [("11.0.1", "0.10.2"), ("0.10.2", "0.10.5")])
def test_headers_and_library_of_two_versions_are_refused(root, headers, library_of):
    root(("usr", "libddsc.so", library_of, "libddsc.so.0"))
    root.headers("usr", "libddsc.so", headers)
    with pytest.raises(MissingStackError, match=library_of):
        find("cyclonedds", root.path)


def test_a_link_of_another_version_is_refused(root):
    """Programs would be linked to the one, and load the other."""
    folder = root(CYCLONE) / "usr" / LIBRARIES
    shutil.copy(folder / "libddsc.so.0.10.4", folder / "libddsc.so.0.10.3")
    (folder / "libddsc.so.0debian").unlink()
    (folder / "libddsc.so.0debian").symlink_to("libddsc.so.0.10.3")
    with pytest.raises(MissingStackError, match="which programs load"):
        find("cyclonedds", root.path)


def test_a_cyclone_without_its_own_plugins_is_refused(root):
    """Or else those of the other would be loaded."""
    folder = root(CYCLONE, CYCLONE_11) / "usr/local/lib"
    (folder / "libdds_security_ac.so").unlink()
    with pytest.raises(MissingStackError, match="has no security plugins"):
        find("cyclonedds", root.path)


def test_a_root_that_the_loader_would_misread_is_refused(tmp_path):
    with pytest.raises(UsageError, match="the loader cannot use"):
        find("cyclonedds", tmp_path / "a:b")


def test_in_another_root_what_was_found_is_run_with(root):
    """It was looked for in usr/local too, and run with usr/lib alone."""
    found = find("cyclonedds", root(CYCLONE, CYCLONE_11))
    root.put(f"usr/{LIBRARIES}/ld-linux-x86-64.so.2", "")
    loader, option, places, program = found.peer(Path("peer"))
    assert (Path(loader).name, option, program) == (
        "ld-linux-x86-64.so.2",
        "--library-path",
        "peer",
    )
    first, *others = places.split(":")
    assert first == str(root.path / "usr/local/lib")
    assert str(root.path / "usr" / LIBRARIES) in others


@pytest.mark.parametrize(
    ("stack", "package"), [("cyclonedds", "cyclonedds-dev"), ("fastdds", "libfastrtps-dev")]
)
def test_a_stack_that_is_not_there_is_missed_with_its_packages(root, stack, package):
    with pytest.raises(MissingStackError, match="is not installed") as missing:
        find(stack, root())
    assert package in missing.value.hint


def test_a_header_that_tells_no_version_is_none(root):
    root.put("usr/include/dds/version.h", "#define OTHER 1\n")
    with pytest.raises(MissingStackError):
        find("cyclonedds", root())


def test_a_missing_compiler_is_named_with_its_package(root):
    for lacking in ("idlc", "gcc"):
        (root(CYCLONE) / "usr/bin" / lacking).unlink()
        with pytest.raises(MissingStackError, match=f"but {lacking}") as missing:
            find("cyclonedds", root.path)
        assert "cyclonedds-tools" in missing.value.hint


def test_a_stack_that_nobody_can_try_is_refused(root):
    with pytest.raises(UsageError, match="connext"):
        find("connext", root())


# Compiling a peer


@pytest.fixture
def tools(tmp_path, monkeypatch):
    """tools({name: script}): these come before the machine's, and the cache is the test's."""

    def install(scripts):
        folder = tmp_path / "tools"
        folder.mkdir(exist_ok=True)
        for name, script in scripts.items():
            (folder / name).write_text(f"#!/bin/sh\n{script}\n")
            (folder / name).chmod(0o755)
        monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")
        monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    return install


@pytest.fixture
def here(root):
    """A Fast DDS that is elsewhere, and whose compiler is this machine's."""
    return replace(find("fastdds", root(FASTDDS_2)), root=Path("/"))


@pytest.fixture
def peer(tmp_path, library) -> Path:
    """What a compiler makes of it."""
    path = tmp_path / "made"
    path.write_bytes(library.program(FASTDDS_2[-1], "libc.so.6"))
    return path


def test_a_peer_is_compiled_once_and_kept(tools, here, peer, tmp_path):
    tools({"g++": f"echo run >> {tmp_path}/count; test -f fastdds.cpp && cp {peer} peer"})
    program = built(here)
    assert built(here) == program
    assert program.is_relative_to(tmp_path / "cache" / "pqsec")
    assert program.read_bytes() == peer.read_bytes()
    assert os.access(program, os.X_OK)
    assert (tmp_path / "count").read_text() == "run\n"
    assert [path.name for path in program.parent.iterdir()] == [program.name]


def test_a_peer_that_two_need_at_once_is_compiled_once(tools, here, peer, tmp_path):
    """Each took as long as both, on a machine with two processors."""
    tools({"g++": f"echo run >> {tmp_path}/count; sleep 0.3; cp {peer} peer"})
    with ThreadPoolExecutor() as pool:
        first, second = pool.map(built, [here, here])
    assert first == second
    assert (tmp_path / "count").read_text() == "run\n"


def test_another_version_gets_a_peer_of_its_own(tools, here, peer):
    tools({"g++": f"cp {peer} peer"})
    assert built(here) != built(replace(here, version="2.10.0"))


def test_another_build_of_the_library_gets_a_peer_of_its_own(tools, here, peer):
    """A package that was built again under one version is linked again."""
    tools({"g++": f"cp {peer} peer"})
    assert built(here) != built(replace(here, library=replace(here.library, build="00")))
    assert built(here) != built(replace(here, folder=Path("/opt")))


def test_a_peer_that_is_linked_to_another_library_is_not_run(tools, here, peer, library, tmp_path):
    """Its label would be a lie."""
    peer.write_bytes(library.program("libfastrtps.so.2.6"))
    tools({"g++": f"cp {peer} peer"})
    with pytest.raises(BuildError, match=r"libfastrtps\.so\.2\.6, and not to libfastrtps"):
        built(here)
    assert [path for path in (tmp_path / "cache").rglob("*") if path.is_file()] == []


def test_a_compiler_that_takes_too_long_is_ended_with_what_it_started(
    tools, here, tmp_path, monkeypatch
):
    monkeypatch.setattr("pqsec_pki.trial.building.PATIENCE", 2)
    tools({"g++": f"sleep 60 & echo $! > {tmp_path}/child; wait"})
    with pytest.raises(BuildError, match="took more than"):
        built(here)
    assert_ends(int((tmp_path / "child").read_text()))


def test_a_compiler_that_fails_is_quoted_and_nothing_is_kept(tools, here, tmp_path):
    tools({"g++": "echo 'x.hpp: fatal error: no such file' >&2; exit 1"})
    with pytest.raises(BuildError, match="fatal error: no such file") as failure:
        built(here)
    assert "libfastrtps-dev" in failure.value.hint
    assert [path for path in (tmp_path / "cache").rglob("*") if path.is_file()] == []


@pytest.mark.parametrize("flaw", ["pqsec", "pqsec/peers"])
def test_a_cache_where_others_may_write_is_refused(tools, here, tmp_path, flaw):
    """Programs in it are run."""
    tools({"g++": f"touch {tmp_path}/ran"})
    folder = tmp_path / "cache" / flaw
    folder.mkdir(parents=True)
    folder.chmod(0o777)
    with pytest.raises(FileError, match="others may write here") as refusal:
        built(here)
    assert "XDG_CACHE_HOME" in refusal.value.hint
    assert not (tmp_path / "ran").exists()


def test_a_cache_that_is_a_link_is_refused(tools, here, peer, tmp_path):
    tools({"g++": f"cp {peer} peer"})
    (tmp_path / "cache").mkdir()
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "cache/pqsec").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(FileError, match="others may write here"):
        built(here)


@pytest.mark.parametrize("umask", [0o000, 0o002, 0o077])
def test_a_cache_of_ones_own_is_made_whatever_the_umask(tools, here, peer, umask):
    tools({"g++": f"cp {peer} peer"})
    before = os.umask(umask)
    try:
        program = built(here)
    finally:
        os.umask(before)
    places = (program, program.parent, program.parent.parent)
    assert [oct(path.stat().st_mode & 0o777) for path in places] == ["0o700"] * 3


@pytest.mark.parametrize("flaw", ["writable", "link"])
def test_a_program_that_another_put_there_is_not_run(tools, here, peer, tmp_path, flaw):
    tools({"g++": f"cp {peer} peer"})
    program = built(here)
    (tmp_path / "theirs").write_text("theirs")
    program.unlink()
    if flaw == "link":
        program.symlink_to(tmp_path / "theirs")
    else:
        program.write_text("theirs")
        program.chmod(0o777)
    assert built(here).read_bytes() == peer.read_bytes()
    assert (tmp_path / "theirs").read_text() == "theirs"


def test_a_user_without_a_home_is_told_what_to_set(tools, here, peer, monkeypatch):
    tools({"g++": f"cp {peer} peer"})
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")  # to be ignored

    def homeless():
        raise RuntimeError

    monkeypatch.setattr(Path, "home", homeless)
    with pytest.raises(FileError, match="no home") as refusal:
        built(here)
    assert "XDG_CACHE_HOME" in refusal.value.hint


def test_a_root_from_which_nothing_starts_is_refused(root):
    installation = find("cyclonedds", root(CYCLONE))
    with pytest.raises(MissingStackError, match="no program loader"):
        installation.peer(Path("peer"))


def test_a_cache_that_cannot_be_written_is_said(tools, here, peer, tmp_path):
    tools({"g++": f"cp {peer} peer"})
    (tmp_path / "cache").write_text("a file in the way")
    with pytest.raises(FileError, match="cache"):
        built(here)


# A scene, with peers that are scripts

LISTEN = "print('joined', flush=True); time.sleep(3600)"


@pytest.fixture
def setup(tmp_path):
    """scene(send, receive) has peers of this Python, and says how long it took."""

    def play(send, receive=LISTEN, *, timeout=120.0, strangers=()):
        script = tmp_path / "peer.py"
        script.write_text(
            "import os, subprocess, sys, time\n"
            "act, domain, topic, text, seconds = sys.argv[1:]\n"
            "def spoken(): open('spoken', 'w').close()\n"
            "def wait():\n"
            "    while not os.path.exists('spoken'): time.sleep(0.01)\n"
            f"os.chdir({str(tmp_path)!r})\n"
            f"exec({{'send': {send!r}, 'receive': {receive!r}}}[act])\n"
        )
        roles = [
            TrialRole(name="/a", act=Act.SEND, text="x", environment={"PEER": "a"}),
            TrialRole(name="/b", act=Act.RECEIVE, environment={"PEER": "b"}),
            *(
                TrialRole(name=n, act=Act.RECEIVE, environment={}, unauthenticated=True)
                for n in strangers
            ),
        ]
        setup = TrialSetup(
            program=[sys.executable, str(script)], domain=3, topic="T", timeout=timeout
        )
        return run_peers(setup, roles)

    return play


def test_it_is_over_when_the_receiver_has_received(setup):
    done = setup(
        "print('joined\\nmatched', flush=True); spoken(); time.sleep(60)",
        "wait(); print('received x')",
        timeout=60,
    )
    sender, receiver = done.outcomes
    assert (receiver.received, receiver.refused, receiver.signal) == ("x", None, None)
    assert (sender.joined, sender.matched, sender.received, sender.signal) == (
        True,
        True,
        None,
        None,
    )
    assert done.seconds < 60


def test_it_is_over_at_once_when_a_stack_refuses(setup):
    done = setup("print('refused participant: Error'); sys.exit(3)", timeout=60)
    assert done.outcomes[0].refused == "participant: Error"
    assert done.seconds < 60


def test_when_one_stack_refuses_the_other_may_say_so_too(setup, monkeypatch):
    monkeypatch.setattr(running, "_SETTLE", 60)  # it ends before, when both have ended
    late = "spoken(); time.sleep(0.4); print('refused reader: Error'); sys.exit(3)"
    done = setup("wait(); print('refused writer: Error'); sys.exit(3)", late)
    assert [each.refused for each in done.outcomes] == ["writer: Error", "reader: Error"]


def test_a_crash_is_told(setup):
    done = setup("os.abort()")
    assert done.outcomes[0].signal == "SIGABRT"
    assert done.outcomes[1].signal is None


def test_it_is_over_when_the_time_is(setup):
    done = setup(LISTEN, timeout=0.5)
    assert done.seconds == 0.5


@pytest.mark.slow
def test_nobody_waits_for_a_stranger(setup):
    done = setup(
        LISTEN,
        "print('received x') if 'PEER' not in os.environ else time.sleep(60)",
        timeout=5,
        strangers=["?"],
    )
    assert done.seconds == 5
    assert done.outcomes[2].received == "x"


@pytest.mark.slow
def test_a_stranger_is_given_time_after_the_others(setup, monkeypatch):
    """Else it would hear nothing only for want of time."""
    monkeypatch.setattr(running, "_SETTLE", 5)
    late = "if 'PEER' in os.environ: spoken()\nelse: wait(); time.sleep(0.6)\nprint('received x')"
    done = setup(LISTEN, late, strangers=["?"])
    assert done.outcomes[2].received == "x"


def test_what_a_peer_is_told(setup):
    done = setup(
        "print(act, domain, topic, text, os.environ['PEER'], flush=True); spoken(); time.sleep(60)",
        "wait(); print('received it')",
    )
    assert done.outcomes[0].log == "send 3 T x a\n"


@pytest.mark.slow
def test_nothing_is_left_running(setup):
    child = "p = subprocess.Popen(['sleep', '60']); print(p.pid, flush=True); time.sleep(60)"
    done = setup(child, timeout=5)
    assert_ends(int(done.outcomes[0].log))


def assert_ends(pid):
    for _ in range(2000):
        if not Path(f"/proc/{pid}").exists() or _state(pid) == "Z":
            return
        time.sleep(0.05)
    pytest.fail(f"{pid} runs")


def _state(pid):
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]


@pytest.mark.slow
def test_a_log_without_end_does_not_fill_the_memory(setup):
    flood = "os.write(1, b'z' * (3 << 20)); time.sleep(60)"
    assert len(setup(flood, timeout=5).outcomes[0].log) == 1 << 20


def test_marks_differ():
    assert unique_text() != unique_text()


# Words

LONG = MAX_LOG - 100
FAST = (
    "\x1b[37;1m2026-11-21 16:59:24.472 \x1b[31;1m[\x1b[37;1mSECURITY\x1b[31;1m Error] "
    "\x1b[37mParticipant is not allowed with its own permissions file.\x1b[34;1m"
    " -> Function \x1b[36minit\x1b[m\n"
)
CYCLONE_LOG = (
    "1795280364.177205 [0] dq.builtin: Remote secure participant d93d81a0:1c1 not allowed\n"
    "1795280364.178316 [0] ld-linux-x: Failed to finalize (code: 200)\n"
)


def test_words_are_bare_and_said_once():
    noise = "2026-11-21 16:59:24.472 [UTILS Warning] Cannot get MAC addresses -> Function Host\n"
    operator = "2026-11-21 16:59:24.472 [RTPS_EDP Error] no writer -> Function operator()\n"
    own = "joined\nmatched\nrefused writer: x\nreceived y\n"
    said = "[SECURITY Error] Participant is not allowed with its own permissions file."
    assert words(noise + FAST + own + FAST + operator) == (said, "[RTPS_EDP Error] no writer")
    assert words(CYCLONE_LOG) == (
        "Remote secure participant d93d81a0:1c1 not allowed",
        "Failed to finalize (code: 200)",
    )


@pytest.mark.parametrize(
    "line",
    ["1" * LONG, f"{'1' * LONG}.", f"x{' ' * LONG}x", f"1234567890.1 [{'1' * LONG}"],
    ids=["digits", "a time", "spaces", "a domain"],
)
@pytest.mark.timeout(60)  # what is more than linear takes hours
def test_a_hostile_line_takes_no_longer_than_another(line):
    assert len(words(line)) == 1


def test_words_are_not_too_many():
    assert len(words("\n".join(map(str, range(1000))))) == 50


def outcome(log="", act=Act.SEND, name="/a", **how):
    facts = dict.fromkeys(("received", "refused", "signal"))
    facts |= {"joined": True, "matched": False} | how
    role = TrialRole(name=name, act=act, text="x", environment={})
    return PeerOutcome(role=role, log=log, **facts)


def explained(*outcomes, stack="fastdds"):
    return findings([(each, stack) for each in outcomes], topic="rt/x")


def test_a_known_message_has_a_cause_and_a_remedy_and_is_said_once():
    both = [outcome(FAST), outcome(FAST, name="/b")]
    (found,) = explained(*both)
    assert found.participants == ("/a", "/b")
    assert "not allowed with its own" in found.said
    assert found.cause
    assert found.remedy


def test_a_topic_that_is_refused_without_words_is_a_matter_of_permissions():
    refused = "topic: Not Allowed By Security"
    (found,) = explained(
        outcome(CYCLONE_LOG.splitlines()[0], Act.RECEIVE, refused=refused), stack="cyclonedds"
    )
    assert refused in found.said
    assert "subscribe rt/x" in found.cause
    assert "pqsec explain --participant /a --subscribe rt/x --as cyclonedds" in found.remedy


def test_a_topic_that_is_no_word_for_a_shell_is_not_to_be_copied():
    topic = "x;`id`$(id)\n--y"
    refused = outcome(refused="topic: Not Allowed By Security")
    (found,) = findings([(refused, "cyclonedds")], topic=topic)
    assert found.remedy.startswith("`pqsec explain --participant /a --publish TOPIC --as ")
    assert "\n" not in found.cause


def test_a_name_that_no_topic_can_have_is_no_matter_of_permissions():
    (found,) = explained(outcome(refused="topic: Bad Parameter"), stack="cyclonedds")
    assert "permissions" not in found.cause
    assert "--topic" in found.remedy


def test_a_participant_that_is_refused_without_words_is_for_the_check():
    (found,) = explained(outcome("", refused="participant: Error", joined=False))
    assert "pqsec check --target fastdds" in found.remedy


def test_words_that_nobody_knows_are_quoted():
    (found,) = explained(outcome("[SECURITY Error] colourless green ideas\x07 sleep"))
    assert (found.said, found.cause) == (
        "[SECURITY Error] colourless green ideas\\u0007 sleep",
        None,
    )


def test_silence_is_a_finding():
    (found,) = explained(outcome(""), outcome("", name="/b"))
    assert found.participants == ("/a", "/b")
    assert "pqsec verify-handshake /a /b --as fastdds" in found.remedy


def test_a_crash_is_a_finding():
    (found,) = explained(outcome("", signal="SIGSEGV"))
    assert "SIGSEGV" in found.said


# The report

HEARD = {"received": "x", "joined": True}


def report(*, receiver=HEARD, unauthenticated=None, wire=None):
    way = TopicRoute(sender="/a", receiver="/b", domain=0, topic="T")
    outcomes = (
        outcome(),
        outcome(act=Act.RECEIVE, name="/b", **receiver),
        outcome(act=Act.RECEIVE, name="?", **(unauthenticated or {})),
    )
    trial_run = TrialRun(outcomes=outcomes, seconds=1.0, wire=wire, alone=True)
    return TrialReport(
        installations=(),
        topic_route=way,
        trial_run=trial_run,
        **dict(zip(("sender", "receiver", "unauthenticated"), outcomes, strict=True)),
    )


@pytest.mark.parametrize(
    ("receiver", "unauthenticated", "accepted", "heard"),
    [
        (HEARD, {}, True, False),
        (HEARD, {"received": "x"}, True, True),
        (HEARD, {"joined": False}, True, None),
        (HEARD, {"signal": "SIGSEGV"}, True, None),
        ({}, {}, False, None),
        ({}, {"received": "x"}, False, True),
        ({"received": "another"}, {}, False, None),
    ],
)
def test_only_a_sample_that_arrived_and_a_stranger_that_could_hear_are_good(
    receiver, unauthenticated, accepted, heard
):
    made_of = report(receiver=receiver, unauthenticated=unauthenticated)
    assert (made_of.accepted, made_of.unauthenticated_heard) == (accepted, heard)
    assert made_of.ok is (accepted and heard is False)


@pytest.mark.parametrize(
    ("seen", "readable"),
    [
        (None, None),
        ({"packets": 0}, None),
        ({"packets": 9}, False),
        ({"packets": 9, "lost": 1}, None),
        ({"packets": 9, "readable": 1, "lost": 1}, True),
    ],
)
def test_the_wire_is_judged_by_what_was_seen(seen, readable):
    wire = None if seen is None else Wire(b"x", **seen)
    assert report(wire=wire).readable is readable


# Which topic


@pytest.fixture
def way(tmp_path):
    """way({name: (publish, subscribe)}, domain) is what each participant sends to which others."""

    def of(specs, domain=0):
        keystore = made(tmp_path / "k", "classical", names=())
        fixed = {"domains": DomainSet.of(0), "validity": timedelta(days=30)}
        wished = [
            ParticipantSpec(name=name, publish=publish, subscribe=subscribe, **fixed)
            for name, (publish, subscribe) in specs.items()
        ]
        issue(keystore, keystore.unlock(None), wished, now=NOW)
        found = topic_route(keystore, tuple(specs), domain, NOW)
        return found.sender, found.receiver, found.topic

    return of


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ((("x",), ()), ((), ("x",)), ("/a", "/b", "x")),
        (((), ("x",)), (("x",), ()), ("/b", "/a", "x")),
        ((("both", "x"), ("both",)), (("both",), ("both", "x")), ("/a", "/b", "x")),
        ((("both",), ("both",)), (("both",), ("both",)), ("/a", "/b", "both")),
        ((("*",), ()), ((), ("*",)), ("/a", "/b", "pqsec/trial")),
        ((("*",), ()), ((), ("x",)), ("/a", "/b", "x")),
    ],
    ids=["one way", "the other", "one way before both", "both ways", "any", "any to one"],
)
def test_a_topic_is_found_that_one_may_send_and_the_other_receive(way, first, second, expected):
    assert way({"/a": first, "/b": second}) == expected


def test_who_may_not_talk_to_each_other_are_told_so(way):
    with pytest.raises(UsageError, match="neither of /a and /b") as refusal:
        way({"/a": (("x",), ()), "/b": ((), ("y",))})
    assert "--topic" in refusal.value.hint


def test_a_domain_that_is_not_theirs_has_no_topic(way):
    with pytest.raises(UsageError, match="domain 7"):
        way({"/a": (("x",), ()), "/b": ((), ("x",))}, domain=7)


def test_roots_of_user_name_spaces_capture_too(requires):
    """As in a container without privileges: they may not force the size of the buffer."""
    command = ["unshare", "--user", "--map-root-user"]
    allowed = subprocess.run([*command, "true"], capture_output=True, check=False, timeout=60)
    requires(not allowed.returncode or None, "a user name space", "allow them to this user")
    code = (
        "from pqsec_pki.trial.network import new_network, watched\n"
        "assert new_network()\n"
        "with watched(b'x') as wire: print(wire.lost)\n"
    )
    done = subprocess.run(
        [*command, sys.executable, "-c", code],
        capture_output=True, text=True, check=False, timeout=60,
    )  # fmt: skip
    assert (done.stdout, done.stderr) == ("0\n", "")
