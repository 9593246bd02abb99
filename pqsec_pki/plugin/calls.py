"""The shim's calls to the agent: arguments and results, in one table for both sides.

`tests/unit/test_plugin_calls.py` compares the C sources in `shim/` with it.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki.plugin.octets import MessageReader, MessageWriter

VERSION = 4
"""Version of the protocol on the socket. Shim and agent must have the same."""
MAGIC = "pqsec"
CONTROL = "control"
"""The plugin name for the command line. All versions have its calls, to stop an old agent."""

HANDSHAKE = frozenset(
    {
        "validate_remote_identity",
        "begin_handshake_request",
        "begin_handshake_reply",
        "process_handshake",
        "validate_remote_permissions",
    }
)
"""Calls that wait until no participant is being created: peers repeat their messages."""
WORKING = bytes(4)
"""An empty frame: the call waits for its turn, and the deadline for its answer begins again."""

Arguments: TypeAlias = list[Any]


@dataclass(frozen=True, slots=True)
class Call:
    """The letters of a call's arguments and results; `octets` has the meaning of each."""

    takes: str
    gives: str

    def arguments(self, reader: MessageReader) -> Arguments:
        """The arguments that the shim sent; MalformedError for others."""
        found = [reader.one(kind) for kind in self.takes]
        reader.finish()
        return found

    def results(self, values: tuple[Any, ...]) -> bytes:
        """The results, encoded."""
        writer = MessageWriter()
        for kind, value in zip(self.gives, values, strict=True):
            writer.one(kind, value)
        return writer.octets


def _calls(kinds: dict[str, str]) -> Mapping[str, Call]:
    return MappingProxyType({name: Call(*kind.split(">")) for name, kind in kinds.items()})


CALLS: Mapping[str, Mapping[str, Call]] = MappingProxyType(
    {
        "authentication": _calls(
            {
                "validate_local_identity": "nsqg>hgxb",
                "get_identity_token": "h>t",
                "set_permissions_credential_and_token": "htt>",
                "validate_remote_identity": "thtg>ht",
                "begin_handshake_request": "hho>ht",
                "begin_handshake_reply": "thho>ht",
                "process_handshake": "th>t",
                "get_shared_secret": "h>hxcco",
                "get_authenticated_peer_credential_token": "h>t",
                "find_revoked": ">h",
                "check_guid_comes_from": "hgg>",
                "return_handshake_handle": "h>",
                "return_identity_handle": "h>",
            }
        ),
        "access_control": _calls(
            {
                "validate_local_permissions": "hnsq>hx",
                "validate_remote_permissions": "hhtt>hx",
                "check_create_participant": "hn>",
                "check_create_datawriter": "hnspd>",
                "check_create_datareader": "hnspd>",
                "check_create_topic": "hns>",
                "check_remote_participant": "hn>",
                "check_remote_datawriter": "hnspd>",
                "check_remote_datareader": "hnspd>b",
                "check_remote_topic": "hns>",
                "get_permissions_token": "h>t",
                "get_permissions_credential_token": "h>t",
                "get_participant_sec_attributes": "h>bbbbbm",
                "get_topic_sec_attributes": "hs>bbbb",
                "get_endpoint_sec_attributes": "hs>bbbbbbbm",
                "return_permissions_handle": "h>",
            }
        ),
        CONTROL: _calls({"status": ">s", "stop": ">"}),
    }
)
"""Calls by the plugin that a connection is for; the command line uses `control`."""
