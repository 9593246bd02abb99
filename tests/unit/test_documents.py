"""Governance and permissions: what is written, what is read, what is refused."""

import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta, timezone
from itertools import permutations
from pathlib import Path

import pytest

from pqsec_pki.documents import (
    Criteria,
    DefaultAction,
    DomainRange,
    DomainSet,
    Governance,
    Grant,
    Kind,
    PermissionRule,
    Permissions,
    ProtectionKind,
    TopicRule,
    _schema,
    parse_subject,
    same_subject,
    validate,
    with_line_feeds,
)
from pqsec_pki.errors import InvalidDocumentError, MalformedError, UsageError

CORPUS = Path(__file__).parents[1] / "vectors" / "corpus"
START = datetime(2026, 1, 1, tzinfo=UTC)
END = datetime(2027, 1, 1, tzinfo=UTC)

HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?>\n'
    '<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation='
    '"http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_permissions.xsd">\n'
)
DENY_ALL = "<default>DENY</default>"


def least(**changes):
    settings = {
        "subject_name": "CN=/talker",
        "not_before": START,
        "not_after": END,
        "domains": DomainSet.of(0),
        "publish": ["rt/chatter"],
    }
    return Grant.least(**settings | changes)


def document(*, grants=None, before="2026-01-01T00:00:00Z", rules="", default=DENY_ALL, head=HEAD):
    grant = (
        f'<grant name="g">\n<subject_name>CN=x</subject_name>\n<validity>'
        f"<not_before>{before}</not_before><not_after>2027-01-01T00:00:00Z</not_after>"
        f"</validity>{rules}{default}</grant>"
    )
    return f"{head}<permissions>{grant if grants is None else grants}</permissions></dds>".encode()


def allowing(domains):
    return f"<allow_rule><domains>{domains}</domains></allow_rule>"


def read_domains(xml):
    [grant] = Permissions.from_xml(document(rules=allowing(xml))).grants
    return grant.rules[0].domains


def problems_of(xml, read=validate):
    with pytest.raises(InvalidDocumentError) as refusal:
        read(xml)
    return refusal.value.problems


# What is written


def test_permissions_are_written_in_the_one_form_every_stack_takes():
    grant = least(subscribe=["rt/a", "rt/b"], domains=DomainSet.of(0, DomainRange(first=5, last=9)))
    assert Permissions(grants=(grant,)).to_xml().decode() == HEAD + (
        "<permissions>\n"
        '<grant name="CN=/talker">\n'
        "<subject_name>CN=/talker</subject_name>\n"
        "<validity>\n"
        "<not_before>2026-01-01T00:00:00Z</not_before>\n"
        "<not_after>2027-01-01T00:00:00Z</not_after>\n"
        "</validity>\n"
        "<allow_rule>\n"
        "<domains>\n"
        "<id>0</id>\n"
        "<id_range>\n"
        "<min>5</min>\n"
        "<max>9</max>\n"
        "</id_range>\n"
        "</domains>\n"
        "<publish>\n"
        "<topics>\n"
        "<topic>rt/chatter</topic>\n"
        "</topics>\n"
        "</publish>\n"
        "<subscribe>\n"
        "<topics>\n"
        "<topic>rt/a</topic>\n"
        "<topic>rt/b</topic>\n"
        "</topics>\n"
        "</subscribe>\n"
        "</allow_rule>\n"
        "<default>DENY</default>\n"
        "</grant>\n"
        "</permissions>\n"
        "</dds>\n"
    )


def test_the_protected_governance_says_what_sros2_says():
    of_sros2 = CORPUS / "sros2/sros2/policy/defaults/dds/governance.xml"
    assert Governance.protected(DomainSet.of(0)) == Governance.from_xml(of_sros2.read_bytes())


def test_a_written_governance_is_read_as_it_was():
    governance = Governance.protected(DomainSet.of(0, DomainRange(first=3, last=230)))
    assert Governance.from_xml(governance.to_xml()) == governance
    assert validate(governance.to_xml()) is Kind.GOVERNANCE
    assert b"<enable_join_access_control>true</enable_join_access_control>" in governance.to_xml()


def test_all_parts_of_a_rule_are_written_and_read():
    criteria = Criteria(
        topics=("rt/*", "P?a"), partitions=("A", "B*"), data_tags=(("k", "v"), ("k", "w"))
    )
    rules = tuple(
        PermissionRule(
            allow=allow,
            domains=DomainSet(parts=(1, DomainRange(first=4))),
            publish=(criteria, Criteria(topics=("x",))),
            subscribe=(criteria,),
            relay=(criteria,),
        )
        for allow in (True, False)
    )
    grant = Grant(
        name="all of it",
        subject_name="CN=x",
        not_before=START,
        not_after=END,
        rules=rules,
        default=DefaultAction.ALLOW,
    )
    permissions = Permissions(grants=(grant, least()))
    assert Permissions.from_xml(permissions.to_xml()) == permissions


@pytest.mark.parametrize(
    "text", ["<a>&'\"]]>", "tab\there", "line\nline", "\r", "é\u00a0ü\u2028", "😀"]
)
def test_any_text_that_xml_can_carry_survives(text):
    permissions = Permissions(grants=(least(name=text, publish=[f"a{text}"]),))
    assert Permissions.from_xml(permissions.to_xml()) == permissions


@pytest.mark.parametrize("text", ["\0", "\x1b[2J", "\ud800", "\uffff"])
def test_text_that_xml_cannot_carry_is_not_written(text):
    with pytest.raises(UsageError, match="XML cannot carry"):
        Permissions(grants=(least(publish=[text]),)).to_xml()


def test_times_cyclone_would_take_as_expired_are_not_written():
    last = datetime(2261, 12, 31, 23, 59, 59, tzinfo=UTC)
    assert b">2261-12-31T23:59:59Z<" in Permissions(grants=(least(not_after=last),)).to_xml()
    with pytest.raises(UsageError, match="2262-01-01 00:00 UTC is too late"):
        Permissions(grants=(least(not_after=last + timedelta(seconds=1)),)).to_xml()


# Values


def test_a_grant_keeps_whole_seconds_in_utc():
    zone = timezone(timedelta(hours=-5))
    grant = least(not_before=datetime(2026, 1, 1, 20, 0, 0, 999_999, tzinfo=zone))
    assert grant.not_before == datetime(2026, 1, 2, 1, 0, 0, tzinfo=UTC)
    assert grant.not_before.tzinfo is UTC


def test_a_grant_refuses_times_without_a_zone_or_outside_the_calendar():
    with pytest.raises(UsageError, match="no time zone"):
        least(not_before=datetime(2026, 1, 1))  # noqa: DTZ001 - the flaw under test
    with pytest.raises(UsageError, match="outside the years"):
        least(not_before=datetime(1, 1, 1, tzinfo=timezone(timedelta(hours=1))))


def test_the_least_grant_names_each_topic_once_and_denies_the_rest():
    grant = least(publish=["rt/a", "rt/a"], subscribe=["rt/b"])
    expected = PermissionRule(
        allow=True,
        domains=DomainSet.of(0),
        publish=(Criteria(topics=("rt/a",)),),
        subscribe=(Criteria(topics=("rt/b",)),),
    )
    assert grant.rules == (expected,)
    assert grant.default is DefaultAction.DENY
    assert grant.name == grant.subject_name


def test_the_least_grant_without_topics_denies_all():
    [rule] = least(publish=[]).rules
    assert not rule.allow
    assert rule.publish == rule.subscribe == (Criteria(topics=("*",)),)


@pytest.mark.parametrize(
    "flaw", [{"subject_name": " "}, {"publish": [""]}, {"not_before": END}, {"not_after": START}]
)
def test_a_least_grant_that_could_never_serve_is_refused(flaw):
    with pytest.raises(UsageError):
        least(**flaw)


def test_white_space_around_a_subject_name_is_dropped():
    assert least(subject_name="\n  CN=/talker ").subject_name == "CN=/talker"


def test_documents_and_rules_without_content_cannot_be_made():
    [rule] = Governance.protected(DomainSet.of(0)).domain_rules
    for empty in (
        lambda: replace(rule, topic_rules=()),
        lambda: Permissions(grants=()),
        lambda: Governance(domain_rules=()),
        lambda: DomainSet(parts=()),
        lambda: Criteria(topics=()),
    ):
        with pytest.raises(UsageError):
            empty()


def test_payloads_have_no_origin_authentication():
    with pytest.raises(UsageError, match="data_protection_kind"):
        TopicRule(
            topic_expression="*",
            enable_discovery_protection=True,
            enable_liveliness_protection=True,
            enable_read_access_control=True,
            enable_write_access_control=True,
            metadata_protection_kind=ProtectionKind.ENCRYPT_WITH_ORIGIN_AUTHENTICATION,
            data_protection_kind=ProtectionKind.ENCRYPT_WITH_ORIGIN_AUTHENTICATION,
        )


# Domains


def test_a_domain_set_holds_its_ids_and_ranges_with_both_ends():
    domains = DomainSet.of(1, DomainRange(first=5, last=7))
    assert [d for d in range(10) if d in domains] == [1, 5, 6, 7]
    assert str(domains) == "1,5-7"


def test_a_domain_set_is_read_from_what_it_shows():
    domains = DomainSet.of(1, DomainRange(first=5, last=7))
    assert DomainSet.parse(str(domains)) == DomainSet.parse(" 1, 5-7 ") == domains


@pytest.mark.parametrize(
    "text", ["", "x", "1,", "-1", "5-", "1-2-3", "\u0661", "9" * 5000, "7-5", "231"]
)
def test_text_that_is_no_domain_set_is_refused(text):
    with pytest.raises(UsageError):
        DomainSet.parse(text)


def test_a_range_may_lack_either_end():
    assert 10**6 in read_domains("<id_range><min>3</min></id_range>")
    assert 2 not in read_domains("<id_range><min>3</min></id_range>")
    assert 0 in read_domains("<id_range><max>3</max></id_range>")
    assert 4 not in read_domains("<id_range><max>3</max></id_range>")


def test_domain_ids_are_read_as_the_schema_writes_numbers():
    assert read_domains("<id> +007\n</id><id>-0</id>").parts == (7, 0)


@pytest.mark.parametrize("number", [str(2**31), "9" * 5000])
def test_a_number_too_large_for_a_domain_id_is_refused(number):
    [problem] = problems_of(document(rules=allowing(f"<id>{number}</id>")), Permissions.from_xml)
    assert problem.element == "id"
    assert "not a domain id" in problem.message


@pytest.mark.parametrize(
    "part", [231, -1, 2**31, DomainRange(first=0), DomainRange(first=9, last=5)]
)
def test_domains_the_stacks_disagree_on_are_refused(part):
    with pytest.raises(UsageError):
        DomainSet.of(part)


# Times


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("2026-03-01T12:00:00", datetime(2026, 3, 1, 12, tzinfo=UTC)),
        ("2026-03-01T12:00:00Z", datetime(2026, 3, 1, 12, tzinfo=UTC)),
        (" 2026-03-01T12:00:00Z", datetime(2026, 3, 1, 12, tzinfo=UTC)),
        ("\n\t2026-03-01T12:00:00+05:30 ", datetime(2026, 3, 1, 6, 30, tzinfo=UTC)),
        ("2026-03-01T12:00:00Z \n", datetime(2026, 3, 1, 12, tzinfo=UTC)),
        ("2026-03-01T12:00:00+05:30", datetime(2026, 3, 1, 6, 30, tzinfo=UTC)),
        ("2026-03-01T12:00:00-14:00", datetime(2026, 3, 2, 2, tzinfo=UTC)),
        ("2026-03-01T12:00:00.999999999999Z", datetime(2026, 3, 1, 12, tzinfo=UTC)),
        ("0001-01-01T00:00:00Z", datetime(1, 1, 1, tzinfo=UTC)),
        ("9999-12-31T23:59:59Z", datetime(9999, 12, 31, 23, 59, 59, tzinfo=UTC)),
    ],
)
def test_times_are_read_with_and_without_zone_and_fraction(written, meant):
    [grant] = Permissions.from_xml(document(before=written)).grants
    assert grant.not_before == meant


@pytest.mark.parametrize(
    "written",
    [
        "-0001-01-01T00:00:00Z",
        "2026-01-01T24:00:00Z",
        "12026-01-01T00:00:00Z",
        "0001-01-01T00:00:00+01:00",
        "9999-12-31T23:59:59-01:00",
    ],
)
def test_times_the_schema_takes_and_no_calendar_does_are_refused_with_their_line(written):
    validate(document(before=written))
    [problem] = problems_of(document(before=written), Permissions.from_xml)
    assert (problem.line, problem.element) == (5, "not_before")
    assert problem.message.startswith(written)


# What is refused


def test_everything_wrong_is_listed_with_line_element_and_rule():
    xml = document(
        before="soon", rules=allowing("\n<id>x</id>\n<id_range/>"), default="<default>no</default>"
    )
    assert list(map(str, problems_of(xml))) == [
        "line 5: <not_before>: 'soon' is not a time such as 2030-01-31T00:00:00Z",
        "line 6: <id>: 'x' is not a domain id, 0 or more",
        "line 7: <id_range>: is not complete; expected next: max, min",
        "line 7: <default>: 'no' is not one of 'ALLOW', 'DENY'",
    ]


@pytest.mark.parametrize(
    ("xml", "expected"),
    [
        (document(default=""), "<grant>: is not complete; expected next: allow_rule, deny_rule"),
        (document(rules="<ufo/>"), "<ufo>: is not expected here; expected: allow_rule, deny_rule"),
        (document(default=DENY_ALL + "<ufo/>"), "<ufo>: is not expected here"),
        (document(grants="<grant/>"), "<grant>: lacks its attribute 'name'"),
        (document(grants='<grant name="" x="1"/>'), "<grant>: has no attribute 'x'"),
        (document(rules="stray"), "<grant>: holds elements only, no text"),
        (document(default="<default><b/></default>"), "<default>: holds text only, no elements"),
        (document(head="<dds xmlns='urn:x'>"), "<{urn:x}dds>: is not a <dds>"),
        (document(head="<other>").replace(b"/dds", b"/other"), "<other>: is not the root element"),
        (
            document(default="<default xsi:type='x'>DENY</default>"),
            "<default>: The QName value 'x'",
        ),
        (b"<dds/>", "<dds>: is not a <dds> with <domain_access_rules> or <permissions> in it"),
        (b"<html><body/></html>", "<html>: is not a <dds> with"),
    ],
)
def test_a_broken_rule_is_told_in_plain_words(xml, expected):
    assert expected in str(problems_of(xml)[0])


def test_a_flood_of_problems_is_cut_short():
    problems = problems_of(document(rules=allowing("<id>x</id>" * 5000)))
    assert len(problems) == 101
    assert problems[-1].message == "and 4900 more"


def test_threads_do_not_get_the_problems_of_one_another():
    xml = [document(default=f"<default>{n}</default>") for n in range(4)]
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(problems_of, xml * 200))
    assert [[p.message[:3] for p in problems] for problems in found] == [
        [f"'{n}'"] for n in range(4)
    ] * 200


def test_a_schema_is_compiled_by_one_thread_at_a_time(monkeypatch):
    # libxml2 fills its table of built-in types on first use, without a lock: of threads
    # that compiled their first schema at once, one in ten saw half of the table.
    locked = []

    compile_schema = _schema._schema.__wrapped__

    def compiled(kind):
        locked.append(_schema._ONE_AT_A_TIME.locked())
        return compile_schema(kind)

    monkeypatch.setattr(_schema, "_schema", compiled)
    Governance.protected(DomainSet.of(0)).to_xml()
    assert locked == [True]


def test_the_other_document_is_told_apart():
    permissions = Permissions(grants=(least(),)).to_xml()
    governance = Governance.protected(DomainSet.of(0)).to_xml()
    assert "a permissions document, not a" in str(problems_of(permissions, Governance.from_xml)[0])
    assert "a governance document, not a" in str(problems_of(governance, Permissions.from_xml)[0])


def test_control_characters_of_a_document_do_not_reach_a_terminal():
    [problem] = problems_of(document(default="<default>\u009b2J\u202e</default>"))
    assert problem.message == "'\\u009b2J\\u202e' is not one of 'ALLOW', 'DENY'"


@pytest.mark.parametrize(
    ("xml", "message"),
    [
        (b"", "line 1: not well-formed"),
        (b"<dds>", "line 1: not well-formed"),
        (HEAD.encode() + b"</x>", "line 3: not well-formed"),
        (b"<dds>\x00</dds>", "not well-formed"),
        (b"<dds>\xff</dds>", "not well-formed"),
        (b"<?xml version='1.0' encoding='klingon'?><dds/>", "not well-formed"),
        (b"<a>" * 300 + b"</a>" * 300, "depth"),
        (b" " * (8 << 20) + b"<dds/>", "larger than"),
        (b"<!DOCTYPE dds><dds/>", "DOCTYPE"),
        (b"<!DOCTYPE dds SYSTEM 'file:///etc/passwd'><dds/>", "DOCTYPE"),
    ],
)
def test_what_is_not_fit_to_be_read_is_refused(xml, message):
    with pytest.raises(InvalidDocumentError, match=message):
        validate(xml)


def test_entities_are_neither_fetched_nor_replaced(tmp_path):
    (tmp_path / "secret").write_text("the secret")
    declared = f"<!DOCTYPE dds [<!ENTITY e SYSTEM '{(tmp_path / 'secret').as_uri()}'>]>"
    with pytest.raises(InvalidDocumentError, match="DOCTYPE") as refusal:
        Permissions.from_xml(document(head=declared + "<dds>", default="&e;"))
    assert "the secret" not in str(refusal.value)


def test_a_document_of_entities_that_multiply_is_refused():
    steps = "".join(f"<!ENTITY e{n + 1} '{f'&e{n};' * 20}'>" for n in range(20))
    bomb = f"<!DOCTYPE dds [<!ENTITY e0 'x'>{steps}]><dds a='&e20;'>&e20;</dds>"
    with pytest.raises(InvalidDocumentError):
        validate(bomb.encode())


# How it may be encoded


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "iso-8859-1"])
def test_byte_order_marks_and_declared_encodings_are_understood(encoding):
    declared = encoding.removesuffix("-sig")
    head = HEAD.replace("UTF-8", declared)
    topic = "<publish><topics><topic>é</topic></topics></publish>"
    rules = allowing("<id>0</id>").replace("</allow", f"{topic}</allow")
    xml = document(head=head, rules=rules).decode().encode(encoding)
    [grant] = Permissions.from_xml(xml).grants
    assert grant.rules[0].publish[0].topics == ("é",)


MARKUP = {"a comment": "<!-- x -->", "a CDATA section": "<![CDATA[x]]>", "a processing": "<?y z?>"}
PARTS = (
    "<publish><partitions><partition>P</partition></partitions><topics><topic>T</topic></topics>"
    "<data_tags><tag><name>a</name><value>1</value></tag></data_tags></publish>"
)
EVERY_VALUE = {
    Permissions: document(
        rules=allowing("<id>0</id><id_range><min>3</min><max>4</max></id_range>").replace(
            "</allow", f"{PARTS}</allow"
        )
    ),
    Governance: Governance.protected(DomainSet.parse("0,2-3")).to_xml(),
}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "utf-7"])
@pytest.mark.parametrize("markup", MARKUP)
@pytest.mark.parametrize("kind", EVERY_VALUE, ids=lambda kind: kind.__name__)
def test_a_value_with_markup_in_it_is_refused_since_fast_dds_stops_reading_there(
    kind, markup, encoding
):
    text = EVERY_VALUE[kind].decode().replace("UTF-8", encoding)
    values = [*re.finditer("<([a-z_]+)>([^<>]+)</", text)]
    assert len(values) > 10
    for value in values:
        for place in (value.start(2), value.start(2) + 1, value.end(2)):
            spoiled = f"{text[:place]}{MARKUP[markup]}{text[place:]}".encode(encoding)
            with pytest.raises(InvalidDocumentError) as refused:
                kind.from_xml(spoiled)
            [problem] = refused.value.problems
            assert problem.message.startswith(f"readers differ: {markup}")
            assert (problem.element, problem.line) == (value[1], text.count("\n", 0, place) + 1)


@pytest.mark.parametrize("kind", EVERY_VALUE, ids=lambda kind: kind.__name__)
def test_comments_between_elements_change_no_value(kind):
    plain = EVERY_VALUE[kind]
    assert kind.from_xml(re.sub(rb">(\s*)<", rb">\1<!-- x --><?y z?><", plain)) == kind.from_xml(
        plain
    )


def test_criteria_are_read_in_any_order_and_tags_with_several_pairs():
    parts = (
        "<data_tags><tag><name>a</name><value>1</value><name>b</name><value>2</value></tag>"
        "</data_tags><partitions><partition>P</partition></partitions>"
        "<topics><topic>T</topic></topics>"
    )
    rules = allowing("<id>0</id>").replace("</allow", f"<relay>{parts}</relay></allow")
    [grant] = Permissions.from_xml(document(rules=rules)).grants
    expected = Criteria(topics=("T",), partitions=("P",), data_tags=(("a", "1"), ("b", "2")))
    assert grant.rules[0].relay == (expected,)


# Subject names


@pytest.mark.parametrize(
    "text",
    [
        "CN=x,O=Lab,C=ES",
        "CN=x, O=Lab, C=ES",
        "C=ES,O=Lab,CN=x",
        "C = ES, O = Lab, CN = x",
        "/C=ES/O=Lab/CN=x",
        'CN="x" ,O=L\\61b,C=ES',
        " CN=x ,O=Lab , C=ES\n",
    ],
)
def test_all_spellings_of_a_name_are_the_same(text):
    assert same_subject(parse_subject(text), parse_subject("CN=x,O=Lab,C=ES"))


@pytest.mark.parametrize(
    "text",
    [
        "CN=x",
        "CN=x,O=Lab,C=ES,L=Madrid",
        "O=Lab,CN=x,C=ES",
        "cn=x,O=Lab,C=ES",
        "CN=X,O=Lab,C=ES",
        "CN=x+O=Lab,C=ES",
        "CN=x\\,O=Lab,C=ES",
        "CN=x\\ ,O=Lab,C=ES",
        "CN=x\u00a0,O=Lab,C=ES",
        "CN=\u00a0x,O=Lab,C=ES",
        "/CN=x,O=Lab,C=ES",
    ],
)
def test_a_name_with_other_fewer_or_more_parts_is_another(text):
    assert not same_subject(parse_subject(text), parse_subject("CN=x,O=Lab,C=ES"))


def test_the_same_parts_in_an_order_of_their_own_are_another_name():
    """Only the two orders that stacks write are the same name."""
    parts = ("CN=x", "OU=a", "OU=b", "C=ES")
    name = parse_subject(",".join(parts))
    for order in permutations(parts):
        same = order in {parts, parts[::-1]}
        assert same_subject(parse_subject(",".join(order)), name) is same


def test_two_names_that_cannot_be_read_are_not_the_same():
    assert not same_subject((), ())
    assert not same_subject((), parse_subject("CN=x"))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("CN=/ns/node", "/ns/node"),
        ("/CN=/ns/node", "/ns/node"),
        (r"/CN=\/ns\/node", "/ns/node"),
        (r"CN=a\, b\+c", "a, b+c"),
        (r"CN=\C3\A9", "é"),
        (r"/CN=\xC3\xA9", "é"),
        (r"CN=x\ ", "x "),
        ('CN="a, b" ', "a, b"),
        (r"CN=\#0", "#0"),
        ("CN=a=b", "a=b"),
    ],
)
def test_the_value_of_a_name_is_read_with_its_slashes_and_escapes(text, value):
    assert parse_subject(text) == (frozenset({("CN", value)}),)


@pytest.mark.parametrize(
    "text",
    ["", "gibberish", "CN", "=x", "CN=a,", ",CN=a", 'CN="a', 'CN=a"b', "CN=a\\", "CN=#0401", "/",
     "/x/CN=a", r"CN=\FF", "CN=\ud800", "CN=" + "x" * 5000],
)  # fmt: skip
def test_what_is_no_name_is_refused(text):
    with pytest.raises(MalformedError, match=r"no subject name|not a subject name"):
        parse_subject(text)


def test_importing_the_rooms_loads_neither_lxml_nor_jinja2():
    code = (
        "import sys, pqsec_pki.documents, pqsec_pki.access;"
        "print({'lxml', 'jinja2', 'markupsafe'} & {name.split('.')[0] for name in sys.modules})"
    )
    root = Path(__file__).parents[2]
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=root, check=True, capture_output=True, text=True
    )
    assert run.stdout == "set()\n"


def test_permissions_with_lf_and_crlf_are_one_value_while_they_are_in_use():
    xml = Permissions(grants=(least(),)).to_xml()
    found = Permissions.from_xml(xml)
    assert Permissions.from_xml(xml.replace(b"\n", b"\r\n")) is found


@pytest.mark.parametrize(
    "xml", [b"<a>\r\r\n</a>", b"<a>\r\n\r</a>", b"<\0a\0/\0\r\n", b"\xef\xbb\xbf<a>\r\n</a>"]
)
def test_line_ends_that_may_be_something_else_are_not_changed(xml):
    assert with_line_feeds(b"<a>\r\n</a>") == b"<a>\n</a>"
    assert with_line_feeds(xml) == xml


def test_a_value_of_an_unknown_type_is_read_as_openssl_writes_it():
    """`openssl x509 -nameopt RFC2253` dumps its DER."""
    written = parse_subject("1.2.3.4=#0C026162,CN=a")
    assert same_subject(written, parse_subject("1.2.3.4=#0c026162 , CN=a"))
    assert not same_subject(written, parse_subject("1.2.3.4=#0C026163,CN=a"))
    assert parse_subject("x500UniqueIdentifier=#0302005A")
    for broken in ("1.2.3.4=#", "1.2.3.4=#0", "CN=#0C0161", "CN=#0C0", "CN=#xy"):
        with pytest.raises(MalformedError):
            parse_subject(broken)
