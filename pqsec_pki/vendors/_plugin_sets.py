"""pqsec's plugin for a participant with several sets of credentials, and its `pqsec.toml`.

The stack's configuration names the strongest set, and `pqsec.toml` beside its certificate names the
others: without that file the participant meets nobody with a weaker one.
"""

import posixpath
import shlex
from collections.abc import Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path, PurePosixPath

from pqsec_pki.credentials import ENCLAVES
from pqsec_pki.errors import UsageError, VerificationError
from pqsec_pki.keystore import Keystore, layout, regular_name
from pqsec_pki.plugin import SETTINGS
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors import own_plugin
from pqsec_pki.vendors.enclave import StackEnclave
from pqsec_pki.vendors.exports import FOLDER, Export, Options


def refuse_unfit(keystore: Keystore, stack: str, options: Options) -> None:
    """UsageError if an option of the plugin does not fit the number of sets."""
    several = len(keystore.profiles) > 1
    if options.plugin is None:
        return
    if options.stock is not None and not several:
        raise UsageError("--stock is for a keystore with several sets of credentials")
    if options.at and several and stack == Stack.ROS2:
        raise UsageError(
            "with --at, ROS 2's export has the files of one set of credentials",
            hint="install a bundle on the robot, and run `pqsec export` there, or leave out --at",
        )


def enclave_for(keystore: Keystore, name: str, options: Options) -> StackEnclave:
    """The enclave that the configuration names: with our plugin that of the strongest set."""
    if options.plugin is None:
        return StackEnclave.find(keystore, name, options.at)
    return StackEnclave.find(keystore.sets[-1], name, _place_of(keystore, name, options.at))


def refusal(
    keystore: Keystore, name: str, options: Options, now: datetime
) -> VerificationError | None:
    """Why our plugin refuses the participant in one of the weaker sets; None if in none."""
    found = (
        own_plugin.refusal(StackEnclave.find(each, name), options, now)
        for each in keystore.sets[:-1]
    )
    return next(filter(None, found), None)


def with_settings(
    made: Export, keystore: Keystore, enclave: StackEnclave, options: Options
) -> Export:
    """The export with the participant's `pqsec.toml`, and how it gets to its place.

    `enclave` is that of the strongest set. UsageError if the file in its place is invalid.
    """
    if options.plugin is None or len(keystore.profiles) == 1:
        return made
    text, place = _text(keystore, enclave, options), enclave.at / SETTINGS
    step = f"install -m 644 {FOLDER}/{SETTINGS} {shlex.quote(str(place))}"
    note = f"{SETTINGS} must be {place}: it names the sets of credentials that must be there"
    return replace(
        made,
        files={**made.files, SETTINGS: text},
        steps=made.steps if options.at else (step, *made.steps),
        notes=(*made.notes, note),
    )


def _place_of(keystore: Keystore, name: str, at: PurePosixPath | None) -> PurePosixPath | None:
    """Where the strongest set's folder will be, if that of the first set will be `at`.

    UsageError if `at` is not a folder that has the other sets beside it.
    """
    if at is None or len(keystore.profiles) == 1:
        return at
    below = f"/{ENCLAVES}{regular_name(name)}"
    if not str(at).endswith(below):
        raise UsageError(
            f"{at} does not end in {below}: the other sets of credentials are beside {ENCLAVES}",
            hint=f"give the place as `pqsec install` has it: --at /DIR/current{below}",
        )
    root = PurePosixPath(str(at).removesuffix(below) or "/")
    return root / _folder(keystore.sets[-1], name)


def _text(keystore: Keystore, enclave: StackEnclave, options: Options) -> str:
    """What the file in its place says, with these sets, and these names if any are given."""
    from pqsec_pki.plugin.credentials import Source  # noqa: PLC0415 -- heavy
    from pqsec_pki.plugin.settings import SettingsFile  # noqa: PLC0415 -- likewise

    there = SettingsFile.beside(Source(SETTINGS, enclave.folder / SETTINGS))
    stock = there.stock if options.stock is None else options.stock
    return replace(there, sets=_folders(keystore, enclave.name), stock=stock).text


def _folders(keystore: Keystore, name: str) -> Mapping[str, str]:
    """Profile -> folder of each set, from that of the strongest."""
    own = _folder(keystore.sets[-1], name)
    return {
        each.profile.name: posixpath.relpath(f"/{_folder(each, name)}", f"/{own}")
        for each in keystore.sets
    }


def _folder(view: Keystore, name: str) -> Path:
    """The participant's folder in a set, below that of the keystore."""
    return Path(layout.in_set(view.set_name, ENCLAVES)) / regular_name(name).lstrip("/")
