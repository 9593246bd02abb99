"""File systems without links, as exFAT on a USB stick: what is carried there, and what needs links.

A library takes the links away below one folder; a real exFAT is used where one can be mounted.
"""

import os
import shutil
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.unit.keystores import made

GCC = shutil.which("gcc")
EXFAT = [shutil.which(each) for each in ("mkfs.exfat", "mount.exfat-fuse", "losetup", "fusermount")]
pytestmark = pytest.mark.skipif(GCC is None, reason="no gcc for the library: apt-get install gcc")


@pytest.fixture(scope="session")
def library(tmp_path_factory):
    made = tmp_path_factory.mktemp("no_links") / "no_links.so"
    source = Path(__file__).with_name("no_links.c")
    subprocess.run([GCC, "-shared", "-fPIC", "-O1", "-o", made, source, "-ldl"], check=True)
    return made


@pytest.fixture
def stick(tmp_path, library):
    """A folder without links, and the variables of processes for which it has none."""
    folder = tmp_path / "stick"
    folder.mkdir()
    return folder, {"LD_PRELOAD": str(library), "NO_LINKS": f"{folder}/", "NO_RENAME": "1"}


@pytest.fixture(params=["renamed at once", "renamed alone"])
def any_stick(request, stick):
    """With and without renameat2(2)."""
    if request.param == "renamed at once":
        del stick[1]["NO_RENAME"]
    return stick


def start(stick, line):
    folder, variables = stick
    command = [sys.executable, "-m", "pqsec_pki", *line.split()]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, cwd=folder, env=os.environ | variables, **streams)


def run(stick, line):
    with start(stick, line) as process:
        out, err = process.communicate(timeout=300)
    return process.returncode, out, err


@pytest.fixture
def keystore(tmp_path):
    return made(tmp_path / "k", "classical").root


LINES = {
    "bundle": "-k {k} bundle /talker --plain-key -o made",
    "request": "request /r --profile pq --dir {home}/robot --csr made",
    "list": "-k {k} ca crl --validity 30d -o made",
    "report": "-k {k} report -o made",
    "export": "-k {k} export cyclonedds /talker -o made",
}


@pytest.mark.parametrize("line", LINES.values(), ids=LINES)
def test_what_is_carried_is_written_without_links_and_replaces_nothing(
    stick, keystore, tmp_path, line
):
    for number, code in enumerate((0, 3)):
        words = line.format(k=keystore, home=tmp_path / str(number))
        found, _, err = run(stick, words)
        assert found == code, err
        if code:
            assert "exists" in err
        [there] = stick[0].iterdir()
        assert there.name == "made"
    found, _, err = run(stick, f"{line.format(k=keystore, home=tmp_path / 'last')} --force")
    assert found == 0, err
    assert [each.name for each in stick[0].iterdir()] == ["made"]


WRITE = """
import sys
from pathlib import Path
from pqsec_pki._files import write
from pqsec_pki.errors import ExistsError
print("ready", flush=True)
sys.stdin.readline()
try:
    write(Path("made"), sys.argv[1].encode() * 1000)
except ExistsError:
    print("exists")
else:
    print("written")
"""


def test_of_several_at_once_one_writes_the_file(any_stick):
    folder, variables = any_stick
    streams = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", WRITE, str(each)],
            cwd=folder,
            env=os.environ | variables,
            **streams,
        )
        for each in range(6)
    ]
    for each in processes:
        assert each.stdout.readline() == "ready\n"
    for each in processes:
        each.stdin.write("\n")
        each.stdin.flush()
    said = [each.communicate(timeout=300)[0] for each in processes]
    assert sorted(said) == [*["exists\n"] * 5, "written\n"]
    assert (folder / "made").read_bytes() == str(said.index("written\n")).encode() * 1000


def test_a_killed_command_leaves_no_part_there(any_stick):
    """At each call that changes something: nothing, or all of it."""
    folder, variables = any_stick
    script = """
import os
from pathlib import Path
from pqsec_pki._files import write
from tests.unit.killing import survives
calls, target = 1, Path("made")
while not survives(calls, lambda: write(target, b"whole" * 1000)):
    assert not target.exists() or target.read_bytes() == b"whole" * 1000
    target.unlink(missing_ok=True)
    calls += 1
assert os.listdir() == ["made"]
print(calls)
"""
    places = {"PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=folder,
        env=os.environ | variables | places,
        check=True,
        stdout=subprocess.PIPE,
    )
    assert int(done.stdout) > 5


NEEDING = {
    "ca init": "-k kept ca init --profile pq --no-passphrase",
    "install": "install {bundle} --dir kept --trust-first",
    "plugin": "plugin install --dir kept",
    "adopt": "adopt kept",
}


@pytest.mark.parametrize("line", NEEDING.values(), ids=NEEDING)
def test_what_needs_links_is_refused_before_anything_is_made(stick, keystore, tmp_path, line):
    bundle = tmp_path / "a.bundle"
    assert run(stick, f"-k {keystore} bundle /talker --plain-key -o {bundle}")[0] == 0
    kept = stick[0] / "kept"
    if "adopt" in line:
        shutil.copytree(keystore, kept)  # without links, as a copy to such a disk
        (kept / "pqsec.json").unlink()
        shutil.rmtree(kept / "private")
    before = sorted(stick[0].rglob("*"))
    code, out, err = run(stick, line.format(bundle=bundle))
    assert (code, out) == (3, "")
    assert "kept: has a file system without links" in err
    assert "pqsec: hint: choose a folder on ext4" in err
    assert sorted(stick[0].rglob("*")) == before


@contextmanager
def mounted(tmp_path):
    """A folder of a new exFAT; skips where none can be mounted."""
    if not all(EXFAT) or os.geteuid():
        pytest.skip("no exFAT: as root, apt-get install exfatprogs exfat-fuse fuse mount")
    make, mount, loop, unmount = EXFAT
    image, folder = tmp_path / "image", tmp_path / "exfat"
    image.write_bytes(bytes(8 << 20))
    folder.mkdir()
    subprocess.run([make, image], check=True, stdout=subprocess.DEVNULL)
    command = [loop, "--find", "--show", image]
    found = subprocess.run(command, check=False, capture_output=True, text=True)
    if found.returncode:
        pytest.skip(f"no exFAT: {found.stderr.strip()}")
    try:
        subprocess.run([mount, found.stdout.strip(), folder], capture_output=True, check=False)
        until = time.monotonic() + 5
        while f" {folder} " not in Path("/proc/mounts").read_text():
            if time.monotonic() > until:
                pytest.skip("no exFAT: it cannot be mounted here")
            time.sleep(0.05)
        yield folder
        subprocess.run([unmount, "-u", folder], check=True)
    finally:
        subprocess.run([loop, "--detach", found.stdout.strip()], check=False)


@pytest.mark.timeout(120)
def test_a_real_exfat_carries_a_bundle(tmp_path, keystore):
    with mounted(tmp_path) as folder:
        line = f"-k {keystore} bundle /talker --plain-key -o made"
        assert [run((folder, {}), line)[0] for _ in range(2)] == [0, 3]
        assert run((folder, {}), f"{line} --force")[0] == 0
        assert [each.name for each in folder.iterdir()] == ["made"]
        assert run((folder, {}), "-k kept ca init --profile pq --no-passphrase")[0] == 3
        assert [each.name for each in folder.iterdir()] == ["made"]
