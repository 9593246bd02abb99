"""What a DDS process sends to the agent of the plugin, which may be anything."""

import os
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

from pqsec_pki.errors import MalformedError
from pqsec_pki.handshake import DataHolder
from pqsec_pki.plugin.calls import CALLS
from pqsec_pki.plugin.connection import AgentContext, Connection
from tests.fuzz.people import NOW
from tests.unit.keystores import made
from tests.unit.plugin_wire import asked, greeting, properties

_GUID = b"\xff" * 15 + b"\xc1"
_TOKEN = DataHolder("DDS:Auth:PKI-DH:1.0", (("a", "b"),), (("c", b"d"),))
_PAIRS = (("dds.sec.auth.password", "x"),)
_SAMPLES = {
    "h": 7,
    "n": 0,
    "s": "rt/chatter",
    "t": _TOKEN,
    "o": b"data",
    "g": _GUID,
    "p": ("a", "b"),
    "d": _PAIRS,
    "q": _PAIRS,
}


def take(plugin: str, octets: bytes) -> None:
    """A connection that has heard the greeting hears `octets`; an error of its own is a finding."""
    log: list[str] = []
    connection = Connection(AgentContext(lambda: NOW, log.append, dict, lambda: None), "fuzz")
    heard = list(connection.receive(greeting(plugin) + octets))
    if any("Traceback" in line for line in log):
        raise AssertionError("\n".join(log))
    if not heard:
        raise MalformedError("no greeting")


@cache
def place() -> "TemporaryDirectory[str]":
    """Goes with the process."""
    return TemporaryDirectory(prefix="pqsec-fuzz-")


@cache
def folder() -> Path:
    """That of a participant, so that calls get somewhere."""
    return made(Path(place().name) / "k", "pq").root / "enclaves/talker"


def calls(plugin: str) -> list[bytes]:
    """Each call once, and one that is answered."""
    pairs, where = properties(folder())
    samples = [
        asked(plugin, name, *(_SAMPLES[kind] for kind in call.takes))
        for name, call in CALLS[plugin].items()
    ]
    if plugin == "authentication":
        guid = os.urandom(12) + b"\0\0\1\xc1"
        return [*samples, asked(plugin, "validate_local_identity", 0, where, pairs, guid)]
    return [*samples, asked(plugin, "validate_local_permissions", 1, 0, where, pairs)]


TARGETS = {
    f"agent-{name}": (partial(take, name), partial(calls, name))
    for name in CALLS
    if name != "control"
}
