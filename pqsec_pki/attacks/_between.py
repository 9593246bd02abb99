"""The attacker is a participant, between two others that each have a handshake with it."""

from collections.abc import Iterator
from dataclasses import replace

from pqsec_pki._dataclass import dataclass
from pqsec_pki.attacks._context import AttackContext, Attempt, with_identity
from pqsec_pki.attacks._forgery import Keys, issued
from pqsec_pki.attacks._impostors import issue_by_unknown_intermediate
from pqsec_pki.attacks.attack import Attack, Attacker
from pqsec_pki.handshake import (
    DataHolder,
    Final,
    GenericMessage,
    Introduction,
    Reply,
    Request,
    Transcript,
    WireVersion,
    adjusted_guid,
)
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import MESSAGE, HandshakeSession, SessionSide

_NAME = "/between"


def relay_key_shares(context: AttackContext) -> Iterator[Attempt]:
    """Forward dh1 of one and dh2 of the other under the attacker's own genuine identity."""
    ca, context = issue_by_unknown_intermediate(context)
    one, _ = context.session.sides
    keys = Keys.like(one.participant.certificate)
    certificate = issued(ca, _NAME, keys, context.session.now)
    guid = adjusted_guid(certificate.subject_der, one.guid)
    own = with_identity(one, certificate=certificate, key=keys.both, guid=guid, permissions=b"")
    relay = _Between(context.session, own)
    yield Attempt("dh1 and dh2 forwarded", replace(context.session, relay=relay, third=own))


@dataclass(slots=True)
class _Between:
    """Replier to one side and initiator to the other, without the private key of dh1 or dh2."""

    session: HandshakeSession
    own: SessionSide
    request: Request | None = None
    reply: Reply | None = None

    def __call__(self, name: str, data: bytes) -> bytes:
        if name == MESSAGE:  # without the secret it can neither read nor create one
            return data
        message = GenericMessage.decode(data)
        one, other = self.session.sides
        receiver = other if message.source == one.writer else one
        answer = replace(
            message,
            source=self.own.writer,
            destination_participant=receiver.guid,
            tokens=(self._token(message.tokens[0]),),
        )
        return answer.encode()

    def _token(self, token: DataHolder) -> DataHolder:
        match token.class_id:
            case Request.CLASS_ID:
                self.request = Request.from_holder(token)
                own = self._introduction
                mine = replace(self.request, introduction=own, hash_c1=own.digest())
                return mine.to_holder()
            case Reply.CLASS_ID:
                self.reply = Reply.from_holder(token)
                transcript = self._transcript(of_request=True)
                signature = self.own.terms.own.key.sign_handshake(transcript.reply_octets())
                values = transcript.values()
                return Reply(
                    introduction=self._introduction, signature=signature, **values
                ).to_holder()
            case Final.CLASS_ID:
                transcript = self._transcript(of_request=False)
                signature = self.own.terms.own.key.sign_handshake(transcript.final_octets())
                return Final(signature=signature, **transcript.values()).to_holder()
        return token

    @property
    def _introduction(self) -> Introduction:
        return self.own.terms.own.introduction(self.session.agreement, nul=True)

    def _transcript(self, *, of_request: bool) -> Transcript:
        """The transcript that the initiator has, or the one that the replier has."""
        request, reply = self.request, self.reply
        if request is None or reply is None:
            raise AssertionError  # a Reply comes after a Request
        own = self._introduction.digest()
        return Transcript(
            hash_c1=request.introduction.digest() if of_request else own,
            hash_c2=own if of_request else reply.introduction.digest(),
            challenge1=request.challenge1,
            challenge2=reply.challenge2,
            dh1=request.dh1,
            dh2=reply.dh2,
        )


def _only_first_version(session: HandshakeSession) -> str | None:
    if session.version is WireVersion.FIRST:
        return None
    return "its messages are of the first version, which is refused here"


ATTACKS = (
    Attack(
        name="insider-in-the-middle",
        attacker=Attacker.INSIDER,
        title="makes two peers share a key, while each of them authenticates the attacker",
        refused_at=("message",),
        checks=(Code.C26,),
        also=(Code.NOT_SIGNED,),
        because="it has no permissions here, since the permissions CA's key is not available",
        act=relay_key_shares,
        not_applicable=_only_first_version,
    ),
)
