"""Topics of some participants that look like mistakes, beside those of their whole keystore."""

from collections.abc import Iterable, Iterator, Sequence
from datetime import datetime

from pqsec_pki.access import (
    CriteriaRight,
    follows_locale,
    open_rights,
    rights_of,
    without_counterpart,
)
from pqsec_pki.documents import ros
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import Keystore
from pqsec_pki.policy.participants import own_permissions, shared_governance

MAX_PARTICIPANTS = 200
"""Participants of a keystore whose other documents are read, 1 ms each: a command that issues one
participant must not wait for 2,000. `pqsec check` has no limit."""


def doubtful_topics(keystore: Keystore, names: Iterable[str], now: datetime) -> Iterator[str]:
    """What is doubtful about the topics of these participants, in words; no signature is checked.

    A doubled slash, a pattern that depends on the locale; and a topic without a counterpart, if a
    topic with a similar spelling has one. Nothing if a document cannot be read.
    """
    try:
        rights, chosen = _rights(keystore, now), set(names)
    except PqsecError:
        return
    own = [each for each in rights if each.owner in chosen]
    topics = (topic for each in own for topic in each.topics)
    for topic in dict.fromkeys(filter(ros.doubled_slash, topics)):
        yield f"{topic} has //, which no ROS 2 name may have"
    patterns = (name for each in own for name in (*each.topics, *each.partitions))
    yield from map(locale_doubt, dict.fromkeys(filter(follows_locale, patterns)))
    yield from (str(each) for each in without_counterpart(own, rights) if each.meant)


def locale_doubt(pattern: str) -> str:
    """What is doubtful about a pattern that depends on the locale, and the way out."""
    return (
        f"what {pattern} matches in Fast DDS depends on the locale of the process (PQS244): list"
        " ASCII characters, as [0-9a-z], or write a star"
    )


def _rights(keystore: Keystore, now: datetime) -> Sequence[CriteriaRight]:
    names = keystore.names()
    if len(names) > MAX_PARTICIPANTS:
        return ()
    found = list(open_rights(shared_governance(keystore, None).value))
    for name in names:
        found += rights_of(name, own_permissions(keystore, name, now, None).value.grants)
    return found
