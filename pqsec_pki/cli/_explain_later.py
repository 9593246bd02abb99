"""What explain tells of recorded traffic, if some participants are met with classical keys."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any

from pqsec_pki.access import SPEC, Action, Decryptable, Question, decryptable_later
from pqsec_pki.cli import _printing, _settings
from pqsec_pki.cli._names import named
from pqsec_pki.cli._printing import few, printable
from pqsec_pki.documents import ros
from pqsec_pki.errors import UsageError
from pqsec_pki.policy import RightAnswer, fleet_in


def decryptable(
    found: Sequence[RightAnswer], asked: dict[str, Any], now: datetime
) -> list[Decryptable]:
    """What of these rights can be decrypted later because of the participants in `--stock`.

    UsageError if files are asked about, or no stock stack can have credentials of the keystore;
    KeystoreError for the name of no participant.
    """
    if not asked["stock"]:
        return []
    if asked["participant"] is None:
        raise UsageError("--stock is for a keystore: files do not say who gets the keys")
    keystore = _settings.open_keystore()
    if not keystore.profile.runs_in_stock:
        raise UsageError(
            f"--stock: no stock stack can have credentials of profile {keystore.profile.name}"
        )
    stock = named(keystore, asked["stock"])
    for each in stock:
        keystore.refuse_unknown(each)
    questions = [
        (each.policy_input.who, use.answers[0].question) for each in found for use in each.uses
    ]
    fleet = fleet_in(keystore, now, SPEC)
    answer = decryptable_later(
        fleet.governance,
        fleet.members,
        stock,
        topics=[each.topic for _, each in questions if each.topic],
        now=now,
    )
    if not answer.complete:
        _printing.note("the patterns are too many: more topics may be decrypted later")
    rows = [row for who, each in questions for row in _of(who, each, answer.rows)]
    if asked["domain"] is not None:
        rows = [each for each in rows if asked["domain"] in each.domains]
    return list(dict.fromkeys(rows))


def _of(who: str, question: Question, rows: Sequence[Decryptable]) -> Iterator[Decryptable]:
    """The rows about that right of a participant, with its topic alone."""
    for each in rows:
        if question.action is Action.JOIN and who in each.senders:
            yield each
        users = each.senders if question.action is Action.PUBLISH else each.receivers
        is_use = question.action in {Action.PUBLISH, Action.SUBSCRIBE}
        if is_use and who in users and question.topic in each.topics:
            yield replace(each, topics=(question.topic,))


def later_lines(rows: Sequence[Decryptable]) -> Iterator[str]:
    """A line for each."""
    for each in rows:
        topics = ", ".join(printable(ros.said(topic)) for topic in each.topics)
        where = f", partitions {printable(each.where)}" if each.where else ""
        senders, readers, getters = (
            few(map(printable, names)) for names in (each.senders, each.receivers, each.stock)
        )
        why = f"stock {getters} gets the keys" if getters else "stock senders give the keys"
        yield (
            f"later {senders}: {topics}, {each.domains.words}{where}, can be"
            f" decrypted later for all readers ({readers}): {why} under ECDH"
        )
