"""Cyclone DDS: one XML file, the same for 0.10 and 11.

Cyclone DDS trims values in it, and replaces ${NAME} by the variable; `${:-}` is empty, which is
used to write a literal "${". A handshake whose certificates carry ML-DSA has up to 22 KB. By
default it is sent in datagrams of 14 KB, which IP fragments; if a fragment is lost, the whole
message is sent again after a second. So in that case datagrams are limited to an Ethernet frame.
"""

from collections.abc import Mapping
from pathlib import Path

from pqsec_pki.errors import PqsecError, UsageError, VerificationError, shown
from pqsec_pki.plugin import LIBRARY
from pqsec_pki.stacks import SMALL_FRAGMENT, Stack
from pqsec_pki.vendors import own_plugin
from pqsec_pki.vendors._datagrams import MAX_MESSAGE
from pqsec_pki.vendors._render import render
from pqsec_pki.vendors.cyclone_plugins import (
    NAMES,
    agree,
    find_cyclone_plugins,
    in_words,
    installed,
    mixed,
    plugins_in,
    read_plugin,
)
from pqsec_pki.vendors.enclave import StackEnclave, password_note
from pqsec_pki.vendors.exports import FOLDER, PASSWORD_VARIABLE, Export, Options

FILE = "cyclonedds.xml"
CHANGED = frozenset('"\\')
"""In paths of signed documents it drops the first and reads the second as /: by its source, in
DDS_Security_normalize_file, and measured with 0.10.2."""
_MIXED = (
    "name the plugins of the version that runs, with --plugins DIR, or --crypto FILE with"
    " --plugin; or give that version, with --stack-version"
)


def export(enclave: StackEnclave, options: Options) -> Export:
    """CYCLONEDDS_URI and the file that it names."""
    _refuse_folder(enclave)
    notes = password_note(enclave, options)
    located = _located(options)
    release, problem = _looked_at(located, options)
    if problem and not options.anyway:
        raise VerificationError(problem, hint=_MIXED)
    plugins = {kind: _path(located.get(kind), name) for kind, name in NAMES.items()}
    if options.plugin:
        ours = protected(str(options.plugin.absolute() / LIBRARY))
        plugins |= {"auth": ours, "ac": ours}
        notes += (own_plugin.NOTE,)
    if None in located.values():
        notes += (_unlocated(options),)
    text = render(
        "cyclonedds.xml",
        enclave=enclave,
        uri=lambda file: protected(enclave.uri(file)),
        plugins=plugins,
        release=release,
        password=_password(enclave, options),
        loopback=options.loopback,
        max_message=MAX_MESSAGE,
        fragment=SMALL_FRAGMENT if enclave.has_large_handshake else None,
    )
    return Export(
        stack=Stack.CYCLONEDDS,
        participant=enclave.name,
        files={FILE: text},
        environment={"CYCLONEDDS_URI": f"file://{FOLDER}/{FILE}"},
        notes=notes,
        warnings=(problem,) if problem else (),
        is_private=options.password is not None,
        unfit_folder=",",  # CYCLONEDDS_URI is a list
    )


def _refuse_folder(enclave: StackEnclave) -> None:
    if changed := set(str(enclave.at)) & CHANGED:
        raise UsageError(
            f"{shown(str(enclave.at))}: Cyclone DDS opens no documents in a folder with"
            f" {min(changed)!r} in it",
            hint="put the keystore elsewhere",
        )


def _path(path: Path | None, name: str) -> str:
    return protected(str(path)) if path else name


def protected(text: str) -> str:
    """`text`, written so that Cyclone DDS reads it unchanged."""
    return text.replace("${", "$${:-}{")


def _located(options: Options) -> dict[str, Path | None]:
    """The paths of Cyclone DDS's own plugins, if they were given or found."""
    folder = options.plugins
    if folder is None and not options.at:
        folder = find_cyclone_plugins(Path("/"), lambda each: agree(each.release, options.release))
    found = dict.fromkeys(NAMES) | (plugins_in(folder.absolute()) if folder else {})
    if options.crypto:
        found["crypto"] = options.crypto.absolute()
    return {kind: found[kind] for kind in (["crypto"] if options.plugin else NAMES)}


def _looked_at(located: Mapping[str, Path | None], options: Options) -> tuple[str, str]:
    """The version that the located plugins belong to, and what is wrong with loading them.

    Both may be empty: another machine cannot be checked from here.
    """
    paths = [] if options.at else [path for path in located.values() if path]
    try:
        plugins = [read_plugin(path) for path in paths]
    except PqsecError as error:
        return "", str(error)
    return in_words(plugins[0].release) if plugins else "", mixed(plugins, options.release)


def _unlocated(options: Options) -> str:
    """A note about plugins without a path, with those that were found but are not used."""
    note = "the plugins are named, not located: the loader must find libdds_security_*.so"
    there = () if options.at else installed(Path("/"))
    others = ", ".join(f"{folder} ({in_words(plugin.release)})" for folder, plugin in there)
    choice = "" if options.version else "; --stack-version chooses"
    return f"{note}; seen here: {others}{choice}" if others else note


def _password(enclave: StackEnclave, options: Options) -> str | None:
    """The value of <Password>; without the variable, the process stops with this message."""
    if not enclave.key_is_encrypted:
        return None
    if options.password is None:
        return f"${{{PASSWORD_VARIABLE}:?must contain the passphrase of the key}}"
    if options.password != options.password.strip(" \t"):
        raise UsageError(
            "Cyclone DDS trims the passphrase in its configuration",
            hint=f"leave it out here, and set {PASSWORD_VARIABLE} for the process",
        )
    return protected(options.password)
