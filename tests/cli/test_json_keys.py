"""What `--json` prints is one value, with the keys that programs rely on.

json_keys.json has, for each command line, the keys of its result. A key that is missing breaks
programs: it takes another JSON_VERSION. A new one is added there, so that it is missed later.
"""

import json
from pathlib import Path

import pytest

from pqsec_pki.cli._printing import JSON_VERSION

RECORDED = Path(__file__).with_name("json_keys.json")
KEYS = json.loads(RECORDED.read_text())


@pytest.mark.parametrize("line", KEYS)
def test_json_is_one_value_with_the_recorded_keys(pqsec, keystore, line):
    keystore()
    done = pqsec(f"{line} --json")
    value = json.loads(done.out or done.err)
    assert value["version"] == JSON_VERSION
    assert sorted(set(keys_of(value))) == KEYS[line].split()


def keys_of(value, before=""):
    """Such as `findings[].rule`."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield f"{before}.{key}".removeprefix(".")
            yield from keys_of(inner, f"{before}.{key}")
    if isinstance(value, list):
        for each in value:
            yield from keys_of(each, f"{before}[]")
