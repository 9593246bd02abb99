"""pqsec explain: show whether a participant may do something, and why."""

import re
import shlex
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import click

from pqsec_pki.access import (
    INTERPRETATIONS,
    Action,
    DocumentOwner,
    Question,
    is_known,
    topics_named,
)
from pqsec_pki.cli import _completion, _help, _printing, _settings
from pqsec_pki.cli._printing import printable
from pqsec_pki.documents import parse_subject, ros
from pqsec_pki.errors import MalformedError, UsageError, VerificationError, meant
from pqsec_pki.policy import (
    Answer,
    DomainsAnswer,
    PolicyInput,
    answers_by_domain,
    governance_in,
    only_subject,
    permissions_in,
    policy_input_of,
    signed_by,
)

_PATTERN = re.compile(r"[*?\[\]]")


@_help.command(
    examples={
        "Ask about a ROS 2 topic": "pqsec explain --participant /talker --ros-publish /chatter",
        "Ask about a DDS topic on one domain, as Fast DDS decides": (
            "pqsec explain --participant /listener --subscribe rt/chatter --domain 0 --as fastdds"
        ),
        "Ask about files, without a keystore": (
            "pqsec explain --governance governance.yaml --permissions talker.yaml --join"
        ),
    },
    exit_codes={
        0: "allowed",
        1: "denied, or a document is not valid or not signed by the CA",
        3: "a file, the keystore or the participant cannot be read",
    },
)
@click.option(
    "--participant",
    metavar="NAME",
    help="Ask about this participant of the keystore.",
    shell_complete=_completion.participants,
)
@click.option(
    "--governance",
    type=_settings.FILE,
    help="Without a keystore: read the governance from this file (.xml, .p7s or .yaml).",
)
@click.option(
    "--permissions",
    type=_settings.FILE,
    help="Without a keystore: read the permissions from this file.",
)
@click.option(
    "--subject",
    metavar="NAME",
    help="Without a keystore: ask about the certificate with this subject name.",
)
@click.option(
    "--permissions-ca",
    type=_settings.FILE,
    help="Without a keystore: check that this CA signed both documents.",
)
@click.option(
    "--publish",
    metavar="TOPIC",
    help="Ask whether it may publish this DDS topic.",
    shell_complete=_completion.topics,
)
@click.option(
    "--subscribe",
    metavar="TOPIC",
    help="Ask whether it may subscribe to this DDS topic.",
    shell_complete=_completion.topics,
)
@click.option(
    "--relay",
    metavar="TOPIC",
    help="Ask whether it may relay this DDS topic.",
    shell_complete=_completion.topics,
)
@click.option(
    "--ros-publish",
    metavar="TOPIC",
    help="Ask whether it may publish this ROS 2 topic.",
    shell_complete=_completion.ros_topics,
)
@click.option(
    "--ros-subscribe",
    metavar="TOPIC",
    help="Ask whether it may subscribe to this ROS 2 topic.",
    shell_complete=_completion.ros_topics,
)
@click.option("--join", is_flag=True, help="Ask whether it may join the domain.")
@click.option("--domain", type=click.IntRange(0), help="Ask about this DDS domain.  [default: all]")
@click.option(
    "--partition", "partitions", multiple=True, help="Ask about this partition; repeatable."
)
@click.option(
    "--tag",
    "tags",
    multiple=True,
    metavar="NAME=VALUE",
    help="Ask about this data tag; repeatable.",
)
@click.option(
    "--as",
    "stack",
    type=click.Choice([each.name for each in INTERPRETATIONS]),
    help="Answer as this stack interprets the documents.  [default: by the standard, with the"
    " stacks that differ]",
)
@_settings.command_options
def explain(stack: str | None, **asked: Any) -> int:
    """Show whether a participant may do something, and which rule decides.

    Name a participant of the keystore, or the files of one, and one right. Documents of a
    keystore must be signed by its CAs.
    """
    now = _settings.now()
    action, topic = _wanted(asked)
    try:
        policy_input = _policy_input(asked, now)
    except VerificationError as error:
        if _settings.settings().json:
            _printing.emit({"allowed": False, "problems": error.lines}, [])
        raise
    asked_of = Question(
        subject=policy_input.subject,
        domain=asked["domain"] or 0,
        action=action,
        now=now,
        topic=topic,
        partitions=asked["partitions"],
        data_tags=tuple(map(_tag, asked["tags"])),
    )
    found = list(
        answers_by_domain(policy_input, asked_of, stack, everywhere=asked["domain"] is None)
    )
    _print_answers(policy_input, found)
    if not found[0].allowed and topic:
        _note_similar_topic(policy_input, action, topic)
    return 0 if found[0].allowed else 1


def _policy_input(asked: dict[str, Any], now: datetime) -> PolicyInput:
    name, files = asked["participant"], ("governance", "permissions")
    if name and any(asked[each] for each in (*files, "subject", "permissions_ca")):
        raise UsageError(
            "--participant excludes --governance, --permissions, --subject and --permissions-ca"
        )
    if name:
        return policy_input_of(_settings.open_keystore(), name, now)
    if not all(asked[each] for each in files):
        raise UsageError(
            "no participant named",
            hint="use --participant NAME, or --governance FILE and --permissions FILE",
        )
    return _policy_input_in_files(asked, now)


def _policy_input_in_files(asked: dict[str, Any], now: datetime) -> PolicyInput:
    ca: Path | None = asked["permissions_ca"]
    check = signed_by(ca, now) if ca else None
    permissions = permissions_in(asked["permissions"], now, check)
    governance = governance_in(asked["governance"], check)
    for each in (governance, permissions):
        if each.signed and not each.verified:
            _printing.note(
                f"{printable(str(each.path))}: the signature was not checked: use --permissions-ca"
            )
    subject = _subject(asked["subject"]) if asked["subject"] else only_subject(permissions)
    return PolicyInput(who=subject, subject=subject, governance=governance, permissions=permissions)


def _subject(text: str) -> str:
    try:
        parse_subject(text)
    except MalformedError as error:
        raise UsageError(f"--subject: {error}", hint=error.hint) from None
    return text


def _wanted(asked: dict[str, Any]) -> tuple[Action, str | None]:
    """The action and the DDS topic. UsageError unless there is exactly one question."""
    wanted = [
        (action, prefix, name)
        for action in Action
        for prefix in ("", "ros_")
        if (name := asked.get(f"{prefix}{action}"))
    ]
    if len(wanted) != 1:
        raise UsageError(
            "ask exactly one question",
            hint="use --publish TOPIC, --subscribe TOPIC, --relay TOPIC, --ros-publish TOPIC,"
            " --ros-subscribe TOPIC or --join",
        )
    action, prefix, name = wanted[0]
    if action is Action.JOIN:
        return action, None
    if _PATTERN.search(name):
        instead = f"--{'ros-' if prefix else ''}topic {shlex.quote(printable(name))}"
        raise UsageError(
            f"{printable(name)} is a pattern, and explain needs the name of one topic",
            hint=f"`pqsec who-may {instead}` lists the topics that match it",
        )
    return action, ros.topic(name) if prefix else name


def _tag(text: str) -> tuple[str, str]:
    name, found, value = text.partition("=")
    if not found:
        raise UsageError(f"{text!r} is not a data tag", hint="write it as --tag NAME=VALUE")
    return name, value


def _note_similar_topic(policy_input: PolicyInput, action: Action, topic: str) -> None:
    """Note a similar topic name if no rule names or matches `topic`."""
    who = DocumentOwner(
        name=policy_input.who,
        subject=policy_input.subject,
        permissions=policy_input.permissions.value,
    )
    named = topics_named([who])
    if topic in named or is_known(topic, named):
        return
    if action is not Action.RELAY and (instead := _ros_topic(topic)):
        _printing.note(f"{topic} is the ROS 2 name of {instead}: ask with --ros-{action} {topic}")
    elif instead := meant(topic, named):
        _printing.note(
            f"no rule of {printable(policy_input.who)} names {printable(topic)}; {instead}"
        )


def _ros_topic(name: str) -> str:
    """The DDS topic of a ROS 2 name; empty if `name` is not a ROS 2 name."""
    try:
        return ros.topic(name)
    except UsageError:
        return ""


# Printing


def _print_answers(policy_input: PolicyInput, found: list[DomainsAnswer]) -> None:
    question = found[0].question
    value = {
        "participant": policy_input.who,
        "subject": question.subject,
        "action": question.action.value,
        "topic": question.topic,
        "partitions": question.partitions,
        "data_tags": list(map("=".join, question.data_tags)),
        "at": question.now,
        "verified": policy_input.governance.verified and policy_input.permissions.verified,
        **found[0].to_json(policy_input),
        "elsewhere": [each.to_json(policy_input) for each in found[1:]],
    }
    _printing.emit(value, [line for each in found for line in _lines(policy_input, each)])


def _lines(policy_input: PolicyInput, finding: DomainsAnswer) -> Iterator[str]:
    question, answer, others = finding.question, finding.answer, finding.others
    what = "join" if question.topic is None else f"{question.action} {printable(question.topic)}"
    title = f"{printable(policy_input.who)}: {what}, {finding.where}"
    yield f"{answer.word.upper():<4}  {title}, by {answer.interpretation.title}"
    yield from _why(policy_input, answer, "      ")
    for number, word in enumerate(answer.protection):
        yield f"{'' if number else '      protected':<17} {word}"
    if others:
        yield from _compared(policy_input, answer, others)


def _compared(policy_input: PolicyInput, answer: Answer, others: list[Answer]) -> Iterator[str]:
    alike = [other.interpretation.title for other in others if not other.differs(answer)]
    if alike:
        yield f"same  {', '.join(alike)}"
    for other in others:
        if other.differs(answer):
            yield f"{other.word.upper():<4}  {other.interpretation.title} decides differently"
            yield from _why(policy_input, other, "      ")
        elif other.disagreement:
            yield f"note  {other.interpretation.title}: {other.disagreement}"
        if other.hazard:
            yield f"note  {other.interpretation.title}: {other.hazard}"


def _why(policy_input: PolicyInput, answer: Answer, indent: str) -> Iterator[str]:
    disagreement = f"; {answer.disagreement}" if answer.disagreement else ""
    yield f"{indent}{printable(answer.decision.reason)}{disagreement}"
    if place := policy_input.place(answer.decision):
        criteria = policy_input.criteria_line(answer.decision)
        topics = f" (its topics from line {criteria})" if criteria else ""
        yield f"{indent}{printable(str(place[0]))}:{place[1]}{topics}"
