"""Real documents: our schemas agree with the OMG's, and no value is lost."""

import json
import re
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lxml import etree

from pqsec_pki.credentials import TrustAnchors, only_certificate
from pqsec_pki.documents import Governance, Kind, Permissions, validate
from pqsec_pki.errors import InvalidDocumentError, VerificationError
from tests.longer import examples

CORPUS = Path(__file__).parent / "corpus"
ENTRIES = json.loads((CORPUS / "MANIFEST.json").read_text())
CRASHING = "governance_blank_topic_expression"
VALUES = {Kind.GOVERNANCE: Governance, Kind.PERMISSIONS: Permissions}


def xml_in(file):
    """The document in `file`: the first part of an S/MIME message, or all of it."""
    data = (CORPUS / file).read_bytes()
    if not (boundary := re.search(rb'boundary="?([^"\r\n;]+)', data)):
        return data
    part = data.split(b"--" + boundary[1])[1]
    return part[part.index(b"<") :].rstrip(b"\r\n")  # its headers may end in \r\r\n


@cache
def normative(kind):
    return etree.XMLSchema(etree.parse(CORPUS / "normative_xsd" / f"omg_1.1_{kind}.xsd"))


def is_valid(document):
    try:
        validate(document)
    except InvalidDocumentError:
        return False
    return True


def of(*, valid):
    return [pytest.param(e, id=e["file"]) for e in ENTRIES if e["xsd_valid"] is valid]


def written():
    """The valid ones, but those that crash stacks: pqsec reads these, and does not write them."""
    return [each for each in of(valid=True) if CRASHING not in each.id]


def test_every_document_in_the_corpus_is_listed():
    documents = {
        str(file.relative_to(CORPUS))
        for file in CORPUS.rglob("*")
        if file.suffix in {".p7s", ".smime"} or file.name in {"governance.xml", "permissions.xml"}
    }
    assert len(ENTRIES) == 156
    assert documents <= {entry["file"] for entry in ENTRIES}


@pytest.mark.parametrize("entry", of(valid=True))
def test_a_document_the_omg_schema_takes_is_valid_and_known_for_what_it_is(entry):
    document = xml_in(entry["file"])
    assert normative(entry["kind"]).validate(etree.fromstring(document))
    assert validate(document) == entry["kind"]


@pytest.mark.parametrize("entry", of(valid=False))
def test_a_document_the_omg_schema_refuses_is_refused_with_line_element_and_rule(entry):
    document = xml_in(entry["file"])
    assert not normative(entry["kind"]).validate(etree.fromstring(document))
    with pytest.raises(InvalidDocumentError) as refusal:
        validate(document)
    for problem in refusal.value.problems:
        assert 0 < problem.line <= document.count(b"\n") + 1
        assert f"<{problem.element}".encode() in document
        assert problem.message


@pytest.mark.parametrize("entry", written())
def test_a_valid_document_is_read_and_written_and_read_as_equal_values(entry):
    values = VALUES[entry["kind"]]
    value = values.from_xml(xml_in(entry["file"]))
    assert values.from_xml(value.to_xml()) == value
    assert normative(entry["kind"]).validate(etree.fromstring(value.to_xml()))


@pytest.mark.parametrize("entry", [each for each in of(valid=True) if CRASHING in each.id])
def test_a_document_that_crashes_stacks_is_read_and_not_written(entry):
    value = Governance.from_xml(xml_in(entry["file"]))
    with pytest.raises(InvalidDocumentError, match="crashes Cyclone DDS"):
        value.to_xml()


NOT_BY_A_CA_HERE = (
    "_not_signed.p7s",
    "_unknown_ca.p7s",
    "_signed_by_chained_ca.smime",
    "_signed_by_expired_ca.smime",
    "_malicious.smime",
    "test_router/governance.smime",
    "test_router/permissions.smime",
)
"""Wrong on purpose, or by CAs whose certificates are not in the corpus."""


def test_what_cas_of_other_projects_signed_is_verified():
    """With each of the CAs named, as `pqsec verify --ca` does."""
    cas = [only_certificate(path.read_bytes(), str(path)) for path in CORPUS.rglob("*.pem")]
    named = [TrustAnchors(identity_cas=(), permissions_ca=each) for each in cas]
    refused = [
        entry["file"]
        for entry in ENTRIES
        if entry["signed"] and not signed_by_one((CORPUS / entry["file"]).read_bytes(), named)
    ]
    assert named
    assert [file for file in refused if not file.endswith(NOT_BY_A_CA_HERE)] == []
    assert len(refused) == 11


def signed_by_one(message, named):
    return any(holds(message, anchors) for anchors in named)


def holds(message, anchors):
    try:
        anchors.verified(message, datetime(2026, 11, 21, tzinfo=UTC))
    except VerificationError:
        return False
    return True


# Mutants: documents one or a few steps away from valid ones.

SEEDS = sorted({xml_in(entry["file"]) for entry in ENTRIES if entry["xsd_valid"]}, key=len)
NAMES = sorted({"other"} | {e.tag for seed in SEEDS for e in etree.fromstring(seed).iter("*")})
TEXTS = (
    "", " ", "x", "0", "-0", "-1", "+7", " 7 ", "007", "1.5", "231", "9" * 40, "\u0661",
    "true", "false", " true ", "1", "TRUE", "yes",
    "NONE", "SIGN", "ENCRYPT", "encrypt", " ENCRYPT ", "ENCRYPT_WITH_ORIGIN_AUTHENTICATION",
    "ALLOW", "DENY", "deny", "DENY\n",
    "2030-01-01T00:00:00", "2030-01-01T00:00:00Z", " 2030-01-01T00:00:00.125+14:00\n",
    "2030-01-01", "2030-02-30T00:00:00", "2030-01-01T24:00:00", "-0001-01-01T00:00:00",
    "0000-01-01T00:00:00", "12030-01-01T00:00:00", "2030-01-01T00:00:00+15:00",
)  # fmt: skip


def deleted(element, _name, _text):
    element.getparent().remove(element)


def doubled(element, _name, _text):
    element.addnext(etree.fromstring(etree.tostring(element, with_tail=False)))


def swapped(element, _name, _text):
    if (following := element.getnext()) is not None:
        following.addnext(element)


def moved_to_the_end(element, _name, _text):
    element.getparent().append(element)


def renamed(element, name, _text):
    element.tag = name


def joined_by_another(element, name, _text):
    element.addprevious(etree.Element(name))


def rewritten(element, _name, text):
    element.text = text


def followed_by_text(element, _name, text):
    element.tail = text


def given_an_attribute(element, name, text):
    element.set(name, text)


def stripped_of_attributes(element, _name, _text):
    element.attrib.clear()


def moved_into_a_namespace(element, _name, _text):
    element.tag = f"{{urn:other}}{etree.QName(element).localname}"


CHANGES = (
    deleted, doubled, swapped, moved_to_the_end, renamed, joined_by_another, rewritten,
    followed_by_text, given_an_attribute, stripped_of_attributes, moved_into_a_namespace,
)  # fmt: skip


def mutant(seed, *changes):
    root = etree.fromstring(seed, etree.XMLParser(remove_comments=True))
    for change, place, name, text in changes:
        inner = list(root.iter("*"))[1:]
        if inner:
            change(inner[place % len(inner)], name, text)
    return etree.tostring(root)


def normative_verdict(document):
    root = etree.fromstring(document)
    return any(normative(kind).validate(root) for kind in Kind)


def richest(kind):
    """The valid document with the most kinds of elements, the shortest of them."""
    documents = [xml_in(e["file"]) for e in ENTRIES if e["xsd_valid"] and e["kind"] == kind]
    return max(documents, key=lambda d: (len({e.tag for e in etree.fromstring(d).iter()}), -len(d)))


@pytest.mark.parametrize("kind", Kind)
@pytest.mark.parametrize("change", CHANGES)
def test_any_single_change_to_a_document_gets_the_verdict_of_the_omg_schema(kind, change):
    seed = richest(kind)
    size = len(list(etree.fromstring(seed).iter("*"))) - 1
    names = NAMES if change in {renamed, joined_by_another} else NAMES[:1]
    texts = TEXTS if change in {rewritten, followed_by_text} else TEXTS[:1]
    verdicts = [
        (is_valid(document), normative_verdict(document))
        for place in range(size)
        for name in names
        for text in texts
        for document in [mutant(seed, (change, place, name, text))]
    ]
    assert [ours for ours, _ in verdicts] == [theirs for _, theirs in verdicts]
    nothing_to_strip = change is stripped_of_attributes and kind is Kind.GOVERNANCE
    assert (False, False) in verdicts or nothing_to_strip


STEPS = st.tuples(
    st.sampled_from(CHANGES), st.integers(0, 400), st.sampled_from(NAMES), st.sampled_from(TEXTS)
)


@settings(max_examples=examples(400))
@given(seed=st.sampled_from(SEEDS), steps=st.lists(STEPS, min_size=1, max_size=4))
def test_several_changes_to_a_document_get_the_verdict_of_the_omg_schema(seed, steps):
    document = mutant(seed, *steps)
    assert is_valid(document) == normative_verdict(document)
