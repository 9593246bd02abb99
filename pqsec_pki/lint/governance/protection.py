"""Rules about governance: what it leaves unprotected, and who may join."""

from collections.abc import Iterator

from pqsec_pki.documents import DomainRule, ProtectionKind, TopicRule
from pqsec_pki.lint.document import GovernanceFile
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR, WARNING, INFO = Severity
_NONE = ProtectionKind.NONE


def _topics(document: GovernanceFile) -> Iterator[tuple[DomainRule, TopicRule]]:
    for rule in document.domain_rules:
        for topic in rule.topic_rules:
            yield rule, topic


def _is_open(topic: TopicRule) -> bool:
    kinds = (topic.metadata_protection_kind, topic.data_protection_kind)
    return set(kinds) == {_NONE}


@lint_rule(
    "PQS221", WARNING, "unauthenticated participants are allowed",
    why="Every program on the network can join the domain and use all topics whose rule has no"
    " access control.",
    fix="Set allow_unauthenticated_participants to false when all participants are secured.",
    bad="""
        <allow_unauthenticated_participants>true</allow_unauthenticated_participants>

        <rtps_protection_kind>NONE</rtps_protection_kind>
    """,
    good="""
        <allow_unauthenticated_participants>false</allow_unauthenticated_participants>

        <rtps_protection_kind>SIGN</rtps_protection_kind>
    """,
)  # fmt: skip
def unauthenticated(document: GovernanceFile) -> Iterator[Violation]:
    for rule in document.domain_rules:
        if rule.allow_unauthenticated_participants:
            yield document.at(
                rule.line, f"domains {rule.domains} allow unauthenticated participants"
            )


@lint_rule(
    "PQS222", ERROR, "unauthenticated participants with RTPS protection",
    why="An unauthenticated participant cannot read protected RTPS messages. The two settings"
    " exclude each other, and Fast DDS 3 refuses the governance.",
    fix="Set rtps_protection_kind to NONE, or allow_unauthenticated_participants to false.",
    stacks={Stack.FASTDDS: "3.1.2, 3.6.2"},
    rows=("allow_unauthenticated=true with rtps_protection≠NONE",),
    measured="Fast DDS 3.1.2 and 3.6.2 refuse, 2.9.1 and Cyclone DDS take it",
    bad="""
        <allow_unauthenticated_participants>true</allow_unauthenticated_participants>

        <rtps_protection_kind>SIGN</rtps_protection_kind>
    """,
    good="""
        <allow_unauthenticated_participants>true</allow_unauthenticated_participants>

        <rtps_protection_kind>NONE</rtps_protection_kind>
    """,
)  # fmt: skip
def unauthenticated_and_protected(document: GovernanceFile) -> Iterator[Violation]:
    for rule in document.domain_rules:
        if rule.allow_unauthenticated_participants and rule.rtps_protection_kind is not _NONE:
            yield document.at(
                rule.line, "Fast DDS 3 refuses allow_unauthenticated_participants with"
                f" rtps_protection_kind {rule.rtps_protection_kind}",
            )  # fmt: skip


@lint_rule(
    "PQS223", WARNING, "every authenticated participant may join",
    why="Without join access control, the permissions are not checked when a participant joins.",
    fix="Set enable_join_access_control to true.",
    bad="<enable_join_access_control>false</enable_join_access_control>",
    good="<enable_join_access_control>true</enable_join_access_control>",
)  # fmt: skip
def no_join_control(document: GovernanceFile) -> Iterator[Violation]:
    for rule in document.domain_rules:
        if not rule.enable_join_access_control:
            yield document.at(rule.line, f"domains {rule.domains} have no join access control")


@lint_rule(
    "PQS224", WARNING, "topics without protection",
    why="Neither the data nor the messages around it are protected. Every program on the network"
    " can read, forge and change them.",
    fix="Set metadata_protection_kind or data_protection_kind to ENCRYPT.",
    bad="""
        <rtps_protection_kind>NONE</rtps_protection_kind>

        <metadata_protection_kind>NONE</metadata_protection_kind>
        <data_protection_kind>NONE</data_protection_kind>
    """,
    good="""
        <rtps_protection_kind>NONE</rtps_protection_kind>

        <metadata_protection_kind>NONE</metadata_protection_kind>
        <data_protection_kind>ENCRYPT</data_protection_kind>
    """,
)  # fmt: skip
def unprotected_topic(document: GovernanceFile) -> Iterator[Violation]:
    for rule, topic in _topics(document):
        if _is_open(topic) and rule.rtps_protection_kind is _NONE:
            yield document.at(
                topic.line, f"topics {topic.topic_expression!a} are sent in the clear"
            )


@lint_rule(
    "PQS225", INFO, "topics are signed but not encrypted",
    why="Nobody can forge the data, but every program on the network can read it. This may be"
    " intended.",
    fix="To encrypt the topics, set data_protection_kind (or metadata_protection_kind) to ENCRYPT.",
    bad="""
        <metadata_protection_kind>SIGN</metadata_protection_kind>
        <data_protection_kind>SIGN</data_protection_kind>
    """,
    good="""
        <metadata_protection_kind>SIGN</metadata_protection_kind>
        <data_protection_kind>ENCRYPT</data_protection_kind>
    """,
)  # fmt: skip
def readable_topic(document: GovernanceFile) -> Iterator[Violation]:
    for rule, topic in _topics(document):
        kinds = {topic.metadata_protection_kind, topic.data_protection_kind}
        whole = rule.rtps_protection_kind
        protected = not _is_open(topic) or whole is not _NONE
        if protected and not any(kind.encrypts for kind in (*kinds, whole)):
            yield document.at(
                topic.line, f"topics {topic.topic_expression!a} can be read by anyone"
            )


@lint_rule(
    "PQS226", INFO, "topics without access control",
    why="Without read or write access control, every participant in the domain may read or write"
    " the topic. The permissions are not checked for it.",
    fix="Set enable_read_access_control and enable_write_access_control to true.",
    bad="<enable_read_access_control>false</enable_read_access_control>",
    good="<enable_read_access_control>true</enable_read_access_control>",
)  # fmt: skip
def no_topic_control(document: GovernanceFile) -> Iterator[Violation]:
    for _, topic in _topics(document):
        open_to = [
            word
            for word, controlled in (
                ("read", topic.enable_read_access_control),
                ("write", topic.enable_write_access_control),
            )
            if not controlled
        ]
        if open_to:
            words = " and ".join(open_to)
            yield document.at(
                topic.line,
                f"every participant of the domain may {words} topics {topic.topic_expression!a}",
            )
