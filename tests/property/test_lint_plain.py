"""Rules that are left out for plain permissions find nothing in any: the expression is enough."""

import re
import stat
from pathlib import Path

import pytest
from hypothesis import HealthCheck, Phase, assume, given, settings
from hypothesis import strategies as st

from pqsec_pki.documents import DomainSet, Grant, Permissions
from pqsec_pki.documents._plain import MAX_PLAIN
from pqsec_pki.lint._plain import NEVER_IN_PLAIN
from pqsec_pki.lint.document import Documents, ParsedText, PermissionsFile, PlainPermissions
from pqsec_pki.lint.file import File
from pqsec_pki.lint.table import RULES
from tests.longer import examples
from tests.property.plain_texts import SHORT
from tests.unit.keystores import DAY, NOW


def file_of(xml):
    return File(Path("permissions.xml"), xml, stat.S_IFREG | 0o644, NOW)


def document_of(xml):
    """As lint reads it."""
    return Documents().of(file_of(xml))


def found_in(xml, rules):
    """What the rules find in the document if it counts as any other."""
    document = PermissionsFile(file_of(xml), ParsedText(xml))
    assert document.permissions
    return [(each, found) for each in rules for found in RULES[each].check(document)]


def permissions(publish=("rt/chatter",)):
    return Permissions(
        grants=(
            Grant.least(
                subject_name="CN=/talker",
                domains=DomainSet.of(0),
                not_before=NOW - DAY,
                not_after=NOW + 300 * DAY,
                publish=publish,
                name="/talker",
            ),
        )
    ).to_xml()


@settings(
    max_examples=examples(60),
    deadline=None,
    phases=[Phase.generate],  # making such a text smaller takes minutes, and tells nothing more
    suppress_health_check=[HealthCheck.too_slow],
)
@given(xml=st.from_regex(SHORT, fullmatch=True), crlf=st.booleans())
def test_rules_that_are_left_out_find_nothing_in_plain_permissions(xml, crlf):
    xml = xml.replace(b"\n", b"\r\n") if crlf else xml
    document = document_of(xml)
    assume(document.permissions)  # no 31st of February
    assert type(document) is PlainPermissions
    assert found_in(xml, NEVER_IN_PLAIN) == []


def test_only_rules_about_permissions_are_left_out():
    assert {id_ for id_ in NEVER_IN_PLAIN if not issubclass(PermissionsFile, RULES[id_].scope)} == (
        set()
    )


def test_what_pqsec_writes_is_plain():
    assert type(document_of(permissions())) is PlainPermissions


@pytest.mark.parametrize(
    "change",
    [
        (b"rt/chatter", b"rt/*"),
        (b"rt/chatter", b"rt//chatter"),
        (b"rt/chatter", b"/chatter"),
        (b"rt/chatter", b" rt/chatter"),
        (b"rt/chatter", b"DCPSTopic"),
        (b"rt/chatter", b"rt/chatter&#10;"),
        (b"rt/chatter", b""),
        (b"CN=/talker", b"CN=/talker,CN=/other"),
        (b"CN=/talker", b"CN = /talker"),
        (b"<id>0</id>", b"<id>231</id>"),
        (b"<id>0</id>", b"<id_range><min>0</min></id_range>"),
        (b"DENY", b"ALLOW"),
        (b"allow_rule", b"deny_rule"),
        (b"Z</not_after>", b"</not_after>"),
        (rb"<not_after>....", b"<not_after>2300"),
        (b"<dds ", b"<!-- mine -->\n<dds "),
        (b"<domains>", b'<domains kind="test">'),
        (b"</permissions>\n</dds>", b"</permissions>\n</dds>\n"),
        (b"<not_before>....-..-..", b"<not_before>2026-02-30"),
    ],
    ids=lambda change: change[1].decode().strip(),
)
def test_anything_else_is_not_plain(change):
    old, new = change
    xml = re.sub(old, new, permissions())
    assert xml != permissions()
    assert type(document_of(xml)) is not PlainPermissions


def test_a_large_document_is_read_like_any_other():
    topics = tuple(f"rt/topic{number}" for number in range(MAX_PLAIN // 20))
    xml = permissions(topics)
    assert len(xml) > MAX_PLAIN
    assert type(document_of(xml)) is PermissionsFile
