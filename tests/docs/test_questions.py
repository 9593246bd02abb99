"""docs/reference/decisions.md: each row of its table has a question that the stacks answer so."""

from datetime import UTC, datetime

import pytest

from pqsec_pki.access import INTERPRETATIONS, SPEC, Action, Question, Viewpoint, decide
from pqsec_pki.documents import (
    Criteria,
    DefaultAction,
    DomainRange,
    DomainSet,
    Governance,
    Permissions,
)
from tests.docs.tables import Document
from tests.unit.test_diff import allow, deny, document, grant, topic_rule, with_rule

STACKS = [interpretation.title for interpretation in INTERPRETATIONS if interpretation is not SPEC]
TABLE = {row[""]: row for row in Document("reference/decisions.md").table("", "Standard", *STACKS)}

NOW = datetime(2026, 6, 1, tzinfo=UTC)
LATER = datetime(2026, 7, 1, tzinfo=UTC)
FAR = datetime(2300, 1, 1, tzinfo=UTC)
GOVERNANCE = Governance.protected(DomainSet.of(0, 6))
HIGH = Governance.protected(DomainSet(parts=(231,)))
JOIN = {"action": Action.JOIN, "topic": None}
IN_P = {"partitions": ("P",)}
SPLIT = (Criteria(topics=("a",)), Criteria(topics=("b",), partitions=("P",)))
OPEN = with_rule(topics=(topic_rule("x", enable_write_access_control=False), topic_rule()))


def spelled(old, new):
    """A document that allows all, with its text changed."""
    xml = document(allow("a"), not_after=LATER).to_xml()
    assert old in xml
    return Permissions.from_xml(xml.replace(old, new))


CASES = {
    "The grant is for": (document(allow("a"), subject="CN=/a/b"), {}),
    "Of several grants": (Permissions(grants=(grant(not_before=LATER), grant(allow("a")))), {}),
    "A grant is in force": (document(allow("a"), not_after=FAR), {}),
    "A range of domains without an end": (
        document(allow("a", domains=DomainSet(parts=(DomainRange(first=5),)))),
        {"domain": 6},
    ),
    "A domain above 230": (
        document(allow("a", domains=DomainSet(parts=(231,)))),
        {"domain": 231, "governance": HIGH},
    ),
    "Joining requires": (document(default=DefaultAction.ALLOW), JOIN),
    "A domain that no governance rule names": (
        document(allow("a", domains=DomainSet.of(1))),
        JOIN | {"domain": 1},
    ),
    "A time in a zone": (spelled(b"2026-07-01T00:00:00Z", b"2026-06-01T20:00:00+14:00"), {}),
    "White space around a topic or partition": (spelled(b"<topic>a", b"<topic> a"), {}),
    "A line end around a subject_name": (spelled(b"CN=/a<", b"CN=/a\n<"), {}),
    "An unclosed bracket": (document(allow("a", "[P-")), {}),
    "The topic itself": (document(deny("a", publish=(), subscribe=SPLIT), allow("a")), {}),
    "Default of a grant": (document(allow("b"), default=DefaultAction.ALLOW), {}),
    "Criteria of a rule": (document(allow("a", publish=SPLIT)), IN_P),
    "A deny rule with partitions": (document(deny("a", **IN_P), allow("a")), {}),
    "A deny rule without partitions": (
        document(allow("a", partitions=("Q",)), deny("a"), allow("a", **IN_P)),
        IN_P,
    ),
    "Partitions of an endpoint": (
        document(allow("a", partitions=("P?",))),
        {"partitions": ("P*",)},
    ),
    "An allow rule with partitions, an endpoint without": (document(allow("a", **IN_P)), {}),
    "Data tags": (document(allow("a")), {"data_tags": (("k", "v"),)}),
    "Relaying": (
        document(allow("a", relay=(Criteria(topics=("a",)),))),
        {"action": Action.RELAY},
    ),
    r"\* in a pattern": (document(allow(r"\*")), {"topic": r"\x"}),
    "[^a] in a pattern": (document(allow("[^a]")), {"topic": "b"}),
    "*ab and the topic aab": (document(allow("*ab")), {"topic": "aab"}),
    "topic_expression of governance": (document(allow("b")), {"topic": "*", "governance": OPEN}),
    "A topic with a builtin name, DCPSTopic": (
        document(allow("a")),
        {"topic": "DCPSTopic"},
    ),
}


def test_every_row_has_a_question():
    assert list(CASES) == list(TABLE)


@pytest.mark.parametrize("name", CASES)
def test_who_differs_from_the_standard_is_said_to(name):
    """Peers are asked: of its own stack OpenDDS creates no participant at all."""
    permissions, asked = CASES[name]
    asked = {"subject": "CN=/a", "domain": 0, "action": Action.PUBLISH, "topic": "a"} | asked
    governance = asked.pop("governance", GOVERNANCE)
    question = Question(now=NOW, **asked)
    answers = {
        interpretation.title: decide(
            governance, permissions, question, interpretation, by=Viewpoint.PEER
        ).allowed
        for interpretation in INTERPRETATIONS
    }
    standard = answers.pop(SPEC.title)
    differing = {title for title, allowed in answers.items() if allowed is not standard}
    said = {title for title in STACKS if TABLE[name][title] != TABLE[name]["Standard"]}
    assert differing
    assert differing <= said
