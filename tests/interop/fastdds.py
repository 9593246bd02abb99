"""A participant of Fast DDS without Fast DDS: only its security plugins.

Debian's libfastrtps-dev has them. In shape it is cyclone.py's participant.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pqsec_pki.handshake import ByteOrder, DataHolder, participant_data
from tests.interop.cyclone import Meeting, RefusedError, Secret, Token
from tests.interop.fastdds_shim import Answer, FastDdsShim

__all__ = ["Participant", "participant"]

_AUTHENTICATION = "dds.sec.auth.builtin.PKI-DH."
_ACCESS_CONTROL = "dds.sec.access.builtin.Access-Permissions."
_PLUGINS = {
    "dds.sec.auth.plugin": "builtin.PKI-DH",
    "dds.sec.access.plugin": "builtin.Access-Permissions",
    "dds.sec.crypto.plugin": "builtin.AES-GCM-GMAC",
}
_FILES = {
    _AUTHENTICATION + "identity_ca": "identity_ca.cert.pem",
    _AUTHENTICATION + "identity_certificate": "cert.pem",
    _AUTHENTICATION + "private_key": "key.pem",
    _ACCESS_CONTROL + "permissions_ca": "permissions_ca.cert.pem",
    _ACCESS_CONTROL + "governance": "governance.p7s",
    _ACCESS_CONTROL + "permissions": "permissions.p7s",
}

# ValidationResult_t
_OK, _FAILED, _RETRY, _PENDING_REQUEST, _PENDING_MESSAGE, _OK_FINAL_MESSAGE = range(6)


@contextmanager
def participant(
    fastdds: FastDdsShim, enclave: Path, *, passphrase: str = "", **authentication: str
) -> Iterator["Participant"]:
    """A participant with the six files in `enclave`, alone with its plugins.

    `authentication` are more properties of that plugin. RefusedError if its identity is
    refused.
    """
    more = {_AUTHENTICATION + name: value for name, value in authentication.items()}
    files = {name: f"file://{enclave / file}" for name, file in _FILES.items()}
    properties = _PLUGINS | files | more | {_AUTHENTICATION + "password": passphrase}
    number = fastdds.new(properties)
    try:
        yield Participant(fastdds, number)
    finally:
        fastdds.delete(number)


class Participant:
    """A participant's authentication, access control and cryptography."""

    def __init__(self, fastdds: FastDdsShim, number: int) -> None:
        self._fastdds, self._number = fastdds, number
        self.words = ""
        """What the plugins said of the last call; they do not mean all of it."""
        self.candidate = os.urandom(12) + b"\0\0\1\xc1"
        self.guid = self._call("validate_local_identity", 0, self.candidate).octets
        self.identity_token = self._call("get_identity_token").token

    def join(self, domain: int) -> tuple[Token, Token]:
        """Check the signed documents for `domain`.

        The permissions credential and token, to be shown to others with `show`.
        """
        self._call("validate_local_permissions", domain)
        self._call("check_create_participant", domain)
        credential = self._call("get_permissions_credential_token").token
        return credential, self._call("get_permissions_token").token

    def show(self, credential: Token, _token: Token) -> None:
        """Send these permissions in handshakes."""
        self._call("set_permissions_credential_and_token", 0, _octets(credential))

    def meet(self, guid: bytes, identity: Token, _auth_request: Token | None = None) -> Meeting:
        """Take note of a remote participant. Fast DDS knows of no AuthRequest."""
        good = (_PENDING_REQUEST, _PENDING_MESSAGE)
        answer = self._call("validate_remote_identity", 0, guid, _octets(identity), good=good)
        return Meeting(answer.handle, answer.code == _PENDING_REQUEST, None)

    def request(self, meeting: Meeting) -> tuple[int, Token]:
        """Begin a handshake: its handle and the first message."""
        data, good = participant_data(self.guid), (_PENDING_MESSAGE,)
        answer = self._call("begin_handshake_request", meeting.handle, data, good=good)
        return answer.handle, answer.token

    def reply(self, meeting: Meeting, request: Token) -> tuple[int, Token]:
        """Answer a handshake: its handle and the second message."""
        inputs = _octets(request), participant_data(self.guid)
        answer = self._call(
            "begin_handshake_reply", meeting.handle, *inputs, good=(_PENDING_MESSAGE,)
        )
        return answer.handle, answer.token

    def process(self, handshake: int, message: Token) -> Token | None:
        """Take the peer's next message; the final message to send, if this side does."""
        good = (_OK, _OK_FINAL_MESSAGE)
        answer = self._call("process_handshake", handshake, _octets(message), good=good)
        return answer.token if answer.code == _OK_FINAL_MESSAGE else None

    def secret(self, handshake: int) -> Secret:
        """What a finished handshake agreed on."""
        octets = self._call("get_shared_secret", handshake).octets
        return Secret(octets[:-64], octets[-64:-32], octets[-32:])

    def admit(self, meeting: Meeting, _handshake: int, permissions_token: Token) -> Token:
        """Check the permissions that the peer showed in a finished handshake.

        The peer's credential: its permissions (dds.perm.cert).
        """
        function = "get_authenticated_peer_credential_token"
        credential = self._call(function, meeting.handle).token
        inputs = _octets(permissions_token), _octets(credential)
        self._call("validate_remote_permissions", meeting.handle, *inputs)
        return credential

    def validate(self, domain: int, peer: Meeting) -> None:
        """Take the signed documents for `domain` as one's own, and as those of `peer`."""
        self._call("validate_local_permissions", domain)
        credential = self._call("get_permissions_credential_token").octets
        token = self._call("get_permissions_token").octets
        self._call("validate_remote_permissions", peer.handle, token, credential)

    def check(self, function: str, domain: int, *names: str) -> None:
        """One of access control's checks; `names` are a topic and its partitions."""
        self._call(function, domain, "".join(f"{name}\0" for name in names).encode())

    def keys(self, handshake: int) -> Token:
        """The keys of this participant, a crypto token for the peer of that handshake."""
        return self._call("create_local_participant_crypto_tokens", handshake).token

    def protect(self, handshake: int, submessage: bytes) -> bytes:
        """`submessage` as it goes to the peer when keys are sent."""
        return self._call("encode_datawriter_submessage", handshake, submessage).octets

    def unprotect(self, handshake: int, data: bytes) -> bytes:
        """What the peer protected so; RefusedError if it was changed or has other keys."""
        return self._call("decode_datawriter_submessage", handshake, data).octets

    def _call(
        self,
        function: str,
        number: int = 0,
        first: bytes = b"",
        second: bytes = b"",
        good: tuple[int, ...] = (_OK,),
    ) -> Answer:
        """The plugin's answer; RefusedError unless its code is in `good`."""
        answer = self._fastdds.call(self._number, function, number, first, second)
        self.words = answer.words
        if answer.code not in good:
            raise RefusedError(function, answer.code, self.words)
        return answer


def _octets(token: Token) -> bytes:
    return DataHolder(*token).encode(ByteOrder.LITTLE)
