"""One connection of the agent: reads frames, makes calls, writes frames. It has no socket."""

from collections.abc import Callable, Iterator
from dataclasses import field
from typing import Any

from pqsec_pki import __version__
from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError, PqsecError, shown
from pqsec_pki.plugin.access_control import AccessControl
from pqsec_pki.plugin.authentication import Authentication, LateError
from pqsec_pki.plugin.calls import CALLS, HANDSHAKE
from pqsec_pki.plugin.greeting import Greeting, ProtocolError, VersionError
from pqsec_pki.plugin.lists import NewestLists
from pqsec_pki.plugin.notes import Clock, Log, Notes
from pqsec_pki.plugin.octets import MAX_FRAME, MessageReader, MessageWriter
from pqsec_pki.plugin.pending import PendingReplies

_HEAD = 4
_DONE, _REFUSED = 0, 1
_MOST_SHOWN = 600
_HANDSHAKE = frozenset(name.encode() for name in HANDSHAKE)
_LONGEST = max(map(len, _HANDSHAKE)) + 1
GREETED = (1).to_bytes(_HEAD, "little") + bytes([_DONE])
"""The answer to a greeting."""


@dataclass(frozen=True, slots=True)
class AgentContext:
    """What the connections of a worker share: the clock, the log, the agent's status and its stop,
    the newest revocation lists, and the handshakes that wait for a Final."""

    clock: Clock
    log: Log
    status: Callable[[], dict[str, Any]]
    stop: Callable[[], None]
    lists: NewestLists = field(default_factory=NewestLists)
    answers: PendingReplies = field(default_factory=PendingReplies)


class Control:
    """The calls of the command line."""

    def __init__(self, context: AgentContext) -> None:
        self._context = context

    def __len__(self) -> int:
        return 0

    def status(self) -> tuple[int, str]:
        """The agent's status as JSON."""
        import json  # noqa: PLC0415 -- not for a host that waits for the agent to start

        return 0, json.dumps(self._context.status() | {"version": __version__})

    def stop(self) -> tuple[int]:
        """Stop the agent after this answer."""
        self._context.stop()
        return (0,)


class Connection:
    """A DDS process and one plugin of it, or the command line."""

    def __init__(self, context: AgentContext, who: str, plugin: str = "") -> None:
        """`plugin` is that of its greeting, if that was read already."""
        self._context, self._who = context, who
        self._notes = Notes(who, context.log, context.clock)
        self._inbox = bytearray()
        self._name = plugin
        self._plugin = self._new(plugin) if plugin else None

    @property
    def what(self) -> tuple[str, str, int]:
        """(the process, the plugin, the number of its objects)."""
        return self._who, self._name, len(self._plugin) if self._plugin is not None else 0

    def finish(self) -> None:
        """Forget everything: the other end has closed the connection."""
        if isinstance(self._plugin, Authentication):
            self._plugin.finish()
        self._notes.finish()

    def receive(self, octets: bytes) -> Iterator[bytes]:
        """The answers to the octets so far. ProtocolError if they are not the protocol."""
        self.hear(octets)
        while self.waits:
            yield self.answer()

    def hear(self, octets: bytes) -> None:
        """Keep the octets until they are answered."""
        self._inbox += octets

    @property
    def waits(self) -> bool:
        """Whether a whole frame waits for its answer. ProtocolError if it is too long for one."""
        return not missing(self._inbox, MAX_FRAME)

    @property
    def waits_for_handshake(self) -> bool:
        """Whether that frame is a call of a handshake."""
        size = int.from_bytes(self._inbox[_HEAD : 2 * _HEAD], "little")
        return bytes(self._inbox[2 * _HEAD : 2 * _HEAD + min(size, _LONGEST)]) in _HANDSHAKE

    def answer(self) -> bytes:
        """The answer to the first frame that waits. ProtocolError if it cannot be understood."""
        size = int.from_bytes(self._inbox[:_HEAD], "little")
        frame = bytes(self._inbox[_HEAD : _HEAD + size])
        del self._inbox[: _HEAD + size]
        return framed(self._greeted(frame) if self._plugin is None else self._called(frame))

    def _greeted(self, frame: bytes) -> bytes:
        try:
            self._name = Greeting.read(frame).plugin
        except VersionError as error:
            return refusal(str(error))
        self._plugin = self._new(self._name)
        return bytes([_DONE])

    def _new(self, name: str) -> Authentication | AccessControl | Control:
        if name == "authentication":
            context = self._context
            return Authentication(context.clock, self._notes.add, context.lists, context.answers)
        if name == "access_control":
            return AccessControl(self._context.clock)
        return Control(self._context)

    def _called(self, frame: bytes) -> bytes:
        """The answer to a call: a refusal for any error, because the host needs an answer."""
        name = ""
        try:
            reader = MessageReader(frame)
            name = reader.text()
            return self._result(name, reader)
        except LateError as error:
            self._notes.add(f"{shown(name)}: ignored: {error}")
            return refusal(str(error))
        except PqsecError as error:
            words = str(error) + (f" ({error.hint})" if error.hint else "")
        except Exception:  # noqa: BLE001 -- see above
            import traceback  # noqa: PLC0415 -- likewise

            self._notes.add(traceback.format_exc())
            words = "an error of the agent: see its log"
        self._notes.add(f"{shown(name)} refused: {shown(words, _MOST_SHOWN)}")
        return refusal(words)

    def _result(self, name: str, reader: MessageReader) -> bytes:
        call = CALLS[self._name].get(name)
        if call is None:
            raise MalformedError(f"no call is named '{shown(name)}'")
        result, *values = getattr(self._plugin, name)(*call.arguments(reader))
        writer = MessageWriter()
        writer.number("B", _DONE)
        writer.number("I", result)
        return writer.octets + call.results(tuple(values))


def framed(body: bytes) -> bytes:
    """The frame of `body`, with its length."""
    return len(body).to_bytes(_HEAD, "little") + body


def missing(inbox: bytes | bytearray, limit: int) -> int:
    """How many octets the first frame in `inbox` still needs, as far as is known.

    ProtocolError if it has more than `limit`.
    """
    if len(inbox) < _HEAD:
        return _HEAD - len(inbox)
    size = int.from_bytes(inbox[:_HEAD], "little")
    if size > limit:
        raise ProtocolError(f"a frame of {size} octets")
    return max(0, _HEAD + size - len(inbox))


def refusal(words: str) -> bytes:
    """The answer that refuses a call, with the reason."""
    writer = MessageWriter()
    writer.number("B", _REFUSED)
    writer.text(shown(words, _MOST_SHOWN))
    return writer.octets
