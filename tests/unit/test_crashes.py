"""Valid documents that end the process of a stack: signing refuses them, and questions say so.

`tests/interop/test_crashes.py` asks the stacks themselves.
"""

from dataclasses import replace
from datetime import UTC, datetime

import pytest

from pqsec_pki.access import (
    CYCLONEDDS,
    FASTDDS,
    INTERPRETATIONS,
    Action,
    Question,
    Verdict,
    decide,
    permissions_diff,
)
from pqsec_pki.documents import CRASH_SHAPES, DomainRange, Governance, Permissions
from pqsec_pki.errors import InvalidDocumentError
from tests.crashing import CRASHING, GOVERNANCE, PERMISSIONS, spoiled

NOW = datetime(2026, 11, 28, tzinfo=UTC)
PUBLISHING = {"action": Action.PUBLISH, "topic": "rt/chatter"}


@pytest.mark.parametrize("case", CRASHING)
def test_what_crashes_a_stack_is_not_written(case):
    """Whatever signs a document writes it with `to_xml`."""
    kind, line = CRASHING[case].kind, CRASHING[case].line
    with pytest.raises(InvalidDocumentError, match="crashes Cyclone DDS") as refused:
        kind.from_xml(CRASHING[case].xml).to_xml()
    [problem] = refused.value.problems
    assert problem.line == line


def test_the_same_documents_without_it_are_written():
    assert Permissions.from_xml(PERMISSIONS).to_xml()
    assert Governance.from_xml(GOVERNANCE).to_xml()


def test_an_empty_topic_to_relay_crashes_no_stack_that_was_run():
    empty = spoiled(PERMISSIONS, b"<relay><topics><topic>rt/r</topic>", b"rt/r", b"")
    assert Permissions.from_xml(empty).to_xml()


def test_governance_with_a_range_without_min_is_written_with_it():
    """Cyclone DDS refuses it, and does not crash."""
    xml = GOVERNANCE.replace(b"<min>0</min>", b"")
    governance = Governance.from_xml(xml)
    assert b"<min>0</min>" in governance.to_xml()
    [part] = governance.domain_rules[0].domains.parts
    assert part == replace(DomainRange(first=0, last=9), no_min=True)


def test_every_shape_names_versions_that_an_interpretation_is_for():
    for shape in CRASH_SHAPES:
        rows = [row.name for row in INTERPRETATIONS if shape.crashes(row.stack, row.version)]
        assert {"cyclonedds@0.10", "cyclonedds@11.0"} <= {*rows}
        assert not shape.crashes("cyclonedds", "1")
        assert not shape.crashes("opendds")


def ask(kind, xml, interpretation, **asked):
    """The decision about publishing rt/chatter on domain 0 by the two documents."""
    documents = {Permissions: PERMISSIONS, Governance: GOVERNANCE} | {kind: xml}
    governance = Governance.from_xml(documents[Governance], any_markup=True)
    permissions = Permissions.from_xml(documents[Permissions], any_markup=True)
    question = Question(subject="CN=/lab/alice", domain=0, now=NOW, **(asked or PUBLISHING))
    return decide(governance, permissions, question, interpretation)


@pytest.mark.parametrize("case", CRASHING)
def test_a_stack_that_crashes_says_neither_yes_nor_no(case):
    found = CRASHING[case]
    for row in INTERPRETATIONS:
        for asked in (PUBLISHING, {"action": Action.JOIN}):
            decision = ask(found.kind, found.xml, row, **asked)
            crashes = row.name in found.stacks.split()
            assert (decision.verdict is Verdict.CRASHES) is crashes, row.name
            if crashes:
                assert not decision.allowed
                assert decision.yes_or_no is None
                assert row.title in decision.reason
                assert (decision.criteria or decision.decided_by).line == found.line


def test_a_grant_for_somebody_else_crashes_nothing():
    grant = PERMISSIONS[PERMISSIONS.index(b"<grant") : PERMISSIONS.index(b"</permissions>")]
    others = grant.replace(b"/lab/alice", b"/lab/bob").replace(b"<min>0</min>", b"")
    both = PERMISSIONS.replace(b"</permissions>", others + b"</permissions>")
    assert ask(Permissions, both, CYCLONEDDS).allowed


def test_cyclone_dds_refuses_governance_with_a_range_without_min():
    xml = GOVERNANCE.replace(b"<min>0</min>", b"")
    decision = ask(Governance, xml, CYCLONEDDS)
    assert decision.verdict is Verdict.NO
    assert "without <min>" in decision.reason
    assert ask(Governance, xml, FASTDDS).allowed


def test_fast_dds_refuses_permissions_with_an_empty_topic_and_does_not_crash():
    for old in (b"rt/chatter", b"rt/s", b"rt/r"):
        decision = ask(Permissions, PERMISSIONS.replace(old, b" "), FASTDDS)
        assert decision.verdict is Verdict.NO
        assert "refuses" in decision.reason


@pytest.mark.parametrize("markup", [b"<!-- x -->", b"<?y z?>", b"<![CDATA[x]]>"])
@pytest.mark.parametrize(
    ("kind", "xml", "place", "line"),
    [(Permissions, PERMISSIONS, b"rt/s<", 8), (Governance, GOVERNANCE, b"*<", 8)],
)
def test_readers_differ_is_the_answer_of_all_where_a_value_has_markup(
    kind, xml, place, line, markup
):
    xml = spoiled(xml, place, place[:-1] + markup + b"<")
    for row in INTERPRETATIONS:
        for asked in (PUBLISHING, {"action": Action.JOIN}):
            decision = ask(kind, xml, row, **asked)
            assert decision.verdict is Verdict.READERS_DIFFER
            assert (decision.allowed, decision.yes_or_no) == (False, None)
            assert decision.decided_by.line == line
    with pytest.raises(InvalidDocumentError, match="readers differ"):
        kind.from_xml(xml, any_markup=True).to_xml()
    with pytest.raises(InvalidDocumentError, match="readers differ"):
        kind.from_xml(xml)


def test_markup_does_not_excuse_other_flaws():
    xml = spoiled(PERMISSIONS, b"rt/s<", b"rt/s<!-- x --><").replace(b"DENY", b"MAYBE")
    with pytest.raises(InvalidDocumentError, match="MAYBE"):
        Permissions.from_xml(xml, any_markup=True)


@pytest.mark.parametrize("case", ["a range without min", "an empty topic"])
def test_a_change_says_that_the_document_now_crashes_a_stack(case):
    plain, crashing = map(Permissions.from_xml, (PERMISSIONS, CRASHING[case].xml))
    for documents, words in (((plain, crashing), "now"), ((crashing, plain), "no longer")):
        texts = [change.text for change in permissions_diff(*documents).changes]
        wanted = f"the document {words} crashes Cyclone DDS 0.10.2 and Cyclone DDS 11.0.1"
        assert any(wanted in text for text in texts), texts
