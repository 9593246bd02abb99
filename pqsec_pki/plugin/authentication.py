"""The authentication plugin's calls: DDS-Security 1.1, 8.3.2.7 and 9.3.3, table 52.

Names, arguments and results are those in `calls`. Each call gives the result code of
DDS-Security and the values; a refusal is a PqsecError.
"""

from collections.abc import Callable
from dataclasses import replace
from datetime import timedelta
from enum import IntEnum

from pqsec_pki.algorithms import KeyAgreement
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import VerificationError, shown
from pqsec_pki.handshake import (
    AuthRequest,
    DataHolder,
    Discovered,
    Done,
    Final,
    IdentityToken,
    PeerRequirements,
    PolicyRow,
    RemotePeer,
    Reply,
    Request,
    RequestSent,
    adjusted_guid,
    begin,
    initiates,
    reply_to,
)
from pqsec_pki.plugin.credentials import Properties
from pqsec_pki.plugin.handles import Handles
from pqsec_pki.plugin.identity import Local
from pqsec_pki.plugin.lists import NewestLists
from pqsec_pki.plugin.notes import Clock
from pqsec_pki.plugin.octets import Pairs
from pqsec_pki.plugin.participant import Participant
from pqsec_pki.plugin.peer_table import Handshake, PeerState, PeerTable, Remote
from pqsec_pki.plugin.pending import PendingReplies
from pqsec_pki.plugin.revocation_watch import RevocationWatch

NO_TOKEN = DataHolder("")
"""TOKEN_NIL. Cyclone DDS reads the length of the class id, so there must be one."""
CREDENTIAL, CREDENTIAL_PROPERTY = "DDS:Access:PermissionsCredential", "dds.perm.cert"
PEER_CREDENTIAL = "DDS:Auth:PKI-DH:1.0"
_TEXT = "surrogateescape"


class ValidationResult(IntEnum):
    """The values of DDS_Security_ValidationResult_t that are returned here."""

    OK = 0
    PENDING_HANDSHAKE_REQUEST = 3
    PENDING_HANDSHAKE_MESSAGE = 4
    OK_FINAL_MESSAGE = 5


class LateError(VerificationError):
    """A valid message that came too late, because the agent or the network is slow."""


class Authentication:
    """The plugin of one DDS process and domain."""

    def __init__(
        self, clock: Clock, note: Callable[[str], None], lists: NewestLists, answers: PendingReplies
    ) -> None:
        self._now, self._note = clock, note
        self._handles = Handles()
        self._peers = PeerTable(self._handles, answers, note)
        self._revocation_watch = RevocationWatch(self._handles, self._peers, lists, clock, note)

    def __len__(self) -> int:
        return len(self._handles)

    def validate_local_identity(
        self, domain: int, folder: str, properties: Pairs, candidate: bytes
    ) -> tuple[ValidationResult, int, bytes, int, bool]:
        """The handle, the adjusted GUID, the second (of Unix time) when the identity expires, and
        whether the caller must call find_revoked."""
        del domain
        found = Properties(properties, folder)
        participant = Participant.load(found, candidate, self._now(), self._note)
        participant = self._revocation_watch.admitted(participant)
        return (
            ValidationResult.OK,
            self._handles.add(participant),
            participant.guid,
            end_of(*participant.certificates),
            participant.has_list,
        )

    def get_identity_token(self, identity: int) -> tuple[ValidationResult, DataHolder]:
        """The IdentityToken that discovery announces."""
        participant = self._handles.get(identity, Participant)
        return ValidationResult.OK, participant.token().to_holder()

    def set_permissions_credential_and_token(
        self, identity: int, credential: DataHolder, permissions: DataHolder
    ) -> tuple[ValidationResult]:
        """Set the permissions document that handshakes with the configured set will contain."""
        del permissions
        participant = self._handles.get(identity, Participant)
        document = dict(credential.properties).get(CREDENTIAL_PROPERTY)
        if credential.class_id != CREDENTIAL or document is None:
            raise VerificationError(
                f"a '{shown(credential.class_id)}' is not a permissions credential"
            )
        octets = document.encode(errors=_TEXT)
        self._handles.replace(identity, participant.with_permissions(octets))
        return (ValidationResult.OK,)

    def validate_remote_identity(
        self, auth_request: DataHolder, identity: int, token: DataHolder, guid: bytes
    ) -> tuple[ValidationResult, int, DataHolder]:
        """The peer's handle, and our AuthRequest unless the peer's came first."""
        participant = self._handles.get(identity, Participant)
        said = IdentityToken.from_holder(token)
        heard = AuthRequest.from_holder(auth_request) if auth_request.class_id else None
        handle, peer_state = self._peers.peer_state(identity, guid)
        peer_state.said = said
        answer = NO_TOKEN
        if heard:
            peer_state.heard = heard.future_challenge
        else:
            peer_state.announced = self._peers.challenge(identity, guid)
            answer = AuthRequest(future_challenge=peer_state.announced).to_holder()
        first = initiates(participant.guid, guid)
        result = (
            ValidationResult.PENDING_HANDSHAKE_REQUEST
            if first
            else ValidationResult.PENDING_HANDSHAKE_MESSAGE
        )
        return result, handle, answer

    def begin_handshake_request(
        self, identity: int, peer: int, data: bytes
    ) -> tuple[ValidationResult, int, DataHolder]:
        """The handshake's handle, and the Request.

        VerificationError if the peer may not know the key agreement: no Request is sent.
        """
        participant, remote, peer_state = self._peers.met(identity, peer)
        local, row = participant.asks(peer_state.said, remote.guid)
        _check_known(peer_state.said, local.agreement, several=participant.stock is not None)
        discovered = _discovered(remote, peer_state, row)
        terms = local.terms(discovered, peer_state.announced, data)
        terms = replace(terms, policy=_read_by(peer_state.said, local.agreement, terms.policy))
        request, state = begin(terms, local.agreement)
        handle = self._peers.asked(local, identity, peer, state)
        return ValidationResult.PENDING_HANDSHAKE_MESSAGE, handle, request.to_holder()

    def begin_handshake_reply(
        self, token: DataHolder, peer: int, identity: int, data: bytes
    ) -> tuple[ValidationResult, int, DataHolder]:
        """The handshake's handle, and the Reply."""
        participant, remote, peer_state = self._peers.met(identity, peer)
        request, now = Request.from_holder(token, participant.readable), self._now()
        certificate = RemotePeer.read(request.introduction).certificate
        self._peers.refuse_early(identity, certificate, now)
        local, row = participant.answers(peer_state.said, remote.guid, certificate)
        discovered = _discovered(remote, peer_state, row)
        terms = local.terms(discovered, peer_state.announced, data)
        terms = replace(terms, own=replace(terms.own, ca=local.anchors.issuer_of(certificate)))
        reply, state = reply_to(terms, request, now=now)
        handle = self._peers.answered(identity, peer, state, now)
        return ValidationResult.PENDING_HANDSHAKE_MESSAGE, handle, reply.to_holder()

    def process_handshake(
        self, token: DataHolder, handle: int
    ) -> tuple[ValidationResult, DataHolder]:
        """The Final that answers a Reply; an empty token after a Final."""
        handshake = self._handles.get(handle, Handshake)
        is_final = token.class_id == Final.CLASS_ID
        if handshake.answer and (is_final or handshake.asked is None):
            final = Final.from_holder(token, (handshake.answer.version,))
            done = handshake.answer.receive(final)
            self._peers.finished(handshake, done)
            return ValidationResult.OK, NO_TOKEN
        if handshake.asked is None or handshake.asked_by is None:
            raise LateError("the handshake is over: the message came late, or twice")
        reply = Reply.from_holder(token, (handshake.asked.request.version,))
        if reply.dh1 in handshake.earlier:
            raise LateError("a Reply to a Request that was given up for a later one: it came late")
        last, done = self._finish(handshake.asked_by, handshake.asked, reply)
        self._peers.finished(handshake, done)
        return ValidationResult.OK_FINAL_MESSAGE, last.to_holder()

    def get_shared_secret(
        self, handle: int
    ) -> tuple[ValidationResult, int, int, bytes, bytes, bytes]:
        """The peer's handle, when its identity expires, both challenges, and the SharedSecret.

        VerificationError if the peer was revoked after its certificate was checked.
        """
        handshake, done = self._done(handle)
        certificate = done.peer.certificate
        participant = self._handles.get(handshake.identity, Participant)
        if participant.revokes(certificate):
            raise VerificationError(
                f"the certificate of {certificate.subject_name} was revoked meanwhile"
            )
        end = end_of(certificate, participant.set_of(certificate).anchors.issuer_of(certificate))
        return (
            ValidationResult.OK,
            handshake.remote,
            end,
            done.challenge1,
            done.challenge2,
            done.shared_secret,
        )

    def get_authenticated_peer_credential_token(
        self, handle: int
    ) -> tuple[ValidationResult, DataHolder]:
        """The peer's certificate and permissions document, for access control."""
        _, done = self._done(handle)
        items = (
            ("c.id", done.peer.certificate.pem.decode()),
            ("c.perm", done.peer.permissions.decode(errors=_TEXT)),
        )
        return ValidationResult.OK, DataHolder(PEER_CREDENTIAL, items)

    def finish(self) -> None:
        """Forget all handshakes: the connection ends."""
        self._peers.drop_all()

    def find_revoked(self) -> tuple[ValidationResult, int]:
        """The handle of a revoked participant or peer; 0 if there is no other.

        If a revocation list is refused, the previous list stays in force, and the error is raised
        after all handles were reported.
        """
        return ValidationResult.OK, self._revocation_watch.next()

    def check_guid_comes_from(
        self, handle: int, adjusted: bytes, candidate: bytes
    ) -> tuple[ValidationResult]:
        """Check that `adjusted` was derived from `candidate` for that identity, ours or a peer's.

        Fast DDS calls it for discovery servers that are configured by their GUID.
        VerificationError if it was not.
        """
        if adjusted_guid(self._certificate(handle).subject_der, candidate) != adjusted:
            raise VerificationError("the GUID was not derived from the candidate for this identity")
        return (ValidationResult.OK,)

    def return_handshake_handle(self, handle: int) -> tuple[ValidationResult]:
        """Forget the handshake. Cyclone DDS never calls it; a handshake ends with an identity."""
        self._peers.drop_handshake(handle)
        return (ValidationResult.OK,)

    def return_identity_handle(self, handle: int) -> tuple[ValidationResult]:
        """Forget the identity: the participant or the peer was deleted."""
        self._peers.drop(handle)
        return (ValidationResult.OK,)

    def _certificate(self, handle: int) -> Certificate:
        """Certificate of a participant or an authenticated peer; VerificationError for others."""
        participant = self._handles.find(handle, Participant)
        if participant is not None:
            return participant.first.certificate  # the subject is that of all sets
        for _, remote, certificate in self._peers.authenticated():
            if remote == handle:
                return certificate
        raise VerificationError("the peer has not authenticated")

    def _finish(self, local: Local, state: RequestSent, reply: Reply) -> tuple[Final, Done]:
        certificate = RemotePeer.read(reply.introduction).certificate
        own = replace(state.terms.own, ca=local.anchors.issuer_of(certificate))
        state = replace(state, terms=replace(state.terms, own=own))
        return state.receive(reply, now=self._now())

    def _done(self, handle: int) -> tuple[Handshake, Done]:
        handshake = self._handles.get(handle, Handshake)
        if handshake.done is None:
            raise VerificationError("the handshake is not over")
        return handshake, handshake.done


def _discovered(remote: Remote, peer_state: PeerState, row: PolicyRow) -> Discovered:
    """What the peer announced: GUID, challenge, and the name by which our policy knows it."""
    return Discovered(guid=remote.guid, future_challenge=peer_state.heard, subject=row.subject)


def _check_known(said: IdentityToken, agreement: KeyAgreement, *, several: bool) -> None:
    """VerificationError if the peer may not know it: OpenDDS crashes on an unknown one."""
    if not said.knows(agreement):
        entry = 'stock = ["/name"]' if several else 'peers = "stock"'
        raise VerificationError(
            f"the peer does not say that it knows {agreement.wire_name}, so it was sent no"
            " request: it may be a stock stack",
            hint=f"for peers with stock stacks put {entry} in pqsec.toml",
        )


def _read_by(
    said: IdentityToken, agreement: KeyAgreement, policy: PeerRequirements
) -> PeerRequirements:
    """`policy` with the versions that the peer announces; VerificationError if there is none.

    Versions are announced for agreements that bind the transcript; others have the first always.
    """
    if not agreement.binds_transcript:
        return policy
    allowed = policy.versions
    versions = tuple(each for each in allowed if said.reads(each))
    if not versions:
        raise VerificationError(
            f"the peer does not say that it reads version {allowed[0]} of the messages",
            hint="put wire_versions = [2, 1] in pqsec.toml, or update the peer",
        )
    return replace(policy, versions=versions)


def end_of(*certificates: Certificate) -> int:
    """The first second (of Unix time) when one of them is no longer valid."""
    end = min(each.not_after for each in certificates)
    return int((end + timedelta(seconds=1)).timestamp())
