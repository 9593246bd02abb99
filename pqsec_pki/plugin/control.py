"""Asks the agent for its status, and stops it."""

import socket
from typing import Any, cast

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import FileError, MalformedError, PqsecError
from pqsec_pki.plugin.agent_folder import AgentFolder
from pqsec_pki.plugin.calls import CALLS, Arguments
from pqsec_pki.plugin.greeting import Greeting
from pqsec_pki.plugin.octets import MAX_FRAME, MessageReader, MessageWriter

_SECONDS = 5.0


@dataclass(frozen=True, slots=True)
class AgentStatus:
    """The status of an agent."""

    process: int
    workers: tuple[int, ...]
    """The processes that serve hosts and hold their keys; all end with the agent."""
    version: str
    socket: str
    connections: tuple[dict[str, Any], ...]
    notice: str = ""
    """A fact about the agent that the user should know, and the action to take."""

    def to_json(self) -> dict[str, object]:
        """The status for --json."""
        return {
            "process": self.process,
            "workers": self.workers,
            "agent_version": self.version,
            "socket": self.socket,
            "connections": self.connections,
            "notice": self.notice,
        }


class Client:
    """A connection to the agent, like the shim's."""

    def __init__(self, place: AgentFolder, plugin: str) -> None:
        self._plugin = plugin
        self._link = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self._link.settimeout(_SECONDS)
        try:
            self._link.connect(str(place.socket))
        except OSError as error:
            self.close()
            raise FileError(f"no agent listens at {place.socket}") from error
        try:
            self._accepted(Greeting.own(plugin).octets)
        except PqsecError:
            self.close()
            raise

    def close(self) -> None:
        self._link.close()

    def wait_for_end(self) -> None:
        """Wait until the agent closes the connection; FileError if it does not."""
        try:
            while self._link.recv(1 << 16):
                pass
        except ConnectionError:
            return
        except OSError as error:
            raise FileError(f"the agent does not stop: {error}") from error

    def call(self, name: str, *arguments: Any) -> tuple[int, Arguments]:
        """The result and values of a call; MalformedError with the message of a refusal."""
        kinds, writer = CALLS[self._plugin][name], MessageWriter()
        writer.text(name)
        for kind, value in zip(kinds.takes, arguments, strict=True):
            writer.one(kind, value)
        reader = self._accepted(writer.octets)
        result = reader.number("I")
        found = [reader.one(kind) for kind in kinds.gives]
        reader.finish()
        return result, found

    def _accepted(self, frame: bytes) -> MessageReader:
        try:
            self._link.sendall(len(frame).to_bytes(4, "little") + frame)
            size = 0
            while not size:  # the call waits for its turn
                size = int.from_bytes(self._received(4), "little")
            reader = MessageReader(self._received(min(size, MAX_FRAME)))
        except OSError as error:
            raise FileError(f"the agent does not answer: {error}") from error
        if reader.number("B"):
            raise MalformedError(reader.text())
        return reader

    def _received(self, size: int) -> bytes:
        found = b""
        while len(found) < size:
            part = self._link.recv(size - len(found))
            if not part:
                raise ConnectionResetError("it is gone")
            found += part
        return found


def agent_status(place: AgentFolder) -> AgentStatus | None:
    """The agent's status; None if no agent listens.

    FileError if it does not answer, or if other users own its folder or may enter it.
    """
    if not place.is_there() or not place.socket.exists():
        return None
    try:
        client = Client(place, "control")
    except FileError as error:
        if isinstance(error.__cause__, TimeoutError):
            raise  # it may be starting
        return None
    try:
        _, (text,) = client.call("status")
    finally:
        client.close()
    import json  # noqa: PLC0415 -- not for the agent, which starts with this room

    found = cast("dict[str, Any]", json.loads(text))
    return AgentStatus(
        found["process"],
        tuple(found.get("workers", ())),  # an older agent has none
        found["version"],
        found["socket"],
        tuple(found["connections"]),
        found.get("notice", ""),
    )


def retired_agents(place: AgentFolder) -> list[AgentStatus]:
    """The agents that serve no new hosts, and have some still. FileError as agent_status."""
    if not place.is_there():
        return []
    return [found for each in place.retired if (found := agent_status(each))]


def stop_agent(place: AgentFolder) -> bool:
    """Stop the agent, and those that have retired, and wait until their sockets are removed.

    Whether there was an agent. FileError as agent_status, when all others have stopped.
    """
    stopped, failed = False, None
    for each in (place, *(place.retired if place.is_there() else ())):
        try:
            stopped |= _stop(each)
        except PqsecError as error:
            failed = failed or error
    if failed:
        raise failed
    return stopped


def _stop(place: AgentFolder) -> bool:
    if agent_status(place) is None:
        return False
    client = Client(place, "control")
    try:
        client.call("stop")
        client.wait_for_end()
    finally:
        client.close()
    return True
