"""Keys by their URIs: found, or made for new CAs and participants."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from types import ModuleType
from typing import NamedTuple

from pqsec_pki._libraries import needs_libraries
from pqsec_pki.algorithms import (
    ExternalKey,
    PrivateKey,
    SignatureAlgorithm,
    load_private_key,
    private_key_pem,
)
from pqsec_pki.errors import PqsecError, UsageError
from pqsec_pki.tokens import _signers
from pqsec_pki.tokens.pin import Pin, stored_pin
from pqsec_pki.tokens.reference import is_reference, reference_to, uri_in
from pqsec_pki.tokens.uri import SCHEME, KeyUri, usable


def find_key(uri: str, pin: Pin = stored_pin) -> ExternalKey:
    """The key with that URI.

    UsageError if it is not a URI of a key, PqsecError if the key is not there or cannot be used,
    PassphraseError for a wrong PIN.
    """
    if not uri.lower().startswith(f"{SCHEME}:"):
        return _signers.find(uri)
    parsed = KeyUri.parse(uri)
    found: ExternalKey | None = _pkcs11().find(parsed, pin)
    if found is None:
        raise PqsecError(
            f"the {parsed.place} has no key {uri}",
            hint="`pkcs11-tool --list-objects --login` shows what it has",
        )
    return found


def key_in(data: bytes, passphrase: bytes | None = None, pin: Pin = stored_pin) -> PrivateKey:
    """The private key in the content of a file, or in the place that it refers to.

    Errors as of `load_private_key` and `find_key`.
    """
    return find_key(uri_in(data), pin) if is_reference(data) else load_private_key(data, passphrase)


def key_file(key: PrivateKey, passphrase: bytes | None = None) -> bytes:
    """The content of a private key's file: a reference if the key is elsewhere.

    Else the key, encrypted under `passphrase` if there is one.
    """
    if isinstance(key, ExternalKey):
        return reference_to(key.uri)
    return private_key_pem(key, passphrase)


class MadeKeys(NamedTuple):
    """Keys by the names that the caller gave."""

    keys: dict[str, ExternalKey]
    generated: frozenset[str]
    """The names of those that were not there before."""


@contextmanager
def made_keys(
    wanted: Mapping[str, tuple[str, SignatureAlgorithm]], pin: Pin = stored_pin
) -> Iterator[MadeKeys]:
    """The keys of new CAs or of a participant: for each name the one with that URI and algorithm.

    A key that its token does not have is generated there; such keys are removed again if the
    block fails. Errors as of `find_key`; UsageError also for a key of another algorithm.
    """
    uris = [usable(uri) for uri, _ in wanted.values()]
    if len({*uris}) < len(uris):
        raise UsageError(
            "one key is named twice: with one key for two CAs, a participant's key could sign"
            " permissions",
            hint="give each key a URI of its own (CVE-2023-24010)",
        )
    made: dict[str, KeyUri] = {}
    try:
        keys = {name: _found(uri, algorithm, pin) for name, (uri, algorithm) in wanted.items()}
        for name, (uri, algorithm) in wanted.items():
            if keys[name] is None:
                parsed = KeyUri.parse(uri)
                keys[name] = _pkcs11().generate(parsed, algorithm, pin)
                made[name] = parsed
        yield MadeKeys({name: key for name, key in keys.items() if key}, frozenset(made))
    except BaseException:
        for each in made.values():
            with suppress(PqsecError):  # the first error is the one to report
                _pkcs11().destroy(each, pin)
        raise


@contextmanager
def participant_keys(
    wanted: Mapping[str, tuple[str, SignatureAlgorithm]], pin: Pin = stored_pin
) -> Iterator[MadeKeys]:
    """Like `made_keys`. UsageError also for an algorithm with which tokens sign no handshakes."""
    for _, algorithm in wanted.values():
        algorithm.refuse_own_handshakes()
    with made_keys(wanted, pin) as made:
        yield made


def _found(uri: str, algorithm: SignatureAlgorithm, pin: Pin) -> ExternalKey | None:
    """The key, if it is there; UsageError if it is of another algorithm."""
    is_in_token = uri.lower().startswith(f"{SCHEME}:")
    found: ExternalKey | None = (
        _pkcs11().find(KeyUri.parse(uri), pin) if is_in_token else _signers.find(uri)
    )
    if found and found.algorithm is not algorithm:
        raise UsageError(
            f"the key {uri} is {found.algorithm.name}, and {algorithm.name} is needed",
            hint="name another key; --profile and options such as --identity-key choose the kind",
        )
    return found


def _pkcs11() -> ModuleType:
    """The module that uses tokens; PqsecError if its library is not installed."""
    with needs_libraries("keys in tokens need the library {library}"):
        from pqsec_pki.tokens import _pkcs11  # noqa: PLC0415 -- its library is an extra
    return _pkcs11
