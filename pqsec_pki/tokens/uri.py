"""URIs of keys in PKCS#11 tokens (RFC 7512), as pqsec accepts them."""

import re
from pathlib import Path
from typing import Self
from urllib.parse import quote, unquote_to_bytes

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import UsageError

SCHEME = "pkcs11"
MAX_LENGTH = 2048
"""Characters of a URI."""
_EXAMPLE = "write for example 'pkcs11:token=lab;object=identity-ca'"
_TOKEN = ("token", "serial", "manufacturer", "model")
_OBJECT = ("object", "id")
_OF_PATH = (*_TOKEN, *_OBJECT, "type")
_MODULE = ("module-path", "module-name")
_UNRESERVED = ":[]@!$'()*+,="
"""Characters that RFC 7512 allows in a value of the path besides those that `quote` leaves."""
_PIN = r"(?i)(pin-value=)[^&]*"
_PERCENT = r"%(?![0-9A-Fa-f]{2})"


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyUri:
    """A private key in a token. At least the token or its serial number, and a label or an id."""

    token: str | None = None
    """The token's label."""
    serial: str | None = None
    manufacturer: str | None = None
    model: str | None = None
    object: str | None = None
    """The key's label (CKA_LABEL)."""
    id: bytes | None = None
    """CKA_ID."""
    pin_source: Path | None = None
    """A file with the PIN in its first line."""

    @classmethod
    def parse(cls, text: str) -> Self:
        """UsageError if `text` is not such a URI, has a PIN, or names a library."""
        if len(text) > MAX_LENGTH:
            raise UsageError(f"the URI of a key has at most {MAX_LENGTH} characters")
        scheme, colon, rest = text.partition(":")
        if scheme.lower() != SCHEME or not colon:
            raise UsageError("not a URI of a key in a PKCS#11 token (RFC 7512)", hint=_EXAMPLE)
        path, _, query = rest.partition("?")
        found = _attributes(path, ";")
        asked = _attributes(query, "&")
        _refuse_pin_and_module(asked)
        if unknown := [*(found.keys() - {*_OF_PATH}), *(asked.keys() - {"pin-source"})]:
            raise UsageError(
                f"the URI of a key has an attribute that is not known: {', '.join(unknown)}",
                hint=f"known are {', '.join(_OF_PATH)}, and pin-source after a question mark",
            )
        if found.pop("type", b"private") != b"private":
            raise UsageError("the URI names no private key", hint="leave its type out")
        texts = {name: _text(name, found[name]) for name in found if name != "id"}
        source = asked.get("pin-source")
        uri = cls(**texts, id=found.get("id"), pin_source=_file(source) if source else None)
        uri._refuse_vague()
        return uri

    def _refuse_vague(self) -> None:
        if self.token is None and self.serial is None:
            raise UsageError("the URI of a key names no token", hint=_EXAMPLE)
        if self.object is None and self.id is None:
            raise UsageError("the URI names a token, and no key in it", hint=_EXAMPLE)

    @property
    def place(self) -> str:
        """The token, as people know it."""
        return f"token '{self.token}'" if self.token else f"token with serial number {self.serial}"

    def __str__(self) -> str:
        """The URI in one form: attributes in a fixed order, with what must be escaped escaped."""
        values: list[tuple[str, str | bytes | None]] = [
            *((name, getattr(self, name)) for name in (*_TOKEN, *_OBJECT)),
        ]
        path = ";".join(f"{name}={_quoted(value)}" for name, value in values if value is not None)
        query = f"?pin-source={quote(f'file:{self.pin_source}', safe='/:')}"
        return f"{SCHEME}:{path};type=private{query if self.pin_source else ''}"


def usable(uri: str) -> str:
    """The URI of a key, in a token or elsewhere; UsageError if it names a PIN or a library."""
    return str(KeyUri.parse(uri)) if uri.lower().startswith(f"{SCHEME}:") else uri


def without_pin(uri: str) -> str:
    """The URI as it may be shown: other tools write PINs into it, which pqsec refuses."""
    return re.sub(_PIN, r"\1(not shown)", uri)


def _quoted(value: str | bytes) -> str:
    if isinstance(value, bytes):
        return "".join(f"%{octet:02X}" for octet in value)
    return quote(value, safe=_UNRESERVED)


def _attributes(text: str, separator: str) -> dict[str, bytes]:
    found: dict[str, bytes] = {}
    for item in filter(None, text.split(separator)):
        name, equals, value = item.partition("=")
        if not equals or not value or not value.isascii() or re.search(_PERCENT, value):
            raise UsageError(f"'{name}' in the URI of a key has no valid value", hint=_EXAMPLE)
        if name in found:
            raise UsageError(f"the URI of a key has '{name}' twice")
        found[name] = unquote_to_bytes(value)
    return found


def _refuse_pin_and_module(asked: dict[str, bytes]) -> None:
    if "pin-value" in asked:
        raise UsageError(
            "the URI of a key contains a PIN, which others could read",
            hint="use pin-source=file:/path, PQSEC_PIN_FILE, or the prompt",
        )
    if any(each in asked for each in _MODULE):
        raise UsageError(
            "the URI of a key names the library of its token, and everyone who opens the keystore"
            " would run it",
            hint="name the library in PQSEC_PKCS11_MODULE, or register it with p11-kit",
        )


def _text(name: str, value: bytes) -> str:
    try:
        text = value.decode()
    except UnicodeDecodeError:
        raise UsageError(f"'{name}' in the URI of a key is not UTF-8") from None
    if not text.isprintable():
        raise UsageError(f"'{name}' in the URI of a key has unprintable characters")
    return text


def _file(source: bytes) -> Path:
    """RFC 7512, 2.4: a file as a URI or as a path; commands (`|`) are not accepted."""
    path = Path(_text("pin-source", source).removeprefix("file:"))
    if not path.is_absolute():
        raise UsageError(
            "pin-source in the URI of a key is not a file's absolute path",
            hint="write pin-source=file:/path/to/file",
        )
    return Path("/" + str(path).lstrip("/"))  # file:///path too
