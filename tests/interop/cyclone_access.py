"""The access control of Cyclone DDS, asked about single endpoints.

It is the real plugin, called as a participant's stack and as its peers call it. It looks
at no key and no chain: identities are only handles to it, and a certificate only has a
subject.
"""

import ctypes
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ctypes import POINTER, Structure, byref
from functools import partial
from pathlib import Path
from typing import Any

from pqsec_pki.access import Action, Question
from tests.interop.cyclone_abi import ACCESS_CONTROL, Plugin, RefusedError, started
from tests.interop.cyclone_types import (
    Byte,
    Count,
    DataHolder,
    Properties,
    Qos,
    Text,
    Token,
)

_AUTHENTICATION = ctypes.create_string_buffer(8)
"""Stands for that plugin, which this one never calls."""
_OWN, _REMOTE = 1, 2
_PARTICIPANT_DATA = ctypes.create_string_buffer(512)
KINDS = {Action.PUBLISH: "datawriter", Action.SUBSCRIBE: "datareader"}
_FILES = {
    "dds.sec.auth.identity_ca": "identity_ca.cert.pem",
    "dds.sec.auth.identity_certificate": "cert.pem",
    "dds.sec.access.permissions_ca": "permissions_ca.cert.pem",
    "dds.sec.access.governance": "governance.p7s",
    "dds.sec.access.permissions": "permissions.p7s",
}


class _Strings(Structure):
    _fields_ = (("maximum", Count), ("length", Count), ("buffer", POINTER(Text)))

    @classmethod
    def of(cls, texts: tuple[str, ...]) -> "_Strings":
        array = (Text * len(texts))(*(text.encode() for text in texts))
        return cls(len(texts), len(texts), ctypes.cast(array, POINTER(Text)))


def _endpoint_data(policies: int) -> type[Structure]:
    """What discovery tells of an endpoint; only names and partitions are looked at."""
    fields = (
        ("keys", Byte * 24),
        ("topic", Text),
        ("type", Text),
        ("policies", Byte * policies),
        ("partitions", _Strings),
        ("rest", Byte * 128),
    )
    return type("_EndpointData", (Structure,), {"_fields_": fields})


_DATA = {Action.PUBLISH: _endpoint_data(96), Action.SUBSCRIBE: _endpoint_data(88)}


class _TopicData(Structure):
    _fields_ = (("key", Byte * 12), ("topic", Text), ("rest", Byte * 256))


@contextmanager
def access_control(plugins: Path, enclave: Path, domain: int) -> Iterator["AccessControl"]:
    """The plugin with the files in `enclave`, on that domain."""
    with started(plugins / "libdds_security_ac.so", "access_control", ACCESS_CONTROL) as plugin:
        yield AccessControl(plugin, enclave, domain)


class AccessControl:
    """What Cyclone DDS answers to questions, by its own checks in their order."""

    def __init__(self, plugin: Plugin, enclave: Path, domain: int) -> None:
        self._plugin = plugin
        properties = {name: f"file:{enclave / file}" for name, file in _FILES.items()}
        self._qos = Qos(properties=Properties.of(properties.items()))
        certificate, permissions = "cert.pem", "permissions.p7s"
        shown = (("c.id", certificate), ("c.perm", permissions))
        credential = tuple((name, (enclave / file).read_bytes()) for name, file in shown)
        self.unfit = refusal(lambda: self._validate(domain, credential))

    def _validate(self, domain: int, credential: tuple[tuple[str, bytes], ...]) -> None:
        """Take the signed documents as one's own, and as those of a peer."""
        call, peer = self._plugin.call, DataHolder.of(Token("DDS:Auth:PKI-DH:1.0", credential))
        token = DataHolder.of(Token("DDS:Access:Permissions:1.0"))
        arguments = _AUTHENTICATION, _OWN
        self._own = call("validate_local_permissions", *arguments, domain, self._qos)
        self._peer = call("validate_remote_permissions", *arguments, _REMOTE, token, peer)

    def own(self, question: Question) -> str:
        """Why the participant's own stack refuses; empty if it does not."""
        return self.unfit or refusal(lambda: self._ask_own(question))

    def peer(self, question: Question) -> str:
        """Why a peer of the same domain refuses; empty if it does not."""
        return self.unfit or refusal(lambda: self._ask_peer(question))

    def _ask_own(self, question: Question) -> None:
        check = partial(self._check, "check_create_", self._own, question.domain)
        check("participant", self._qos)
        if question.topic is not None:
            topic = question.topic.encode()
            check("topic", topic, self._qos)
            check(KINDS[question.action], topic, self._qos, _Strings.of(question.partitions), None)

    def _ask_peer(self, question: Question) -> None:
        check = partial(self._check, "check_remote_", self._peer, question.domain)
        check("participant", _PARTICIPANT_DATA)
        if question.topic is not None:
            names = {"topic": question.topic.encode(), "type": b"T"}
            data = _DATA[question.action](partitions=_Strings.of(question.partitions), **names)
            relay_only = [] if question.action is Action.PUBLISH else [byref(Byte())]
            check(KINDS[question.action], data, *relay_only)
            check("topic", _TopicData(topic=names["topic"]))

    def _check(
        self, prefix: str, permissions: int, domain: int, what: str, *arguments: Any
    ) -> None:
        self._plugin.call(prefix + what, permissions, domain, *arguments)


def refusal(ask: Callable[[], None]) -> str:
    """Why a stack refuses; empty if it does not."""
    try:
        ask()
    except RefusedError as error:
        return str(error)
    return ""
