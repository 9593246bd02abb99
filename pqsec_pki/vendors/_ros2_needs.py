"""What a ROS 2 participant may do: which domains it can join, and whether a node can live."""

import re
from dataclasses import dataclass
from functools import cached_property
from typing import Self

from pqsec_pki._files import read
from pqsec_pki.access import Action, Policy, Question
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
from pqsec_pki.vendors.enclave import Enclave

_PART = "[A-Za-z_][A-Za-z0-9_]*"
_REPLIES = [t.rpartition("/")[2] for t in ros.node_minimum("/n").publish if t.startswith("rr/")]
_OF_A_NODE = re.compile(rf"rr(?P<node>(?:/{_PART})+)/(?:\*(?:Reply)?|{'|'.join(_REPLIES)})")
"""Replies of the services that every node has; the node can be told from them."""
_OF_NODES = re.compile(rf"rr(?P<nodes>(?:/{_PART})*/(?:{_PART})?\*)(?:Reply)?")
"""Replies of nodes whose names begin so, such as those of ROS 2's own command line."""


@dataclass(frozen=True)
class Needs:
    """The documents of a participant, to be asked. Signatures and dates are not looked at."""

    enclave: str
    subject: str
    governance: Governance
    permissions: Permissions

    @classmethod
    def of(cls, enclave: Enclave) -> Self:
        """Of the files in the enclave; what cannot be read is an error that names it."""
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
        """The participant's own, the first."""
        own = parse_subject(self.subject)
        return next((g for g in self.permissions.grants if _is_for(g, own)), None)

    @cached_property
    def _policy(self) -> Policy:
        return Policy(self.governance, self.permissions)

    def may(self, action: Action, domain: int, topic: str | None = None) -> str:
        """Why not; empty if it may, at a time when the grant holds."""
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
        """Those it may join, ascending."""
        governed = {d for rule in self.governance.domain_rules for d in rule.domains.ids()}
        return tuple(d for d in sorted(governed) if not self.may(Action.JOIN, d))

    @cached_property
    def nodes(self) -> tuple[str, ...]:
        """The nodes that the permissions are for; the enclave's own name if none can be told.

        A name may end in `*`, where any nodes are meant whose names begin so.
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
        """What the node misses to live on that domain; empty if it has all."""
        needed = ros.node_minimum(node.replace("*", "x"))
        missing = {
            "publish": [t for t in needed.publish if self.may(Action.PUBLISH, domain, t)],
            "subscribe to": [t for t in needed.subscribe if self.may(Action.SUBSCRIBE, domain, t)],
        }
        said = [f"{way} {', '.join(topics)}" for way, topics in missing.items() if topics]
        return f"it would end as it starts: it may not {' nor '.join(said)}" if said else ""


def _is_for(grant: Grant, own: Subject) -> bool:
    try:
        return same_subject(parse_subject(grant.subject_name), own)
    except MalformedError:
        return False
