"""Permissions in the form in which pqsec writes those of most participants.

A fleet has thousands of such documents. One expression recognises them, and excludes what most
rules look for, so these need not run. `tests/property/test_lint_plain.py` makes documents from
the expression and runs the rules on them.
"""

import re

MAX_PLAIN = 64 << 10
"""Bytes. Longer documents are read like any others."""

_DAY = rb"20[0-9]{2}-(?:0[1-9]|1[0-2])-(?:0[1-9]|[12][0-9]|3[01])"
_TIME = _DAY + rb"T(?:[01][0-9]|2[0-3]):[0-5][0-9]:[0-5][0-9]Z"
_NAME = rb"/[A-Za-z0-9_]{1,20}(?:/[A-Za-z0-9_]{1,20})?"
_TOPIC = rb"(?!DCPS)[A-Za-z0-9_]{1,60}(?:/[A-Za-z0-9_]{1,60}){0,2}"
_TOPICS = (
    rb"          <topics>\n(?:            <topic>" + _TOPIC + rb"</topic>\n)+"
    rb"          </topics>\n"
)

PLAIN = re.compile(
    rb'<\?xml version="1\.0" encoding="UTF-8"\?>\n'
    rb'<dds xmlns:xsi="http://www\.w3\.org/2001/XMLSchema-instance" xsi:noNamespaceSchemaLocation="'
    rb'http://www\.omg\.org/spec/DDS-SECURITY/20170901/omg_shared_ca_permissions\.xsd">\n'
    rb'  <permissions>\n    <grant name="' + _NAME + rb'">\n'
    rb"      <subject_name>CN=" + _NAME + rb"</subject_name>\n      <validity>\n"
    rb"        <not_before>" + _TIME + rb"</not_before>\n"
    rb"        <not_after>" + _TIME + rb"</not_after>\n      </validity>\n"
    rb"      <allow_rule>\n        <domains>\n(?:          <id>[1-9]?[0-9]</id>\n)+"
    rb"        </domains>\n"
    rb"(?:        <publish>\n" + _TOPICS + rb"        </publish>\n)?"
    rb"(?:        <subscribe>\n" + _TOPICS + rb"        </subscribe>\n)?"
    rb"      </allow_rule>\n      <default>DENY</default>\n    </grant>\n"
    rb"  </permissions>\n</dds>\n"
)
"""One grant with one allow_rule for plain topics, without partitions; lines end with LF."""

NEVER_IN_PLAIN = frozenset(
    f"PQS{number}"
    for numbers in (
        range(201, 207),  # how the XML is written
        range(208, 214),
        range(215, 221),
        range(231, 240),  # domains and patterns
        range(241, 244),
        range(251, 262),  # deny_rules, partitions, a second grant, a default ALLOW
        range(263, 267),  # how times are written
        range(269, 278),
        range(411, 426),  # how the subject is written
    )
    for number in numbers
)
"""The rules about permissions that find nothing in such a document."""
