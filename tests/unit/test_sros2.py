"""Policies of SROS2: its own permissions come of them, and no file is read but theirs."""

import os
import re
from datetime import UTC, datetime
from pathlib import Path

import pytest
from lxml import etree

from pqsec_pki.documents import Criteria, DomainSet, Permissions, ros, sros2
from pqsec_pki.documents._sros2_words import TYPES
from pqsec_pki.documents._xinclude import MAX_CHAIN, MAX_ELEMENTS, MAX_INCLUDES
from pqsec_pki.errors import FileError, InvalidDocumentError, PqsecError

POLICIES = Path(__file__).parents[1] / "vectors/corpus/sros2/test/policies"
NAMES = ["sample", "single_context", "add_two_ints", "minimal_action", "talker_listener"]
TIMES = {
    "not_before": datetime(2020, 5, 1, tzinfo=UTC),
    "not_after": datetime(2030, 5, 1, tzinfo=UTC),
}
XI = 'xmlns:xi="http://www.w3.org/2001/XInclude"'


def permissions_of(enclaves, **options):
    return sros2.permissions_of(enclaves, domains=DomainSet.of(0), **TIMES, **options)


@pytest.mark.parametrize("name", NAMES)
def test_the_permissions_are_those_that_sros2_expects_of_its_test_policies(name):
    enclaves = sros2.read_policy(POLICIES / f"{name}.policy.xml")
    expected = (POLICIES / "permissions" / name / "permissions.xml").read_bytes()
    assert permissions_of(enclaves, discovery=False) == Permissions.from_xml(expected)


@pytest.mark.parametrize("name", NAMES)
def test_discovery_is_allowed_by_a_rule_of_its_own(name):
    enclaves = sros2.read_policy(POLICIES / f"{name}.policy.xml")
    only = (Criteria(topics=(ros.DISCOVERY,)),)
    for grant in permissions_of(enclaves).grants:
        *_, last = grant.rules
        assert (last.allow, last.publish, last.subscribe) == (True, only, only)


def test_what_a_jazzy_node_lacks_in_sros2s_sample_is_told_and_can_be_added():
    [talker, _] = sros2.read_policy(POLICIES / "talker_listener.policy.xml")
    service = "/talker/get_type_description"
    assert sros2.lacking(talker) == (ros.service_reply(service), ros.service_request(service))
    [before] = permissions_of([talker], discovery=False).grants
    [grant] = permissions_of([talker], node_minimum=True).grants
    [rule], [old] = grant.rules, before.rules
    needs = ros.node_minimum("/talker")
    for now, then, need in (
        (rule.publish, old.publish, needs.publish),
        (rule.subscribe, old.subscribe, needs.subscribe),
    ):
        topics, already = now[0].topics, then[0].topics
        assert set(topics) == {*already, *need}
        assert len(set(topics)) == len(topics)
        assert topics[: len(already)] == already


def test_what_a_policy_denies_or_allows_by_a_pattern_is_not_added(read):
    inside = (
        '<topics publish="DENY"><topic>/rosout</topic></topics>'
        '<services reply="ALLOW"><service>~/*</service></services>'
    )
    [enclave] = read(policy(inside))
    deny, allow = permissions_of([enclave], node_minimum=True).grants[0].rules
    assert deny.publish[0].topics == ("rt/rosout",)
    only = ("rr/ns/n/*Reply", ros.DISCOVERY, "rt/parameter_events")
    assert allow.publish[0].topics == only
    assert allow.subscribe[0].topics == ("rq/ns/n/*Request", ros.DISCOVERY)


def test_sros2s_default_policy_lacks_nothing():
    path = POLICIES.parents[1] / "sros2/policy/defaults/policy.xml"
    [enclave] = sros2.read_policy(path)
    assert sros2.lacking(enclave) == ()
    [grant] = permissions_of([enclave]).grants
    assert grant.subject_name == "CN=/"
    assert "rt/*" in grant.rules[0].publish[0].topics


# Policies of our own


def policy(inside, *, profile='ns="/ns" node="n"', extra=""):
    return (
        f'<policy version="0.2.0" {XI}><enclaves>{extra}<enclave path="/e"><profiles>'
        f"<profile {profile}>{inside}</profile></profiles></enclave></enclaves></policy>"
    )


@pytest.fixture
def read(tmp_path):
    """read(policy, {path: content}) is what the policy says, with these files beside it."""

    def read_(text, files=None, **options):
        folder = tmp_path / "policies"
        for name, content in {"p.policy.xml": text, **(files or {})}.items():
            file = folder / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(content if isinstance(content, bytes) else content.encode())
        return sros2.read_policy(folder / "p.policy.xml", **options)

    return read_


@pytest.mark.parametrize(
    ("namespace", "name", "topic"),
    [
        ("/ns", "x", "rt/ns/x"),
        ("/ns", "/x", "rt/x"),
        ("/ns", "~/x", "rt/ns/n/x"),
        ("/", "x", "rt/x"),
        ("/", "~/x", "rt/n/x"),
        ("/a/b", " x/* ", "rt/a/b/x/*"),
    ],
)
def test_names_are_resolved_as_sros2_does(read, namespace, name, topic):
    inside = f'<topics publish="ALLOW"><topic>{name}</topic></topics>'
    [enclave] = read(policy(inside, profile=f'ns="{namespace}" node="n"'))
    assert enclave.blocks[0].topics.publish == (topic,)


def test_denials_come_first_and_topics_are_sorted_by_their_blocks(read):
    [enclave] = read(
        policy(
            '<topics publish="ALLOW" subscribe="DENY"><topic>z</topic><topic>b</topic></topics>'
            '<services reply="DENY"><service>s</service></services>'
            '<topics publish="ALLOW"><topic>a</topic><topic>z</topic></topics>'
        )
    )
    deny, allow, _ = permissions_of([enclave]).grants[0].rules
    assert (deny.allow, allow.allow) == (False, True)
    assert deny.publish[0].topics == ("rr/ns/sReply",)
    assert deny.subscribe[0].topics == ("rq/ns/sRequest", "rt/ns/z", "rt/ns/b")
    assert allow.publish[0].topics == ("rt/ns/a", "rt/ns/z", "rt/ns/b")
    assert allow.subscribe == ()


def test_metadata_and_an_empty_profile_say_nothing(read):
    text = policy("").replace("</profile>", "</profile><metadata>any<thing/></metadata>")
    [enclave] = read(text)
    assert enclave.blocks == ()
    assert len(permissions_of([enclave]).grants[0].rules) == 1


TOPICS = '<topics publish="ALLOW"><topic>x</topic></topics>'
FAULTS = [
    ("<dds/>", "<dds>: is not expected here; expected: policy"),
    (policy("").replace("0.2.0", "0.3.0"), "is not of version 0.2.0"),
    (policy("").replace(' version="0.2.0"', ""), "lacks its attribute 'version'"),
    (policy("", profile='node="n"'), "<profile>: lacks its attribute 'ns'"),
    (policy("", profile='ns="/" node="n" x="y"'), "<profile>: has no attribute 'x'"),
    (policy("", profile='ns="/" node="2"'), "<profile>: '/2' is not a full ROS 2 name"),
    (policy("<topic>x</topic>"), "<topic>: is not expected in <profile>; expected: topics"),
    (policy("text"), "<profile>: holds elements only, no text"),
    (policy(f"{TOPICS}text"), "<profile>: holds elements only, no text"),
    (policy("<topics publish='ALLOW'/>"), "<topics>: lacks <topic>"),
    (policy(TOPICS.replace("ALLOW", "allow")), "has publish='allow', not ALLOW or DENY"),
    (policy(TOPICS.replace("publish", "reply")), "<topics>: has no attribute 'reply'"),
    (policy(TOPICS.replace(">x<", "><")), "<topic>: is not a ROS 2 name"),
    (policy(TOPICS.replace(">x<", ">x y<")), "<topic>: is not a ROS 2 name"),
    (policy(TOPICS.replace(">x<", "><x/><")), "<topic>: is not a ROS 2 name"),
    ('<policy version="0.2.0"/>', "<policy>: lacks <enclaves>"),
    (policy("", extra="<x/>"), "<x>: is not expected in <enclaves>; expected: enclave"),
]


@pytest.mark.parametrize(("text", "words"), FAULTS)
def test_what_is_no_policy_is_refused_with_the_line_and_the_element(read, text, words):
    with pytest.raises(InvalidDocumentError) as refusal:
        read(text)
    assert "p.policy.xml: line 1: " in str(refusal.value)
    assert words in str(refusal.value)


@pytest.fixture(scope="module")
def normative():
    """SROS2's own schema; what it wants from the network is given here."""
    text = (POLICIES.parents[1] / "sros2/policy/schemas/policy.xsd").read_bytes()
    base = (
        '<xs:schema xmlns:xs="http://www.w3.org/2001/XMLSchema" targetNamespace='
        '"http://www.w3.org/XML/1998/namespace"><xs:attribute name="base"/></xs:schema>'
    )

    class Given(etree.Resolver):
        def resolve(self, url, _public, context):
            return self.resolve_string(base, context) if url.endswith("xml.xsd") else None

    parser = etree.XMLParser()
    parser.resolvers.add(Given())
    return etree.XMLSchema(etree.fromstring(text, parser))


TAKEN = [
    policy(TOPICS),
    policy(""),
    policy("").replace("</profile>", "</profile><metadata><x/></metadata>"),
    policy("").replace("<profiles>", '<profiles type="x">'),
    policy(TOPICS * 2).replace(
        "</enclave>", "<profiles><profile ns='' node='a'/></profiles></enclave>"
    ),
    policy(TOPICS.replace(' publish="ALLOW"', "")),
]
MORE_FAULTS = [
    policy("").replace("</profiles>", "</profiles><x/>"),
    policy("").replace("</enclaves>", "</enclaves><enclaves/>"),
    policy("").replace("</policy>", f"{policy('')[policy('').index('<enclaves>') :]}"),
    policy("").replace("<profile ns", "<metadata/><profile ns"),
    policy("").replace("</profile>", "</profile><metadata/><metadata/>"),
    policy("").replace(' path="/e"', ""),
    policy("").replace("<enclaves>", "<enclaves a='b'>"),
]


@pytest.mark.parametrize("text", TAKEN)
def test_what_sros2s_schema_takes_is_taken(read, normative, text):
    assert normative.validate(etree.fromstring(text))
    assert read(text)


@pytest.mark.parametrize("text", [*(text for text, _ in FAULTS), *MORE_FAULTS])
def test_what_sros2s_schema_refuses_is_refused(read, normative, text):
    stricter = any(words in text for words in ('node="2"', "<topic></topic>", ">x y<"))
    assert not normative.validate(etree.fromstring(text)) or stricter
    with pytest.raises(InvalidDocumentError):
        read(text)


XSI = 'xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"'
EVERYTHING = policy(
    TOPICS
    + '<services reply="ALLOW"><service>s</service></services>'
    + '<actions call="ALLOW"><action>a</action></actions>'
).replace("<policy ", f"<policy {XSI} ")
ELEMENTS = [
    *("policy", "enclaves", "enclave", "profiles", "profile"),
    *("topics", "topic", "services", "service", "actions", "action"),
]
ALLOWED_OF_XSI = [
    'xsi:noNamespaceSchemaLocation="policy.xsd"',
    'xsi:noNamespaceSchemaLocation="http://example.org/a b"',
    'xsi:noNamespaceSchemaLocation=""',
    'xsi:schemaLocation="urn:a policy.xsd"',
    'xsi:schemaLocation="one"',
]
OTHERS_OF_XSI = [
    *(f'xsi:nil="{value}"' for value in ("true", "false", "0", "x")),
    *('xsi:type=""', 'xsi:type="nope"', 'xsi:type="RuleQualifier"', 'xsi:type="xsi:Policy"'),
    *('xsi:other="1"', 'xsi:SchemaLocation="a b"', 'schemaLocation="a b"', 'type2="x"'),
    *('xsi:type=" Policy "', 'xsi:type=" Expression"', 'xml:space="default"', 'xml:lang="en"'),
]


def with_attribute(element, attribute):
    text = re.sub(f"<{element}(?=[ >])", f"<{element} {attribute}", EVERYTHING, count=1)
    assert text != EVERYTHING
    return text


@pytest.mark.parametrize("element", ELEMENTS)
def test_attributes_of_the_schema_instance_namespace_are_taken_as_sros2_takes_them(
    read, normative, element
):
    types = [f'xsi:type="{each}"' for each in [*TYPES.values(), element]]
    plain = permissions_of(read(EVERYTHING))
    for attribute in [*ALLOWED_OF_XSI, *OTHERS_OF_XSI, *types]:
        text = with_attribute(element, attribute)
        if normative.validate(etree.fromstring(text)):
            assert permissions_of(read(text)) == plain, attribute
        else:
            with pytest.raises(InvalidDocumentError, match=f"<{element}>: has "):
                read(text)
    assert all(
        normative.validate(etree.fromstring(with_attribute(element, each)))
        for each in [*ALLOWED_OF_XSI, f'xsi:type="{TYPES[element]}"']
    )


@pytest.mark.parametrize("attribute", ALLOWED_OF_XSI)
def test_a_schema_location_is_taken_on_an_include_and_in_its_file(read, attribute):
    text = including(more=f'xpointer="xpointer(/profile/*)" {XSI} {attribute}')
    for inside in (f"<profile {XSI} {attribute}>{TOPICS}</profile>", GOOD):
        [enclave] = read(text, {"a.xml": inside})
        assert enclave.blocks[0].topics.publish == ("rt/ns/x",)


def test_a_schema_location_is_not_opened(read, secret):
    hint = f'xsi:noNamespaceSchemaLocation="{secret}"'
    (secret.parent / "policies/policy.xsd").symlink_to("fifo")  # whoever opens it waits
    for each in (hint, 'xsi:noNamespaceSchemaLocation="policy.xsd"'):
        assert read(with_attribute("policy", each)) == read(EVERYTHING)


def test_an_attribute_of_a_name_is_refused_as_sros2_does(read, normative):
    text = policy(TOPICS.replace("<topic>", '<topic publish="DENY">'))
    assert not normative.validate(etree.fromstring(text))
    with pytest.raises(InvalidDocumentError, match="<topic>: has no attribute 'publish'"):
        read(text)


def test_a_fault_in_an_included_file_is_told_with_that_file(read):
    include = '<xi:include href="inc/n.xml" xpointer="xpointer(/profile/*)"/>'
    bad = "<profile>\n<topics publish='yes'><topic>x</topic></topics></profile>"
    with pytest.raises(InvalidDocumentError, match=r"inc/n\.xml: line 2: <topics>: has publish"):
        read(policy(include), {"inc/n.xml": bad})


# Includes


def including(href="a.xml", more='xpointer="xpointer(/profile/*)"', inside=""):
    return policy(f'<xi:include href="{href}" {more}>{inside}</xi:include>')


GOOD = f"<profile>{TOPICS}</profile>"


@pytest.mark.parametrize(
    "href", ["a.xml", "./a.xml", "d/../a.xml", "d/b.xml", "link.xml", "d/up.xml", "é.xml"]
)
def test_an_include_below_the_folder_is_taken(read, tmp_path, href):
    up = f'<profile {XI}><xi:include href="../a.xml" xpointer="xpointer(/profile/*)"/></profile>'
    files = {"a.xml": GOOD, "d/b.xml": GOOD, "d/up.xml": up, "é.xml": GOOD}
    (tmp_path / "policies").mkdir()
    (tmp_path / "policies/link.xml").symlink_to("d/b.xml")
    [enclave] = read(including(href), files)
    assert enclave.blocks[0].topics.publish == ("rt/ns/x",)


@pytest.mark.parametrize(
    ("more", "content"),
    [
        ("", TOPICS),
        ('parse="xml"', TOPICS),
        ('xpointer="xpointer(/*/*)"', GOOD),
        ('xpointer="xpointer(/profile/topics)"', GOOD),
        ('xpointer="xpointer(/a/b/topics)"', f"<a><b>{TOPICS}</b></a>"),
        ("", GOOD.replace("<profile>", "").replace("</profile>", "").encode("utf-16")),
    ],
)
def test_the_forms_of_include_that_sros2_uses_are_taken(read, more, content):
    [enclave] = read(including(more=more), {"a.xml": content})
    assert [block.topics.publish for block in enclave.blocks] == [("rt/ns/x",)]


def test_a_pointer_that_finds_nothing_includes_nothing(read):
    [enclave] = read(including(more='xpointer="xpointer(/policy/*)"'), {"a.xml": GOOD})
    assert enclave.blocks == ()


@pytest.fixture
def secret(tmp_path):
    """A file beside the policy's folder, with a name nobody else has."""
    (tmp_path / "policies").mkdir()
    (tmp_path / "secret.xml").write_text(GOOD.replace(">x<", ">top-secret<"))
    (tmp_path / "policies/out.xml").symlink_to("../secret.xml")
    (tmp_path / "policies/outside").symlink_to("..")
    (tmp_path / "policies/loop.xml").symlink_to("loop.xml")
    os.mkfifo(tmp_path / "policies/fifo")
    return tmp_path / "secret.xml"


OUTSIDE = [
    ("../secret.xml", "is outside the policy's folder"),
    ("d/../../secret.xml", "is outside the policy's folder|there is no file"),
    ("out.xml", "is outside the policy's folder"),
    ("outside/secret.xml", "is outside the policy's folder"),
    ("{secret}", "is not a relative path"),
    ("file://{secret}", "is not a relative path"),
    ("file:../secret.xml", "is not a relative path"),
    ("http://example.org/a.xml", "is not a relative path"),
    ("//example.org/a.xml", "is not a relative path"),
    ("C:\\secret.xml", "is not a relative path"),
    ("\\\\host\\secret.xml", "is not a relative path"),
    ("~/secret.xml", "is not a relative path"),
    ("%2e%2e/secret.xml", "is not a relative path"),
    ("a.xml#profile", "is not a relative path"),
    ("a.xml?x", "is not a relative path"),
    ("", "is not a relative path"),
    ("loop.xml", "there is no file"),
    ("nothing.xml", "there is no file"),
    ("x" * 5000, "there is no file"),
    ("fifo", "is not a file"),
    (".", "is not a file"),
]


@pytest.mark.parametrize(("href", "words"), OUTSIDE)
def test_an_include_of_anything_but_a_file_below_the_folder_is_refused(read, secret, href, words):
    with pytest.raises(InvalidDocumentError, match=words) as refusal:
        read(including(href.replace("{secret}", str(secret))))
    assert "top-secret" not in str(refusal.value)


def test_another_root_is_taken_only_when_told(read, secret):
    with pytest.raises(InvalidDocumentError, match="outside"):
        read(including("../secret.xml"))
    [enclave] = read(including("../secret.xml"), root=secret.parent)
    assert enclave.blocks[0].topics.publish == ("rt/ns/top-secret",)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (including(more='parse="text"'), "includes a file that is not XML"),
        (including(more='encoding="utf-16"'), "has encoding, which is not supported"),
        (including(more='accept="x"'), "has accept, which is not supported"),
        (including(inside="<xi:fallback/>"), "has a fallback, which is not supported"),
        (including(more='xpointer="element(/1)"'), "is not of the form xpointer"),
        (including(more='xpointer="xpointer(//*)"'), "is not of the form xpointer"),
        (including(more="xpointer=\"xpointer(document('/etc/passwd'))\""), "is not of the form"),
        (including(more='xpointer=""'), "is not of the form xpointer"),
        (including().replace("<enclaves>", '<enclaves xml:base="/etc/">'), "has xml:base"),
        (including(more='xml:base=".."'), "has xml:base"),
        (f'<xi:include {XI} href="a.xml"/>', "is the root element"),
    ],
)
def test_the_rest_of_xinclude_is_refused(read, text, words):
    with pytest.raises(InvalidDocumentError, match=words):
        read(text, {"a.xml": GOOD})


def include_of(name):
    return f'<xi:include href="{name}" xpointer="xpointer(/profile/*)"/>'


def file_with(*names):
    return f"<profile {XI}>{''.join(map(include_of, names))}</profile>"


BOMBS = {
    "itself": ({"a.xml": file_with("a.xml")}, "inside itself"),
    "the policy": ({"a.xml": file_with("p.policy.xml")}, "inside itself"),
    "a circle": ({"a.xml": file_with("b.xml"), "b.xml": file_with("a.xml")}, "inside itself"),
    "a deep chain": (
        {"a.xml": file_with("1.xml")}
        | {f"{n}.xml": file_with(f"{n + 1}.xml") for n in range(1, 2000)},
        f"more than {MAX_CHAIN} includes deep",
    ),
    "doubling": (
        {"a.xml": file_with("1.xml", "1.xml"), "14.xml": GOOD}
        | {f"{n}.xml": file_with(f"{n + 1}.xml", f"{n + 1}.xml") for n in range(1, 14)},
        f"{MAX_INCLUDES} includes",
    ),
    "large files": (
        {"a.xml": file_with(*["b.xml"] * 10), "b.xml": f"<profile>{'<x/>' * 100_000}</profile>"},
        f"{MAX_ELEMENTS} elements",
    ),
}


@pytest.mark.parametrize("name", BOMBS)
def test_an_include_bomb_is_refused(read, name):
    files, words = BOMBS[name]
    with pytest.raises(InvalidDocumentError, match=words):
        read(including(), files)


ENTITY = '<!DOCTYPE policy [<!ENTITY e SYSTEM "{secret}">]>'


@pytest.mark.parametrize("where", ["p.policy.xml", "a.xml"])
def test_entities_are_refused_in_every_file(read, secret, where):
    hostile = ENTITY.replace("{secret}", str(secret)) + GOOD.replace(">x<", ">&e;<")
    text = hostile if where == "p.policy.xml" else including()
    with pytest.raises(InvalidDocumentError, match="DOCTYPE") as refusal:
        read(text, {"a.xml": hostile})
    assert where in str(refusal.value)


def test_a_broken_include_is_told_with_its_name(read):
    with pytest.raises(InvalidDocumentError, match=r"a\.xml: line 1: not well-formed"):
        read(including(), {"a.xml": "<profile>"})


def test_a_policy_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        sros2.read_policy(tmp_path / "no/such.policy.xml")
    with pytest.raises(PqsecError):
        sros2.read_policy(Path("a\0b"))
