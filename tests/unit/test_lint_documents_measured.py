"""What real stacks made of a document, and what the check says of it: they agree.

As test_lint_measured.py does for certificates and signatures: an error is told for a stack
if one of its versions refused the variant, and else none, but for what says why not.
"""

import re

import pytest

from pqsec_pki.lint import Severity
from pqsec_pki.stacks import Stack
from tests.docs.rules_page import MEASURED
from tests.unit.test_lint_documents import (
    ALLOW,
    GOVERNANCE,
    PERMISSIONS,
    PUBLISH,
    domains,
    found_in,
    governance,
    permissions,
    subject,
    time,
    topic,
)

VERDICTS = {row["variant"]: row["verdicts"] for row in MEASURED}
LAST = "</domain_access_rules>"
LIVELINESS = r" *<enable_liveliness_protection>.*\n"


def elements(old, new, text=GOVERNANCE):
    """The document with what the expression finds replaced."""
    assert re.search(old, text), old
    return re.sub(old, new, text)


VARIANTS = {
    "`CN=x,O=Lab,C=ES` (RFC 2253 = reversed, no spaces)": [subject("CN=x,O=Lab,C=ES")],
    "`C=ES,O=Lab,CN=x` (DER order; what OpenDDS needs)": [subject("C=ES,O=Lab,CN=x")],
    "two grants, one per order": [subject("CN=x,O=Lab,C=ES", "C=ES,O=Lab,CN=x")],
    "`CN=x, O=Lab, C=ES`": [subject("CN=x, O=Lab, C=ES")],
    "`C = ES, O = Lab, CN = x` (openssl default print)": [subject("C = ES, O = Lab, CN = x")],
    "`/C=ES/O=Lab/CN=x`": [subject("/C=ES/O=Lab/CN=x")],
    "`cn=` lower-case type, or value case": [subject("cn=x")],
    "newlines/indent around the text": [subject("\n   CN=x\n  ")],
    "emailAddress/serialNumber as dotted OID (`rfc4514_string()` default)": [
        subject("CN=x,1.2.840.113549.1.9.1=a@b")
    ],
    "emailAddress/serialNumber by OpenSSL short name": [subject("CN=x,emailAddress=a@b")],
    "ROS 2 `CN=/ns/node`": [subject("CN=/ns/node")],
    "two OUs": [subject("CN=x,OU=a,OU=b")],
    "multi-valued RDN": [subject("CN=x+OU=a")],
    "UTF-8 value written raw": [subject("CN=ñ")],
    r"UTF-8 value written `\C3\A9`": [subject(r"CN=\C3\B1")],
    "… both as two grants": [subject("CN=ñ", r"CN=\C3\B1")],
    "no zone / `Z` / `+00:00` / `.000` / surrounding spaces": [
        time("not_before", f"2026-01-01T00:00:00{zone}") for zone in ("", "Z", "+00:00", ".000Z")
    ],
    "date only": [time("not_before", "2026-01-01")],
    "`2026-01-01 00:00:00`": [time("not_before", "2026-01-01 00:00:00")],
    "not_after year ≥ 2262 (9999, 2300)": [time("not_after", "9999-01-01T00:00:00Z")],
    "garbage not_before (silently accepted!)": [time("not_before", "soon")],
    "expired / future": [
        time("not_after", "2026-01-01T00:00:00Z"), time("not_before", "2026-12-01T00:00:00Z"),
    ],
    "no xsi attributes; no `<?xml?>`; DOCTYPE; PI; CDATA": [
        elements("<dds [^>]*>", "<dds>"), PERMISSIONS.partition("?>")[2].lstrip(),
        governance("<domain_access_rules>", "<?x y?><domain_access_rules>"),
        # Not CDATA: in a part of a value it is read otherwise by each, so pqsec refuses all of it.
    ],
    "default xmlns": [governance("<dds ", '<dds xmlns="urn:x" ')],
    "xsi:schemaLocation, or any other root attribute": [governance("<dds ", '<dds version="1" ')],
    "comment directly before `</dds>` in governance": [governance(LAST, LAST + "<!-- end -->")],
    "comment elsewhere": [governance("<domains>", "<!-- here --><domains>")],
    "upper-case tags": [elements("</?[a-z_]+", lambda found: found[0].upper())],
    "booleans TRUE/FALSE, 1/0": [governance(">true<", ">TRUE<"), governance(">true<", ">1<")],
    "` true `, ` ENCRYPT `, spaces around topic": [
        governance(">true<", "> true <"), governance(">ENCRYPT<", "> ENCRYPT <"), topic(" a "),
    ],
    "`encrypt` lower case": [governance(">ENCRYPT<", ">encrypt<")],
    "governance elements out of XSD order": [
        elements(f"({LIVELINESS})((.*\n){{2}})", r"\2\1", GOVERNANCE)
    ],
    "permissions elements out of XSD order (default/validity/domains)": [
        permissions(ALLOW, "").replace("</default>", "</default>" + ALLOW)
    ],
    "missing liveliness element": [elements(LIVELINESS, "")],
    "unknown/vendor element": [governance("<domains>", "<priority>1</priority><domains>")],
    "1.2 `enable_key_revision` / `rtps_psk_protection_kind` / allowed algorithms": [
        governance("<discovery_p", "<enable_key_revision>true</enable_key_revision><discovery_p")
    ],
    "data_protection_kind …_WITH_ORIGIN_AUTHENTICATION": [
        governance("data_protection_kind>ENCRYPT<",
                   "data_protection_kind>ENCRYPT_WITH_ORIGIN_AUTHENTICATION<")
    ],
    "domain id/max 231, 232": [domains("<id>231</id>")],
    "id_range with only `<min>0` on domain 16": [domains("<id_range><min>0</min></id_range>")],
    "id_range with only `<max>`": [domains("<id_range><max>16</max></id_range>")],
    "allow_unauthenticated=true with rtps_protection≠NONE": [
        governance("_participants>false", "_participants>true")
    ],
    "empty `<topic_expression/>`": [governance(">*<", "><")],
    "rule without `<domains>`": [elements("(?s)<domains>.*?</domains>", "", PERMISSIONS)],
    "empty `<topic/>`": [topic("")],
    "no grant name": [permissions(' name="CN=/talker"', "")],
    "`<default>` missing or lower case": [permissions(">DENY<", ">deny<")],
    "`<default>ALLOW` and no rule": [permissions(ALLOW, "").replace(">DENY<", ">ALLOW<")],
    "`<relay>`, `<data_tags>` present (ignored)": [
        permissions("</subscribe>", "</subscribe>" + PUBLISH.replace("publish", "relay")),
    ],
    "`[^A-C]`": [topic("rt/[^A-C]")],
    "`[!A-C]`, `[S-U]`, `?`, `*` crossing `/`": [topic("rt/[!A-C]"), topic("[S-U]?*")],
    "brace `{T,U}` in topic": [topic("rt/{T,U}")],
}  # fmt: skip
CYCLONE, FAST = Stack.CYCLONEDDS, Stack.FASTDDS
OTHERWISE = {
    ("garbage not_before (silently accepted!)", CYCLONE): "a hole: it is taken without a word",
    ("`<default>` missing or lower case", CYCLONE): "`allow` is taken for DENY without a word",
    ("upper-case tags", CYCLONE): "it is no document of the standard, and told to all",
    ("default xmlns", FAST): "it is no document of the standard, and told to all",
    ("date only", FAST): "it is no time by the schema, and told to all",
}
"""Where an error is told of what a stack takes, and why."""
CASES = [
    pytest.param(row, text, id=f"{row}-{number}")
    for row, texts in VARIANTS.items()
    for number, text in enumerate(texts)
]


@pytest.mark.parametrize(("row", "text"), CASES)
@pytest.mark.parametrize("target", [CYCLONE, FAST])
def test_an_error_is_told_to_those_whose_stack_refuses(row, text, target, tmp_path):
    findings = found_in(tmp_path, text, target)
    is_error = any(each.rule.severity is Severity.ERROR for each in findings)
    verdicts = VERDICTS[row][:3] if target is CYCLONE else VERDICTS[row][3:]
    is_refused = bool({"R", "X"} & set(verdicts))
    assert is_error is (is_refused or (row, target) in OTHERWISE), [*map(str, findings)]
