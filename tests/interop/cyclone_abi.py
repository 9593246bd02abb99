"""The binary interface of Cyclone DDS's security plugins, through ctypes.

Names and layouts are those of dds_security_api_{types,authentication,access_control,
cryptography}.h, 0.10.2 to 11.0.1 alike. Nothing is compiled.

The plugins expect a ddsi_domaingv. They keep its event queue for set_listener, which is
never called here, and read one bool, whether to send optional handshake properties: a
block of ones or zeros stands in for it.
"""

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes import CFUNCTYPE, POINTER, Structure, byref
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.interop.cyclone_types import (
    Byte,
    DataHolder,
    DataHolders,
    EndpointAttributes,
    Failure,
    Guid,
    Handle,
    Handles,
    Number,
    Octets,
    ParticipantAttributes,
    Properties,
    Qos,
    Text,
    Token,
)

_pointer = ctypes.c_void_p

# DDS_Security_ValidationResult_t
OK, _FAILED, _RETRY, PENDING_REQUEST, PENDING_MESSAGE, OK_FINAL_MESSAGE = range(6)


def _table(
    *functions: tuple[str, Any, tuple[Any, ...]] | str, first: str | None = "gv"
) -> type[Structure]:
    """The plugin's struct of functions; one that is not called here is only a name."""
    fields: list[tuple[str, Any]] = [(first, _pointer)] if first else []
    for function in functions:
        if isinstance(function, str):
            fields.append((function, _pointer))
        else:
            name, result, arguments = function
            kind = CFUNCTYPE(result, _pointer, *arguments, POINTER(Failure))
            fields.append((name, kind))
    return type("_Table", (Structure,), {"_fields_": fields})


_token, _guid, _qos, _octets = POINTER(DataHolder), POINTER(Guid), POINTER(Qos), POINTER(Octets)
_new = POINTER(Handle)
AUTHENTICATION = _table(
    ("validate_local_identity", Number, (_new, _guid, Number, _qos, _guid)),
    ("get_identity_token", Byte, (_token, Handle)),
    "get_identity_status_token",
    ("set_permissions_credential_and_token", Byte, (Handle, _token, _token)),
    ("validate_remote_identity", Number, (_new, _token, _token, Handle, _token, _guid)),
    ("begin_handshake_request", Number, (_new, _token, Handle, Handle, _octets)),
    ("begin_handshake_reply", Number, (_new, _token, _token, Handle, Handle, _octets)),
    ("process_handshake", Number, (_token, _token, Handle)),
    ("get_shared_secret", Handle, (Handle,)),
    ("get_authenticated_peer_credential_token", Byte, (_token, Handle)),
)
_new_endpoint = (Handle, Number, Text, _qos, _pointer, _pointer)
ACCESS_CONTROL = _table(
    ("validate_local_permissions", Handle, (_pointer, Handle, Number, _qos)),
    ("validate_remote_permissions", Handle, (_pointer, Handle, Handle, _token, _token)),
    ("check_create_participant", Byte, (Handle, Number, _qos)),
    ("check_create_datawriter", Byte, _new_endpoint),
    ("check_create_datareader", Byte, _new_endpoint),
    ("check_create_topic", Byte, (Handle, Number, Text, _qos)),
    "check_local_datawriter_register_instance",
    "check_local_datawriter_dispose_instance",
    ("check_remote_participant", Byte, (Handle, Number, _pointer)),
    ("check_remote_datawriter", Byte, (Handle, Number, _pointer)),
    ("check_remote_datareader", Byte, (Handle, Number, _pointer, _pointer)),
    ("check_remote_topic", Byte, (Handle, Number, _pointer)),
    "check_local_datawriter_match",
    "check_local_datareader_match",
    "check_remote_datawriter_register_instance",
    "check_remote_datawriter_dispose_instance",
    ("get_permissions_token", Byte, (_token, Handle)),
    ("get_permissions_credential_token", Byte, (_token, Handle)),
)
_holders, _handles = POINTER(DataHolders), POINTER(Handles)
_participant, _endpoint = POINTER(ParticipantAttributes), POINTER(EndpointAttributes)
_properties = POINTER(Properties)
_give, _take = (_holders, Handle, Handle), (Handle, Handle, _holders)
CRYPTO = _table("transform", "key_factory", "key_exchange")
KEY_FACTORY = _table(
    ("register_local_participant", Handle, (Handle, Handle, _properties, _participant)),
    ("register_matched_remote_participant", Handle, (Handle, Handle, Handle, Handle)),
    ("register_local_datawriter", Handle, (Handle, _properties, _endpoint)),
    ("register_matched_remote_datareader", Handle, (Handle, Handle, Handle, Byte)),
    ("register_local_datareader", Handle, (Handle, _properties, _endpoint)),
    ("register_matched_remote_datawriter", Handle, (Handle, Handle, Handle)),
    first=None,
)
KEY_EXCHANGE = _table(
    ("create_local_participant_crypto_tokens", Byte, _give),
    ("set_remote_participant_crypto_tokens", Byte, _take),
    ("create_local_datawriter_crypto_tokens", Byte, _give),
    ("set_remote_datawriter_crypto_tokens", Byte, _take),
    ("create_local_datareader_crypto_tokens", Byte, _give),
    ("set_remote_datareader_crypto_tokens", Byte, _take),
    first=None,
)
TRANSFORM = _table(
    ("encode_serialized_payload", Byte, (_octets, _octets, _octets, Handle)),
    ("encode_datawriter_submessage", Byte, (_octets, _octets, Handle, _handles, POINTER(Number))),
    ("encode_datareader_submessage", Byte, (_octets, _octets, Handle, _handles)),
    "encode_rtps_message",
    "decode_rtps_message",
    "preprocess_secure_submsg",
    ("decode_datawriter_submessage", Byte, (_octets, _octets, Handle, Handle)),
    ("decode_datareader_submessage", Byte, (_octets, _octets, Handle, Handle)),
    ("decode_serialized_payload", Byte, (_octets, _octets, _octets, Handle, Handle)),
    first=None,
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
        failure = Failure()
        passed = [_by_reference(each) for each in arguments]
        result: int = getattr(self.functions, function)(self.instance, *passed, byref(failure))
        if result not in good if good else not result:
            words = (failure.message or b"").decode(errors="replace")
            raise RefusedError(function, failure.code, words)
        return result

    def part(self, name: str, table: type[Structure]) -> "Plugin":
        """The plugin inside this one that its struct points to as `name`."""
        address: int = getattr(self.functions, name)
        return Plugin(address, ctypes.cast(address, POINTER(table)).contents)


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
    start.argtypes, stop.argtypes = [Text, POINTER(_pointer), _pointer], [_pointer]
    domain = ctypes.create_string_buffer(bytes([optional]) * 65536)
    instance = _pointer()
    if start(b"", byref(instance), ctypes.addressof(domain)) or not instance.value:
        raise RefusedError(f"init_{name}", 0, "the plugin does not start")
    try:
        yield Plugin(instance.value, ctypes.cast(instance, POINTER(table)).contents)
    finally:
        stop(instance)
