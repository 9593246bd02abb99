"""The rules about documents: each sees its flaw, one edit away from a document without any."""

import re
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.documents import PRESETS, DomainSet, Governance, Grant, Permissions
from pqsec_pki.lint import RULES, Severity, check
from pqsec_pki.lint.documents.expressions import _BRACE, _ODD_BRACKET
from pqsec_pki.stacks import Stack

NOW = datetime(2026, 6, 1, tzinfo=UTC)
YEAR = timedelta(days=365)

GOVERNANCE = Governance.protected(DomainSet.of(0)).to_xml().decode()
PERMISSIONS = (
    Permissions(
        grants=(
            Grant.least(
                subject_name="CN=/talker",
                not_before=NOW - YEAR,
                not_after=NOW + YEAR,
                domains=DomainSet.of(0),
                publish=("rt/chatter", "ros_discovery_info"),
                subscribe=("rt/cmd", "ros_discovery_info"),
            ),
        )
    )
    .to_xml()
    .decode()
)
GRANT = PERMISSIONS[PERMISSIONS.index("<grant") : PERMISSIONS.index("</permissions")]
ALLOW = GRANT[GRANT.index("<allow_rule") : GRANT.index("<default")]
DENY = ALLOW.replace("allow_rule", "deny_rule")
PUBLISH = ALLOW[ALLOW.index("<publish") : ALLOW.index("<subscribe")]
[TOPIC_RULE] = re.findall(r"(?s) *<topic_rule>.*?</topic_rule>\n", GOVERNANCE)
OPEN_RULE = TOPIC_RULE.replace("read_access_control>true", "read_access_control>false")
[DOMAIN_RULE] = re.findall(r"(?s) *<domain_rule>.*</domain_rule>\n", GOVERNANCE)


def partition(name):
    return f"<partitions><partition>{name}</partition></partitions>"


def only(verdict, action, topic="rt/chatter", within=""):
    """A rule for one action on one topic."""
    criteria = f"<topics><topic>{topic}</topic></topics>{partition(within) if within else ''}"
    return (
        f"<{verdict}_rule><domains><id>0</id></domains><{action}>{criteria}</{action}>"
        f"</{verdict}_rule>"
    )


def governance(old, new, count=-1):
    assert old in GOVERNANCE, old
    return GOVERNANCE.replace(old, new, count)


def permissions(old, new, count=-1):
    assert old in PERMISSIONS, old
    return PERMISSIONS.replace(old, new, count)


def subject(name, *others):
    grants = [GRANT.replace("<subject_name>CN=/talker<", f"<subject_name>{n}<") for n in
              (name, *others)]  # fmt: skip
    return permissions(GRANT, "".join(grants))


def domains(inside):
    return permissions("<id>0</id>", inside)


def topic(name):
    return permissions("rt/chatter", name)


def time(old, new):
    return re.sub(rf"(<{old}>)[^<]*", rf"\g<1>{new}", PERMISSIONS)


def unsecured(join="false"):
    return governance(f"_participants>{join}", "_participants>true").replace(
        "<rtps_protection_kind>SIGN", "<rtps_protection_kind>NONE"
    )


def found_in(folder, text, *targets, name="document.xml"):
    file = folder / name
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return check([file], now=NOW, targets=targets).findings


# Rule -> texts that break it.
FLAWED = {
    "PQS201": [PERMISSIONS[:-9], "<!DOCTYPE dds>" + PERMISSIONS.partition("?>")[2], ""],
    "PQS202": [governance(">SIGN<", ">SIGNED<"), governance("<id>0</id>", "<id>-1</id>")],
    "PQS203": [governance("<dds ", '<dds xmlns="urn:x" '), governance("domain_access_rules", "x"),
               re.sub(r"</?dds", lambda found: found[0].upper(), GOVERNANCE), "<html/>"],
    "PQS204": [b"\xef\xbb\xbf" + PERMISSIONS.encode(),
               governance("UTF-8", "UTF-16").encode("utf-16")],
    "PQS205": [governance("UTF-8", "ISO-8859-1"), governance("UTF-8", "UTF-16").encode("utf-16")],
    "PQS206": [governance("xsi:noName", "xsi:schemaLocation='a b' xsi:noName"),
               governance("<domains>", "<domains xmlns=''>"), permissions("xsi", "x"),
               permissions("<topic>", "<topic xmlns:a='b'>"),
               governance("<id>", "<id x='1'>"), permissions("<grant ", "<grant id='1' ")],
    "PQS207": [governance("</domain_access_rules>", f"</domain_access_rules>{each}")
               for each in ("<!-- end -->", "<![CDATA[ ]]>", "&#32;")],
    "PQS208": [governance(TOPIC_RULE, re.sub(r"(?s)(<topic_expression>.*?\n)(.*?)( *</topic_rule>)",
                                             r"\2\1\3", TOPIC_RULE)),
               permissions("</validity>", "</validity><default>DENY</default>"),
               permissions(PUBLISH, "").replace("</subscribe>", "</subscribe>" + PUBLISH)],
    "PQS209": [governance("<domains>", "<priority>1</priority><domains>"),
               permissions("</topics>", "</topics><qos/>")],
    "PQS210": [governance("<discovery_p", "<enable_key_revision>1</enable_key_revision>"
                          "<discovery_p")],
    "PQS211": [governance("_control>true", "_control>TRUE"), governance("_control>true",
                                                                        "_control>1")],
    "PQS212": [governance(">true<", "> true <"), governance(">ENCRYPT<", "> ENCRYPT <"),
               topic(" rt/chatter"), permissions(">DENY<", ">\nDENY<")],
    "PQS213": [governance(">ENCRYPT<", ">encrypt<"), permissions(">DENY<", ">deny<")],
    "PQS214": [governance("<data_protection_kind>ENCRYPT",
                          "<data_protection_kind>ENCRYPT_WITH_ORIGIN_AUTHENTICATION")],
    "PQS215": [permissions(' name="CN=/talker"', "")],
    "PQS216": [permissions("<default>DENY</default>", "")],
    "PQS217": [re.sub(r"(?s)<domains>.*?</domains>", "", PERMISSIONS),
               re.sub(r"(?s)<domains>.*?</domains>", "<domains/>", GOVERNANCE)],
    "PQS218": [topic(""), governance(">*<", "><"), topic(" ")],
    "PQS219": [re.sub(" *<enable_liveliness_protection>.*\n", "", GOVERNANCE),
               re.sub(" *<subject_name>.*\n", "", PERMISSIONS)],
    "PQS220": [governance(">true<", ">TRUE<"), permissions(">DENY<", ">deny<")],
    "PQS221": [unsecured()],
    "PQS222": [governance("_participants>false", "_participants>true")],
    "PQS223": [governance("join_access_control>true", "join_access_control>false")],
    "PQS224": [re.sub("(rtps|metadata|data)(_protection_kind>)[A-Z]+<", r"\1\2NONE<", GOVERNANCE)],
    "PQS225": [re.sub("(metadata|data)(_protection_kind>)ENCRYPT<", r"\1\2SIGN<", GOVERNANCE)],
    "PQS226": [governance("read_access_control>true", "read_access_control>false")],
    "PQS227": [governance(TOPIC_RULE, TOPIC_RULE + TOPIC_RULE.replace(">*<", ">rt/x<")),
               governance(TOPIC_RULE, TOPIC_RULE.replace(">*<", ">rt/*<")
                          + TOPIC_RULE.replace(">*<", ">rt/a*b<") + TOPIC_RULE)],
    "PQS228": [governance(DOMAIN_RULE, DOMAIN_RULE * 2)],
    "PQS229": [governance(">*<", ">rt/*<")],
    "PQS231": [domains("<id_range><min>0</min></id_range>")],
    "PQS232": [domains("<id_range><max>9</max></id_range>")],
    "PQS233": [domains("<id>231</id>"), domains("<id>" + "9" * 40 + "</id>"),
               domains("<id_range><min>0</min><max>232</max></id_range>")],
    "PQS234": [domains("<id_range><min>5</min><max>3</max></id_range>")],
    "PQS235": [topic("rt/{a,b}"), governance(">*<", ">{a,b}<")],
    "PQS236": [topic("rt/[^a]")],
    "PQS230": [GOVERNANCE],
    "PQS237": [topic("*a*b*c*d*e")],
    "PQS238": [topic(r"rt/\*"), governance(">*<", r">a\b<")],
    "PQS239": [topic("rt/[]a]"), topic("rt/[a-]"), topic("[0-9]-f"), topic("[[:digit:]]"),
               topic("rt/[a"), topic("[!]a]")],
    "PQS244": [topic("rt/a?"), topic("rt/[!a]"), topic("[é]"), topic("[a[:alpha:]]"),
               governance(">*<", ">a?<")],
    "PQS240": [governance(TOPIC_RULE, TOPIC_RULE.replace(">*<", ">rt/*<") + OPEN_RULE)],
    "PQS241": [topic("rt/[ab]")],
    "PQS242": [topic("rt/*b"), topic("*/a*")],
    "PQS243": [topic("rt/[a"), topic("[!]"), topic("[]"), topic(r"[a]\[[b"), topic("[a-"),
               governance(">*<", ">[P-<"),
               permissions("</topics>", "</topics>" + partition("[P-"))],
    "PQS251": [permissions(">DENY<", ">ALLOW<")],
    "PQS252": [permissions(">DENY<", ">ALLOW<").replace(ALLOW, "")],
    "PQS253": [topic("*"), topic("**"), topic("?*")],
    "PQS254": [permissions(ALLOW, ALLOW + DENY),
               permissions(ALLOW, ALLOW.replace("rt/chatter", "rt/*") + DENY),
               permissions(ALLOW, ALLOW.replace("rt/chatter", "rt/c*r") + DENY),
               permissions(ALLOW, ALLOW.replace(
                   "<id>0</id>", "<id_range><min>0</min><max>9</max></id_range>") + DENY)],
    "PQS255": [permissions(ALLOW, DENY + ALLOW)],
    "PQS256": [permissions(ALLOW, DENY.replace("</topics>", "</topics>" + partition("P")))],
    "PQS257": [permissions(PUBLISH, PUBLISH + PUBLISH.replace("chatter", "x").replace(
        "</topics>", "</topics>" + partition("P")))],
    "PQS258": [permissions(PUBLISH, PUBLISH.replace("</topics>", "</topics>" + partition("P")))],
    "PQS259": [permissions("</subscribe>", "</subscribe>" + PUBLISH.replace("publish", "relay"))],
    "PQS260": [permissions("</topics>", "</topics><data_tags><tag><name>a</name><value>b</value>"
                           "</tag></data_tags>")],
    "PQS261": [subject("CN=/talker", "CN=/talker"), subject("CN=x,O=y", "CN=x, O=y")],
    "PQS262": [time("not_after", "2020-01-01T00:00:00Z"),
               re.sub("(<not_[a-z]+>)[^<]+", r"\g<1>2026-06-01T00:00:00Z", PERMISSIONS)],
    "PQS263": [time("not_after", "2262-01-01T00:00:00Z"),
               time("not_after", "10000000000-01-01T00:00:00Z")],
    "PQS264": [time("not_before", "soon"), time("not_before", "2026-01-01"),
               time("not_after", "2026-02-30T00:00:00Z"), time("not_before", "")],
    "PQS265": [time("not_before", "2020-01-01T00:00:00")],
    "PQS266": [time("not_before", "2020-01-01T00:00:00+02:00")],
    "PQS267": [topic("rr/a/b/get_parametersReply")],
    "PQS268": [permissions("ros_discovery_info", "x")],
    "PQS269": [topic("DCPSTopic"), governance(">*<", ">DCPS*<")],
    "PQS276": [topic("rt//scan"), topic("rq/reset//Request"), topic("rt/robot1//*")],
    "PQS277": [topic("/chatter"), topic("/robot1/odom")],
    "PQS278": [governance("</id>", "</id\n>"), permissions("<topics>", "<topics><![CDATA[\n]]>"),
               permissions("<topics>", "<topics>&#10;"), topic("&#x000000000000041;"),
               topic(' "x'), topic("\u2018x")],
    "PQS279": [governance("<id>", "<?x y?><id>"), permissions("</dds>", "</dds><?x?>"),
               permissions("<dds", "<!-- x --><?x?><dds")],
    "PQS270": [permissions(ALLOW, only("deny", "publish", "rt/*") + only("allow", "subscribe")),
               permissions(ALLOW, only("deny", "publish") + only("allow", "subscribe", "r?/*")),
               permissions(ALLOW, only("deny", "publish")).replace(">DENY<", ">ALLOW<"),
               permissions(ALLOW, only("deny", "subscribe") + only("allow", "publish"))],
    "PQS271": [permissions(ALLOW, DENY.replace("<id>0<", "<id>1<") + ALLOW)],
    "PQS272": [permissions(ALLOW, only("allow", "publish", within="P") + only("deny", "publish")
                           ).replace(">DENY<", ">ALLOW<"),
               permissions(ALLOW, only("allow", "subscribe", "rt/*") + only("deny", "publish")
                           + only("allow", "publish", "*", within="*"))],
    "PQS273": [permissions("</topics>", "</topics>" + partition("P"))],
    "PQS274": [permissions(ALLOW, ""), permissions(ALLOW, DENY)],
    "PQS275": [permissions("</topics>", "</topics>" + partition(name))
               for name in ("floor?", "*a*", "a*b", "floor[12]", "a**", r"\a")],
    "PQS411": [subject(""), subject("talker"), subject("CN")],
    "PQS412": [subject("\n  CN=/talker\n  ")],
    "PQS413": [subject("CN=x, O=Lab"), subject("CN = x"), subject("CN=x ,O=Lab")],
    "PQS414": [subject("/C=ES/CN=x")],
    "PQS415": [subject("C=ES,O=Lab,CN=x")],
    "PQS416": [subject("CN=x,O=Lab,C=ES")],
    "PQS417": [subject("cn=x"), subject("CN=x,STREET=y"), subject("CN=x,2.5.4.5=1")],
    "PQS418": [subject("CN=é")],
    "PQS419": [subject("CN=x,OU=a,OU=b")],
    "PQS420": [subject("CN=x+OU=a")],
    "PQS421": [subject(r"CN=x,O=Acme\, Inc"), subject(r"CN=x,O=a\"b")],
    "PQS422": [subject("CN=" + "x" * 65)],
    "PQS423": [subject("CN=a|b"), subject("CN=a;b")],
    "PQS425": [subject(r"CN=\C3\A9")],
    "PQS424": [subject("CN=/a//b"), subject("CN=/a/,O=b"), subject("CN=" + "/a" * 20)],
}  # fmt: skip

# Rule -> texts close to breaking it.
SOUND = {
    "PQS201": [PERMISSIONS.partition("?>")[2].lstrip(), governance("<id>", "<?x y?><id>")],
    "PQS206": [permissions('name="CN=/talker"', 'name=""'), governance("</id>", "</id ><!--'-->"),
               governance("<domains>", "<domains xsi:noNamespaceSchemaLocation='a'>")],
    "PQS207": [governance("<domain_access_rules>", "<!-- a --><domain_access_rules><!-- b -->"),
               permissions("</permissions>", "</permissions><!-- end -->")],
    "PQS208": [permissions("</topics>", "</topics>" + partition("P"))],
    "PQS222": [unsecured()],
    "PQS224": [re.sub("(metadata|data)(_protection_kind>)[A-Z]+<", r"\1\2NONE<", GOVERNANCE)],
    "PQS225": [governance("<data_protection_kind>ENCRYPT", "<data_protection_kind>NONE"),
               re.sub("(rtps)(_protection_kind>)SIGN<", r"\1\2ENCRYPT<", re.sub(
                   "(metadata|data)(_protection_kind>)ENCRYPT<", r"\1\2SIGN<", GOVERNANCE))],
    "PQS255": [permissions(ALLOW, ALLOW + DENY + ALLOW)],
    "PQS227": [governance(TOPIC_RULE, TOPIC_RULE.replace(">*<", ">rt/x<") + TOPIC_RULE),
               governance(TOPIC_RULE, TOPIC_RULE.replace(">*<", ">rt/a*<")
                          + TOPIC_RULE.replace(">*<", ">rt/*<") + TOPIC_RULE)],
    "PQS228": [governance(DOMAIN_RULE, DOMAIN_RULE + DOMAIN_RULE.replace(">0<", ">1<"))],
    "PQS233": [domains("<id>230</id>")],
    "PQS234": [domains("<id_range><min>3</min><max>3</max></id_range>")],
    "PQS235": [topic("rt/{a}")],
    "PQS236": [topic("rt/[!a]")],
    "PQS230": [governance("join_access_control>true", "join_access_control>false"),
               governance(TOPIC_RULE, OPEN_RULE.replace(">*<", ">nothing<") + TOPIC_RULE)],
    "PQS237": [topic("*a*b*c*d")],
    "PQS238": [topic("rt/[*]")],
    "PQS239": [topic("rt/[!a-c]"), topic("[ab][0-9a-f]*"), topic("a]")],
    "PQS244": [topic("rt/é*"), topic("rt/[0-9a-z]"), topic("rt/[a]é")],
    "PQS240": [governance(TOPIC_RULE, OPEN_RULE.replace(">*<", ">rt/*<") + TOPIC_RULE)],
    "PQS241": [topic("rt/a")],
    "PQS242": [topic("rt/**")],
    "PQS243": [topic("rt/[a]"), topic("[!]]"), topic("[]]"), topic(r"\[a"), topic("a]")],
    "PQS252": [permissions(">DENY<", ">ALLOW<")],
    "PQS253": [topic("rt/*"), permissions(ALLOW, ALLOW + DENY.replace("rt/chatter", "*"))],
    "PQS254": [permissions(ALLOW, DENY.replace("rt/c", "rt/b") + ALLOW),
               permissions(ALLOW, ALLOW + DENY.replace("rt/", "rt/x").replace("ros_", "rox_")),
               permissions(ALLOW, ALLOW + DENY.replace("<id>0<", "<id>1<")),
               permissions(ALLOW, ALLOW + DENY.replace("</topics>", "</topics>" + partition("P"))),
               permissions(ALLOW, ALLOW + DENY.replace("rt/chatter", "*").replace("ros_", "z")
                           .replace("rt/cmd", "*"))],
    "PQS257": [permissions(PUBLISH, PUBLISH + PUBLISH.replace("chatter", "x"))],
    "PQS258": [permissions("</topics>", "</topics>" + partition("P"))],
    "PQS261": [subject("CN=x,O=y", "O=y,CN=x"), subject("CN=x", "CN=y"),
               subject("CN=é", r"CN=\C3\A9")],
    "PQS263": [time("not_after", "2261-01-01T00:00:00Z")],
    "PQS264": [time("not_before", " 2020-01-01T00:00:00.125+14:00 ")],
    "PQS265": [time("not_before", "2020-01-01T00:00:00+00:00")],
    "PQS266": [time("not_before", "2020-01-01T00:00:00+00:00"),
               time("not_before", "2020-01-01T00:00:00")],
    "PQS267": [permissions("<topic>rt/chatter<", "<topic>rr/a/get_parametersReply</topic>"
                           "<topic>rr/a/get_type_descriptionReply<"), topic("rr/a/*Reply")],
    "PQS268": [permissions("ros_discovery_info", "*")],
    "PQS269": [topic("rt/DCPSTopic")],
    "PQS276": [topic("rt/scan"), topic("a//b"), topic("rtx//scan")],
    "PQS277": [topic("rt/chatter"), topic("chatter"), topic("/not-ros")],
    "PQS278": [permissions("<topics>", "<topics\t><!-- </topics > <![CDATA[ ]]> &#10; -->"),
               topic("&#x41;"), topic("'x'"), topic("&quot;x")],
    "PQS279": [permissions("<dds", "<?x?><dds"), permissions("<topics>", "<topics><!-- <?x?> -->")],
    "PQS270": [permissions(ALLOW, only("allow", "subscribe") + only("deny", "publish", "rt/*")),
               permissions(ALLOW, only("allow", "subscribe") + only("deny", "publish")
                           + only("allow", "subscribe", "rt/*")),
               permissions(ALLOW, only("deny", "publish", "rt/x") + only("allow", "subscribe")),
               permissions(ALLOW, DENY + only("allow", "subscribe", "ros_discovery_info")),
               permissions(ALLOW, only("deny", "publish") + only("deny", "subscribe", "rt/*")
                           + only("allow", "subscribe", "*")),
               permissions(ALLOW, only("deny", "publish").replace("<id>0<", "<id>1<")
                           + only("allow", "subscribe"))],
    "PQS271": [permissions(ALLOW, DENY + ALLOW), permissions(ALLOW, DENY + ALLOW).replace(
        "<id>0</id>", "<id>0</id><id>1</id>")],
    "PQS272": [permissions(ALLOW, only("allow", "publish", within="P") + only("deny", "publish")),
               permissions(ALLOW, only("deny", "publish", within="*")).replace(">DENY<", ">ALLOW<"),
               permissions(ALLOW, only("deny", "publish") + only("allow", "publish", "*"))],
    "PQS273": [PERMISSIONS],
    "PQS274": [permissions(ALLOW, "").replace(">DENY<", ">ALLOW<")],
    "PQS275": [*(permissions("</topics>", "</topics>" + partition(name))
                 for name in ("floor1", "floor*", "*")),
               permissions(ALLOW, ALLOW + DENY.replace("</topics>", "</topics>" + partition("?")))],
    "PQS413": [subject(r"CN=x\, y"), subject("CN=a b")],
    "PQS415": [subject("C=ES,CN=x", "CN=x,C=ES"), subject("CN=x,C=ES")],
    "PQS416": [subject("CN=x,C=ES", "C=ES,CN=x"), subject("CN=x")],
    "PQS417": [subject("CN=x,emailAddress=a@b,serialNumber=1")],
    "PQS418": [subject("CN=é", r"CN=\C3\A9"), subject(r"CN=\C3\A9")],
    "PQS425": [subject("CN=é", r"CN=\C3\A9"), subject("CN=é")],
    "PQS419": [subject("CN=x,DC=a,DC=b")],
    "PQS421": [subject("CN=x,O=Acme Inc")],
    "PQS422": [subject("CN=" + "x" * 64)],
    "PQS423": [subject("CN=/ns/node_1.a-b c")],
    "PQS424": [subject("CN=/a/b"), subject("/C=ES/CN=x"), subject("CN=a,O=b"),
               subject("CN=" + "/a" * 19)],
}  # fmt: skip


def each(table):
    return [
        pytest.param(id_, text, id=f"{id_}-{number}")
        for id_, texts in table.items()
        for number, text in enumerate(texts)
    ]


def targets_of(id_):
    return sorted(RULES[id_].stacks)[:1] if RULES[id_].only_when_asked else []


@pytest.mark.parametrize(("id_", "text"), each(FLAWED))
def test_the_flaw_is_seen(id_, text, tmp_path):
    found = found_in(tmp_path, text, *targets_of(id_))
    assert id_ in {each.rule.id for each in found}
    assert all(each.message.isprintable() for each in found)


@pytest.mark.parametrize(("id_", "text"), each(SOUND))
def test_what_is_close_to_the_flaw_is_not_taken_for_it(id_, text, tmp_path):
    found = found_in(tmp_path, text, *targets_of(id_))
    assert id_ not in {each.rule.id for each in found}


@pytest.mark.timeout(120)  # what is quadratic takes an hour
@pytest.mark.parametrize("text", ["[" * 200_000 + "a]", "{" + "," * 200_000], ids=["[[[", "{,,,"])
def test_brackets_and_commas_beyond_number_are_gone_through_once(text):
    for pattern in (_ODD_BRACKET, _BRACE):
        assert not pattern.search(text)


@pytest.mark.parametrize("text", [GOVERNANCE, PERMISSIONS], ids=["governance", "permissions"])
@pytest.mark.parametrize("target", [None, *Stack])
def test_the_documents_the_flaws_are_made_from_have_none(text, target, tmp_path):
    found = found_in(tmp_path, text, *([target] if target else []))
    is_unfit = target is Stack.OPENDDS and text is GOVERNANCE  # OpenDDS creates no participant
    assert [each.rule.id for each in found] == ["PQS230"] * is_unfit


def test_every_rule_of_these_families_has_its_flawed_document():
    frame = {f"PQS{number:03}" for number in range(1, 11)}
    ours = {rule.id for rule in RULES.values() if rule.family in {"frame", "documents", "naming"}}
    elsewhere = frame | {"PQS401", "PQS402", "PQS431", "PQS432"}  # test_lint_naming, test_lint
    assert set(FLAWED) == ours - elsewhere


PRESET_FINDINGS = {
    "strict": set(),
    "authenticated": {"PQS225"},
    "open-discovery": set(),
    "lossy-network": set(),
    "migration": {"PQS221"},
}


@pytest.mark.parametrize("preset", PRESETS, ids=lambda preset: preset.name)
def test_a_preset_is_told_only_what_it_is_made_for(preset, tmp_path):
    """Data that can be read in `authenticated`, and strangers in `migration`, are meant."""
    found = found_in(tmp_path, preset.governance(DomainSet.of(0)).to_xml())
    assert {each.rule.id for each in found} == PRESET_FINDINGS.get(preset.name, set())
    assert not [each for each in found if each.rule.severity is Severity.ERROR]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        (governance(">SIGN<", ">SIGNED<"), ">SIGNED<", "'SIGNED' is not one of"),
        (topic("rt/[^a]"), "[^a]", "write [!...]"),
        (domains("<id_range><min>0</min></id_range>"), "<id_range>", "no <max>"),
        (permissions(ALLOW, ALLOW + DENY), None, "the allow_rule in line 10 covers it"),
    ],
)
def test_a_finding_names_the_line_and_says_what_is_wrong(text, line, words, tmp_path):
    [finding, *_] = [each for each in found_in(tmp_path, text) if words in each.message]
    if line:
        assert finding.line == text[: text.index(line)].count("\n") + 1


def test_a_break_of_the_schema_is_told_once_and_by_the_rule_that_knows_why(tmp_path):
    for id_ in (
        "PQS208",
        "PQS209",
        "PQS210",
        "PQS211",
        "PQS213",
        "PQS214",
        "PQS215",
        "PQS216",
        "PQS219",
    ):
        for text in FLAWED[id_]:
            told = {each.rule.id for each in found_in(tmp_path, text)}
            assert told <= {id_, "PQS206", "PQS220"}, (id_, told)
