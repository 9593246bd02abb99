"""The manual pages are those of the code, in the wheel, and troff and man read them."""

import os
import re
import shutil
import subprocess
import sys
import zipfile

import pytest

from tests.cli.test_help import ALL
from tests.docs.man_pages import FOLDER, ROOT, pages

GET_GROFF = "apt-get install groff-base"


def test_the_pages_in_the_repository_are_those_of_the_code():
    stored = {path.name: path.read_text() for path in FOLDER.iterdir()}
    found = pages()
    assert stored.keys() == found.keys(), "run `python tests/docs/man_pages.py`"
    differing = [name for name, text in found.items() if stored[name] != text]
    assert differing == [], "run `python tests/docs/man_pages.py`"
    assert {f"pqsec-{path.replace(' ', '-')}.1" for path in ALL} <= found.keys()


def test_a_page_has_the_sections_and_examples_of_its_command():
    faults = []
    found = pages()
    for path, command in ALL.items():
        text = found[f"pqsec-{path.replace(' ', '-')}.1"]
        sections = re.findall(r"(?m)^\.SH (.*)$", text)
        wanted = ["NAME", "SYNOPSIS", "DESCRIPTION", "OPTIONS", "EXAMPLES", "EXIT STATUS"]
        if sections != [*wanted, "ENVIRONMENT", "SEE ALSO"]:
            faults.append(f"{path}: {sections}")
        plain = text.replace(r"\-", "-").replace(r"\(aq", "'").replace(r"\(ha", "^")
        faults += [f"{path}: {line}" for line in command.examples.values() if line not in plain]
    assert faults == []


def test_troff_has_no_complaint(requires):
    groff = requires(shutil.which("groff"), "groff", GET_GROFF)
    for path in sorted(FOLDER.iterdir()):
        done = subprocess.run(
            [groff, "-man", "-Tutf8", "-ww", path], capture_output=True, text=True, check=False
        )
        assert (done.returncode, done.stderr) == (0, ""), path.name
        assert "pqsec" in done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory, requires):
    """The files of a wheel of this checkout, unpacked."""
    pytest.importorskip("hatchling", reason="hatchling is missing: pip install '.[test]'")
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (path,) = folder.glob("*.whl")
    with zipfile.ZipFile(path) as packed:
        packed.extractall(folder / "files")
    (data,) = (folder / "files").glob("pqsec-*.data")
    return data / "data"


def test_the_wheel_has_the_pages(wheel):
    found = {path.name: path.read_text() for path in (wheel / "share/man/man1").iterdir()}
    assert found == pages()


def test_man_finds_a_page_below_the_prefix_of_a_venv(wheel, requires):
    man = requires(shutil.which("man"), "man", "apt-get install man-db")
    requires(shutil.which("groff"), "groff", GET_GROFF)
    environment = os.environ | {"MANPATH": str(wheel / "share/man"), "MANWIDTH": "80"}
    for name in ("pqsec", "pqsec-issue", "pqsec-ca-init"):
        done = subprocess.run(
            [man, name], env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        plain = re.sub(r".\x08|\x1b\[[0-9;]*m", "", done.stdout)
        assert f"{name.upper()}(1)" in plain
        assert re.search(rf"SYNOPSIS\n +{name.replace('-', ' ')} ", plain)
