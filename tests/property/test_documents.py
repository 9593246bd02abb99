"""Documents: what is written is read back, and no input breaks out of the room."""

import contextlib
from datetime import UTC, datetime

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pqsec_pki.access import may_join
from pqsec_pki.documents import (
    Criteria,
    DefaultAction,
    DomainRange,
    DomainRule,
    DomainSet,
    Governance,
    Grant,
    Kind,
    PermissionRule,
    Permissions,
    ProtectionKind,
    TopicRule,
    parse_subject,
    ros,
    validate,
)
from pqsec_pki.errors import PqsecError, UsageError
from tests.longer import examples

TEXT = st.text(
    st.characters(exclude_categories=["Cs", "Cc"], exclude_characters="\ufffe\uffff")
    | st.sampled_from("\t\n\r<>&'\"]"),
    max_size=12,
)
TOPIC = TEXT.filter(lambda text: text.strip(" \t\r\n"))
"""An empty one crashes stacks, and is not written."""
ID = st.integers(0, 2**31 - 1)
DOMAINS = st.builds(
    DomainSet,
    parts=st.lists(
        ID | st.builds(DomainRange, first=ID, last=st.none() | ID), min_size=1, max_size=3
    ).map(tuple),
)
TIMES = st.datetimes(datetime(1, 1, 2), datetime(2261, 12, 30), timezones=st.timezones())  # noqa: DTZ001 - the bounds hypothesis wants
CRITERIA = st.builds(
    Criteria,
    topics=st.lists(TOPIC, min_size=1, max_size=3).map(tuple),
    partitions=st.lists(TEXT, max_size=2).map(tuple),
    data_tags=st.lists(st.tuples(TEXT, TEXT), max_size=2).map(tuple),
)
ALL_CRITERIA = st.lists(CRITERIA, max_size=2).map(tuple)
RULES = st.builds(
    PermissionRule,
    allow=st.booleans(),
    domains=DOMAINS,
    publish=ALL_CRITERIA,
    subscribe=ALL_CRITERIA,
    relay=ALL_CRITERIA,
)


def grants(text):
    return st.builds(
        Grant,
        name=text,
        subject_name=text,
        not_before=TIMES,
        not_after=TIMES,
        rules=st.lists(RULES, max_size=3).map(tuple),
        default=st.sampled_from(DefaultAction),
    )


def permissions(text=TEXT):
    return st.builds(Permissions, grants=st.lists(grants(text), min_size=1, max_size=2).map(tuple))


PROTECTION = st.sampled_from(ProtectionKind)
TOPIC_RULES = st.builds(
    TopicRule,
    topic_expression=TOPIC,
    enable_discovery_protection=st.booleans(),
    enable_liveliness_protection=st.booleans(),
    enable_read_access_control=st.booleans(),
    enable_write_access_control=st.booleans(),
    metadata_protection_kind=PROTECTION,
    data_protection_kind=st.sampled_from(list(ProtectionKind)[:3]),
)
DOMAIN_RULES = st.builds(
    DomainRule,
    domains=DOMAINS,
    allow_unauthenticated_participants=st.booleans(),
    enable_join_access_control=st.booleans(),
    discovery_protection_kind=PROTECTION,
    liveliness_protection_kind=PROTECTION,
    rtps_protection_kind=PROTECTION,
    topic_rules=st.lists(TOPIC_RULES, min_size=1, max_size=3).map(tuple),
)
GOVERNANCES = st.builds(
    Governance, domain_rules=st.lists(DOMAIN_RULES, min_size=1, max_size=3).map(tuple)
)

DOCUMENTS = (
    Permissions(
        grants=(
            Grant.least(
                subject_name="CN=/a",
                not_before=datetime(2026, 1, 1, tzinfo=UTC),
                not_after=datetime(2027, 1, 1, tzinfo=UTC),
                domains=DomainSet.of(0, DomainRange(first=1, last=9)),
                publish=["rt/a"],
                subscribe=["rt/b"],
            ),
        )
    ).to_xml(),
    Governance.protected(DomainSet.of(0, DomainRange(first=1, last=9))).to_xml(),
)
READERS = [validate, Permissions.from_xml, Governance.from_xml]


@given(permissions())
def test_written_permissions_are_read_as_equal_values(value):
    document = value.to_xml()
    assert validate(document) is Kind.PERMISSIONS
    assert Permissions.from_xml(document) == value


@given(GOVERNANCES)
def test_a_written_governance_is_read_as_equal_values(value):
    document = value.to_xml()
    assert validate(document) is Kind.GOVERNANCE
    assert Governance.from_xml(document) == value


@given(permissions(st.text(max_size=12)))
def test_values_with_any_text_are_written_or_refused(value):
    with contextlib.suppress(UsageError):
        assert Permissions.from_xml(value.to_xml()) == value


@pytest.mark.parametrize("read", READERS)
@given(
    data=st.binary(max_size=200) | st.text(max_size=200).map(lambda t: t.encode("utf-8", "replace"))
)
def test_any_bytes_are_read_or_refused(read, data):
    with contextlib.suppress(PqsecError):
        read(data)


@pytest.mark.parametrize("read", READERS)
@settings(max_examples=examples(300))
@given(
    document=st.sampled_from(DOCUMENTS),
    edits=st.lists(
        st.tuples(
            st.integers(0, 2500),
            st.integers(0, 30),
            st.binary(max_size=8)
            | st.sampled_from(
                [b"<!--", b"-->", b"<![CDATA[", b"&", b"&#0;", b"</dds>", b"<?", b'"', b"9" * 5000]
            ),
        ),
        min_size=1,
        max_size=3,
    ),
)
def test_a_damaged_document_is_read_or_refused(read, document, edits):
    for place, length, put in edits:
        document = document[:place] + put + document[place + length :]
    with contextlib.suppress(PqsecError):
        read(document)


NUMBERS = st.from_regex(r"[+-]?[0-9]{1,40}", fullmatch=True)
INSTANTS = st.from_regex(
    r"-?[0-9]{4,6}-[0-1][0-9]-[0-3][0-9]T[0-2][0-9]:[0-6][0-9]:[0-6][0-9](\.[0-9]{1,9})?"
    r"(Z|[+-][0-1][0-9]:[0-5][0-9])?",
    fullmatch=True,
)


@settings(max_examples=examples(500))
@given(number=NUMBERS, before=INSTANTS, after=INSTANTS)
def test_any_number_and_time_is_read_or_refused(number, before, after):
    document = DOCUMENTS[0].replace(b"<id>0<", f"<id>{number}<".encode())
    document = document.replace(b"2026-01-01T00:00:00Z", before.encode())
    document = document.replace(b"2027-01-01T00:00:00Z", after.encode())
    with contextlib.suppress(PqsecError):
        Permissions.from_xml(document)


@given(st.text(max_size=60) | st.text('CNO=,/+\\" #x0', max_size=60))
def test_any_text_is_a_subject_or_refused(text):
    with contextlib.suppress(PqsecError):
        assert parse_subject(text)


@given(GOVERNANCES, permissions(), st.text(max_size=20), ID, TIMES)
def test_any_question_is_answered_or_refused(governance, value, subject, domain, now):
    with contextlib.suppress(PqsecError):
        assert may_join(governance, value, subject, domain, now).reason


@given(st.text(max_size=40) | st.text("/_a0~{}", max_size=40))
def test_any_ros_name_has_a_dds_form_or_is_refused(name):
    with contextlib.suppress(UsageError):
        assert ros.topic(name).removeprefix("rt") == name
