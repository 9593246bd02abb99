"""What a ROS 2 participant may do: the domains that it can join, and whether a node can run."""

import re
from functools import cached_property
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.access import Action, InterpretedPolicy, Question
from pqsec_pki.credentials import CERTIFICATE, GOVERNANCE, PERMISSIONS
from pqsec_pki.documents import (
    Governance,
    Grant,
    Permissions,
    Subject,
    parse_subject,
    ros,
    same_subject,
)
from pqsec_pki.errors import MalformedError, located
from pqsec_pki.keystore import load_certificate
from pqsec_pki.smime import document_in
from pqsec_pki.vendors.enclave import StackEnclave

_PART = "[A-Za-z_][A-Za-z0-9_]*"
_REPLIES = [t.rpartition("/")[2] for t in ros.node_minimum("/n").publish if t.startswith("rr/")]
_OF_A_NODE = re.compile(rf"rr(?P<node>(?:/{_PART})+)/(?:\*(?:Reply)?|{'|'.join(_REPLIES)})")
"""Reply topics of the services that every node has; they contain the node's name."""
_OF_NODES = re.compile(rf"rr(?P<nodes>(?:/{_PART})*/(?:{_PART})?\*)(?:Reply)?")
"""Reply topics for a pattern of node names, such as those of ROS 2's own command line."""


@dataclass(frozen=True)
class Needs:
    """A participant's documents, for questions. Signatures and dates are not checked."""

    enclave: str
    subject: str
    governance: Governance
    permissions: Permissions

    @classmethod
    def of(cls, enclave: StackEnclave) -> Self:
        """From the files of the enclave; the error for an unreadable file names it."""
        documents = {}
        for name in (GOVERNANCE, PERMISSIONS):
            with located(enclave.folder / name):
                documents[name] = document_in(read(enclave.folder / name))
        with located(enclave.folder / GOVERNANCE):
            governance = Governance.from_xml(documents[GOVERNANCE])
        with located(enclave.folder / PERMISSIONS):
            permissions = Permissions.from_xml(documents[PERMISSIONS])
        subject = load_certificate(enclave.folder / CERTIFICATE).subject_name
        return cls(enclave.name, subject, governance, permissions)

    @cached_property
    def _grant(self) -> Grant | None:
        """The participant's first grant."""
        own = parse_subject(self.subject)
        return next((g for g in self.permissions.grants if _is_for(g, own)), None)

    @cached_property
    def _policy(self) -> InterpretedPolicy:
        return InterpretedPolicy(self.governance, self.permissions)

    def may(self, action: Action, domain: int, topic: str | None = None) -> str:
        """Why it may not do that while the grant is valid; empty if it may."""
        if self._grant is None:
            return f"no grant is for {self.subject}"
        question = Question(
            subject=self.subject,
            domain=domain,
            action=action,
            now=self._grant.not_before,
            topic=topic,
        )
        decision = self._policy.decide(question)
        return "" if decision.allowed else decision.reason

    @cached_property
    def domains(self) -> tuple[int, ...]:
        """The domains that it may join, ascending."""
        governed = {d for rule in self.governance.domain_rules for d in rule.domains.ids()}
        return tuple(d for d in sorted(governed) if not self.may(Action.JOIN, d))

    @cached_property
    def nodes(self) -> tuple[str, ...]:
        """The nodes that the permissions are for; the enclave's own name if they show none.

        A name that ends in `*` means all nodes whose names begin so.
        """
        topics = [
            topic
            for rule in (self._grant.rules if self._grant else ())
            for criteria in rule.publish
            for topic in criteria.topics
        ]
        found = dict.fromkeys(told["node"] for t in topics if (told := _OF_A_NODE.fullmatch(t)))
        any_of = dict.fromkeys(told["nodes"] for t in topics if (told := _OF_NODES.fullmatch(t)))
        return tuple(found) or tuple(any_of) or (self.enclave,)

    def lack(self, node: str, domain: int) -> str:
        """What the node lacks to run on that domain; empty if nothing."""
        needed = ros.node_minimum(node.replace("*", "x"))
        missing = {
            "publish": [t for t in needed.publish if self.may(Action.PUBLISH, domain, t)],
            "subscribe to": [t for t in needed.subscribe if self.may(Action.SUBSCRIBE, domain, t)],
        }
        denied = [f"{way} {', '.join(topics)}" for way, topics in missing.items() if topics]
        return f"it would exit at start: it may not {' nor '.join(denied)}" if denied else ""


def _is_for(grant: Grant, own: Subject) -> bool:
    try:
        return same_subject(parse_subject(grant.subject_name), own)
    except MalformedError:
        return False
