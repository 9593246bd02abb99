"""pqsec plugin and pqsec agent, as their users see them."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from pqsec_pki.plugin import NAMES
from pqsec_pki.plugin.agent_folder import AgentFolder
from pqsec_pki.plugin.control import Client


@pytest.fixture
def runtime(monkeypatch):
    """A runtime folder of this test's own; a socket's path must be short."""
    folder = tempfile.mkdtemp(prefix="pqsec-")
    monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
    yield Path(folder)
    shutil.rmtree(folder)


def test_the_plugin_is_compiled_and_tried_and_never_overwritten_unasked(pqsec, requires, tmp_path):
    requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")
    folder = tmp_path / "lib"
    found = pqsec(f"plugin install --dir {folder} --json").json
    assert found["library"] == str(folder / "libpqsec_dds.so")
    assert [(folder / name).resolve() for name in NAMES] == [folder / "libpqsec_dds.so"] * 2
    before = (folder / "libpqsec_dds.so").stat().st_ino
    pqsec(f"plugin install --dir {folder}").refused(3, "exists", hint="--force")
    assert (folder / "libpqsec_dds.so").stat().st_ino == before
    pqsec(f"plugin install --dir {folder} --force").done()
    assert (folder / "libpqsec_dds.so").stat().st_ino != before


def test_a_folder_that_others_may_write_in_gets_no_plugin(pqsec, requires, tmp_path):
    """They could replace what every DDS process of the user loads."""
    requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")
    folder = tmp_path / "lib"
    folder.mkdir()
    folder.chmod(0o777)
    pqsec(f"plugin install --dir {folder}").refused(3, "anybody may write there", hint="chmod go-w")
    assert list(folder.iterdir()) == []


def test_a_folder_that_cannot_be_made_is_told_and_not_taken_for_installed(
    pqsec, requires, tmp_path
):
    requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")
    (tmp_path / "file").write_text("mine")
    folder = tmp_path / "file" / "lib"
    pqsec(f"plugin install --dir {folder}").refused(3, f"{folder}: not a directory")


def test_what_is_installed_is_listed_and_uninstalled_without_a_trace(
    pqsec, requires, monkeypatch, tmp_path
):
    requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    folder = tmp_path / "lib"
    nothing = pqsec(f"plugin status --dir {folder}")
    assert (nothing.code, nothing.out) == (1, f"the plugin is not installed in {folder}\n")
    pqsec(f"plugin install --systemd --dir {folder}").done()
    (folder / "libpqsec_fastdds.so").touch()
    record = {"library": str(tmp_path / "libfastrtps.so"), "build": "00ff", "version": [2, 9, 1]}
    record |= {"protocol": 2, "python": sys.executable}
    (folder / "pqsec-fastdds-00ff.json").write_text(json.dumps(record))
    (folder / "pqsec-fastdds-00ff.so").touch()
    listed = pqsec(f"plugin status --dir {folder}")
    assert listed.code == 1
    assert listed.out.startswith(f"ok    Cyclone DDS       {folder / 'libpqsec_dds.so'}\n")
    assert f"FAIL  Fast DDS 2.9.1    {tmp_path / 'libfastrtps.so'}" in listed.out
    assert "`pqsec plugin install fastdds`" in listed.out
    found = pqsec(f"plugin status --dir {folder} --json").json["installed"]
    assert [(each["stack"], each["ok"]) for each in found] == [
        ("cyclonedds", True),
        ("fastdds", False),
    ]
    pqsec(f"plugin uninstall --dir {folder}").refused(
        2, "8 files would be removed", hint=f"status --dir {folder}`", shows="libpqsec_dds.so"
    )
    removed = pqsec(f"plugin uninstall --yes --dir {folder} --json").done().json["removed"]
    assert len(removed) == 8
    assert not folder.exists()
    assert not list((tmp_path / "config/systemd/user").iterdir())
    assert pqsec(f"plugin uninstall --dir {folder}").done().out.startswith("the plugin is not")


def test_a_file_of_the_users_own_is_not_uninstalled(pqsec, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    (tmp_path / "lib").mkdir()
    for name in ("libpqsec_dds.so", "libdds_security_auth.so", "mine.so"):
        (tmp_path / "lib" / name).write_text("mine")
    pqsec(f"plugin uninstall --yes --dir {tmp_path / 'lib'}").done()
    left = {path.name for path in (tmp_path / "lib").iterdir()}
    assert left == {"libdds_security_auth.so", "mine.so"}


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("plugin install --library x", "--library is for fastdds"),
        ("plugin install opendds --library x", "--library is for fastdds"),
        ("plugin install --include x", "--include is for fastdds"),
        ("plugin install opendds --include x", "--include is for fastdds"),
        ("plugin install --root x", "--root is for opendds"),
        ("plugin install fastdds --systemd", "--systemd is not for fastdds"),
        ("plugin install opendds --systemd", "--systemd is not for opendds"),
    ],
)
def test_an_option_of_the_other_stack_is_refused(pqsec, line, words):
    pqsec(line).refused(2, words)


def test_without_opendds_the_way_out_is_told(pqsec, tmp_path, monkeypatch):
    line = f"plugin install opendds --dir {tmp_path / 'lib'}"
    monkeypatch.delenv("DDS_ROOT", raising=False)
    pqsec(line).refused(2, "DDS_ROOT is not set", hint="--root DIR")
    for told in (lambda: line + f" --root {tmp_path}", lambda: line):
        pqsec(told()).refused(3, "has no headers of OpenDDS", hint="DDS_ROOT")
        monkeypatch.setenv("DDS_ROOT", str(tmp_path))
    assert not (tmp_path / "lib").exists()


def test_a_library_that_is_not_fast_dds_is_refused_with_the_reason(pqsec, library, tmp_path):
    (tmp_path / "x.so").write_bytes(library("libx.so.1", build="00"))
    line = f"plugin install fastdds --library {tmp_path / 'x.so'} --dir {tmp_path / 'lib'}"
    pqsec(line).refused(3, "does not export the functions", hint="-DSECURITY=ON")
    assert not (tmp_path / "lib").exists()


def test_headers_that_are_named_must_have_the_librarys_version(pqsec, requires, tmp_path):
    found = next(Path("/usr/lib").glob("*-linux-gnu*/libfastrtps.so"), None)
    requires(found, "Fast DDS 2", "apt-get install libfastrtps-dev")
    (tmp_path / "one").mkdir()
    (tmp_path / "two/fastrtps").mkdir(parents=True)
    (tmp_path / "two/fastrtps/config.h").write_text('#define FASTRTPS_VERSION_STR "2.99.1"\n')
    line = f"plugin install fastdds --library {found} --include one --include two --dir lib"
    refused = pqsec(line).refused(3, "headers of Fast DDS, and only headers of 2.99.1 are there")
    assert "that has fastrtps/config.h: --include DIR" in refused.err
    pqsec(line.replace("one", "onw")).refused(3, "onw: no such folder")
    assert not (tmp_path / "lib").exists()


@pytest.mark.parametrize(
    ("compiler", "words"), [("nowhere-cc", "no C compiler"), ("false", "the compiler says")]
)
def test_without_a_compiler_that_works_nothing_is_left(
    pqsec, monkeypatch, tmp_path, compiler, words
):
    monkeypatch.setenv("CC", compiler)
    pqsec(f"plugin install --dir {tmp_path / 'lib'}").refused(3, words)
    assert not (tmp_path / "lib").exists()


def test_units_for_systemd_are_written_beside_all_or_nothing(
    pqsec, requires, monkeypatch, tmp_path
):
    requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    folder, service = tmp_path / "lib", tmp_path / "config/systemd/user/pqsec-agent.service"
    service.parent.mkdir(parents=True)
    service.write_text("mine")
    line = f"plugin install --systemd --dir {folder}"
    pqsec(line).refused(3, "pqsec-agent.service exists", hint="--force")
    assert (service.read_text(), folder.exists()) == ("mine", False)
    monkeypatch.setenv("CC", "nowhere-cc")
    pqsec(f"{line} --force").refused(3, "no C compiler")
    assert service.read_text() == "mine"
    monkeypatch.delenv("CC")
    done = pqsec(f"{line} --force").done()
    assert sys.executable in service.read_text()
    assert "systemctl --user enable --now pqsec-agent.service" in done.out


@pytest.mark.parametrize("line", ["plugin install", "plugin install --systemd --dir lib"])
def test_who_has_no_home_is_told_what_to_do(pqsec, monkeypatch, line):
    for name in ("HOME", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 3_000_000_000)  # a user that the system does not know
    pqsec(line).refused(3, "no home folder", hint="HOME")


def test_no_agent_is_no_error_but_no_yes_either(pqsec, runtime):
    assert pqsec("agent status").code == 1
    assert pqsec("agent status --json").json == {"running": False, "retired": []}
    assert pqsec("agent stop").done().out.startswith("no agent runs")
    pqsec("agent log").refused(3, "there is no log")


@contextmanager
def foreground():
    """`pqsec agent run`, killed if it does not end."""
    command = [sys.executable, "-m", "pqsec_pki", "agent", "run"]
    with subprocess.Popen(command, stderr=subprocess.PIPE) as agent:
        try:
            yield agent
        finally:
            agent.kill()


def test_an_agent_runs_in_the_foreground_until_it_is_told_to_stop(pqsec, runtime):
    with foreground() as agent:
        place = AgentFolder.of(os.environ)
        while pqsec("agent status").code:
            assert agent.poll() is None
        client = Client(place, "authentication")
        status = pqsec("agent status").out
        assert f"process   {agent.pid}" in status
        assert "authentication" in status
        pqsec("agent run").refused(3, "an agent already listens at", hint="pqsec agent stop")
        client.close()
        assert pqsec("agent stop").out == "stopped\n"
        agent.wait(20)
        assert agent.returncode == 0


def test_an_agent_in_the_foreground_leaves_no_core_file_either(pqsec, runtime):
    with foreground() as agent:
        while pqsec("agent status").code:
            assert agent.poll() is None
        limits = Path(f"/proc/{agent.pid}/limits").read_text()
        assert re.search(r"Max core file size +0 +0 ", limits)


def test_an_agent_in_the_foreground_can_be_interrupted(pqsec, runtime):
    with foreground() as agent:
        while pqsec("agent status").code:
            assert agent.poll() is None
        agent.send_signal(signal.SIGINT)
        agent.wait(20)
    assert pqsec("agent status").code == 1
