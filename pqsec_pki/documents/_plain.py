"""Permissions in the form in which pqsec writes those of most participants.

A fleet has thousands of such documents. One expression recognises them. It allows no reference, no
other element and no other order, so what a document says is between its tags.
`tests/property/test_plain_permissions.py` compares that with what the XML parser finds.
"""

import re
from datetime import UTC, datetime
from typing import NamedTuple

MAX_PLAIN = 64 << 10
"""Bytes. Longer documents are read like any others."""

_DAY = rb"20[0-9]{2}-(?:0[1-9]|1[0-2])-(?:0[1-9]|[12][0-9]|3[01])"
_TIME = _DAY + rb"T(?:[01][0-9]|2[0-3]):[0-5][0-9]:[0-5][0-9]Z"
_NAME = rb"/[A-Za-z0-9_]{1,20}(?:/[A-Za-z0-9_]{1,20})?"
_TOPIC = rb"(?!DCPS)[A-Za-z0-9_]{1,60}(?:/[A-Za-z0-9_]{1,60}){0,2}"
_TOPICS = (
    rb"<topics>\n(?:<topic>" + _TOPIC + rb"</topic>\n)+"
    rb"</topics>\n"
)

# The fixed text is compared, since an expression takes longer to compile with each character.
HEAD = (
    b'<?xml version="1.0" encoding="UTF-8"?>\n'
    b'<dds xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="'
    b'http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_permissions.xsd">\n'
    b'<permissions>\n<grant name="'
)
TAIL = b"</allow_rule>\n<default>DENY</default>\n</grant>\n</permissions>\n</dds>\n"
BETWEEN = re.compile(
    rb"(?P<name>" + _NAME + rb')">\n'
    rb"<subject_name>(?P<subject>CN=" + _NAME + rb")</subject_name>\n<validity>\n"
    rb"<not_before>(?P<begin>" + _TIME + rb")</not_before>\n"
    rb"<not_after>(?P<end>" + _TIME + rb")</not_after>\n</validity>\n"
    rb"<allow_rule>\n<domains>\n(?P<ids>(?:<id>[1-9]?[0-9]</id>\n)+)"
    rb"</domains>\n"
    rb"(?:<publish>\n(?P<publish>" + _TOPICS + rb")</publish>\n)?"
    rb"(?:<subscribe>\n(?P<subscribe>" + _TOPICS + rb")</subscribe>\n)?"
)
"""One grant with one allow_rule for plain topics, without partitions; lines end with LF."""
_VALUE = re.compile(r"<(?:id|topic)>([^<]+)<")
GRANT_LINE, RULE_LINE = 4, 10
_FIRST_ID = 12
_AROUND_TOPICS = 4
"""Lines of tags around the topics of an action."""


class PlainText(NamedTuple):
    """What such a document says, with the lines of its two actions."""

    name: str
    subject: str
    not_before: datetime
    not_after: datetime
    domains: tuple[int, ...]
    publish: tuple[str, ...]
    publish_line: int
    subscribe: tuple[str, ...]
    subscribe_line: int


def read(xml: bytes) -> PlainText | None:
    """What the document says; None if it has another form, or a day that does not exist."""
    if len(xml) > MAX_PLAIN or not (xml.startswith(HEAD) and xml.endswith(TAIL)):
        return None
    found = BETWEEN.fullmatch(xml, len(HEAD), len(xml) - len(TAIL))
    if found is None:
        return None
    name, subject, begin, end, *lists = (each.decode() for each in found.groups(b""))
    ids, publish, subscribe = (tuple(_VALUE.findall(each)) for each in lists)
    first = _FIRST_ID + len(ids) + 1
    try:
        not_before, not_after = _instant(begin), _instant(end)
    except ValueError:
        return None
    return PlainText(
        *(name, subject, not_before, not_after, tuple(map(int, ids))),
        *(publish, first, subscribe, first + len(publish) + _AROUND_TOPICS if publish else first),
    )


def _instant(text: str) -> datetime:
    return datetime.fromisoformat(text.removesuffix("Z")).replace(tzinfo=UTC)
