"""Whatever a peer may send: tokens, messages, protected data, public values, ciphertexts."""

import zlib
from functools import cache, partial

from pqsec_pki.algorithms import KEY_AGREEMENTS, pem
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import PqsecError
from pqsec_pki.handshake import (
    CREDENTIALS_DICTIONARY,
    AuthRequest,
    ByteOrder,
    DataHolder,
    Final,
    GenericMessage,
    IdentityToken,
    KeyMaterial,
    MessageClass,
    PermissionsToken,
    Reply,
    Request,
    Sender,
    TransformationKind,
    compact,
    participant_data,
    participant_guid,
    reply_to,
    unprotect_payload,
    unprotect_submessage,
)
from pqsec_pki.smime import parts_of
from tests.fuzz import mutation
from tests.fuzz.people import NOW, enrolled, meet, meet_in_second

SUITES = {
    "ecdsa-p256": "ecdh-p256",
    "rsa-2048": "dh-modp-2048-256",
    "ml-dsa-44": "mlkem768",
    "mldsa65+p256": "secp256r1mlkem768",
    "ecdsa-p256 and ml-dsa-65": "x25519mlkem768",
}
"""A kind of key and a key agreement of each form."""
PAIR = "ecdsa-p256 and ml-dsa-65"
SUBMESSAGE = b"\x15\1\x0c\0pqsec check."


# Handshakes


@cache
def meetings():
    """{challenge1: a meeting}. Without hash_c1 a changed Request is looked into further."""
    met = [
        meet(kind, KEY_AGREEMENTS.named(agreement), optional=optional)
        for kind, agreement in SUITES.items()
        for optional in (False, True)
    ]
    return {each.request.challenge1: each for each in met}


def tokens(name):
    return [getattr(met, name).to_holder().encode() for met in meetings().values()]


def meeting_of(challenge1):
    found = meetings()
    return found.get(challenge1) or next(iter(found.values()))


def take_request(data):
    message = Request.from_holder(DataHolder.decode(data))
    return reply_to(meeting_of(message.challenge1).of_bob, message, now=NOW)


def take_reply(data):
    message = Reply.from_holder(DataHolder.decode(data))
    return meeting_of(message.challenge1).waiting.receive(message, now=NOW)


def take_final(data):
    message = Final.from_holder(DataHolder.decode(data))
    return meeting_of(message.challenge1).awaiting.receive(message)


# The second version of these messages, which repeat no challenge


@cache
def second():
    return meet_in_second(PAIR, KEY_AGREEMENTS.named("x25519mlkem768"))


def second_token(name):
    return [getattr(second(), name).to_holder().encode()]


def take_second_request(data):
    return reply_to(second().of_bob, Request.from_holder(DataHolder.decode(data)), now=NOW)


def take_second_reply(data):
    return second().waiting.receive(Reply.from_holder(DataHolder.decode(data)), now=NOW)


def take_second_final(data):
    return second().awaiting.receive(Final.from_holder(DataHolder.decode(data)))


def credentials():
    """What `id` has, before it is compressed."""
    introduction = second().request.introduction
    der = Certificate.from_pem(introduction.certificate).der
    return [b"".join((der, *parts_of(introduction.permissions)))]


def take_credentials(data):
    """Inflated, whatever they are; what is taken is canonical, and makes them again."""
    compressor = zlib.compressobj(1, wbits=-15, zdict=CREDENTIALS_DICTIONARY)
    deflated = compressor.compress(data) + compressor.flush()
    certificate, permissions = compact._inflated(deflated)
    cms, document = parts_of(permissions)
    assert data.endswith(cms + document)
    assert pem("CERTIFICATE", data[: -len(cms + document)]) == certificate
    return permissions


# Bytes of the wire


def other_tokens():
    alice = enrolled(PAIR, "alice")
    return [
        AuthRequest(future_challenge=bytes(32)).to_holder(),
        IdentityToken.of(alice.certificate, alice.ca).to_holder(),
        PermissionsToken("/CN=a", "RSA-2048").to_holder(),
        *(each.to_holder() for each in materials()),
    ]


def take_token(data):
    """In either byte order, as each kind of token; and back to bytes."""
    holders = []
    for order in ByteOrder:
        try:
            holder = DataHolder.decode(data, order)
        except PqsecError:
            continue
        assert DataHolder.decode(holder.encode(order), order) == holder
        holders += each_kind_in(holder)
    return holders


def each_kind_in(holder):
    found = []
    for kind in (AuthRequest, IdentityToken, PermissionsToken, KeyMaterial, Request, Reply, Final):
        try:
            read = kind.from_holder(holder)
        except PqsecError:
            continue
        assert kind.from_holder(read.to_holder()) == read
        found.append(read)
    return found


def samples():
    alice, bob = (enrolled(PAIR, name).guid for name in ("alice", "bob"))
    message = partial(GenericMessage, source=alice, sequence=1, destination_participant=bob)
    made = [
        message(class_id=MessageClass.HANDSHAKE, tokens=(meeting.request.to_holder(),))
        for meeting in list(meetings().values())[:2]
    ]
    crypto = tuple(each.to_holder() for each in materials())
    made.append(message(class_id=MessageClass.WRITER_CRYPTO_TOKENS, tokens=crypto))
    made += [message(class_id=MessageClass.AUTH_REQUEST, tokens=(each,)) for each in other_tokens()]
    return [each.encode(order) for each in made for order in ByteOrder]


def take_sample(data):
    message = GenericMessage.decode(data)
    assert GenericMessage.decode(message.encode()) == message
    return [each_kind_in(token) for token in message.tokens]


# Protected data


@cache
def materials():
    """Of every kind, without and with a receiver's key."""
    kinds = [kind for kind in TransformationKind if kind is not TransformationKind.NONE]
    made = [KeyMaterial.generate(kind) for kind in kinds]
    return [*made, *(each.for_receiver() for each in made)]


def protected(form):
    """For each material: its place in the list as one byte, then what is protected with it."""
    return [bytes([at]) + form(each) for at, each in enumerate(materials())]


def submessage(material):
    receivers = [material] if material.receiver_key else []
    return Sender(material).protect_submessage(SUBMESSAGE, receivers=receivers)


def payload(material):
    return Sender(material).protect_payload(SUBMESSAGE)


def take_protected(unprotect, data):
    if not data:
        return None
    known = materials()
    return unprotect(known[data[0] % len(known)], data[1:])


# Key agreement


@cache
def pairs():
    return [row.generate() for row in KEY_AGREEMENTS]


def public_values():
    return [bytes([at]) + pair.public for at, pair in enumerate(pairs())]


def ciphertexts():
    return [
        bytes([at]) + pair.agreement.encapsulate(pair.public)[0] for at, pair in enumerate(pairs())
    ]


def take_public_value(data):
    pair = pairs()[data[0] % len(pairs())] if data else pairs()[0]
    return pair.agreement.encapsulate(data[1:])


def take_ciphertext(data):
    pair = pairs()[data[0] % len(pairs())] if data else pairs()[0]
    return pair.decapsulate(data[1:])


TARGETS = {
    "sample": (take_sample, samples, mutation.message),
    "token": (take_token, lambda: [each.encode() for each in other_tokens()], mutation.token),
    "request": (take_request, partial(tokens, "request"), mutation.token),
    "reply": (take_reply, partial(tokens, "reply"), mutation.token),
    "final": (take_final, partial(tokens, "final"), mutation.token),
    "second-request": (take_second_request, partial(second_token, "request"), mutation.token),
    "second-reply": (take_second_reply, partial(second_token, "reply"), mutation.token),
    "second-final": (take_second_final, partial(second_token, "final"), mutation.token),
    "credentials": (take_credentials, credentials),
    "participant-data": (
        participant_guid,
        lambda: [participant_data(bytes(range(16)))],
        mutation.parameters,
    ),
    "key-material": (KeyMaterial.decode, lambda: [each.encode() for each in materials()]),
    "submessage": (partial(take_protected, unprotect_submessage), partial(protected, submessage)),
    "payload": (partial(take_protected, unprotect_payload), partial(protected, payload)),
    "public-value": (take_public_value, public_values),
    "ciphertext": (take_ciphertext, ciphertexts),
}
"""{name: (what takes bytes, real bytes that it takes, how they are best spoilt)}"""
