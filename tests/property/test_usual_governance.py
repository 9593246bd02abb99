"""The governance that pqsec writes by default is read without an XML parser, to the same value."""

import subprocess
import sys
from dataclasses import astuple, replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pqsec_pki.documents import DomainSet, Governance, ProtectionKind
from pqsec_pki.documents.governance import _rules_in_elements, _usual_rules
from pqsec_pki.errors import InvalidDocumentError

USUAL = Governance.protected(DomainSet.of(0, 7)).to_xml()


@given(domains=st.lists(st.integers(0, 2**31 - 1), min_size=1, max_size=5), crlf=st.booleans())
def test_both_ways_to_read_find_the_same(domains, crlf):
    xml = Governance.protected(DomainSet(parts=tuple(domains))).to_xml()
    xml = xml.replace(b"\n", b"\r\n") if crlf else xml
    found = Governance.from_xml(xml).domain_rules  # astuple has the lines, too
    assert list(map(astuple, found)) == list(map(astuple, _rules_in_elements(xml)[0]))
    assert bool(_usual_rules(xml)) is (max(domains) < 10**9)


@given(data=st.data())
def test_a_document_with_any_other_octet_is_read_by_the_parser(data):
    place = data.draw(st.integers(0, len(USUAL) - 1))
    octet = data.draw(st.integers(0, 255).filter(lambda each: each != USUAL[place]))
    xml = USUAL[:place] + bytes([octet]) + USUAL[place + 1 :]
    usual = _usual_rules(xml)
    try:
        found, _ = _rules_in_elements(xml)
    except InvalidDocumentError:
        assert not usual
    else:
        assert not usual or list(map(astuple, usual)) == list(map(astuple, found))


@pytest.mark.parametrize(
    "xml",
    [
        USUAL.replace(b"<id>7</id>", b"<id>07</id>"),
        USUAL.replace(b"<id>7</id>", b"<id>+7</id>"),
        USUAL.replace(b"<id>7</id>\n", b""),
        USUAL.replace(b"<domain_access_rules>", b"<!-- --><domain_access_rules>"),
        USUAL + b"\n",
        USUAL.replace(b">*<", b">rt/*<"),
        USUAL.replace(b">SIGN<", b">NONE<"),
        b"",
        b"<domains>\n",
        b"<domains>\n<id>1</id>\n</domains>",
    ],
)
def test_nothing_else_is_taken_for_it(xml):
    other = Governance.protected(DomainSet.of(0)).to_xml() == xml
    assert bool(_usual_rules(xml)) is other


def test_another_governance_is_read_as_before():
    [rule] = Governance.protected(DomainSet.of(3)).domain_rules
    open_to_all = Governance(
        domain_rules=(replace(rule, rtps_protection_kind=ProtectionKind.NONE),)
    )
    assert Governance.from_xml(open_to_all.to_xml()) == open_to_all


def test_the_usual_governance_needs_no_lxml():
    """The first participant of a domain waited for it."""
    code = (
        "import sys; from pqsec_pki.documents import Governance\n"
        "Governance.from_xml(sys.stdin.buffer.read()); print('lxml' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], input=USUAL, capture_output=True, check=True
    )
    assert done.stdout == b"False\n"
