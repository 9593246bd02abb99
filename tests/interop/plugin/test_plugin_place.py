"""Library and agent look in one place, and the library tells the true reason if it has no agent."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

from pqsec_pki.plugin import Place
from pqsec_pki.plugin import place as place_module
from pqsec_pki.plugin.build import SOURCES
from tests.interop.plugin.test_plugin_robust import HERE, compiled

pytestmark = pytest.mark.interop


@pytest.fixture
def run_user(tmp_path, monkeypatch):
    monkeypatch.setattr(place_module, "_RUN_USER", tmp_path / "run")
    return tmp_path / "run"


@pytest.fixture
def asked(requires, tmp_path, run_user):
    """asked(environment) is what the library says, and how it ended."""
    requires(shutil.which("cc"), "a C compiler", "apt-get install gcc libc6-dev")
    words = [f'-DRUN_USER="{run_user}"', '-DPQSEC_PYTHON="/x"', "-pthread", "-I", SOURCES]
    program = compiled(tmp_path / "place", *words, HERE / "place.c", *SOURCES.glob("*.c"))

    def ask(environment):
        done = subprocess.run(
            [program], env=environment, capture_output=True, text=True, check=False, timeout=20
        )
        return done.stdout.strip(), done.returncode

    return ask


@pytest.fixture
def edges():
    """Homes that are just short enough for a socket in them, and too long."""
    root = tempfile.mkdtemp(prefix="pqsec-")
    found = [f"{root}/".ljust(size, "x") for size in (77, 78, 79)]
    for each in found:
        Path(each).mkdir()
    yield found
    shutil.rmtree(root)


def test_library_and_agent_agree_where_it_is(asked, run_user, tmp_path, edges):
    home, link, shared = (tmp_path / name for name in ("home", "link", "shared"))
    home.mkdir(), shared.mkdir(), link.symlink_to(home)
    shared.chmod(0o775)
    homes = ["", "/", "here", "/nowhere", *map(str, (home, link, shared, f"{home}/")), *edges]
    runtimes = [None, "", "here", "/nowhere", str(home)]
    differ = []
    for systemds in (False, True):
        if systemds:
            (run_user / str(os.geteuid())).mkdir(parents=True)
        for each in homes:
            for runtime in runtimes:
                environment = {"HOME": each}
                if runtime is not None:
                    environment["XDG_RUNTIME_DIR"] = runtime
                place = Place.of(environment)
                said, ended = asked(environment)
                if ended or Path(said) != place.socket:
                    differ.append((environment, str(place.socket), said))
    assert differ == []


def test_what_another_user_made_first_is_told_with_the_way_out(asked, tmp_path):
    (tmp_path / "pqsec").mkdir(mode=0o777)
    (tmp_path / "pqsec").chmod(0o777)
    said, ended = asked({"XDG_RUNTIME_DIR": str(tmp_path)})
    assert ended
    assert "is not a folder of this user's alone" in said
    assert "HOME or XDG_RUNTIME_DIR" in said
