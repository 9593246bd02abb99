"""An enrolment token: a file with which one robot enrols, and which names the CAs to trust.

It is a secret while it is valid: its holder can enrol in the robot's place.
"""

import base64
import hashlib
import hmac
import json
import re
import secrets
from dataclasses import field
from datetime import UTC, datetime
from typing import Any, Self
from urllib.parse import urlsplit

from pqsec_pki._dataclass import dataclass
from pqsec_pki.enrolment import Pins, pin_texts, pins_of
from pqsec_pki.errors import MalformedError, UsageError, shown

FORMAT, KIND = 1, "enrolment token"
MAX_TOKEN_FILE = 64 << 10
"""Bytes. A token has 600."""
SECRET_SIZE, ID_SIZE = 32, 8
"""Bytes."""
_ID, _PIN = re.compile("[0-9a-f]{16}"), re.compile("[0-9a-f]{64}")


@dataclass(frozen=True, slots=True, kw_only=True)
class EnrolmentToken:
    """The content of the file."""

    server: str
    """The server's URL."""
    server_pins: frozenset[str]
    """SHA-256 of the server's keys (SPKI), in hex."""
    cas: Pins
    """The CAs that the robot is to trust."""
    id: str
    """The identifier of the token at the server; it is not secret."""
    secret: str = field(repr=False)
    """32 random bytes, in base64url without padding."""
    names: str
    """The participant's name, or a pattern of names."""
    profile: str
    """The name of the keystore's profile; of several, with commas between them."""
    not_after: datetime

    @classmethod
    def new(  # noqa: PLR0913 -- by name
        cls,
        *,
        server: str,
        server_pins: frozenset[str],
        cas: Pins,
        names: str,
        profile: str,
        not_after: datetime,
    ) -> Self:
        """A token with a new secret; UsageError if `server` is not an https URL."""
        return cls(
            server=checked_url(server),
            server_pins=server_pins,
            cas=cas,
            id=secrets.token_hex(ID_SIZE),
            secret=_text(secrets.token_bytes(SECRET_SIZE)),
            names=names,
            profile=profile,
            not_after=not_after.replace(microsecond=0),
        )

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The token in the file's content `data`; MalformedError for anything else.

        No message has any part of the secret.
        """
        try:
            value: dict[str, Any] = json.loads(data)
            if value["kind"] != KIND:
                raise MalformedError("not an enrolment token of pqsec")
            if value["format"] != FORMAT:
                raise MalformedError("an enrolment token of another version of pqsec")
            token = cls(
                server=checked_url(str(value["server"])),
                server_pins=frozenset(server_pin(str(each)) for each in value["server_pins"]),
                cas=pins_of(map(str, value["cas"])),
                id=str(value["id"]),
                secret=str(value["secret"]),
                names=str(value["names"]),
                profile=str(value["profile"]),
                not_after=datetime.fromisoformat(value["not_after"]).astimezone(UTC),
            )
        except (*(ValueError, KeyError, TypeError), *(OverflowError, RecursionError)):
            raise MalformedError("not an enrolment token of pqsec") from None
        except UsageError as error:
            raise MalformedError(f"the enrolment token is damaged: {error}") from None
        if not (_ID.fullmatch(token.id) and secret_hash(token.secret)):
            raise MalformedError("the enrolment token is damaged: it has no secret")
        return token

    def to_bytes(self) -> bytes:
        """The file's content, for a file that only its owner can read."""
        value = {
            "format": FORMAT,
            "kind": KIND,
            "server": self.server,
            "server_pins": sorted(self.server_pins),
            "cas": pin_texts(self.cas),
            "id": self.id,
            "secret": self.secret,
            "names": self.names,
            "profile": self.profile,
            "not_after": self.not_after.astimezone(UTC).isoformat(),
        }
        return json.dumps(value, indent=2).encode() + b"\n"

    @property
    def secret_hash(self) -> str:
        """SHA-256 of the secret, in hex: what the server keeps."""
        return secret_hash(self.secret)


def secret_hash(secret: str) -> str:
    """SHA-256 of the secret's bytes, in hex; empty for a text that is not a secret. The secret is
    random and cannot be guessed, so it needs no salt and no slow hash.
    """
    try:
        data = base64.b64decode(f"{secret}=", altchars=b"-_", validate=True)
    except ValueError:
        return ""
    return hashlib.sha256(data).hexdigest() if len(data) == SECRET_SIZE else ""


def is_secret(secret: str, expected: str) -> bool:
    """Whether `secret` is the one with the hash `expected`."""
    found = secret_hash(secret)
    return bool(found) and hmac.compare_digest(found, expected)


def checked_url(text: str) -> str:
    """`text` if it is the https URL of a server, without its path; else UsageError."""
    try:
        parts = urlsplit(text)
        _ = parts.port
        good = parts.scheme == "https" and parts.hostname and not parts.username
        if good and parts.path in {"", "/"} and not (parts.query or parts.fragment):
            return f"https://{parts.netloc}"
    except ValueError:
        pass
    raise UsageError(
        f"'{shown(text)}' is not the URL of a server",
        hint="write https://HOST or https://HOST:PORT",
    )


def server_pin(text: str) -> str:
    """The SHA-256 of a server's key as it is compared; UsageError if `text` is none."""
    pin = text.lower().replace(":", "")
    if not _PIN.fullmatch(pin):
        raise UsageError(f"'{shown(text)}' is not a SHA-256 in hex")
    return pin


def _text(secret: bytes) -> str:
    return base64.urlsafe_b64encode(secret).rstrip(b"=").decode()
