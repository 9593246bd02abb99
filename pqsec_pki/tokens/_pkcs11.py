"""PKCS#11 tokens: a login for each token, and the keys in it. The only user of python-pkcs11.

A token is used by the process that opened it: PKCS#11 (3.1, 5.4) gives a fork no session.
"""

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import field
from functools import cache
from typing import Any

import pkcs11

from pqsec_pki._dataclass import dataclass
from pqsec_pki._processes import stay_alone
from pqsec_pki.algorithms import ExternalKey, SignatureAlgorithm, load_public_key
from pqsec_pki.errors import PassphraseError, PqsecError, UsageError
from pqsec_pki.tokens._key_types import KEY_TYPES, KeyType, key_type_of, template
from pqsec_pki.tokens.pin import VARIABLE as PIN_VARIABLE
from pqsec_pki.tokens.pin import Pin, pin_in
from pqsec_pki.tokens.uri import KeyUri

VARIABLE = "PQSEC_PKCS11_MODULE"
"""The library of the tokens. A keystore cannot name it: it would run what somebody prepared."""
_DEFAULT_MODULE = "p11-kit-proxy.so"
"""Finds all libraries that are registered on this machine."""
_ID_SIZE = 16
"""Bytes of CKA_ID of a key that is generated here."""


class _NoKeyError(PqsecError):
    """A token has no such key."""


@cache
def library() -> Any:
    """The tokens' library, loaded; PqsecError if there is none."""
    module = os.environ.get(VARIABLE) or _DEFAULT_MODULE
    try:
        return pkcs11.lib(module)
    except (pkcs11.PKCS11Error, RuntimeError) as error:
        raise PqsecError(
            f"the library of the tokens, {module}, cannot be used: {_words(error)}",
            hint=f"name it in {VARIABLE}, or install p11-kit and register it there",
        ) from error


@dataclass(eq=False)
class Login:
    """One login to one token; opened again if the token was pulled and put back."""

    uri: KeyUri
    pin: str = field(repr=False)
    session: Any = None
    lock: threading.RLock = field(default_factory=threading.RLock)

    def open(self, *, typed: bool) -> None:
        """Log in. PassphraseError for a wrong PIN, PqsecError if the token is not there.

        After a wrong PIN, in any process, only a PIN that a user `typed` is tried: a service that
        restarts would lock the token.
        """
        token = _token(self.uri)
        if not typed and pkcs11.TokenFlag.USER_PIN_COUNT_LOW in token.flags:
            raise PassphraseError(
                f"the last PIN for the {self.uri.place} was wrong, so the stored one is not tried",
                hint="correct the file with it, then log in once by hand: without"
                f" {PIN_VARIABLE} pqsec asks for it; or `pkcs11-tool --login --list-objects`",
            )
        with _as_errors(self.uri):
            try:
                self.session = token.open(rw=True, user_pin=self.pin)
            except pkcs11.TokenWriteProtected:
                self.session = token.open(user_pin=self.pin)
            except pkcs11.UserAlreadyLoggedIn:  # by another URI, or before the library began again
                self.session = token.open(rw=True)

    def again(self) -> None:
        """Log in again, in a library that has read its tokens again."""
        library().reinitialize()
        self.open(typed=False)

    def run(self, work: Callable[[Any], Any]) -> Any:
        """`work` with the session; once more in a new one if the token was away meanwhile."""
        gone = (
            *(pkcs11.SessionHandleInvalid, pkcs11.SessionClosed, pkcs11.UserNotLoggedIn),
            *(pkcs11.DeviceRemoved, pkcs11.TokenNotPresent, pkcs11.DeviceError),
            *(pkcs11.KeyHandleInvalid, pkcs11.ObjectHandleInvalid),
        )
        with self.lock, _as_errors(self.uri):
            try:
                return work(self.session)
            except gone:
                self.open(typed=False)
            except _NoKeyError:  # some libraries do not say that the token was away
                self.again()
            return work(self.session)


_Place = tuple[str | None, str | None]
_logins: dict[_Place, Login] = {}
_refused: dict[_Place, str] = {}
"""PINs that were wrong, which must not be tried again: few tries lock a token. Not every token says
so itself."""
_opening = threading.Lock()


def login(uri: KeyUri, pin: Pin) -> Login:
    """The login to the token of `uri`: one for each token and process."""
    with _opening:
        place = (uri.token, uri.serial)
        if place not in _logins:
            token = _token(uri)
            secret = pin_in(uri.pin_source) if uri.pin_source else pin(token.label)
            typed = not (uri.pin_source or os.environ.get(PIN_VARIABLE))
            _logins[place] = _opened(uri, place, secret, typed=typed)
        return _logins[place]


def _opened(uri: KeyUri, place: _Place, secret: str, *, typed: bool) -> Login:
    if _refused.get(place) == secret:
        raise PassphraseError(f"wrong PIN for the {uri.place}")
    made = Login(uri, secret)
    try:
        made.open(typed=typed)
    except PassphraseError:
        _refused[place] = secret
        raise
    stay_alone()
    return made


def _token(uri: KeyUri) -> Any:
    """PqsecError unless exactly one token fits."""
    with _as_errors(uri):
        found = _tokens(uri)
        if not found:
            library().reinitialize()  # some libraries notice a new token only then
            found = _tokens(uri)
    if not found:
        raise PqsecError(
            f"the {uri.place} is not there",
            hint=f"plug it in; {VARIABLE} names its library if it is not registered with p11-kit",
        )
    if len(found) > 1:
        raise PqsecError(f"{len(found)} tokens fit {uri}", hint="add serial=... to the URI")
    return found[0]


def _tokens(uri: KeyUri) -> list[Any]:
    serial = uri.serial and uri.serial.encode()
    return [
        token
        for token in library().get_tokens(token_label=uri.token, token_serial=serial)
        if uri.manufacturer in {None, token.manufacturer_id} and uri.model in {None, token.model}
    ]


@dataclass(frozen=True, slots=True, eq=False)
class TokenSigner:
    """Signs with a key in a token."""

    uri: KeyUri
    type: KeyType
    algorithm: SignatureAlgorithm
    login: Login = field(repr=False)

    def sign(self, data: bytes) -> bytes:
        """A signature over `data` as in certificates and CMS; PqsecError if the token fails."""

        def work(session: Any) -> bytes:
            return self.type.sign(_private(session, self.uri), self.algorithm, data)

        signature: bytes = self.login.run(work)
        return signature


def find(uri: KeyUri, pin: Pin) -> ExternalKey | None:
    """The key with that URI; None if the token has none. PqsecError if it is of no use here."""
    entry = login(uri, pin)

    def work(session: Any) -> bytes:
        private = _object(session, uri, private=True)
        public = _object(session, uri, private=False)
        if private is None:
            raise _NoKeyError(f"the {uri.place} has no key {uri}")
        if public is None:
            raise PqsecError(
                f"the {uri.place} has the private key, and no public key with the same name",
                hint="import the public key under the same label and id",
            )
        return key_type_of(public).spki(public)

    try:
        return _key(uri, entry.run(work), entry)
    except _NoKeyError:
        return None


def generate(uri: KeyUri, algorithm: SignatureAlgorithm, pin: Pin) -> ExternalKey:
    """A new key of that algorithm, which the token will not give away.

    UsageError if tokens have no such keys, PqsecError if this one cannot make them.
    """
    kind = KEY_TYPES.get(algorithm.key_oid)
    if kind is None:
        raise UsageError(
            f"no token signs as {algorithm.name} needs it",
            hint="a composite signs with a context, which PKCS#11 libraries do not offer here:"
            " choose ECDSA, RSA or ML-DSA keys",
        )
    if uri.object is None:
        raise UsageError("a new key in a token needs a label", hint="add object=... to the URI")
    entry = login(uri, pin)
    identifier = uri.id or os.urandom(_ID_SIZE)

    def work(session: Any) -> bytes:
        public, _ = kind.generate(session, algorithm, template(str(uri.object), identifier))
        return kind.spki(public)

    return _key(uri, entry.run(work), entry)


def destroy(uri: KeyUri, pin: Pin) -> None:
    """Remove the key with that URI from its token."""

    def work(session: Any) -> None:
        for private in (True, False):
            found = _object(session, uri, private=private)
            if found is not None:
                found.destroy()

    login(uri, pin).run(work)


def _key(uri: KeyUri, spki: bytes, entry: Login) -> ExternalKey:
    public = load_public_key(spki)
    signer = TokenSigner(uri, KEY_TYPES[public.algorithm.key_oid], public.algorithm, entry)
    return ExternalKey(public.algorithm, public, signer, str(uri))


def _private(session: Any, uri: KeyUri) -> Any:
    found = _object(session, uri, private=True)
    if found is None:
        raise _NoKeyError(f"the {uri.place} no longer has the private key {uri}")
    return found


def _object(session: Any, uri: KeyUri, *, private: bool) -> Any:
    """The private or public key object of `uri`; None if there is none, PqsecError if several."""
    kind = pkcs11.ObjectClass.PRIVATE_KEY if private else pkcs11.ObjectClass.PUBLIC_KEY
    wanted: dict[Any, Any] = {pkcs11.Attribute.CLASS: kind}
    if uri.object is not None:
        wanted[pkcs11.Attribute.LABEL] = uri.object
    if uri.id is not None:
        wanted[pkcs11.Attribute.ID] = uri.id
    found = list(session.get_objects(wanted))
    if len(found) > 1:
        raise PqsecError(
            f"{len(found)} keys in the {uri.place} fit {uri}", hint="add id=... to the URI"
        )
    return found[0] if found else None


@contextmanager
def _as_errors(uri: KeyUri) -> Iterator[None]:
    """Errors of the token as PqsecError, and those of a PIN as PassphraseError."""
    try:
        yield
    except (pkcs11.PinIncorrect, pkcs11.PinInvalid, pkcs11.PinLenRange) as error:
        raise PassphraseError(f"wrong PIN for the {uri.place}") from error
    except pkcs11.PinLocked as error:
        raise PassphraseError(
            f"the PIN of the {uri.place} is locked after too many wrong ones",
            hint="its security officer can set a new one",
        ) from error
    except pkcs11.MechanismInvalid as error:
        raise PqsecError(
            f"the {uri.place} has no keys of this algorithm, or cannot sign with them",
            hint="choose another algorithm, or a token that has it: `pkcs11-tool -M` lists them",
        ) from error
    except pkcs11.PKCS11Error as error:
        raise PqsecError(f"the {uri.place} failed: {_words(error)}") from error


def _words(error: Exception) -> str:
    return f"{type(error).__name__} {error}".strip()
