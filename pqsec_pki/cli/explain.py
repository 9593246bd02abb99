"""pqsec explain: show whether a participant may do something, and why."""

from collections.abc import Callable, Sequence
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any

import click

from pqsec_pki.access import (
    Action,
    Decryptable,
    DocumentOwner,
    Question,
    interpretations_named,
    is_known,
    topics_named,
)
from pqsec_pki.cli import _completion, _explain_asked, _help, _pager, _printing, _settings
from pqsec_pki.cli._explain_later import decryptable, later_lines
from pqsec_pki.cli._explain_lines import lines_of, right_lines
from pqsec_pki.cli._names import named
from pqsec_pki.cli._printing import printable
from pqsec_pki.cli._stack_version import StackVersion
from pqsec_pki.documents import parse_subject, ros
from pqsec_pki.errors import MalformedError, UsageError, VerificationError, meant
from pqsec_pki.keystore import is_several
from pqsec_pki.policy import (
    PolicyInput,
    RightAnswer,
    Use,
    answer_right,
    governance_in,
    only_subject,
    permissions_in,
    policy_input_of,
    signed_by,
)

Answering = Callable[[PolicyInput], RightAnswer]
"""Answers the question for one participant."""


@_help.command(
    examples={
        "Ask about a ROS 2 topic": "pqsec explain /talker --ros-publish /chatter",
        "Ask about a DDS topic on one domain, as Fast DDS decides": (
            "pqsec explain /listener --subscribe rt/chatter --domain 0 --as fastdds"
        ),
        "Ask whether all of a robot's nodes may publish a ROS 2 topic": (
            "pqsec explain '/fleet/*' --ros-publish /chatter"
        ),
        "Ask also what can be decrypted later because /old gets its key by ECDH": (
            "pqsec explain /talker --publish rt/chatter --stock /old"
        ),
        "Ask about files, without a keystore": (
            "pqsec explain --governance governance.yaml --permissions talker.yaml --join"
        ),
    },
    exit_codes={
        0: "allowed, for all participants and topics",
        1: "denied, or not known: a stack crashes, readers differ, or a document is not valid",
        3: "a file, the keystore or the participant cannot be read",
    },
)
@click.argument("name", required=False, metavar="[NAME]", shell_complete=_completion.participants)
@click.option(
    "--participant",
    metavar="NAME",
    help="The same as NAME.",
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
@_explain_asked.options
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
    type=StackVersion(),
    help="Answer as this stack interprets the documents, or this version of it.  [default: by the"
    " standard, with the stacks that differ]",
)
@click.option(
    "--stock",
    multiple=True,
    metavar="NAME",
    help="Count this participant, or all that a pattern or group matches, as met with classical"
    " keys, and name what can be decrypted later because it gets keys; repeatable.",
    shell_complete=_completion.participants,
)
@_pager.option
@_settings.command_options
def explain(name: str | None, stack: str | None, **asked: Any) -> int:
    """Show whether a participant may do something, and which rule decides.

    The answer is YES or NO; CRASHES if the documents end the stack's process; or READERS
    DIFFER if a value has a comment or other markup, which stacks read differently.

    Name a participant of the keystore, or the files of one, and one right. Documents of a
    keystore must be signed by its CAs. A right may take several topics, as a ROS 2 service
    does: all must be allowed on one domain. NAME may be a pattern ('/robot1/*') or a group
    (@hall1): all must have the right.

    With --stock, it also names the topics of the right that a quantum computer can decrypt
    later, for all their readers: a stock participant gets a writer's keys under ECDH.
    """
    if name is not None and asked["participant"] is not None:
        raise UsageError("NAME and --participant exclude each other: they mean the same")
    asked["participant"] = asked["participant"] if name is None else name
    now = _settings.now()
    answer = partial(
        answer_right,
        right=_explain_asked.right_asked(asked),
        question=_question(asked, now),
        chosen=interpretations_named(stack) if stack else (),
        everywhere=asked["domain"] is None,
    )
    names = _participants(asked["participant"])
    if len(names) > 1:
        return _of_several(names, answer, asked, now)
    return _of_one({**asked, "participant": names[0]}, answer, now)


def _question(asked: dict[str, Any], now: datetime) -> Question:
    """The question about each topic, which gets the action that the right needs."""
    return Question(
        subject="",
        domain=asked["domain"] or 0,
        action=Action.JOIN,
        now=now,
        partitions=asked["partitions"],
        data_tags=tuple(map(_tag, asked["tags"])),
    )


def _of_one(asked: dict[str, Any], answer: Answering, now: datetime) -> int:
    try:
        policy_input = _policy_input(asked, now)
    except VerificationError as error:
        if _settings.settings().json:
            _printing.emit({"allowed": False, "problems": error.lines}, [])
        raise
    found = answer(policy_input)
    later = decryptable([found], asked, now)
    if len(found.uses) > 1:
        value = {"allowed": found.yes_or_no, "answer": found.word, "answers": [found]}
        lines = [*right_lines(found), *later_lines(later)]
        _printing.emit({**value, "decryptable_later": later}, lines)
    else:
        _print_one(policy_input, found.uses[0], later)
    return 0 if found.allowed else 1


def _participants(given: str | None) -> list[str | None]:
    """The participants that the name or pattern matches; one None if files are named instead."""
    if given is None or not is_several(given):
        return [given]
    return list(named(_settings.open_keystore(), [given]))


def _of_several(
    names: Sequence[str | None], answer: Answering, asked: dict[str, Any], now: datetime
) -> int:
    """Print the answer for each; 0 if all may. A participant with invalid documents may not."""
    keystore = _settings.open_keystore()
    values, lines, all_may = list[dict[str, object]](), list[str](), True
    every = list[RightAnswer]()
    for name in filter(None, names):
        try:
            policy_input = policy_input_of(keystore, name, now)
        except VerificationError as error:
            all_may = False
            values.append({"participant": name, "allowed": False, "problems": error.lines})
            lines += [f"NO    {name}: {printable(line)}" for line in error.lines]
            continue
        found = answer(policy_input)
        every.append(found)
        all_may = all_may and found.allowed
        values.append(found.to_json())
        lines += right_lines(found)
    later = decryptable(every, asked, now)
    value = {"allowed": all_may, "answers": values, "decryptable_later": later}
    _printing.emit(value, [*lines, *later_lines(later)])
    return 0 if all_may else 1


def _print_one(policy_input: PolicyInput, use: Use, later: Sequence[Decryptable]) -> None:
    answers = use.answers
    if use.topic is not None and use.topic != answers[0].question.topic:
        _printing.note(f"{printable(use.topic)} is a pattern: the answer is for one such topic")
    lines = [line for each in answers for line in lines_of(policy_input, each)]
    value = use.to_json(policy_input) | {"decryptable_later": later}
    _printing.emit(value, [*lines, *later_lines(later)])
    question = answers[0].question
    if not answers[0].allowed and question.topic:
        _note_similar_topic(policy_input, question.action, question.topic)


def _policy_input(asked: dict[str, Any], now: datetime) -> PolicyInput:
    name, files = asked["participant"], ("governance", "permissions")
    if name and any(asked[each] for each in (*files, "subject", "permissions_ca")):
        raise UsageError(
            "NAME excludes --governance, --permissions, --subject and --permissions-ca"
        )
    if name:
        return policy_input_of(_settings.open_keystore(), name, now)
    if not all(asked[each] for each in files):
        raise UsageError(
            "no participant named",
            hint="give its NAME, or --governance FILE and --permissions FILE",
        )
    return _policy_input_in_files(asked, now)


def _policy_input_in_files(asked: dict[str, Any], now: datetime) -> PolicyInput:
    ca: Path | None = asked["permissions_ca"]
    check = signed_by(ca, now) if ca else None
    permissions = permissions_in(asked["permissions"], now, check, any_markup=True)
    governance = governance_in(asked["governance"], check, any_markup=True)
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
