"""Makes pq.json and second.json again, with this checkout's code: python make_pq.py

Every key is new each time, and none is kept but the initiator's ephemeral one. The order
of vectors and of the names in them stays.
"""

import hashlib
import json
import struct
from base64 import b64encode
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

from pqsec_pki.algorithms import KEY_AGREEMENTS, SIGNATURES, pair_private
from pqsec_pki.certificates import Authority
from pqsec_pki.documents import DomainRange, DomainSet, Grant, Permissions
from pqsec_pki.handshake import (
    Identity,
    PeerRequirements,
    Sender,
    Terms,
    WireVersion,
    adjusted_guid,
    begin,
    key_exchange_material,
    reply_to,
)
from pqsec_pki.smime import Signer, sign

NOW = datetime(2026, 1, 1, tzinfo=UTC)
CENTURY = timedelta(days=36525)
ENTITY = bytes.fromhex("000001c1")
SUITES = (
    ("ml-dsa-44", None, "mlkem768"),
    ("ml-dsa-65", None, "mlkem768"),
    ("ml-dsa-65", None, "x25519mlkem768"),
    ("ml-dsa-65", None, "secp256r1mlkem768"),
    ("ml-dsa-87", None, "mlkem1024"),
    ("ml-dsa-87", None, "secp384r1mlkem1024"),
    ("mldsa65-ecdsa-p256-sha512", None, "x25519mlkem768"),
    ("ecdsa-p256", "ml-dsa-65", "x25519mlkem768"),
    ("ecdsa-p256", None, "x25519mlkem768"),
)
"""Key, alternative key, key agreement."""
SECOND_SUITES = (SUITES[1], SUITES[4], SUITES[6], SUITES[7])
"""Those of second.json."""

# A DATA submessage of the volatile secure writer, without content: what comes first after
# a handshake is sent like this.
SUBMESSAGE = struct.pack(
    ">BBHHH4s4sq4s", 0x15, 0x04, 24, 0, 16, b"\xff\2\2\xc4", b"\xff\2\2\xc3", 1, bytes(4)
)


def permissions(name):
    """What CN=`name` may do. Not signed, for brevity: the handshake only hashes it."""
    grant = Grant.least(
        subject_name=f"CN={name}",
        not_before=NOW,
        not_after=NOW + CENTURY,
        domains=DomainSet.of(DomainRange(first=0, last=0)),
        publish=["rt/chatter"],
        subscribe=[],
    )
    return Permissions(grants=(grant,)).to_xml()


def signed(document, row, alternative):
    """A document with a signature, and a countersignature if there are two algorithms."""
    signers = [
        Authority.create("Permissions CA", each, now=NOW, validity=CENTURY)
        for each in (row, alternative)
        if each
    ]
    main, *counter = (Signer(each.certificate, each.key) for each in signers)
    return sign(document, main, countersigner=counter[0] if counter else None, now=NOW)


def enrolled(authority, name, key, second):
    """The identity of CN=`name`, who has `key` and perhaps a `second` one."""
    certificate = authority.issue(
        name,
        key.public_key,
        alternative=second.public_key if second else None,
        now=NOW,
        validity=CENTURY,
    )
    candidate = hashlib.sha256(name.encode()).digest()[:12] + ENTITY
    return Identity(
        certificate=certificate,
        key=pair_private(key, second) if second else key,
        ca=authority.certificate,
        guid=adjusted_guid(certificate.subject_der, candidate),
        permissions=permissions(name),
    )


def two_identities(row, alternative):
    """Alice and Bob of one authority; first who initiates."""
    authority = Authority.create(
        "Identity CA", row, alternative=alternative, now=NOW, validity=CENTURY
    )
    made = (
        enrolled(authority, name, row.generate(), alternative and alternative.generate())
        for name in ("alice", "bob")
    )
    return sorted(made, key=lambda identity: identity.guid)


def private_half(pair):
    """An ephemeral key by the names of its parts, in hex."""
    handle = pair._handle
    if isinstance(handle, tuple):
        return private_half(handle[0]) | private_half(handle[1])
    if hasattr(handle, "curve"):
        size = handle.key_size // 8
        return {"ecdh": handle.private_numbers().private_value.to_bytes(size).hex()}
    name = "ml_kem_seed" if hasattr(handle, "decapsulate") else "x25519"
    return {name: handle.private_bytes_raw().hex()}


def vector(key, alternative, agreement, version=WireVersion.FIRST):
    """One handshake and a protected submessage, as pq.json or second.json has it."""
    row, agreement = SIGNATURES.named(key), KEY_AGREEMENTS.named(agreement)
    second = alternative and SIGNATURES.named(alternative)
    initiator, replier = two_identities(row, second)
    if version is WireVersion.SECOND:
        initiator, replier = (
            replace(each, permissions=signed(each.permissions, row, second))
            for each in (initiator, replier)
        )
    policy = PeerRequirements(
        agreements=(agreement,), versions=(version,), require_alternative=alternative is not None
    )
    request, waiting = begin(Terms(own=initiator, policy=policy), agreement)
    reply, awaiting = reply_to(Terms(own=replier, policy=policy), request, now=NOW)
    final, done = waiting.receive(reply, now=NOW)
    assert awaiting.receive(final).shared_secret == done.shared_secret
    return {
        **who(initiator, replier, agreement),
        **{
            name: b64encode(token.to_holder().encode()).decode()
            for name, token in {"request": request, "reply": reply, "final": final}.items()
        },
        "initiator_ephemeral": private_half(waiting.key_pair),
        **derived(awaiting.transcript, waiting.key_pair.decapsulate(reply.dh2), done),
    }


def who(initiator, replier, agreement):
    signature = initiator.key.algorithm.wire_name
    return {
        "name": f"{signature} {agreement.wire_name}",
        "signature_algorithm": signature,
        "key_agreement": agreement.wire_name,
        "identity_ca": initiator.ca.pem.decode(),
        "initiator_guid": initiator.guid.hex(),
        "replier_guid": replier.guid.hex(),
    }


def derived(transcript, secret, done):
    """What follows from the tokens, in the order it is computed."""
    material = key_exchange_material(done)
    values = {
        "hash_c1": transcript.hash_c1,
        "hash_c2": transcript.hash_c2,
        "signed_reply_sha256": hashlib.sha256(transcript.reply_octets()).digest(),
        "signed_final_sha256": hashlib.sha256(transcript.final_octets()).digest(),
        "secret": secret,
        "shared_secret": done.shared_secret,
        "kx_salt": material.salt,
        "kx_key": material.sender_key,
        "submessage": SUBMESSAGE,
        "protected_submessage": Sender(material).protect_submessage(SUBMESSAGE),
    }
    return {name: value.hex() for name, value in values.items()}


if __name__ == "__main__":
    for file, suites, version in (
        ("pq.json", SUITES, WireVersion.FIRST),
        ("second.json", SECOND_SUITES, WireVersion.SECOND),
    ):
        made = [vector(*suite, version) for suite in suites]
        Path(__file__).with_name(file).write_text(json.dumps(made, indent=1) + "\n")
