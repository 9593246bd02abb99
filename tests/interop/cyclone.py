"""A participant of Cyclone DDS without Cyclone DDS: only its security plugins.

Debian's libddsc0debian has them. What a participant reads and what it sends to others
are the real ones; the messages are handed over by the test.
"""

import ctypes
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tests.interop.cyclone_abi import (
    ACCESS_CONTROL,
    AUTHENTICATION,
    OK,
    OK_FINAL_MESSAGE,
    PENDING_MESSAGE,
    PENDING_REQUEST,
    Plugin,
    RefusedError,
    started,
)
from tests.interop.cyclone_types import (
    DataHolder,
    Guid,
    Handle,
    Octets,
    Properties,
    Qos,
    SharedSecret,
    Token,
)

__all__ = ["Meeting", "Participant", "RefusedError", "Secret", "Token", "participant"]

_FILES = {
    "dds.sec.auth.identity_ca": "identity_ca.cert.pem",
    "dds.sec.auth.identity_certificate": "cert.pem",
    "dds.sec.auth.private_key": "key.pem",
    "dds.sec.access.permissions_ca": "permissions_ca.cert.pem",
    "dds.sec.access.governance": "governance.p7s",
    "dds.sec.access.permissions": "permissions.p7s",
}


class Meeting(NamedTuple):
    """A remote participant that was heard of."""

    handle: int
    begins: bool
    """Whether this side sends the handshake's request."""
    auth_request: Token | None


class Secret(NamedTuple):
    """What a handshake agreed on."""

    secret: bytes
    challenge1: bytes
    challenge2: bytes


def find_plugins() -> Path | None:
    """The folder of the plugins; PQSEC_CYCLONE_PLUGINS names another one."""
    named = os.environ.get("PQSEC_CYCLONE_PLUGINS")
    folders = [Path(named)] if named else sorted(Path("/usr/lib").glob("*/libddsc0*"))
    return next((each for each in folders if (each / "libdds_security_auth.so").exists()), None)


def reported_version(library: Path) -> str:
    """The version that a library of Cyclone DDS has in itself. AssertionError without one."""
    found = set(re.findall(rb"\0(\d+\.\d+\.\d+)(?=\0)", library.read_bytes()))
    assert len(found) == 1, f"{library}: which of {found} is its version?"
    return found.pop().decode()


def plugins_of(prefix: Path, series: str) -> Path:
    """The folder of the plugins in `prefix`. AssertionError if its version is not of `series`."""
    version = reported_version(prefix / "lib/libddsc.so")
    assert version.startswith(f"{series}."), f"{prefix} has Cyclone DDS {version}, not {series}"
    return prefix / "lib"


@contextmanager
def participant(
    plugins: Path, enclave: Path, *, passphrase: str = "", optional: bool = True
) -> Iterator["Participant"]:
    """A participant with the six files in `enclave`, alone with its plugins.

    Without `optional`, its handshake messages have only what DDS-Security demands.
    RefusedError if its identity is refused.
    """
    ctypes.CDLL("libcrypto.so.3").ERR_clear_error()  # it reports the first one in the queue
    library = plugins / "libdds_security_auth.so"
    with (
        started(library, "authentication", AUTHENTICATION, optional=optional) as authentication,
        started(plugins / "libdds_security_ac.so", "access_control", ACCESS_CONTROL) as access,
    ):
        yield Participant(authentication, access, enclave, passphrase)


class Participant:
    """A participant's authentication and access control."""

    def __init__(
        self, authentication: Plugin, access: Plugin, enclave: Path, passphrase: str
    ) -> None:
        self._authentication, self._access = authentication, access
        properties = {name: f"file:{enclave / file}" for name, file in _FILES.items()}
        properties["dds.sec.auth.password"] = passphrase
        if (enclave / "crl.pem").exists():
            properties["org.eclipse.cyclonedds.sec.auth.crl"] = f"file:{enclave / 'crl.pem'}"
        if (enclave / "trusted").exists():  # a plain path, no URI
            properties["dds.sec.auth.trusted_ca_dir"] = str(enclave / "trusted")
        self._qos = Qos(properties=Properties.of(properties.items()))
        self._identity, self.guid = self._validate_identity()
        token = DataHolder()
        self._authentication.call("get_identity_token", token, self._identity)
        self.identity_token = token.token

    def _validate_identity(self) -> tuple[int, bytes]:
        handle, guid, candidate = Handle(), Guid(), Guid.of(os.urandom(12) + b"\0\0\1\xc1")
        function = "validate_local_identity"
        self._authentication.call(function, handle, guid, 0, self._qos, candidate, good=(OK,))
        return handle.value, bytes(guid.octets)

    def join(self, domain: int) -> tuple[Token, Token]:
        """Check the signed documents for `domain`.

        The permissions credential and token, to be shown to others with `show`.
        """
        permissions = self._access.call(
            "validate_local_permissions",
            self._authentication.instance,
            self._identity,
            domain,
            self._qos,
        )
        self._access.call("check_create_participant", permissions, domain, self._qos)
        credential, token = DataHolder(), DataHolder()
        self._access.call("get_permissions_credential_token", credential, permissions)
        self._access.call("get_permissions_token", token, permissions)
        return credential.token, token.token

    def show(self, credential: Token, token: Token) -> None:
        """Send these permissions in handshakes."""
        function = "set_permissions_credential_and_token"
        self._authentication.call(function, self._identity, credential, token)

    def meet(self, guid: bytes, identity: Token, auth_request: Token | None = None) -> Meeting:
        """Take note of a remote participant, with the AuthRequest it sent, if it did."""
        handle, ours = Handle(), DataHolder()
        result = self._authentication.call(
            "validate_remote_identity",
            handle,
            ours,
            auth_request,
            self._identity,
            identity,
            Guid.of(guid),
            good=(PENDING_REQUEST, PENDING_MESSAGE),
        )
        request = ours.token if ours.class_id else None
        return Meeting(handle.value, result == PENDING_REQUEST, request)

    def request(self, meeting: Meeting) -> tuple[int, Token]:
        """Begin a handshake: its handle and the first message."""
        handle, out = Handle(), DataHolder()
        self._authentication.call(
            "begin_handshake_request",
            handle,
            out,
            self._identity,
            meeting.handle,
            self._participant_data(),
            good=(PENDING_MESSAGE,),
        )
        return handle.value, out.token

    def reply(self, meeting: Meeting, request: Token) -> tuple[int, Token]:
        """Answer a handshake: its handle and the second message."""
        handle, out = Handle(), DataHolder()
        self._authentication.call(
            "begin_handshake_reply",
            handle,
            out,
            request,
            meeting.handle,
            self._identity,
            self._participant_data(),
            good=(PENDING_MESSAGE,),
        )
        return handle.value, out.token

    def process(self, handshake: int, message: Token) -> Token | None:
        """Take the peer's next message; the final message to send, if this side does."""
        out, good = DataHolder(), (OK, OK_FINAL_MESSAGE)
        result = self._authentication.call("process_handshake", out, message, handshake, good=good)
        return out.token if result == OK_FINAL_MESSAGE else None

    def secret(self, handshake: int) -> Secret:
        """What a finished handshake agreed on."""
        found = SharedSecret.from_address(self.secret_handle(handshake))
        secret = ctypes.string_at(found.secret, found.size)
        return Secret(secret, bytes(found.challenge1), bytes(found.challenge2))

    def secret_handle(self, handshake: int) -> int:
        """The same as other plugins take it."""
        return self._authentication.call("get_shared_secret", handshake)

    def admit(self, meeting: Meeting, handshake: int, permissions_token: Token) -> Token:
        """Check the permissions that the peer showed in a finished handshake.

        The peer's credential: its certificate (c.id) and permissions (c.perm).
        """
        credential = DataHolder()
        function = "get_authenticated_peer_credential_token"
        self._authentication.call(function, credential, handshake)
        self._access.call(
            "validate_remote_permissions",
            self._authentication.instance,
            self._identity,
            meeting.handle,
            permissions_token,
            credential,
        )
        return credential.token

    def _participant_data(self) -> Octets:
        """A big-endian ParameterList of PID_PARTICIPANT_GUID and PID_SENTINEL."""
        return Octets.of(b"\x00\x50\x00\x10" + self.guid + b"\x00\x01\x00\x00")
