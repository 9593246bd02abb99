"""Rules about governance: missing protection, and what stacks read differently."""

from collections.abc import Iterator

from pqsec_pki.documents import DomainRule, ProtectionKind, TopicRule
from pqsec_pki.lint._shadows import Patterns, covers_all, covers_domains
from pqsec_pki.lint.document import GovernanceFile
from pqsec_pki.lint.rule import Family, Severity, Target, Violation

FAMILY = Family("documents")

ERROR, WARNING, INFO = Severity
_NONE = ProtectionKind.NONE
_CIPHER = {ProtectionKind.ENCRYPT, ProtectionKind.ENCRYPT_WITH_ORIGIN_AUTHENTICATION}
MAX_COMPARED = 64
"""How many earlier domain rules a rule is compared with; real documents have fewer."""


def _rules(document: GovernanceFile) -> tuple[DomainRule, ...]:
    return document.governance.domain_rules if document.governance else ()


def _topics(document: GovernanceFile) -> Iterator[tuple[DomainRule, TopicRule]]:
    for rule in _rules(document):
        for topic in rule.topic_rules:
            yield rule, topic


def _is_open(topic: TopicRule) -> bool:
    kinds = (topic.metadata_protection_kind, topic.data_protection_kind)
    return set(kinds) == {_NONE}


@FAMILY.rule(
    "PQS221", WARNING, GovernanceFile, "unauthenticated participants are allowed",
    why="Every program on the network can join the domain and use all topics whose rule has no"
    " access control.",
    fix="Set allow_unauthenticated_participants to false when all participants are secured.",
)  # fmt: skip
def unauthenticated(document: GovernanceFile) -> Iterator[Violation]:
    for rule in _rules(document):
        if rule.allow_unauthenticated_participants:
            yield document.at(
                rule.line, f"domains {rule.domains} allow unauthenticated participants"
            )


@FAMILY.rule(
    "PQS222", ERROR, GovernanceFile, "unauthenticated participants with RTPS protection",
    why="An unauthenticated participant cannot read protected RTPS messages. The two settings"
    " exclude each other, and Fast DDS 3 refuses the governance.",
    fix="Set rtps_protection_kind to NONE, or allow_unauthenticated_participants to false.",
    stacks=(Target.FASTDDS,), rows=("allow_unauthenticated=true with rtps_protection≠NONE",),
    measured="Fast DDS 3.1.2 and 3.6.2 refuse, 2.9.1 and Cyclone DDS take it",
)  # fmt: skip
def unauthenticated_and_protected(document: GovernanceFile) -> Iterator[Violation]:
    for rule in _rules(document):
        if rule.allow_unauthenticated_participants and rule.rtps_protection_kind is not _NONE:
            yield document.at(
                rule.line, "Fast DDS 3 refuses allow_unauthenticated_participants with"
                f" rtps_protection_kind {rule.rtps_protection_kind}",
            )  # fmt: skip


@FAMILY.rule(
    "PQS223", WARNING, GovernanceFile, "every authenticated participant may join",
    why="Without join access control, the permissions are not checked when a participant joins.",
    fix="Set enable_join_access_control to true.",
)  # fmt: skip
def no_join_control(document: GovernanceFile) -> Iterator[Violation]:
    for rule in _rules(document):
        if not rule.enable_join_access_control:
            yield document.at(rule.line, f"domains {rule.domains} have no join access control")


@FAMILY.rule(
    "PQS224", WARNING, GovernanceFile, "topics without protection",
    why="Neither the data nor the messages around it are protected. Every program on the network"
    " can read, forge and change them.",
    fix="Set metadata_protection_kind or data_protection_kind to ENCRYPT.",
)  # fmt: skip
def clear_topic(document: GovernanceFile) -> Iterator[Violation]:
    for rule, topic in _topics(document):
        if _is_open(topic) and rule.rtps_protection_kind is _NONE:
            yield document.at(
                topic.line, f"topics {topic.topic_expression!a} are sent in the clear"
            )


@FAMILY.rule(
    "PQS225", INFO, GovernanceFile, "topics are signed but not encrypted",
    why="Nobody can forge the data, but every program on the network can read it. This may be"
    " intended.",
    fix="To encrypt the topics, set data_protection_kind (or metadata_protection_kind) to ENCRYPT.",
)  # fmt: skip
def readable_topic(document: GovernanceFile) -> Iterator[Violation]:
    for rule, topic in _topics(document):
        kinds = {topic.metadata_protection_kind, topic.data_protection_kind}
        whole = rule.rtps_protection_kind
        protected = not _is_open(topic) or whole is not _NONE
        if protected and not (kinds | {whole}) & _CIPHER:
            yield document.at(
                topic.line, f"topics {topic.topic_expression!a} can be read by anyone"
            )


@FAMILY.rule(
    "PQS226", INFO, GovernanceFile, "topics without access control",
    why="Without read or write access control, every participant in the domain may read or write"
    " the topic. The permissions are not checked for it.",
    fix="Set enable_read_access_control and enable_write_access_control to true.",
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


@FAMILY.rule(
    "PQS227", WARNING, GovernanceFile, "a topic rule that is never reached",
    why="The first topic rule that matches decides. An earlier rule matches every topic that this"
    " rule matches.",
    fix="Put the narrower rule first.",
)  # fmt: skip
def shadowed_topic(document: GovernanceFile) -> Iterator[Violation]:
    for rule in _rules(document):
        before = Patterns[TopicRule]()
        for topic in rule.topic_rules:
            if earlier := next(before.covering(topic.topic_expression), None):
                yield document.at(
                    topic.line,
                    f"{topic.topic_expression!a} is never reached:"
                    f" the earlier {earlier.topic_expression!a} covers it",
                )
            before.add(topic.topic_expression, topic)


@FAMILY.rule(
    "PQS228", WARNING, GovernanceFile, "a domain rule that is never reached",
    why="The first domain rule that matches decides. An earlier rule matches all domains of this"
    " rule.",
    fix="Remove the domains from one of the two rules.",
)  # fmt: skip
def shadowed_domains(document: GovernanceFile) -> Iterator[Violation]:
    rules = _rules(document)
    for place, rule in enumerate(rules):
        if any(covers_domains(each.domains, rule.domains) for each in rules[:place][:MAX_COMPARED]):
            yield document.at(rule.line, f"domains {rule.domains} are covered by an earlier rule")


@FAMILY.rule(
    "PQS229", WARNING, GovernanceFile, "topics that no topic rule matches",
    why="Stacks refuse to create endpoints of a topic that no topic rule matches.",
    fix="Add a last topic rule for *, with the strictest protection.",
    measured="read in Cyclone DDS's and Fast DDS's source",
)  # fmt: skip
def no_rule_for_the_rest(document: GovernanceFile) -> Iterator[Violation]:
    for rule in _rules(document):
        if not any(covers_all(topic.topic_expression) for topic in rule.topic_rules):
            yield document.at(rule.line, "there is no topic rule for all other topics (*)")


@FAMILY.rule(
    "PQS230", ERROR, GovernanceFile, "OpenDDS creates no participant with this governance",
    why="OpenDDS ignores the permissions here (OpenDDS issue 5007). It creates a participant only"
    " if join access control is off, or if a topic rule has no read or no write access control. All"
    " other stacks accept this governance, and pqsec writes it.",
    fix="For OpenDDS, add a first topic rule for a name that is not used, with"
    " enable_read_access_control false. It opens no other topic.",
    stacks=(Target.OPENDDS,), measured="read in OpenDDS 3.34's source", only_when_asked=True,
)  # fmt: skip
def nobody_joins(document: GovernanceFile) -> Iterator[Violation]:
    for rule in _rules(document):
        if rule.enable_join_access_control and not any(map(_is_half_open, rule.topic_rules)):
            yield document.at(
                rule.line, f"OpenDDS creates no participant on domains {rule.domains}:"
                " joining and every topic have access control",
            )  # fmt: skip


@FAMILY.rule(
    "PQS240", WARNING, GovernanceFile, "a topic rule that opens protected topics in OpenDDS",
    why="OpenDDS checks permissions only if all matching topic rules require it. A later rule"
    " without access control opens topics that an earlier rule protects.",
    fix="For OpenDDS, change the expression of the open rule so that it does not match the"
    " protected topics.",
    stacks=(Target.OPENDDS,), measured="read in OpenDDS 3.34's source", only_when_asked=True,
)  # fmt: skip
def opened_below(document: GovernanceFile) -> Iterator[Violation]:
    for rule in _rules(document):
        open_below = Patterns[TopicRule]()
        for topic in reversed(rule.topic_rules):
            if _is_half_open(topic):
                open_below.add(topic.topic_expression, topic)
            elif wider := next(open_below.covering(topic.topic_expression), None):
                yield document.at(
                    topic.line, f"{topic.topic_expression!a} is open in OpenDDS, because the later"
                    f" {wider.topic_expression!a} is open",
                )  # fmt: skip


def _is_half_open(topic: TopicRule) -> bool:
    return not (topic.enable_read_access_control and topic.enable_write_access_control)
