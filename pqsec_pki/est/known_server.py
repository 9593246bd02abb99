"""The server that a robot enrolled at, in a file of its credential store."""

import json
from dataclasses import field, replace
from pathlib import Path
from typing import Any, Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import is_there, read, write
from pqsec_pki.errors import KeystoreError, PqsecError, located, other_format
from pqsec_pki.est.client import EstClient
from pqsec_pki.est.tls import ServerTrust
from pqsec_pki.est.token_file import checked_url

FILE = "server.json"
FORMAT = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownServer:
    """How to reach the server again, and what it knows."""

    server: str
    trust: ServerTrust
    classical: bool = False
    receipt: str = field(default="", repr=False)
    """SHA-256 of the receipt that it has, in hex."""

    @classmethod
    def of(cls, client: EstClient) -> Self:
        """The server that a client asks."""
        return cls(server=client.server, trust=client.trust, classical=client.classical)

    @classmethod
    def at(cls, root: Path) -> "KnownServer | None":
        """The server of the credential store at `root`; KeystoreError if its file is damaged."""
        if not is_there(root / FILE):
            return None
        with located(root / FILE):
            return cls._from_json(read(root / FILE))

    @classmethod
    def _from_json(cls, data: bytes) -> Self:
        try:
            value: dict[str, Any] = json.loads(data)
            if value["format"] != FORMAT:
                raise other_format(KeystoreError, value["format"], (FORMAT,))
            trust = ServerTrust(
                frozenset(map(str, value["pins"])), str(value["authorities"]).encode()
            )
            return cls(
                server=checked_url(str(value["server"])),
                trust=trust,
                classical=value["classical"] is True,
                receipt=str(value["receipt"]),
            )
        except (*(ValueError, KeyError, TypeError), *(AttributeError, RecursionError)):
            raise KeystoreError("cannot be read") from None
        except PqsecError as error:
            raise KeystoreError(f"cannot be read: {error}", hint=error.hint) from None

    def save(self, root: Path) -> None:
        """Keep it in the credential store at `root`."""
        value = {
            "format": FORMAT,
            "server": self.server,
            "pins": sorted(self.trust.pins),
            "authorities": self.trust.authorities.decode(),
            "classical": self.classical,
            "receipt": self.receipt,
        }
        data = json.dumps(value, indent=2).encode() + b"\n"
        write(root / FILE, data, private=True, force=True)

    def with_receipt(self, sha256: str) -> "KnownServer":
        """This server, after it received the receipt with that hash."""
        return replace(self, receipt=sha256)
