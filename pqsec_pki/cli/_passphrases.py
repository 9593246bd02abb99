"""Read passphrases from files or the terminal, and unlock CAs with them."""

import os
import stat
import sys
from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from pqsec_pki.cli import _printing, _progress, _settings
from pqsec_pki.errors import PassphraseError, PqsecError, UsageError, located

if TYPE_CHECKING:
    from pqsec_pki.keystore import Authorities, Keystore, SigningCa

VARIABLE = "PQSEC_PASSPHRASE_FILE"
PIN_VARIABLE = "PQSEC_PIN_FILE"
MAX_FILE = 4096
"""Bytes."""
SHORTEST, FEWEST = 15, 5
"""Octets of a passphrase that protects CA keys alone (NIST SP 800-63B-4, 3.1.1.2), and how many of
them must differ. An attacker with the encrypted keys can try passphrases as fast as machines
allow."""
_WEAK = "pqsec.weak_passphrase"
_ANY_CLOCK = "pqsec.any_clock"
ACCEPT_CLOCK = "--accept-clock"


def option(command: _settings.Command) -> _settings.Command:
    """Add --passphrase-file and --accept-clock to a command that uses CA keys."""

    def remember(context: click.Context, parameter: click.Parameter, value: object) -> None:
        del parameter
        if value:  # a command that a plan runs has it from `pqsec apply`
            context.meta[_ANY_CLOCK] = True

    clock = click.option(
        ACCEPT_CLOCK,
        is_flag=True,
        expose_value=False,
        callback=remember,
        help="Sign although the clock is behind the ledger, or so far ahead that everything has"
        " expired.",
    )
    add = click.option(
        "--passphrase-file",
        type=_settings.FILE,
        envvar=VARIABLE,
        help="Read the CA passphrase from the first line of this file.",
    )
    return add(clock(command))


def weak_option(command: _settings.Command) -> _settings.Command:
    """Add --weak-passphrase to a command that calls `new`."""

    def remember(context: click.Context, parameter: click.Parameter, value: object) -> None:
        del parameter
        context.meta[_WEAK] = value

    add = click.option(
        "--weak-passphrase",
        is_flag=True,
        expose_value=False,
        callback=remember,
        help="Accept a new passphrase that is easy to guess.",
    )
    return add(command)


def unlock(keystore: "Keystore", passphrase_file: Path | None, *cas: "SigningCa") -> "Authorities":
    """The keystore's CAs, unlocked with the passphrase from the file or the terminal.

    With `cas`, only those: the keys of others may be on another machine.
    """
    return unlocked(keystore, of_cas(keystore, passphrase_file, *cas), *cas)


def unlocked(
    keystore: "Keystore",
    passphrase: bytes | None,
    *cas: "SigningCa",
    without: Collection[str] = (),
) -> "Authorities":
    """Those CAs, unlocked with `passphrase`; they compare the clock, but for --accept-clock.

    The keys of the sets of credentials called `without` are not read.
    """
    found = keystore.unlock(passphrase, pin, cas, without=without)
    return replace(found, compares_clock=compares_clock())


def compares_clock() -> bool:
    """Whether the clock is compared with the keystore: not with --accept-clock."""
    return not click.get_current_context().meta.get(_ANY_CLOCK)


def unlock_with_signers(
    keystore: "Keystore", passphrase_file: Path | None, needed: "SigningCa"
) -> "Authorities":
    """The CA `needed`, and the permissions CA if the same passphrase opens its files here.

    Then the ledger's next head is signed with the change. Nothing fails without it.
    """
    from pqsec_pki.keystore import SigningCa  # noqa: PLC0415 -- not for every command

    signer = SigningCa.PERMISSIONS
    cas: tuple[SigningCa, ...] = (needed,)
    is_locked = keystore.is_locked(cas)
    if keystore.has_key_files(signer) and is_locked >= keystore.is_locked((signer,)):
        cas = (needed, signer)
    passphrase = of_cas(keystore, passphrase_file, needed)
    try:
        return unlocked(keystore, passphrase, *cas)
    except PqsecError:
        return unlocked(keystore, passphrase, needed)


def of_cas(
    keystore: "Keystore",
    passphrase_file: Path | None,
    *cas: "SigningCa",
    without: Collection[str] = (),
) -> bytes | None:
    """The passphrase of the keys of `cas`, or of all CAs; None if they are not encrypted.

    Those of the sets of credentials called `without` are not read.
    """
    if not keystore.is_locked(cas, without=without):
        return None
    if passphrase_file:
        return first_line(passphrase_file)
    if not sys.stdin.isatty():
        raise UsageError(
            "the CA keys are encrypted, and there is no terminal to ask for the passphrase",
            hint=f"use --passphrase-file FILE, or set {VARIABLE}",
        )
    return asked("CA passphrase")


def pin(token: str) -> str:
    """The PIN of the token with that label: from the file in PQSEC_PIN_FILE, or the terminal."""
    from pqsec_pki.tokens import stored_pin  # noqa: PLC0415 -- not for every command

    file = os.environ.get(PIN_VARIABLE)
    if file or not sys.stdin.isatty():
        note_open(Path(file or os.devnull))
        return stored_pin(token)
    return asked(f"PIN of token '{token}'").decode()


def new(
    passphrase_file: Path | None, *, none: bool, option: str = "--passphrase-file"
) -> bytes | None:
    """The passphrase for new CA keys; None with --no-passphrase only, whatever the variable is.

    PassphraseError for a weak one, unless --weak-passphrase is given.
    """
    if none and passphrase_file and not _from_variable():
        raise UsageError(f"{option} and --no-passphrase exclude each other")
    if none:
        return None
    if passphrase_file:
        with located(passphrase_file):
            return _strong(first_line(passphrase_file))
    if not sys.stdin.isatty():
        raise UsageError(
            "the CA keys need a passphrase, and there is no terminal to ask for one",
            hint=f"use {option} FILE, or --no-passphrase to leave them unencrypted",
        )
    return _strong(asked("New CA passphrase", twice=True))


def note_unencrypted(keystore: Path) -> None:
    """Note that the CA keys of the keystore in that folder are not encrypted."""
    from pqsec_pki.keystore import layout  # noqa: PLC0415 -- not for every command

    _printing.note(
        f"the CA keys in {keystore / layout.PRIVATE} are not encrypted: protect that folder"
    )


def _strong(passphrase: bytes) -> bytes:
    """The passphrase; PassphraseError if it is easy to guess."""
    why = ""
    if len(passphrase) < SHORTEST:
        why = f"it has {len(passphrase)} characters, and {SHORTEST} are needed"
    elif len(set(passphrase)) < FEWEST:
        why = f"{FEWEST} of its characters must differ"
    if why and not click.get_current_context().meta.get(_WEAK):
        raise PassphraseError(
            f"the new passphrase is weak: {why}",
            hint="take four or more words at random; --weak-passphrase accepts it as it is",
        )
    return passphrase


def _from_variable() -> bool:
    """Whether --passphrase-file is not on the command line."""
    source = click.get_current_context().get_parameter_source("passphrase_file")
    return source is click.core.ParameterSource.ENVIRONMENT


def of_key(path: Path | None) -> str | None:
    """The passphrase of a participant's key, as text for a stack; None without a file."""
    if path is None:
        return None
    return _text(first_line(path), path)


def _text(secret: bytes, path: Path) -> str:
    try:
        return secret.decode()
    except UnicodeDecodeError:
        raise PassphraseError(f"{path}: the first line is not UTF-8") from None


def asked(what: str, *, twice: bool = False) -> bytes:
    try:
        with _progress.hidden():
            answer: str = click.prompt(what, hide_input=True, confirmation_prompt=twice, err=True)
        return answer.encode()
    except UnicodeError:
        raise PassphraseError("the passphrase is not in the terminal's encoding") from None


def note_open(path: Path) -> None:
    """Say so if others can read a secret file."""
    with suppress(OSError):  # reading it raises the error
        if stat.S_ISREG(mode := path.stat().st_mode) and mode & 0o077:
            _printing.note(f"{path} can be read by others: chmod 600 it")


def first_line(path: Path) -> bytes:
    """The first line of the file, without its line end.

    PassphraseError if it is empty; FileError if another user could change it.
    """
    from pqsec_pki._files import read  # noqa: PLC0415 -- not for every command
    from pqsec_pki._places import refuse_obeyed  # noqa: PLC0415 -- likewise

    note_open(path)
    refuse_obeyed([path], "the passphrase")
    passphrase = read(path, limit=MAX_FILE).split(b"\n", 1)[0].rstrip(b"\r")
    if not passphrase:
        raise PassphraseError(f"{path}: the first line is empty, and must be the passphrase")
    return passphrase
