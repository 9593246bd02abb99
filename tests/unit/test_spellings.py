"""Values that a document may spell in several ways, as each stack reads them.

tests/fuzz/policies.py asks the stacks themselves.
"""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.access import (
    CYCLONEDDS,
    CYCLONEDDS_11,
    FASTDDS,
    INTERPRETATIONS,
    OPENDDS,
    SPEC,
    Action,
    Question,
    decide,
)
from pqsec_pki.access._index import Names
from pqsec_pki.documents import DomainRange, DomainSet, Governance, Permissions
from pqsec_pki.errors import InvalidDocumentError

NOW = datetime(2026, 6, 1, 12, tzinfo=UTC)
GOVERNANCE = Governance.protected(DomainSet.of(DomainRange(first=0, last=230)))
BEGIN, END = "2026-06-01T11:00:00Z", "2026-06-01T13:00:00Z"
CYCLONES = {CYCLONEDDS, CYCLONEDDS_11}
EVERY = set(INTERPRETATIONS)


def permissions(subject="CN=/a", begin=BEGIN, end=END, domain="<id>7</id>", topic="t"):
    """One rule that allows to publish, from a text with these values."""
    xml = f"""<dds><permissions><grant name="g"><subject_name>{subject}</subject_name><validity>
<not_before>{begin}</not_before><not_after>{end}</not_after></validity><allow_rule><domains>
{domain}</domains><publish><topics><topic>{topic}</topic></topics></publish></allow_rule>
<default>DENY</default></grant></permissions></dds>"""
    return Permissions.from_xml(xml.encode())


def allowing(document, governance=GOVERNANCE, domain=7, topic="t"):
    """The interpretations that let the subject publish."""
    asked = {"subject": "CN=/a", "domain": domain, "topic": topic, "now": NOW}
    question = Question(action=Action.PUBLISH, **asked)
    governance = with_an_open_topic(governance)
    return {each for each in EVERY if decide(governance, document, question, each).allowed}


def with_an_open_topic(governance):
    """With a topic that is open, without which OpenDDS creates no participant."""
    [rule] = governance.domain_rules
    [topic] = rule.topic_rules
    open_to_all = replace(topic, topic_expression="open", enable_read_access_control=False)
    return Governance(domain_rules=(replace(rule, topic_rules=(open_to_all, topic)),))


def test_a_usual_document_means_the_same_to_all():
    assert allowing(permissions()) == EVERY


@pytest.mark.parametrize("topic", [" t", "t\n", "\n  t\t", "&#32;t"])
def test_cyclone_dds_removes_white_space_around_a_topic(topic):
    assert allowing(permissions(topic=topic)) == CYCLONES


@pytest.mark.parametrize("topic", [" t", "t\n", "\tt "])
def test_a_topic_with_white_space_in_its_own_name_is_not_covered_for_cyclone_dds(topic):
    """Found by the differential run: equal texts were taken as covered before a stack was asked."""
    found = allowing(permissions(topic=topic), topic=topic)
    assert found == EVERY - CYCLONES
    names = Names([topic, "t", "tt"])
    assert names.covered_by([topic], CYCLONEDDS.covers) == {"t"}
    assert names.covered_by([topic]) == {topic}


@pytest.mark.parametrize("topic", [" ", "\n", "&#9;"])
def test_a_topic_of_white_space_alone_is_empty_and_no_stack_allows_it(topic):
    assert not allowing(permissions(topic=topic)) & {*CYCLONES, FASTDDS}


@pytest.mark.parametrize("subject", ["CN=/a\n", "\n CN=/a", "\tCN=/a"])
def test_fast_dds_finds_no_subject_with_a_line_end_around_it(subject):
    document = permissions(subject)
    assert allowing(document) == EVERY - {FASTDDS}
    assert document.grants[0].subject_name == "CN=/a"


def test_fast_dds_finds_a_subject_with_spaces_around_it():
    assert allowing(permissions(" CN=/a  ")) == EVERY


def test_fast_dds_ignores_the_zone_of_a_time():
    east = {"begin": "2026-06-01T13:00:00+02:00", "end": "2026-06-01T15:00:00+02:00"}
    assert allowing(permissions(**east)) == EVERY - {FASTDDS}
    west = {"begin": "2026-06-01T11:00:00-09:00", "end": "2026-06-01T13:00:00-09:00"}
    assert allowing(permissions(**west)) == {FASTDDS}


@pytest.mark.parametrize(
    ("zone", "reading"),
    [("+12:00", EVERY), ("+12:30", EVERY - CYCLONES), ("-14:00", EVERY - CYCLONES)],
)
def test_cyclone_dds_reads_a_time_in_a_zone_beyond_12_hours_as_past(zone, reading):
    assert allowing(permissions(end=f"2026-06-03T12:00:00{zone}")) == reading


@pytest.mark.parametrize("number", ["010", "08", "+010", "00231", "0000000007777"])
def test_a_number_that_is_octal_for_cyclone_dds_is_refused_with_its_line(number):
    with pytest.raises(InvalidDocumentError, match=r"readers differ: .* is octal") as caught:
        permissions(domain=f"<id>{number}</id>")
    assert caught.value.problems[0].line == 3


@pytest.mark.parametrize("number", ["07", "7", "+7", "0007", " 7\n"])
def test_a_number_that_is_the_same_in_octal_is_read(number):
    assert allowing(permissions(domain=f"<id>{number}</id>")) == EVERY


def test_cyclone_dds_refuses_governance_with_a_range_without_start():
    [rule] = GOVERNANCE.domain_rules
    domains = DomainSet(parts=(DomainRange(first=0, last=230, no_min=True),))
    governance = Governance(domain_rules=(replace(rule, domains=domains),))
    assert allowing(permissions(), governance) == {SPEC, FASTDDS, OPENDDS}


@pytest.mark.parametrize("subject", ["", " \n"])
def test_cyclone_and_fast_dds_refuse_permissions_of_which_a_grant_has_no_subject(subject):
    grants = *permissions().grants, *permissions(subject).grants
    assert allowing(Permissions(grants=grants)) == EVERY - CYCLONES - {FASTDDS}


def test_a_grant_that_was_changed_is_no_longer_spelled_as_in_its_document():
    [grant] = permissions("\nCN=/a", end="2026-06-01T15:00:00+02:00").grants
    assert grant.written.subject_name == "\nCN=/a"
    assert grant.written.not_after.utcoffset() == timedelta(hours=2)
    assert replace(grant, subject_name="CN=/b").written.subject_name == "CN=/b"
    assert replace(grant, not_after=NOW).written.not_after == NOW
