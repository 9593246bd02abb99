"""The access control plugin's calls: DDS-Security 1.1, 8.4.2.9 and 9.4.3, table 63.

Names, arguments and results are those in `calls`; the room `access` decides. A refusal is a
PqsecError with the rule that decided.
"""

from dataclasses import astuple, replace
from typing import Any

from pqsec_pki.access import Action, Viewpoint, decide
from pqsec_pki.credentials import (
    GOVERNANCE,
    PERMISSIONS,
    VerifiedDocuments,
    grant_of,
    verify_documents,
)
from pqsec_pki.errors import VerificationError
from pqsec_pki.handshake import DataHolder, PermissionsToken, peer_certificate
from pqsec_pki.plugin import attributes, trust
from pqsec_pki.plugin.authentication import CREDENTIAL, CREDENTIAL_PROPERTY
from pqsec_pki.plugin.credentials import Properties
from pqsec_pki.plugin.handles import Handles
from pqsec_pki.plugin.notes import Clock
from pqsec_pki.plugin.octets import Pairs
from pqsec_pki.plugin.rights import LocalRights, RemoteRights, Rights, anywhere, end_of
from pqsec_pki.plugin.sets import TrustedSets
from pqsec_pki.plugin.trust import ParticipantTrust

_PEERS = {PERMISSIONS: "the peer's permissions"}
_TEXT = "surrogateescape"
_OK = 0


def _content(documents: VerifiedDocuments) -> tuple[bytes, bytes]:
    """The signed octets of both, without their signatures."""
    found = documents.governance, documents.permissions
    return found[0].verified.document, found[1].verified.document


class AccessControl:
    """The plugin of one DDS process and domain."""

    def __init__(self, clock: Clock) -> None:
        self._now = clock
        self._handles = Handles()

    def __len__(self) -> int:
        return len(self._handles)

    def validate_local_permissions(
        self, identity_handle: int, domain: int, folder: str, pairs: Pairs
    ) -> tuple[int, int, int]:
        """The handle of a local participant's rights, and the second when they end.

        The documents of all its sets must be valid, and say the same.
        """
        trusted = TrustedSets.of(Properties(pairs, folder), self._now())
        found = [self._documents(each) for each in trusted.sets]
        own, message = found[trusted.configured]
        if any(_content(each) != _content(own) for each, _ in found):
            raise VerificationError(
                "the documents of two sets of credentials differ",
                hint="issue them again, and install all sets: `pqsec check` finds what differs",
            )
        rights = LocalRights(
            subject=trusted.sets[0].certificate.subject_name,
            domain=domain,
            governance=own.governance.value,
            permissions=own.permissions.value,
            anchors=tuple(each.anchors for each in trusted.sets),
            message=message,
            identity=identity_handle,
        )
        anchors = (each.anchors for each in trusted.sets)
        ends = map(end_of, (each.grant for each, _ in found), anchors)
        return _OK, self._handles.add(rights), min(ends)

    def _documents(self, trusted: ParticipantTrust) -> tuple[VerifiedDocuments, bytes]:
        """The valid documents of one set, and the signed permissions; VerificationError if not."""
        properties = trusted.properties
        governance, message = (
            properties.source(trust.PROPERTIES[file]).read() for file in (GOVERNANCE, PERMISSIONS)
        )
        try:
            found = verify_documents(
                trusted.certificate,
                trusted.anchors,
                governance=governance,
                permissions=message,
                now=self._now(),
            )
            trusted.refuse_unproven(governance, message)
        except VerificationError as error:
            raise trust.refusal(
                error.problems, trust.places(properties), hint=error.hint
            ) from error
        return found, message

    def validate_remote_permissions(
        self, identity_handle: int, peer: int, token: DataHolder, credential: DataHolder
    ) -> tuple[int, int, int]:
        """The handle of a peer's rights, and the second when they end."""
        del peer
        own, now = self._own(identity_handle), self._now()
        PermissionsToken.from_holder(token)
        found = dict(credential.properties)
        certificate = peer_certificate(found.get("c.id", "").encode(errors=_TEXT))
        message = found.get("c.perm", "").encode(errors=_TEXT).rstrip(b"\0")
        try:
            anchors = own.anchors_for(certificate)
            granted = anchors.permissions(message, now).value
            grant = grant_of(certificate, granted, now)
        except VerificationError as error:
            raise trust.refusal(error.problems, _PEERS, hint=error.hint) from error
        rights = RemoteRights(
            subject=certificate.subject_name,
            domain=own.domain,
            governance=own.governance,
            permissions=granted,
        )
        return _OK, self._handles.add(rights), end_of(grant, anchors)

    # The handle determines whose rights are checked: the local participant's when it creates an
    # entity, a peer's when the entity is discovered.

    def check_create_participant(self, handle: int, domain: int) -> tuple[int]:
        """Check that it may join the domain."""
        return self._refuse_unless(handle, domain, Action.JOIN)

    def check_create_datawriter(
        self, handle: int, domain: int, topic: str, partitions: tuple[str, ...], tags: Pairs
    ) -> tuple[int]:
        """Check that it may publish the topic in those partitions, with those data tags."""
        return self._refuse_unless(handle, domain, Action.PUBLISH, topic, (partitions, tags))

    def check_create_datareader(
        self, handle: int, domain: int, topic: str, partitions: tuple[str, ...], tags: Pairs
    ) -> tuple[int]:
        """Check that it may subscribe to the topic in those partitions, with those data tags."""
        return self._refuse_unless(handle, domain, Action.SUBSCRIBE, topic, (partitions, tags))

    def check_create_topic(self, handle: int, domain: int, topic: str) -> tuple[int]:
        """Check that it may publish or subscribe to the topic, in any partition."""
        rights = self._handles.get(handle, Rights)
        if rights.side is Viewpoint.OWN and topic in attributes.BUILTIN:
            return (_OK,)
        permissions, now = anywhere(rights.permissions), self._now()
        reasons = []
        for action in (Action.PUBLISH, Action.SUBSCRIBE):
            question = rights.question(domain, action, now, topic)
            decision = decide(rights.governance, permissions, question, by=rights.side)
            if decision.allowed:
                return (_OK,)
            reasons.append(decision.reason)
        raise VerificationError(*reasons)

    check_remote_participant = check_create_participant
    check_remote_datawriter = check_create_datawriter
    check_remote_topic = check_create_topic

    def check_remote_datareader(
        self, handle: int, domain: int, topic: str, partitions: tuple[str, ...], tags: Pairs
    ) -> tuple[int, int]:
        """Check a peer's DataReader. The last result is 0: not for relaying only."""
        return *self.check_create_datareader(handle, domain, topic, partitions, tags), 0

    def get_permissions_token(self, handle: int) -> tuple[int, DataHolder]:
        """An empty token, as Cyclone DDS sends it: Fast DDS 2.9.1 refuses the standard's."""
        self._handles.get(handle, LocalRights)
        return _OK, PermissionsToken().to_holder()

    def get_permissions_credential_token(self, handle: int) -> tuple[int, DataHolder]:
        """The signed permissions document, for the handshake."""
        document = self._handles.get(handle, LocalRights).message.decode(errors=_TEXT)
        return _OK, DataHolder(CREDENTIAL, ((CREDENTIAL_PROPERTY, document),))

    def get_participant_sec_attributes(self, handle: int) -> tuple[Any, ...]:
        """The security attributes of the participant, from the domain rule."""
        rule = self._handles.get(handle, LocalRights).domain_rule
        return _OK, *astuple(attributes.of_participant(rule))

    def get_topic_sec_attributes(self, handle: int, topic: str) -> tuple[Any, ...]:
        """The security attributes of a topic."""
        rights = self._handles.get(handle, LocalRights)
        if topic in attributes.BUILTIN:
            return _OK, *astuple(attributes.TopicAttributes())
        return _OK, *astuple(attributes.of_topic(rights.topic_rule(topic)))

    def get_endpoint_sec_attributes(self, handle: int, topic: str) -> tuple[Any, ...]:
        """The security attributes of a writer or reader of the topic."""
        rights = self._handles.get(handle, LocalRights)
        if topic in attributes.BUILTIN:
            return _OK, *astuple(attributes.of_builtin(rights.domain_rule, topic))
        return _OK, *astuple(attributes.of_endpoint(rights.topic_rule(topic)))

    def return_permissions_handle(self, handle: int) -> tuple[int]:
        """Forget the rights: the participant or the peer was deleted."""
        self._handles.drop(handle)
        return (_OK,)

    def _own(self, identity_handle: int) -> LocalRights:
        for _, each in self._handles.all(LocalRights):
            if each.identity == identity_handle:
                return each
        raise VerificationError("a peer of a participant that the agent does not know")

    def _refuse_unless(
        self,
        handle: int,
        domain: int,
        action: Action,
        topic: str | None = None,
        where: tuple[tuple[str, ...], Pairs] = ((), ()),
    ) -> tuple[int]:
        """VerificationError with the reason if it is denied; `where` is the partitions and the
        data tags."""
        rights = self._handles.get(handle, Rights)
        if rights.side is Viewpoint.OWN and topic in attributes.BUILTIN:
            return (_OK,)
        question = rights.question(domain, action, self._now(), topic)
        question = replace(question, partitions=where[0], data_tags=where[1])
        decision = decide(rights.governance, rights.permissions, question, by=rights.side)
        if not decision.allowed:
            raise VerificationError(decision.reason)
        return (_OK,)
