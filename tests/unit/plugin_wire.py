"""The shim's side of the socket, for tests of the agent's."""

import os

from pqsec_pki.algorithms import KEY_AGREEMENTS
from pqsec_pki.errors import PqsecError
from pqsec_pki.handshake import DataHolder, participant_data
from pqsec_pki.plugin.access_control import AccessControl
from pqsec_pki.plugin.authentication import NO_TOKEN, Authentication, ValidationResult
from pqsec_pki.plugin.calls import CALLS, MAGIC, VERSION
from pqsec_pki.plugin.connection import AgentContext, Connection
from pqsec_pki.plugin.greeting import files_seen
from pqsec_pki.plugin.lists import NewestLists
from pqsec_pki.plugin.octets import MessageReader, MessageWriter
from pqsec_pki.plugin.pending import PendingReplies
from pqsec_pki.plugin.server import RESERVED_FILES
from tests.unit.keystores import NOW

_KNOWN = ",".join(row.wire_name for row in KEY_AGREEMENTS)
IDENTITY = DataHolder("DDS:Auth:PKI-DH:1.0", (("pqsec.kagree_algo", _KNOWN),))
AUTHENTICATION = {
    "identity_ca": "identity_ca.cert.pem",
    "identity_certificate": "cert.pem",
    "private_key": "key.pem",
}
ACCESS = {f"{name}.p7s": name for name in ("governance", "permissions")}
FILES = (
    {f"dds.sec.auth.{name}": file for name, file in AUTHENTICATION.items()}
    | {f"dds.sec.access.{name}": file for file, name in ACCESS.items()}
    | {"dds.sec.access.permissions_ca": "permissions_ca.cert.pem"}
)


def framed(body):
    return len(body).to_bytes(4, "little") + body


def with_room_for(connections):
    """The beginning of a command line that starts an agent with files for so many connections."""
    limit = f'ulimit -n {RESERVED_FILES + connections}; exec "$@"'
    return ("sh", "-c", limit, "sh")


def greeting(plugin, *, magic=MAGIC, version=VERSION):
    """The frame with which the command line begins, or a library in this process."""
    writer = MessageWriter()
    writer.text(magic)
    writer.number("I", version)
    writer.text(plugin)
    if plugin != "control":
        for each in (files_seen(), "", ""):
            writer.text(each)
    return framed(writer.octets)


def asked(plugin, name, *arguments):
    """The frame of a call."""
    writer = MessageWriter()
    writer.text(name)
    for kind, value in zip(CALLS[plugin][name].takes, arguments, strict=True):
        writer.one(kind, value)
    return framed(writer.octets)


def properties(folder, **more):
    """What Cyclone DDS hands over for a participant with the files in `folder`."""
    pairs = {name: f"file:{file}" for name, file in FILES.items()}
    return tuple((pairs | more).items()), str(folder)


class Shim:
    """A greeted connection, without a socket."""

    def __init__(self, plugin, now=NOW, **shared):
        """`shared` is what it has in common with the agent's other connections."""
        self.plugin, self.log = plugin, []
        self.now = now
        house = AgentContext(lambda: self.now, self.log.append, dict, lambda: None, **shared)
        self.connection = Connection(house, "test[1]")
        (answer,) = self.connection.receive(greeting(plugin))
        assert answer == framed(b"\0")

    def call(self, name, *arguments):
        """The result and what the call gives; RefusedError with the agent's words."""
        (answer,) = self.connection.receive(asked(self.plugin, name, *arguments))
        reader = MessageReader(answer[4:])
        if reader.number("B"):
            raise RefusedError(reader.text())
        found = [reader.number("I"), *map(reader.one, CALLS[self.plugin][name].gives)]
        reader.finish()
        return found

    def identity(self, folder, **more):
        """A local participant: its handle and GUID."""
        pairs, where = properties(folder, **more)
        candidate = os.urandom(12) + b"\0\0\1\xc1"
        _, handle, guid, *_ = self.call("validate_local_identity", 0, where, pairs, candidate)
        return handle, guid


class RefusedError(Exception):
    """The agent said no."""


def new_guid():
    """As Cyclone DDS makes them."""
    return b"\xff" * 6 + os.urandom(6) + b"\0\0\1\xc1"


def side(folder, **more):
    """A shim with one participant: it, its handle and GUID."""
    shim = Shim("authentication")
    return shim, *shim.identity(folder, **more)


def shaken(*sides):
    """Both ends of a handshake of two (Shim, identity, GUID), the smaller GUID's first."""
    (one, own, guid), (other, theirs, peers) = sorted(sides, key=lambda side: side[2])
    _, seen, request = other.call("validate_remote_identity", NO_TOKEN, theirs, IDENTITY, guid)
    _, known, _ = one.call("validate_remote_identity", request, own, IDENTITY, peers)
    pdata = [participant_data(each) for each in (guid, peers)]
    _, begun, token = one.call("begin_handshake_request", own, known, pdata[0])
    _, answered, token = other.call("begin_handshake_reply", token, seen, theirs, pdata[1])
    result, token = one.call("process_handshake", token, begun)
    assert result == ValidationResult.OK_FINAL_MESSAGE
    assert other.call("process_handshake", token, answered) == [ValidationResult.OK, NO_TOKEN]
    return (one, begun, known), (other, answered, seen)


def half_shaken(asks, answers):
    """A handshake up to its Final: that, and the handle of who waits for it."""
    (one, own, guid), (other, theirs, peers) = asks, answers
    _, seen, _ = other.call("validate_remote_identity", NO_TOKEN, theirs, IDENTITY, guid)
    _, known, _ = one.call("validate_remote_identity", NO_TOKEN, own, IDENTITY, peers)
    pdata = [participant_data(each) for each in (guid, peers)]
    _, begun, token = one.call("begin_handshake_request", own, known, pdata[0])
    _, handle, token = other.call("begin_handshake_reply", token, seen, theirs, pdata[1])
    return one.call("process_handshake", token, begun)[1], handle


def refusals(folder, now=NOW, **more):
    """The errors, with their codes, with which the plugin refuses the enclave in `folder`.

    Of validate_local_identity and validate_local_permissions both, though Cyclone DDS ends with
    the first: so they are all that is wrong. `more` are further properties.
    """
    if (folder / "crl.pem").exists():
        more = {"org.eclipse.cyclonedds.sec.auth.crl": "file:crl.pem"} | more
    pairs, where = properties(folder, **more)
    identity = Authentication(lambda: now, lambda _: None, NewestLists(), PendingReplies())
    found = []
    for call in (
        lambda: identity.validate_local_identity(0, where, pairs, new_guid()),
        lambda: AccessControl(lambda: now).validate_local_permissions(1, 0, where, pairs),
    ):
        try:
            call()
        except PqsecError as error:
            found.append(error)
    return tuple(found)
