"""Finds a topic that one participant may publish and another may subscribe to."""

from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Self, TypeVar

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.access import Action, InterpretedPolicy, Question
from pqsec_pki.credentials import CERTIFICATE, GOVERNANCE, PERMISSIONS
from pqsec_pki.documents import Governance, Permissions
from pqsec_pki.errors import UsageError, located
from pqsec_pki.keystore import Keystore, load_certificate
from pqsec_pki.smime import document_in
from pqsec_pki.vendors import StackEnclave

Value = TypeVar("Value")

_ANY = "pqsec/trial"
"""The topic for participants that may use every topic."""
_PATTERN = set("*?[")


@dataclass(frozen=True, slots=True, kw_only=True)
class TopicRoute:
    """The sender, the receiver, the domain and the topic."""

    sender: str
    receiver: str
    domain: int
    topic: str


def topic_route(
    keystore: Keystore, names: tuple[str, str], domain: int, now: datetime
) -> TopicRoute:
    """The first topic that the first one may publish to the second, or else the reverse.

    Topics that only the sender may publish come first: all nodes of ROS 2 may publish some
    topics. UsageError if there is none.
    """
    first, second = (_Participant.of(keystore, name, domain, now) for name in names)
    ways = [
        (receiver.may(Action.PUBLISH, topic), sender.name, receiver.name, topic)
        for sender, receiver in ((first, second), (second, first))
        for topic in (*sender.names(Action.PUBLISH), *receiver.names(Action.SUBSCRIBE), _ANY)
        if sender.may(Action.PUBLISH, topic) and receiver.may(Action.SUBSCRIBE, topic)
    ]
    if not ways:
        raise UsageError(
            f"on domain {domain} neither of {names[0]} and {names[1]} may publish a topic that"
            " the other may subscribe to",
            hint="`pqsec who-may` shows the permissions; --topic tries a topic anyway",
        )
    _, sender, receiver, topic = min(ways, key=lambda way: way[0])
    return TopicRoute(sender=sender, receiver=receiver, domain=domain, topic=topic)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Participant:
    """One participant, and its documents, which its stack will verify."""

    name: str
    subject: str
    permissions: Permissions
    policy: InterpretedPolicy
    domain: int
    now: datetime

    @classmethod
    def of(cls, keystore: Keystore, name: str, domain: int, now: datetime) -> Self:
        enclave = StackEnclave.find(keystore, name)
        certificate = load_certificate(enclave.folder / CERTIFICATE)
        permissions = _document(enclave.folder / PERMISSIONS, Permissions.from_xml)
        governance = _document(enclave.folder / GOVERNANCE, Governance.from_xml)
        return cls(
            name=enclave.name,
            subject=certificate.subject_name,
            permissions=permissions,
            policy=InterpretedPolicy(governance, permissions),
            domain=domain,
            now=now,
        )

    def names(self, action: Action) -> Iterator[str]:
        """The topics that its rules name for the action, without patterns."""
        for grant in self.permissions.grants:
            for rule in grant.rules:
                for criteria in rule.publish if action is Action.PUBLISH else rule.subscribe:
                    yield from (topic for topic in criteria.topics if not _PATTERN & set(topic))

    def may(self, action: Action, topic: str) -> bool:
        """Whether the standard allows it the action."""
        question = Question(
            subject=self.subject, domain=self.domain, action=action, now=self.now, topic=topic
        )
        return self.policy.decide(question).allowed


def _document(path: Path, parse: Callable[[bytes], Value]) -> Value:
    with located(path):
        return parse(document_in(read(path)))
