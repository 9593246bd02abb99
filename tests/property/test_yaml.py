"""Policies in YAML: what is written is read back, and no input breaks out of the room."""

import contextlib
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pqsec_pki.documents import (
    PRESETS,
    DomainSet,
    Permissions,
    governance_to_yaml,
    new_governance,
    new_permissions,
    permissions_to_yaml,
)
from pqsec_pki.errors import InvalidDocumentError, UsageError
from tests.longer import examples
from tests.property.test_documents import GOVERNANCES, permissions
from tests.unit.test_yaml import read_governance, read_permissions

READERS = [read_governance, read_permissions]
ALL = DomainSet.parse("0,2-5")
DOCUMENTS = [
    *(new_governance(preset, ALL) for preset in PRESETS),
    new_permissions(["/talker", "/listener"], ALL, "1y"),
    b"grants:\n- name: a\n  rules:\n  - deny: {publish: {topics: x, data_tags: {a: b}}}\n",
]
# What YAML might take for something else.
WORDS = st.sampled_from(
    ["no", "NO", "on", "y", "~", "null", "010", "0o7", "1e3", "1_0", "1:30", ".5", "2030-01-01",
     "<<", "=", "*", "&a", "!x", "- a", "a: b", "a #b", " a ", "", "\ufeff", "\x85", "\u2028", "\0",
     "true", "0x1f", "---", "...", "%YAML", "@a", "`a", "'", '"', "\\", "{", "[", "a\n b", "\t"]
)  # fmt: skip
ANY_TEXT = WORDS | st.text(max_size=12)


@given(GOVERNANCES)
def test_a_governance_written_as_yaml_is_read_as_equal_values(value):
    assert read_governance(governance_to_yaml(value)) == value


@settings(max_examples=examples(300))
@given(permissions(ANY_TEXT))
def test_permissions_written_as_yaml_are_read_as_equal_values(value):
    assert read_permissions(permissions_to_yaml(value)) == value


@pytest.mark.parametrize("character", ["\ud800", "a\udfff"])
def test_text_that_no_file_can_hold_is_refused(character):
    [grant] = read_permissions("grants: [{name: a, publish: x}]").grants
    value = Permissions(grants=(replace(grant, name=character),))
    with pytest.raises(UsageError, match="cannot be written to a file"):
        permissions_to_yaml(value)


@pytest.mark.parametrize("read", READERS)
@given(data=st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_any_bytes_are_read_or_refused(read, data):
    with contextlib.suppress(InvalidDocumentError):
        read(data)


PUT = [
    b"*",
    b"&a ",
    b"!!int ",
    b"\t",
    b"\n",
    b"---\n",
    b"- ",
    b": ",
    b"{",
    b"[" * 50,
    b"'",
    b"<<: ",
]
EDITS = st.tuples(
    st.integers(0, 2000), st.integers(0, 30), st.binary(max_size=8) | st.sampled_from(PUT)
)


@pytest.mark.parametrize("read", READERS)
@settings(max_examples=examples(300))
@given(document=st.sampled_from(DOCUMENTS), edits=st.lists(EDITS, min_size=1, max_size=3))
def test_a_damaged_document_is_read_or_refused(read, document, edits):
    for place, length, put in edits:
        document = document[:place] + put + document[place + length :]
    with contextlib.suppress(InvalidDocumentError):
        read(document)


KEYS = ["grants", "name", "publish", "nodes", "node", "rules", "allow", "domains", "topics",
        "validity", "preset", "data_tags", "namespace", "min", "not_after", "x"]  # fmt: skip
TREES = st.recursive(
    st.sampled_from(
        ["/a", "a", "0", "1y", "true", "~/x", "999999y", "strict", "2030-01-01T00:00:00Z"]
    )
    | ANY_TEXT
    | st.integers(),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(KEYS), inner, max_size=4)
    ),
    max_leaves=12,
)


@pytest.mark.parametrize("read", READERS)
@settings(max_examples=examples(500))
@given(tree=TREES)
def test_any_structure_is_read_or_refused(read, tree):
    from pqsec_pki.documents._yaml import dump  # noqa: PLC0415 - the room's own, for any tree

    with contextlib.suppress(InvalidDocumentError):
        read(dump(tree))
