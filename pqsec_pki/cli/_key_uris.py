"""Options for keys that are in tokens or held by another signer."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import click

from pqsec_pki.cli import _passphrases, _printing, _settings
from pqsec_pki.errors import UsageError

if TYPE_CHECKING:
    from pqsec_pki.algorithms import PrivateKey, Profile, SignatureAlgorithm

IN_FILE = "file"
"""In place of a URI: the key is in a file."""
_CA = {
    "identity_key_uri": "the identity CA's key",
    "identity_alt_key_uri": "the identity CA's alternative key",
    "permissions_key_uri": "the permissions CA's key",
    "countersigner_key_uri": "the key of the permissions CA's countersigner",
}
_PARTICIPANT = {
    "participant_key_uri": "the participant's key",
    "alt_key_uri": "its alternative key",
}

Uris = Mapping[str, str]
"""The names of files of keys -> URIs."""


def _remember(context: click.Context, parameter: click.Parameter, value: str | None) -> None:
    if value:
        context.meta.setdefault(__name__, {})[str(parameter.name)] = value


def options(command: _settings.Command) -> _settings.Command:
    """Add an option for the URI of each CA key; `given` has what they say."""
    return _added(command, _CA)


def options_of_sets(command: _settings.Command) -> _settings.Command:
    """Like `options`, for the keys of several sets; `given_for_sets` has what they say."""
    return _added(command, _CA, several=True)


def participant_options(command: _settings.Command) -> _settings.Command:
    """Add an option for the URI of each of a participant's keys; see `given_for_participant`."""
    return _added(command, _PARTICIPANT)


def _added(
    command: _settings.Command, table: Mapping[str, str], *, several: bool = False
) -> _settings.Command:
    more = "; PROFILE=URI if there are several sets" if several else ""
    for name, what in reversed(list(table.items())):
        add: Callable[[_settings.Command], _settings.Command] = click.option(
            f"--{name.replace('_', '-')}",
            metavar="URI",
            multiple=several,
            expose_value=False,
            callback=_remember,
            help=f"Keep {what} in this place: pkcs11:token=LABEL;object=LABEL{more}",
        )
        command = add(command)
    return command


def given() -> Uris:
    """The URIs on the command line, by the names of the keys' files."""
    return _said(_CA, _ca_files())


def given_for_sets(profiles: Sequence["Profile"]) -> Uris:
    """The URIs on the command line, by the names of `ca_key_places`.

    UsageError for one that does not say for which of several sets it is, or twice for one key.
    """
    from pqsec_pki.keystore import layout  # noqa: PLC0415 -- not for --help

    names = {each.name: each.name for each in profiles} | {profiles[0].name: layout.FIRST}
    found: dict[str, str] = {}
    for file, texts in _said(_CA, _ca_files()).items():
        for text in texts:
            profile, mark, uri = text.partition("=")
            if not (mark and profile in names):
                profile, uri = profiles[0].name, text
                _refuse_unclear(profiles, text)
            place = layout.in_set(names[profile], file)
            if place in found:
                raise UsageError(f"{place}: there are two places for one key")
            found[place] = uri
    return found


def _refuse_unclear(profiles: Sequence["Profile"], text: str) -> None:
    if len(profiles) > 1:
        names = ", ".join(each.name for each in profiles)
        raise UsageError(
            f"{text} does not say for which set it is: {names}",
            hint=f"put the profile before it: {profiles[-1].name}={text}",
        )


def _ca_files() -> tuple[str, ...]:
    from pqsec_pki.keystore import layout  # noqa: PLC0415 -- not for --help

    return (
        *(layout.IDENTITY_KEY, layout.IDENTITY_ALT_KEY),
        *(layout.PERMISSIONS_KEY, layout.PERMISSIONS_ALT_KEY),
    )


def given_for_participant() -> Uris:
    """The URIs of a participant's keys on the command line, by the names of the keys' files."""
    from pqsec_pki.credentials import KEYS  # noqa: PLC0415 -- not for --help

    return _said(_PARTICIPANT, KEYS)


def _said(table: Iterable[str], files: Iterable[str]) -> dict[str, Any]:
    found = click.get_current_context().meta.get(__name__, {})
    return {file: found[name] for name, file in zip(table, files, strict=True) if name in found}


@contextmanager
def keys(
    algorithms: Mapping[str, "SignatureAlgorithm"], uris: Uris
) -> Iterator[dict[str, "PrivateKey"]]:
    """The keys with the URIs, found or made, for new CAs with keys in files of these names.

    UsageError for a key that those CAs do not have; other errors as of `made_keys`.
    """
    from pqsec_pki.tokens import made_keys  # noqa: PLC0415 -- not for --help

    outside = {name: uri for name, uri in uris.items() if uri != IN_FILE}
    if surplus := [uri for name, uri in outside.items() if name not in algorithms]:
        raise UsageError(f"no new CA has such a key here: {', '.join(surplus)}")
    pairs = {name: (uri, algorithms[name]) for name, uri in outside.items()}
    with made_keys(pairs, _passphrases.pin) as made:
        yield {**made.keys}
    note_places(outside, made.generated)


@contextmanager
def participants_own(profile: "Profile", uris: Uris) -> Iterator[dict[str, "PrivateKey"]]:
    """The keys with the URIs, found or made, for a participant; errors as of `requests`."""
    if not uris:
        yield {}
        return
    from pqsec_pki.enrolment import key_places  # noqa: PLC0415 -- not for --help
    from pqsec_pki.tokens import participant_keys  # noqa: PLC0415 -- not for --help

    with participant_keys(key_places([profile], uris), _passphrases.pin) as made:
        yield {**made.keys}
    note_participant(profile, uris, made.generated)


def note_participant(profile: "Profile", uris: Uris, generated: Collection[str]) -> None:
    """Like `note_places`; also note that the alternative key is in a file, if no option has its
    URI."""
    from pqsec_pki.credentials import ALT_KEY, KEY  # noqa: PLC0415 -- not for --help

    note_places(uris, generated)
    alone = uris.get(KEY, IN_FILE) != IN_FILE and ALT_KEY not in uris
    if alone and profile.alternative_key:
        _printing.note("the alternative key is in a file: --alt-key-uri names a token for it")


def note_places(uris: Uris, generated: Collection[str]) -> None:
    """Say of each key that is outside whether it was made now."""
    for name, uri in uris.items():
        place = "was generated" if name in generated else "was there already, and is used"
        if uri != IN_FILE:
            _printing.note(f"{uri} {place}")
