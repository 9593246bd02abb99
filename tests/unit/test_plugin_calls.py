"""Shim and agent mean the same: one table, and the octets of each kind of value."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pqsec_pki.errors import MalformedError
from pqsec_pki.handshake import DataHolder
from pqsec_pki.handshake.wire import MAX_TOKEN
from pqsec_pki.plugin.access_control import AccessControl
from pqsec_pki.plugin.authentication import Authentication
from pqsec_pki.plugin.building import SOURCES
from pqsec_pki.plugin.calls import CALLS, VERSION
from pqsec_pki.plugin.connection import Control
from pqsec_pki.plugin.octets import MAX_FRAME, MAX_ITEMS, MessageReader, MessageWriter

SHIM = {plugin: (SOURCES / f"{plugin}.c").read_text() for plugin in CALLS if plugin != "control"}
ASK = re.compile(r'ask\(&self->link, \w+, "(\w+)",\s*"([^"]*)"')
PAIRS = st.lists(st.tuples(st.text(), st.text()), max_size=3).map(tuple)
VALUES = {
    "h": st.integers(0, (1 << 64) - 1),
    "n": st.integers(-(1 << 31), (1 << 31) - 1),
    "b": st.integers(0, 255),
    "m": st.integers(0, (1 << 32) - 1),
    "x": st.integers(-(1 << 63), (1 << 63) - 1),
    "s": st.binary().map(lambda octets: octets.decode("utf-8", "surrogateescape")),
    "o": st.binary(),
    "g": st.binary(min_size=16, max_size=16),
    "c": st.binary(min_size=32, max_size=32),
    "t": st.builds(
        DataHolder,
        st.text(),
        PAIRS,
        st.lists(st.tuples(st.text(), st.binary()), max_size=3).map(tuple),
    ),
    "p": st.lists(st.text(), max_size=3).map(tuple),
    "d": PAIRS,
    "q": PAIRS,
}


@pytest.mark.parametrize("plugin", SHIM)
def test_the_shim_asks_for_each_call_once_and_with_these_kinds(plugin):
    asked = ASK.findall(SHIM[plugin])
    assert len(asked) == len(dict(asked)) == SHIM[plugin].count("ask(")
    table = {name: f"{call.takes}>{call.gives}" for name, call in CALLS[plugin].items()}
    table.pop("check_guid_comes_from", None)  # Fast DDS asks, and Cyclone DDS does not
    assert dict(asked) == table


@pytest.mark.parametrize(
    ("plugin", "kind"),
    [("authentication", Authentication), ("access_control", AccessControl), ("control", Control)],
)
def test_the_agent_answers_every_call(plugin, kind):
    assert [name for name in CALLS[plugin] if not callable(getattr(kind, name, None))] == []


def test_both_have_one_version_and_the_same_limits():
    link, wire = ((SOURCES / name).read_text() for name in ("link.c", "wire.h"))
    assert f"VERSION = {VERSION}," in link
    assert f"MAX_FRAME = 1 << {MAX_FRAME.bit_length() - 1}, MAX_ITEMS = {MAX_ITEMS} " in wire


@pytest.mark.parametrize("kind", VALUES)
@given(data=st.data())
def test_a_value_comes_out_as_it_went_in(kind, data):
    value = data.draw(VALUES[kind])
    writer = MessageWriter()
    writer.one(kind, value)
    reader = MessageReader(writer.octets)
    assert reader.one(kind) == value
    reader.finish()


@pytest.mark.parametrize("kind", VALUES)
@given(data=st.data())
def test_a_value_that_ends_early_or_late_is_refused(kind, data):
    writer = MessageWriter()
    writer.one(kind, data.draw(VALUES[kind]))
    octets = writer.octets
    for spoilt in (octets[:-1], octets + b"\0"):
        reader = MessageReader(spoilt)
        with pytest.raises(MalformedError):
            reader.one(kind), reader.finish()


def test_octets_that_are_no_text_come_out_as_they_went_in():
    writer, document = MessageWriter(), bytes(range(1, 256))
    writer.text(document.decode("utf-8", "surrogateescape"))
    assert MessageReader(writer.octets).text().encode("utf-8", "surrogateescape") == document


@pytest.mark.parametrize("extra", [0, 1])
def test_a_token_larger_than_the_network_may_carry_is_refused(extra):
    around = 4 * len(("class", "properties", "binary properties", "name", "value"))
    token = DataHolder("", (), (("", bytes(MAX_TOKEN - around + extra)),))
    writer = MessageWriter()
    writer.one("t", token)
    reader = MessageReader(writer.octets)
    if extra:
        with pytest.raises(MalformedError, match="a token larger than"):
            reader.one("t")
    else:
        assert reader.one("t") == token


def test_a_list_and_an_answer_have_limits():
    with pytest.raises(MalformedError, match="a list of more than"):
        MessageReader((MAX_ITEMS + 1).to_bytes(4, "little") + bytes(9999)).one("p")
    writer = MessageWriter()
    writer.block(bytes(MAX_FRAME))
    with pytest.raises(MalformedError, match="an answer of more than"):
        _ = writer.octets
