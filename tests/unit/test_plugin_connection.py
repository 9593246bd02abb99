"""A connection of the agent: greetings, frames, refusals, and what survives them."""

import os
import selectors
import socket
from contextlib import ExitStack

import pytest

from pqsec_pki.plugin.authentication import Authentication
from pqsec_pki.plugin.calls import VERSION
from pqsec_pki.plugin.connection import AgentContext, Connection, ProtocolError
from pqsec_pki.plugin.incoming import IncomingConnection, IncomingConnections
from pqsec_pki.plugin.octets import MAX_FRAME, MessageReader
from tests.unit.keystores import NOW
from tests.unit.plugin_wire import RefusedError, Shim, asked, framed, greeting

OURS, PARENT = os.getpid(), os.getppid()


@pytest.fixture
def fresh():
    """A connection that has heard nothing yet."""
    return Connection(AgentContext(lambda: NOW, print, dict, lambda: None), "test[1]")


@pytest.mark.parametrize(
    "octets",
    [
        framed(b""),
        framed(b"\xff" * 40),
        greeting("authentication", magic="pqsex"),
        greeting("crypto"),
        framed(greeting("authentication")[4:] + b"\0"),
        (MAX_FRAME + 1).to_bytes(4, "little"),
    ],
)
def test_what_is_no_greeting_ends_the_connection(fresh, octets):
    with pytest.raises(ProtocolError):
        list(fresh.receive(octets))


def test_another_version_is_told_what_to_do(fresh):
    (answer,) = fresh.receive(greeting("authentication", version=VERSION + 1))
    reader = MessageReader(answer[4:])
    assert reader.number("B") == 1
    assert f"the agent speaks version {VERSION}, the library {VERSION + 1}" in reader.text()


def test_the_command_line_of_another_version_can_still_stop_it(fresh):
    assert list(fresh.receive(greeting("control", version=VERSION + 1))) == [framed(b"\0")]
    assert list(fresh.receive(asked("control", "stop"))) == [framed(bytes(5))]


def test_frames_may_come_in_pieces_and_several_at_once(fresh):
    octets = greeting("authentication") + asked("authentication", "get_identity_token", 7) * 2
    answers = [answer for octet in octets for answer in fresh.receive(bytes([octet]))]
    together = Connection(AgentContext(lambda: NOW, print, dict, lambda: None), "test[1]")
    assert answers == list(together.receive(octets))
    assert len(answers) == 3


def test_a_refused_call_leaves_the_connection_as_it_was():
    shim = Shim("authentication", NOW)
    for frame, words in (
        (framed(b""), "a frame ends early"),
        (asked("access_control", "get_permissions_token", 1), "no call is named"),
        (framed(asked("authentication", "get_identity_token", 1)[4:] + b"\0"), "too long"),
        (asked("authentication", "get_identity_token", 1), "does not know the handle"),
    ):
        (answer,) = shim.connection.receive(frame)
        assert answer[4] == 1
        assert words in answer.decode(errors="replace")
        assert words in shim.log[-1]
    assert shim.log[-1].startswith("test[1]: get_identity_token refused: ")


def test_an_error_of_the_agents_own_is_an_answer_and_a_trace_in_the_log(monkeypatch):
    shim = Shim("authentication", NOW)

    def broken(self, handle):
        raise ZeroDivisionError

    monkeypatch.setattr(Authentication, "get_identity_token", broken)
    with pytest.raises(RefusedError, match="an error of the agent"):
        shim.call("get_identity_token", 1)
    assert "ZeroDivisionError" in shim.log[0]


def test_a_reason_is_short_and_has_no_control_characters():
    shim = Shim("authentication", NOW)
    name = "x\n" * 5000
    (answer,) = shim.connection.receive(framed(len(name).to_bytes(4, "little") + name.encode()))
    assert len(answer) < 1000
    assert "\n" not in shim.log[-1]


@pytest.mark.parametrize(
    ("starter", "order"),
    [(OURS, [OURS, PARENT]), (None, [PARENT, OURS])],
    ids=["the starter first", "in their order"],
)
def test_the_greeting_of_the_host_that_started_the_agent_is_read_first(starter, order):
    """Another process could use the rights of its groups."""
    greeted = []

    def note_greeting(connection, _greeting):
        greeted.append(connection.process)

    with selectors.DefaultSelector() as selector, ExitStack() as stack:
        incoming = IncomingConnections(selector, starter, note_greeting, print)

        def connect(process):
            link, host = map(stack.enter_context, socket.socketpair())
            host.sendall(greeting("authentication"))
            incoming.add(IncomingConnection(link, process))

        def read():
            for key, _ in selector.select(0):
                key.data(key.fileobj)

        connect(PARENT)
        for _ in range(9):  # its length, and what follows
            read()
        assert greeted == order[: 0 if starter else 1]
        connect(OURS)
        for _ in range(9):
            read()
    assert greeted == order
