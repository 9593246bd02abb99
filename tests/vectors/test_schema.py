"""The vectors follow their schema, and are in the source distribution."""

import json
import re
import subprocess
import sys
import tarfile
from functools import cache
from pathlib import Path

import pytest

from tests.json_schemas import validator as validator_of

VECTORS = Path(__file__).parent
ROOT = VECTORS.parents[1]
SCHEMA = json.loads((VECTORS / "schema.json").read_bytes())
README = (VECTORS / "README.md").read_text()
DEFINED = dict(re.findall(r"(?m)^\| `([^`]+\.json)` \| `([^`]+)` \|", README))


@cache
def validator(definition):
    return validator_of({"$ref": f"#/$defs/{definition}", "$defs": SCHEMA["$defs"]})


def test_every_file_of_vectors_is_in_the_table():
    found = {str(path.relative_to(VECTORS)) for path in VECTORS.rglob("*.json")}
    assert found - {"schema.json"} == set(DEFINED)
    assert validator_of(SCHEMA)


@pytest.mark.parametrize(("file", "definition"), DEFINED.items(), ids=list(DEFINED))
def test_a_file_follows_its_definition_and_no_other(file, definition):
    content = json.loads((VECTORS / file).read_bytes())
    validator(definition).validate(content)
    others = set(DEFINED.values()) - {definition}
    assert {other for other in others if validator(other).is_valid(content)} == set()


def test_the_vectors_are_in_the_source_distribution(tmp_path):
    build = [sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True)
    [made] = tmp_path.iterdir()
    with tarfile.open(made) as archive:
        shipped = {name.partition("/")[2] for name in archive.getnames()}
    due = [VECTORS / each for each in ("README.md", "schema.json", *DEFINED)]
    assert {str(path.relative_to(ROOT)) for path in due} <= shipped
