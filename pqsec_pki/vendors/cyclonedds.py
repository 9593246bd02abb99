"""Cyclone DDS: one XML file, the same for 0.10 and 11.

Values in it are trimmed, and ${NAME} is replaced by the variable; `${:-}` is nothing, which
lets "${" stand for itself. A handshake whose certificates carry ML-DSA is up to 22 KB: by
default it goes out in datagrams of 14 KB, which IP fragments, and one that is lost costs the
whole message and a second. So there the datagrams are made to fit a frame of Ethernet.
"""

from contextlib import suppress
from pathlib import Path

from pqsec_pki.errors import UsageError, shown
from pqsec_pki.plugin import LIBRARY
from pqsec_pki.vendors import own_plugin
from pqsec_pki.vendors._render import render
from pqsec_pki.vendors.enclave import Enclave, password_note
from pqsec_pki.vendors.export import FOLDER, PASSWORD_VARIABLE, Export, Options

FILE = "cyclonedds.xml"
PLUGINS = {"auth": "dds_security_auth", "crypto": "dds_security_crypto", "ac": "dds_security_ac"}
CHANGED = frozenset('"\\')
"""In paths of signed documents it drops the one and takes the other for /: by its source, in
DDS_Security_normalize_file, and as 0.10.2 was run."""
PLACES = (
    "usr/lib/*/libddsc0debian",
    "usr/lib/*/libddsc*",
    "usr/lib/*",
    "usr/lib",
    "usr/local/lib",
    "usr/local/lib/*",
    "opt/ros/*/lib/*",
    "opt/ros/*/lib",
)
"""Below /: where distributions, `make install` and ROS 2 put the plugins."""


def export(enclave: Enclave, options: Options) -> Export:
    """CYCLONEDDS_URI and the file that it names."""
    if changed := set(str(enclave.at)) & CHANGED:
        raise UsageError(
            f"{shown(str(enclave.at))}: Cyclone DDS opens no documents in a folder with"
            f" {min(changed)!r} in it",
            hint="put the keystore elsewhere",
        )
    notes = password_note(enclave, options)
    folder = options.plugins or (None if options.at else installed_plugins(Path("/")))
    plugins = {kind: _plugin(folder, name) for kind, name in PLUGINS.items()}
    if options.plugin:
        ours = protected(str(options.plugin.absolute() / LIBRARY))
        plugins |= {"auth": ours, "ac": ours}
        notes += (own_plugin.NOTE,)
    text = render(
        "cyclonedds.xml",
        enclave=enclave,
        uri=lambda file: protected(enclave.uri(file)),
        plugins=plugins,
        password=_password(enclave, options),
        loopback=options.loopback,
        fragments=enclave.has_large_handshake,
    )
    if folder is None:
        notes += ("the plugins are named, not located: the loader must find libdds_security_*.so",)
    return Export(
        stack="cyclonedds",
        participant=enclave.name,
        files={FILE: text},
        environment={"CYCLONEDDS_URI": f"file://{FOLDER}/{FILE}"},
        notes=notes,
        is_private=options.password is not None,
        unfit_folder=",",  # CYCLONEDDS_URI is a list
    )


def installed_plugins(root: Path) -> Path | None:
    """The one folder below `root` that has all plugins; None where there is none, or several."""
    found = {
        folder.resolve() for place in PLACES for folder in root.glob(place) if _has_plugins(folder)
    }
    return found.pop() if len(found) == 1 else None


def _has_plugins(folder: Path) -> bool:
    with suppress(OSError):  # who may not look into a folder does not load from it
        return all((folder / f"lib{name}.so").exists() for name in PLUGINS.values())
    return False


def protected(text: str) -> str:
    """`text` so that Cyclone DDS takes it as it stands."""
    return text.replace("${", "$${:-}{")


def _plugin(folder: Path | None, name: str) -> str:
    return protected(str(folder.absolute() / f"lib{name}.so")) if folder else name


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
