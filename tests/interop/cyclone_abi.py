"""The binary interface of Cyclone DDS's security plugins, through ctypes.

Names and layouts are those of dds_security_api_{types,authentication,access_control}.h,
0.10.2 to 11.0.1 alike. Nothing is compiled.

The plugins expect a ddsi_domaingv. They keep its event queue for set_listener, which is
never called here, and read one bool, whether to send optional handshake properties: a
block of ones or zeros stands in for it.
"""

import ctypes
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from ctypes import CFUNCTYPE, POINTER, Structure, byref
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

_u8, _u32, _i32, _pointer, _text = (
    ctypes.c_ubyte,
    ctypes.c_uint32,
    ctypes.c_int32,
    ctypes.c_void_p,
    ctypes.c_char_p,
)
Handle = ctypes.c_int64

# DDS_Security_ValidationResult_t
OK, _FAILED, _RETRY, PENDING_REQUEST, PENDING_MESSAGE, OK_FINAL_MESSAGE = range(6)


class Octets(Structure):
    _fields_ = (("maximum", _u32), ("length", _u32), ("buffer", POINTER(_u8)))

    @classmethod
    def of(cls, data: bytes) -> "Octets":
        # Aligned to 4 bytes, because Cyclone's reader aligns addresses, not offsets.
        block = (_u32 * (len(data) // 4 + 1))()
        ctypes.memmove(block, data, len(data))
        return cls(len(data), len(data), ctypes.cast(block, POINTER(_u8)))


class _Property(Structure):
    _fields_ = (("name", _text), ("value", _text), ("propagate", _u8))


class Properties(Structure):
    _fields_ = (("maximum", _u32), ("length", _u32), ("buffer", POINTER(_Property)))

    @classmethod
    def of(cls, pairs: Iterable[tuple[str, str]]) -> "Properties":
        items = [_Property(name.encode(), value.encode(), 1) for name, value in pairs]
        array = (_Property * len(items))(*items)
        return cls(len(items), len(items), ctypes.cast(array, POINTER(_Property)))


class _BinaryProperty(Structure):
    _fields_ = (("name", _text), ("value", Octets), ("propagate", _u8))


class BinaryProperties(Structure):
    _fields_ = (("maximum", _u32), ("length", _u32), ("buffer", POINTER(_BinaryProperty)))

    @classmethod
    def of(cls, pairs: Iterable[tuple[str, bytes]]) -> "BinaryProperties":
        items = [_BinaryProperty(name.encode(), Octets.of(value), 1) for name, value in pairs]
        array = (_BinaryProperty * len(items))(*items)
        return cls(len(items), len(items), ctypes.cast(array, POINTER(_BinaryProperty)))


class Token(NamedTuple):
    """A DataHolder as a value: identity, permissions and handshake messages."""

    class_id: str
    properties: tuple[tuple[str, str], ...] = ()
    binary: tuple[tuple[str, bytes], ...] = ()


class DataHolder(Structure):
    _fields_ = (("class_id", _text), ("properties", Properties), ("binary", BinaryProperties))

    @classmethod
    def of(cls, token: Token) -> "DataHolder":
        plain, binary = Properties.of(token.properties), BinaryProperties.of(token.binary)
        return cls(token.class_id.encode(), plain, binary)

    @property
    def token(self) -> Token:
        plain = self.properties.buffer[: self.properties.length]
        binary = self.binary.buffer[: self.binary.length]
        return Token(
            (self.class_id or b"").decode(),
            tuple((each.name.decode(), each.value.decode(errors="replace")) for each in plain),
            tuple(
                (each.name.decode(), ctypes.string_at(each.value.buffer, each.value.length))
                for each in binary
            ),
        )


class Qos(Structure):
    _fields_ = (("properties", Properties), ("binary", BinaryProperties), ("tags", Properties))


class Guid(Structure):
    _fields_ = (("octets", _u8 * 16),)

    @classmethod
    def of(cls, octets: bytes) -> "Guid":
        return cls((_u8 * 16)(*octets))


class SharedSecret(Structure):
    _fields_ = (
        ("secret", POINTER(_u8)),
        ("size", _i32),
        ("challenge1", _u8 * 32),
        ("challenge2", _u8 * 32),
    )


class _Exception(Structure):
    _fields_ = (("message", _text), ("code", _i32), ("minor_code", _i32))


def _table(*functions: tuple[str, Any, tuple[Any, ...]] | str) -> type[Structure]:
    """The plugin's struct of functions; one that is not called here is only a name."""
    fields: list[tuple[str, Any]] = [("gv", _pointer)]
    for function in functions:
        if isinstance(function, str):
            fields.append((function, _pointer))
        else:
            name, result, arguments = function
            kind = CFUNCTYPE(result, _pointer, *arguments, POINTER(_Exception))
            fields.append((name, kind))
    return type("_Table", (Structure,), {"_fields_": fields})


_token, _guid, _qos, _octets = POINTER(DataHolder), POINTER(Guid), POINTER(Qos), POINTER(Octets)
_new = POINTER(Handle)
AUTHENTICATION = _table(
    ("validate_local_identity", _i32, (_new, _guid, _i32, _qos, _guid)),
    ("get_identity_token", _u8, (_token, Handle)),
    "get_identity_status_token",
    ("set_permissions_credential_and_token", _u8, (Handle, _token, _token)),
    ("validate_remote_identity", _i32, (_new, _token, _token, Handle, _token, _guid)),
    ("begin_handshake_request", _i32, (_new, _token, Handle, Handle, _octets)),
    ("begin_handshake_reply", _i32, (_new, _token, _token, Handle, Handle, _octets)),
    ("process_handshake", _i32, (_token, _token, Handle)),
    ("get_shared_secret", Handle, (Handle,)),
    ("get_authenticated_peer_credential_token", _u8, (_token, Handle)),
)
ACCESS_CONTROL = _table(
    ("validate_local_permissions", Handle, (_pointer, Handle, _i32, _qos)),
    ("validate_remote_permissions", Handle, (_pointer, Handle, Handle, _token, _token)),
    ("check_create_participant", _u8, (Handle, _i32, _qos)),
    "check_create_datawriter",
    "check_create_datareader",
    "check_create_topic",
    "check_local_datawriter_register_instance",
    "check_local_datawriter_dispose_instance",
    "check_remote_participant",
    "check_remote_datawriter",
    "check_remote_datareader",
    "check_remote_topic",
    "check_local_datawriter_match",
    "check_local_datareader_match",
    "check_remote_datawriter_register_instance",
    "check_remote_datawriter_dispose_instance",
    ("get_permissions_token", _u8, (_token, Handle)),
    ("get_permissions_credential_token", _u8, (_token, Handle)),
)


class RefusedError(Exception):
    """A plugin said no: its function, its code, its words."""

    def __init__(self, function: str, code: int, words: str) -> None:
        super().__init__(f"{function}: {words} (code {code})")
        self.function, self.code = function, code


@dataclass(frozen=True)
class Plugin:
    """A started plugin: its instance and its functions."""

    instance: int
    functions: Any

    def call(self, function: str, *arguments: Any, good: tuple[int, ...] = ()) -> int:
        """The result; RefusedError unless it is among `good`, or not 0 where there are none.

        Structures are passed by reference; a Token too, as a DataHolder.
        """
        failure = _Exception()
        passed = [_by_reference(each) for each in arguments]
        result: int = getattr(self.functions, function)(self.instance, *passed, byref(failure))
        if result not in good if good else not result:
            words = (failure.message or b"").decode(errors="replace")
            raise RefusedError(function, failure.code, words)
        return result


def _by_reference(argument: Any) -> Any:
    if isinstance(argument, Token):
        argument = DataHolder.of(argument)
    return byref(argument) if isinstance(argument, Structure | Handle) else argument


@contextmanager
def started(
    library: Path, name: str, table: type[Structure], *, optional: bool = False
) -> Iterator[Plugin]:
    """The plugin in `library`, between its init_`name` and finalize_`name`."""
    loaded = ctypes.CDLL(str(library))
    start, stop = getattr(loaded, f"init_{name}"), getattr(loaded, f"finalize_{name}")
    start.argtypes, stop.argtypes = [_text, POINTER(_pointer), _pointer], [_pointer]
    domain = ctypes.create_string_buffer(bytes([optional]) * 65536)
    instance = _pointer()
    if start(b"", byref(instance), ctypes.addressof(domain)) or not instance.value:
        raise RefusedError(f"init_{name}", 0, "the plugin does not start")
    try:
        yield Plugin(instance.value, ctypes.cast(instance, POINTER(table)).contents)
    finally:
        stop(instance)
