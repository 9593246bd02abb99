"""Rules about topic and domain rules that are never reached, or that open other topics."""

from collections.abc import Iterator

from pqsec_pki.documents import TopicRule
from pqsec_pki.lint.document import GovernanceFile
from pqsec_pki.lint.documents._shadows import Patterns, covers_all, covers_domains
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.stacks import Stack

ERROR, WARNING, _ = Severity
MAX_COMPARED = 64
"""How many earlier domain rules a rule is compared with; real documents have fewer."""


@lint_rule(
    "PQS227", WARNING, "a topic rule that is never reached",
    why="The first topic rule that matches decides. An earlier rule matches every topic that this"
    " rule matches.",
    fix="Put the narrower rule first.",
    bad="""
        <topic_rule>
          <topic_expression>*</topic_expression>
          ...
        </topic_rule>
        <topic_rule>
          <topic_expression>rt/chatter</topic_expression>
          ...
        </topic_rule>
    """,
    good="""
        <topic_rule>
          <topic_expression>rt/chatter</topic_expression>
          ...
        </topic_rule>
        <topic_rule>
          <topic_expression>*</topic_expression>
          ...
        </topic_rule>
    """,
)  # fmt: skip
def shadowed_topic(document: GovernanceFile) -> Iterator[Violation]:
    for rule in document.domain_rules:
        before = Patterns[TopicRule]()
        for topic in rule.topic_rules:
            if earlier := next(before.covering(topic.topic_expression), None):
                yield document.at(
                    topic.line,
                    f"{topic.topic_expression!a} is never reached:"
                    f" the earlier {earlier.topic_expression!a} covers it",
                )
            before.add(topic.topic_expression, topic)


@lint_rule(
    "PQS228", WARNING, "a domain rule that is never reached",
    why="The first domain rule that matches decides. An earlier rule matches all domains of this"
    " rule.",
    fix="Remove the domains from one of the two rules.",
    bad="""
        <domain_rule>
          <domains>
            <id_range><min>0</min><max>9</max></id_range>
          </domains>
          ...
        </domain_rule>
        <domain_rule>
          <domains><id>5</id></domains>
          ...
        </domain_rule>
    """,
    good="""
        <domain_rule>
          <domains><id>5</id></domains>
          ...
        </domain_rule>
        <domain_rule>
          <domains>
            <id_range><min>0</min><max>9</max></id_range>
          </domains>
          ...
        </domain_rule>
    """,
)  # fmt: skip
def shadowed_domains(document: GovernanceFile) -> Iterator[Violation]:
    rules = document.domain_rules
    for place, rule in enumerate(rules):
        if any(covers_domains(each.domains, rule.domains) for each in rules[:place][:MAX_COMPARED]):
            yield document.at(rule.line, f"domains {rule.domains} are covered by an earlier rule")


@lint_rule(
    "PQS229", WARNING, "topics that no topic rule matches",
    why="Stacks refuse to create endpoints of a topic that no topic rule matches.",
    fix="Add a last topic rule for *, with the strictest protection.",
    measured="read in Cyclone DDS's and Fast DDS's source",
    bad="<topic_expression>rt/*</topic_expression>",
    good="<topic_expression>*</topic_expression>",
)  # fmt: skip
def no_rule_for_the_rest(document: GovernanceFile) -> Iterator[Violation]:
    for rule in document.domain_rules:
        if not any(covers_all(topic.topic_expression) for topic in rule.topic_rules):
            yield document.at(rule.line, "there is no topic rule for all other topics (*)")


@lint_rule(
    "PQS230", ERROR, "OpenDDS creates no participant with this governance",
    why="OpenDDS ignores the permissions here (OpenDDS issue 5007). It creates a participant only"
    " if join access control is off, or if a topic rule has no read or no write access control. All"
    " other stacks accept this governance, and pqsec writes it.",
    fix="For OpenDDS, add a first topic rule for a name that is not used, with"
    " enable_read_access_control false. It opens no other topic.",
    stacks={Stack.OPENDDS: "3.34"}, measured="read in OpenDDS 3.34's source", only_when_asked=True,
    bad="""
        <topic_rule>
          <topic_expression>*</topic_expression>
          ...
        </topic_rule>
    """,
    good="""
        <topic_rule>
          <topic_expression>not/used</topic_expression>
          ...
          <enable_read_access_control>false</enable_read_access_control>
          ...
        </topic_rule>
        <topic_rule>
          <topic_expression>*</topic_expression>
          ...
        </topic_rule>
    """,
)  # fmt: skip
def no_participant_in_opendds(document: GovernanceFile) -> Iterator[Violation]:
    for rule in document.domain_rules:
        if rule.enable_join_access_control and not any(
            each.is_half_open for each in rule.topic_rules
        ):
            yield document.at(
                rule.line, f"OpenDDS creates no participant on domains {rule.domains}:"
                " joining and every topic have access control",
            )  # fmt: skip


@lint_rule(
    "PQS240", WARNING, "a topic rule that opens protected topics in OpenDDS",
    why="OpenDDS checks permissions only if all matching topic rules require it. A later rule"
    " without access control opens topics that an earlier rule protects.",
    fix="For OpenDDS, change the expression of the open rule so that it does not match the"
    " protected topics.",
    stacks={Stack.OPENDDS: "3.34"}, measured="read in OpenDDS 3.34's source", only_when_asked=True,
    bad="""
        <topic_rule>
          <topic_expression>rt/cmd</topic_expression>
          ...
        </topic_rule>
        <topic_rule>
          <topic_expression>rt/*</topic_expression>
          ...
          <enable_read_access_control>false</enable_read_access_control>
          ...
        </topic_rule>
    """,
    good="""
        <topic_rule>
          <topic_expression>rt/cmd</topic_expression>
          ...
        </topic_rule>
        <topic_rule>
          <topic_expression>rt/state*</topic_expression>
          ...
          <enable_read_access_control>false</enable_read_access_control>
          ...
        </topic_rule>
    """,
)  # fmt: skip
def opened_in_opendds(document: GovernanceFile) -> Iterator[Violation]:
    for rule in document.domain_rules:
        open_below = Patterns[TopicRule]()
        for topic in reversed(rule.topic_rules):
            if topic.is_half_open:
                open_below.add(topic.topic_expression, topic)
            elif wider := next(open_below.covering(topic.topic_expression), None):
                yield document.at(
                    topic.line, f"{topic.topic_expression!a} is open in OpenDDS, because the later"
                    f" {wider.topic_expression!a} is open",
                )  # fmt: skip
