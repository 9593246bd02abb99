"""Permissions in the usual form are read without an XML parser, which finds the same in them."""

from dataclasses import astuple

import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from pqsec_pki.documents import DomainSet, Grant, Permissions
from pqsec_pki.documents._plain import GRANT_LINE
from pqsec_pki.documents.permissions import permissions_in_elements
from pqsec_pki.errors import InvalidDocumentError
from tests.longer import examples
from tests.property.plain_texts import SHORT
from tests.unit.keystores import DAY, NOW


def all_of(permissions):
    """With the lines, which two equal values may not share."""
    return [astuple(each) for each in permissions.grants]


def refusal(read, xml):
    """The problems for which the text is refused; None if it is read."""
    try:
        read(xml)
    except InvalidDocumentError as error:
        return error.lines
    return None


@settings(
    max_examples=examples(60),
    deadline=None,
    phases=[Phase.generate],
    suppress_health_check=[HealthCheck.too_slow],
)
@given(xml=st.from_regex(SHORT, fullmatch=True), crlf=st.booleans())
def test_both_ways_to_read_find_the_same(xml, crlf):
    xml = xml.replace(b"\n", b"\r\n") if crlf else xml
    if refused := refusal(permissions_in_elements, xml):  # a 31st of February
        assert refusal(Permissions.from_xml, xml) == refused
        return
    found = Permissions.from_xml(xml)
    assert found.is_plain
    assert all_of(found) == all_of(permissions_in_elements(xml))


TOPICS = [((), ()), (("a",), ()), ((), ("a", "b")), (("a", "b", "rt/c"), ("d",))]


@pytest.mark.parametrize(("publish", "subscribe"), TOPICS)
def test_what_pqsec_writes_is_read_so_with_its_lines(publish, subscribe):
    grant = Grant.least(
        subject_name="CN=/talker",
        domains=DomainSet.of(0, 7),
        not_before=NOW,
        not_after=NOW + DAY,
        publish=publish,
        subscribe=subscribe,
        name="/talker",
    )
    xml = Permissions(grants=(grant,)).to_xml()
    found = Permissions.from_xml(xml)
    assert found.is_plain is bool(publish or subscribe)  # else there is a deny_rule
    assert found.grants == (grant,)
    assert found.grants[0].line == GRANT_LINE
    assert all_of(found) == all_of(permissions_in_elements(xml))
