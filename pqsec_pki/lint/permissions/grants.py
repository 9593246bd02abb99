"""Rules about permissions: too many rights, rules without effect, what stacks ignore."""

from collections.abc import Iterator
from itertools import pairwise

from pqsec_pki.documents import DefaultAction, Grant
from pqsec_pki.lint.document import ACTIONS, PermissionsFile
from pqsec_pki.lint.documents._shadows import covers_all
from pqsec_pki.lint.permissions._names import parsed, shown
from pqsec_pki.lint.rule import Severity, Target, Violation, lint_rule

ERROR, WARNING, INFO = Severity
_CYCLONE, _FAST, _OPENDDS = Target.CYCLONEDDS, Target.FASTDDS, Target.OPENDDS


@lint_rule(
    "PQS251", WARNING, "default ALLOW",
    why="With default ALLOW, everything that no rule matches is allowed, for example after a"
    " forgotten rule. In Fast DDS it has no effect on topics, because Fast DDS never uses the"
    " default for a topic.",
    fix="Write <default>DENY</default>, and an allow_rule for what the participant needs.",
)  # fmt: skip
def default_allow(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        if grant.default is DefaultAction.ALLOW:
            yield document.at(
                grant.line, f"{shown(grant)}: everything that no rule matches is allowed"
            )


@lint_rule(
    "PQS252", ERROR, "default ALLOW without an allow_rule",
    why="Fast DDS lets a participant join only if an allow_rule names the domain. The default does"
    " not matter.",
    fix="Add an allow_rule for the domain.",
    stacks=(_FAST,),
    rows=("`<default>ALLOW` and no rule", "no rule for the domain, default ALLOW"),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2",
)  # fmt: skip
def nothing_allowed(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        if grant.default is DefaultAction.ALLOW and not any(rule.allow for rule in grant.rules):
            yield document.at(
                grant.line, f"{shown(grant)}: Fast DDS requires an allow_rule to join"
            )


@lint_rule(
    "PQS253", WARNING, "everything is allowed",
    why="An attacker who controls this participant can publish or read any topic.",
    fix="Name the topics that the participant needs. `pqsec permissions new` starts with a node's"
    " own topics.",
)  # fmt: skip
def allow_all(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        for rule in grant.rules:
            for action in ACTIONS if rule.allow else ():
                for criteria in getattr(rule, action):
                    if any(map(covers_all, criteria.topics)):
                        yield document.at(
                            criteria.line, f"{shown(grant)} may {action} every topic (*)"
                        )


@lint_rule(
    "PQS257", WARNING, "topics and partitions in different criteria",
    why="Fast DDS combines the criteria of a rule: it allows a topic of one in the partitions of"
    " another. Cyclone DDS and the standard keep them separate.",
    fix="Write one allow_rule for each.",
    stacks=(_FAST,), rows=("topic in one `<publish>`, partition in another",),
    measured="Fast DDS 2.9.1, 3.1.2, 3.6.2",
)  # fmt: skip
def mixed_criteria(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        for rule in grant.rules:
            for action in ACTIONS if rule.allow else ():
                for one, other in pairwise(getattr(rule, action)):
                    if one.partitions != other.partitions and one.topics != other.topics:
                        yield document.at(
                            other.line, f"Fast DDS mixes the topics and partitions of the {action}"
                            " elements of one rule",
                        )  # fmt: skip


@lint_rule(
    "PQS258", INFO, "allowed only without a partition",
    why="Other rules of the grant name partitions. An allow_rule without partitions applies to"
    " endpoints without a partition, not to endpoints in every partition.",
    fix="Name the partitions here too; <partition>*</partition> means all.",
    rows=("allow without partitions, endpoint in P", "allow partition P, endpoint in none"),
    measured="all six stacks",
)  # fmt: skip
def default_partition(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        criteria = [
            each
            for rule in grant.rules
            if rule.allow
            for action in ACTIONS
            for each in getattr(rule, action)
        ]
        if any(each.partitions for each in criteria):
            for each in criteria:
                if not each.partitions:
                    yield document.at(
                        each.line, f"{_some(each.topics)}: allowed only without a partition"
                    )


@lint_rule(
    "PQS259", WARNING, "relay rules, which stacks ignore",
    why="Cyclone DDS and OpenDDS never check <relay>. Fast DDS checks it only for a peer, as a"
    " right to subscribe.",
    fix="Do not rely on <relay>.",
    stacks=(_CYCLONE, _FAST, _OPENDDS), rows=("`<relay>`, `<data_tags>` present (ignored)",),
    measured="all six stacks; OpenDDS by source",
)  # fmt: skip
def relay(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all("relay"):
        yield document.at(node, "<relay> is not enforced as such by any stack")


@lint_rule(
    "PQS260", WARNING, "data tags, which stacks ignore",
    why="No stack checks data tags: what they should limit is allowed with any tag.",
    fix="Use partitions or other topics.",
    stacks=(_CYCLONE, _FAST, _OPENDDS), rows=("`<relay>`, `<data_tags>` present (ignored)",),
    measured="all six stacks; OpenDDS by source",
)  # fmt: skip
def data_tags(document: PermissionsFile) -> Iterator[Violation]:
    for node in document.all("data_tags"):
        yield document.at(node, "<data_tags> are not enforced by any stack")


@lint_rule(
    "PQS261", WARNING, "two grants for one subject",
    why="The first grant decides, even if it has expired. Cyclone DDS then refuses the participant,"
    " Fast DDS tries the next grant, and OpenDDS ignores the second one.",
    fix="Put the rules of both into one grant.",
    rows=("first grant for subject not valid, second valid",),
    measured="Cyclone DDS 0.10.2, 0.10.5, 11.0.1; OpenDDS by source",
)  # fmt: skip
def two_grants(document: PermissionsFile) -> Iterator[Violation]:
    before: dict[object, Grant] = {}
    for grant in document.grants:
        # A non-ASCII name needs two grants, one spelling for each group of stacks (PQS418, PQS425).
        name: object = (
            parsed(grant.subject_name) or grant.subject_name,
            grant.subject_name.isascii(),
        )
        if name in before:
            first = document.line(before[name].line)
            yield document.at(grant.line, f"{shown(grant)} already has a grant in line {first}")
        before.setdefault(name, grant)


@lint_rule(
    "PQS256", WARNING, "a deny_rule for some partitions only",
    why="Cyclone DDS and Fast DDS deny the topic in every partition. OpenDDS denies it only in"
    " these partitions, as does Cyclone DDS if an earlier allow_rule names the topic. Both compare"
    " names: an endpoint in partition secre? or s* avoids a deny_rule for secret.",
    fix="Name the partitions in an allow_rule instead, and deny the topic without partitions.",
    rows=("deny T only in partition Q, endpoint in none",), measured="all six stacks",
)  # fmt: skip
def deny_in_partition(document: PermissionsFile) -> Iterator[Violation]:
    for grant in document.grants:
        for rule in grant.rules:
            for action in () if rule.allow else ACTIONS:
                for criteria in getattr(rule, action):
                    if criteria.partitions:
                        yield document.at(
                            criteria.line, "the topics are denied in every partition, not only in"
                            f" {_some(criteria.partitions)}",
                        )  # fmt: skip


def _some(words: tuple[str, ...]) -> str:
    """The first three, and how many more there are."""
    rest = f" and {len(words) - 3} more" if len(words) > 3 else ""  # noqa: PLR2004 -- a few
    return ", ".join(ascii(word)[1:-1] for word in words[:3]) + rest
