"""The first frame of a connection: its plugin, and what the agent must have in common with a host.

The command line's has the name only, in all versions of the protocol. A library's also has the
host's mount name space and root folder, and its settings for PKCS#11 tokens.
"""

import os
from contextlib import suppress

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError, PqsecError
from pqsec_pki.plugin.calls import CALLS, CONTROL, MAGIC, VERSION
from pqsec_pki.plugin.octets import MessageReader, MessageWriter

MODULE, PIN_FILE = "PQSEC_PKCS11_MODULE", "PQSEC_PIN_FILE"
"""Variables that a host hands to the agent that it starts."""


class ProtocolError(PqsecError):
    """The octets are not the protocol, so the connection must end."""


class VersionError(PqsecError):
    """The library is of another version."""


@dataclass(frozen=True, slots=True)
class Greeting:
    """The first line of a connection."""

    plugin: str
    """A plugin of DDS-Security, or CONTROL."""
    files: str = ""
    """The host's mount name space and root folder, as of `files_seen`."""
    module: str = ""
    pin_file: str = ""
    """The values of MODULE and PIN_FILE; empty if they are not set."""

    @classmethod
    def own(cls, plugin: str) -> "Greeting":
        """The greeting of this process."""
        return cls(plugin, files_seen(), os.environ.get(MODULE, ""), os.environ.get(PIN_FILE, ""))

    @classmethod
    def read(cls, frame: bytes) -> "Greeting":
        """ProtocolError if it is not a greeting, VersionError with the words for the other end."""
        reader = MessageReader(frame)
        try:
            magic, version, plugin = reader.text(), reader.number("I"), reader.text()
            if magic != MAGIC or plugin not in CALLS:
                raise ProtocolError("not a greeting")
            if plugin == CONTROL:
                reader.finish()
                return cls(plugin)
            if version != VERSION:
                raise VersionError(
                    f"the agent speaks version {VERSION}, the library {version}: run"
                    " `pqsec plugin install` and `pqsec agent stop`"
                )
            found = cls(plugin, reader.text(), reader.text(), reader.text())
            reader.finish()
        except MalformedError as error:
            raise ProtocolError(str(error)) from error
        return found

    @property
    def octets(self) -> bytes:
        """The frame, without its length."""
        writer = MessageWriter()
        writer.text(MAGIC)
        writer.number("I", VERSION)
        writer.text(self.plugin)
        if self.plugin != CONTROL:
            for each in (self.files, self.module, self.pin_file):
                writer.text(each)
        return writer.octets


def files_seen() -> str:
    """Which files paths name in this process: its mount name space, if known, and root folder.

    `shim/agent.c` has the same in C.
    """
    root, space = os.stat("/"), ""  # noqa: PTH116 -- as C does
    with suppress(OSError):  # there may be no /proc
        space = os.readlink("/proc/self/ns/mnt")  # noqa: PTH115 -- likewise
    return f"{space} {root.st_dev}:{root.st_ino}"
