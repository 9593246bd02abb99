"""A missing library is named, with the command that installs it and nothing else."""

import re
import tomllib
from pathlib import Path

import pytest

from pqsec_pki._libraries import LIBRARIES, needs_libraries
from pqsec_pki.errors import PqsecError

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
OWN = re.compile(r"pip3? +install[^\n#;&|]*?[ '\"]pqsec(\[|[ '\"=~<>!`]|$)", re.MULTILINE)
"""An installation of pqsec by its name, from an index."""
_WITHOUT_INDEX = "--no-index"


def test_the_libraries_are_those_of_the_extras():
    extras = PROJECT["optional-dependencies"]
    wanted = {
        line for name in extras if name not in {"test", "dev", "docs"} for line in extras[name]
    }
    own = {line for line in wanted if line.startswith("pqsec[")}
    assert {each.requirement for each in LIBRARIES.values()} == wanted - own


@pytest.mark.parametrize("module", sorted(LIBRARIES))
def test_the_hint_installs_the_missing_library_alone(module):
    lacks = pytest.raises(PqsecError, match=f"lacks {LIBRARIES[module].name}$")
    with lacks as refusal, needs_libraries("lacks {library}"):
        raise ModuleNotFoundError(name=f"{module}.part")
    assert refusal.value.hint == f"pip install '{LIBRARIES[module].requirement}'"


def test_another_missing_module_is_a_bug():
    with pytest.raises(ModuleNotFoundError), needs_libraries("lacks {library}"):
        raise ModuleNotFoundError(name="pqsec_pki.gone")


def test_no_text_installs_pqsec_by_a_name_that_anybody_can_register():
    folders = ("pqsec_pki", "docs", "examples", "packaging", "templates", ".ci")
    files = [*ROOT.glob("*.md"), ROOT / "action.yml"]
    files += [each for name in folders for each in (ROOT / name).rglob("*") if each.is_file()]
    assert len(files) > 1000
    found = {
        f"{path.relative_to(ROOT)}: {line.strip()}"
        for path in files
        if path.suffix not in {".pyc", ".so", ".whl"}
        for line in path.read_text(errors="replace").splitlines()
        if OWN.search(line) and _WITHOUT_INDEX not in line
    }
    assert found == set()
    assert OWN.search("python3 -m pip install --user pqsec")
    assert OWN.search("hint: pip install 'pqsec[enrol]'")
    assert not OWN.search("pip install '.[serve]'  # of pqsec")
