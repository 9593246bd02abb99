"""Cyclone DDS: one XML file, the same for 0.10 and 11.

Values in it are trimmed, and ${NAME} is replaced by the variable; `${:-}` is nothing, which
lets "${" stand for itself. A handshake whose certificates carry ML-DSA is up to 22 KB: by
default it goes out in datagrams of 14 KB, which IP fragments, and one that is lost costs the
whole message and a second. So there the datagrams are made to fit a frame of Ethernet.
"""

from collections.abc import Mapping
from pathlib import Path

from pqsec_pki.errors import PqsecError, UsageError, VerificationError, shown
from pqsec_pki.plugin import LIBRARY
from pqsec_pki.vendors import own_plugin
from pqsec_pki.vendors._render import render
from pqsec_pki.vendors.cyclone_plugins import (
    NAMES,
    agree,
    in_words,
    installed,
    installed_plugins,
    mixed,
    plugins_in,
    read_plugin,
)
from pqsec_pki.vendors.enclave import Enclave, password_note
from pqsec_pki.vendors.export import FOLDER, PASSWORD_VARIABLE, Export, Options

FILE = "cyclonedds.xml"
CHANGED = frozenset('"\\')
"""In paths of signed documents it drops the one and takes the other for /: by its source, in
DDS_Security_normalize_file, and as 0.10.2 was run."""
_MIXED = (
    "name the plugins of the version that runs, with --plugins DIR, or --crypto FILE beside"
    " --plugin; or say which version runs, with --stack-version"
)


def export(enclave: Enclave, options: Options) -> Export:
    """CYCLONEDDS_URI and the file that it names."""
    if changed := set(str(enclave.at)) & CHANGED:
        raise UsageError(
            f"{shown(str(enclave.at))}: Cyclone DDS opens no documents in a folder with"
            f" {min(changed)!r} in it",
            hint="put the keystore elsewhere",
        )
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
        fragments=enclave.has_large_handshake,
    )
    return Export(
        stack="cyclonedds",
        participant=enclave.name,
        files={FILE: text},
        environment={"CYCLONEDDS_URI": f"file://{FOLDER}/{FILE}"},
        notes=notes,
        warnings=(problem,) if problem else (),
        is_private=options.password is not None,
        unfit_folder=",",  # CYCLONEDDS_URI is a list
    )


def _path(path: Path | None, name: str) -> str:
    return protected(str(path)) if path else name


def protected(text: str) -> str:
    """`text` so that Cyclone DDS takes it as it stands."""
    return text.replace("${", "$${:-}{")


def _located(options: Options) -> dict[str, Path | None]:
    """Where Cyclone DDS's own plugins are, as far as that is said or to be seen."""
    folder = options.plugins
    if folder is None and not options.at:
        folder = installed_plugins(Path("/"), lambda each: agree(each.release, options.release))
    found = dict.fromkeys(NAMES) | (plugins_in(folder.absolute()) if folder else {})
    if options.crypto:
        found["crypto"] = options.crypto.absolute()
    return {kind: found[kind] for kind in (["crypto"] if options.plugin else NAMES)}


def _looked_at(located: Mapping[str, Path | None], options: Options) -> tuple[str, str]:
    """The version that the located plugins belong to, and what is wrong with loading them.

    Both may be empty: what another machine has is not to be seen here.
    """
    paths = [] if options.at else [path for path in located.values() if path]
    try:
        plugins = [read_plugin(path) for path in paths]
    except PqsecError as error:
        return "", str(error)
    return in_words(plugins[0].release) if plugins else "", mixed(plugins, options.release)


def _unlocated(options: Options) -> str:
    """A note about plugins that are named only, with those that were seen and are not meant."""
    note = "the plugins are named, not located: the loader must find libdds_security_*.so"
    there = () if options.at else installed(Path("/"))
    others = ", ".join(f"{folder} ({in_words(plugin.release)})" for folder, plugin in there)
    choice = "" if options.version else "; --stack-version chooses"
    return f"{note}; seen here: {others}{choice}" if others else note


def _password(enclave: Enclave, options: Options) -> str | None:
    """What <Password> holds; without the variable, the process stops with these words."""
    if not enclave.key_is_encrypted:
        return None
    if options.password is None:
        return f"${{{PASSWORD_VARIABLE}:?is to hold the passphrase of the key}}"
    if options.password != options.password.strip(" \t"):
        raise UsageError(
            "Cyclone DDS trims the passphrase in its configuration",
            hint=f"leave it out here, and set {PASSWORD_VARIABLE} for the process",
        )
    return protected(options.password)
