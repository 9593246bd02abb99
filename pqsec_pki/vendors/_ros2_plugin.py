"""pqsec's own plugin under ROS 2.

rmw_cyclonedds always loads the same library names (rmw_node.cpp). So the folder in which ours have
these names is put first into the loader's search path. A configuration sets the rest: datagrams for
a post-quantum handshake that fit an Ethernet frame. Under rmw_fastrtps a library is preloaded.
"""

import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path

from pqsec_pki.credentials import ALT_KEY, PERMISSIONS_ALT_CA
from pqsec_pki.errors import UsageError, shown
from pqsec_pki.plugin import SETTINGS
from pqsec_pki.stacks import SMALL_FRAGMENT
from pqsec_pki.vendors import _preload, own_plugin
from pqsec_pki.vendors._datagrams import MAX_MESSAGE
from pqsec_pki.vendors.enclave import StackEnclave
from pqsec_pki.vendors.exports import Options
from pqsec_pki.vendors.own_plugin import FASTRTPS, PATH, folder_in
from pqsec_pki.vendors.ros2_check import Check

RMW, CYCLONE, FAST = "RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp", "rmw_fastrtps_cpp"
_NOTES = {
    CYCLONE: ("ROS 2 must have its package rmw_cyclonedds_cpp, and a Cyclone DDS with security",),
    FAST: (
        "the plugin must be installed for ROS 2's own libfastrtps or libfastdds: --library PATH",
        "nodes of ROS 2 were not run with pqsec's plugin in Fast DDS, only programs of Fast DDS",
        _preload.NOTE,
    ),
}
EXTRA = (ALT_KEY, PERMISSIONS_ALT_CA, SETTINGS)
"""Files that the plugin reads beside those that ROS 2 knows, if they exist."""
_URI = "CYCLONEDDS_URI"
_FRAGMENTS = (
    f"<CycloneDDS><Domain><General><MaxMessageSize>{MAX_MESSAGE}B</MaxMessageSize>"
    f"<FragmentSize>{SMALL_FRAGMENT}B</FragmentSize></General></Domain></CycloneDDS>"
)
_UNFIT = set(":;$")
"""Characters with a meaning of their own in LD_LIBRARY_PATH (ld.so(8))."""


def variables(options: Options) -> dict[str, str]:
    """Variables that replace an earlier value."""
    return {RMW: middleware(options)} if options.plugin else {}


def middleware(options: Options) -> str:
    """The value of RMW_IMPLEMENTATION that runs the plugin."""
    return FAST if options.runs_in == FASTRTPS else CYCLONE


def notes(options: Options) -> tuple[str, ...]:
    """Notes for the user, a sentence each."""
    return (*_NOTES[middleware(options)], own_plugin.NOTE)


def assignments(enclave: StackEnclave, options: Options) -> tuple[str, ...]:
    """Variables that keep an earlier value, as shell assignments.

    UsageError for a folder that the loader cannot search.
    """
    if options.plugin is None:
        return ()
    if options.runs_in == FASTRTPS:
        path = shlex.quote(str(_preload.preloaded(options.plugin, options)))
        return (f'{_preload.VARIABLE}={path}"${{{_preload.VARIABLE}:+:${_preload.VARIABLE}}}"',)
    folder = str(options.plugin.absolute())
    if unfit := sorted(_UNFIT & set(folder)):
        raise UsageError(
            f"{shown(folder)}: the loader finds nothing in a folder with {unfit[0]!r} in its name",
            hint="install the plugin elsewhere: `pqsec plugin install --dir DIR`",
        )
    first = f'{PATH}={shlex.quote(folder)}"${{{PATH}:+:${PATH}}}"'
    more = f'{_URI}="${{{_URI}:+${_URI},}}"{shlex.quote(_FRAGMENTS)}'
    return (first, more) if enclave.has_large_handshake else (first,)


def files(enclave: StackEnclave) -> Iterator[Path]:
    """The files of the enclave that only the plugin reads."""
    yield from (path for name in EXTRA if (path := enclave.folder / name).is_file())


def loaded(environment: Mapping[str, str], participant: str) -> Iterator[Check]:
    """Checks that the middleware that finds the plugin also loads it; none without the plugin."""
    value = environment.get(RMW)
    found = "is not set" if value is None else f"is {shown(value)!r}"
    export = f"pqsec export ros2 {participant} --plugin"
    if value in {None, FAST} and _preload.preloaded_in(environment):
        yield Check(what=RMW)  # rmw_fastrtps is ROS 2's default
    elif folder := folder_in(environment):
        problem = "" if value == CYCLONE else f"{found}, and only {CYCLONE} loads pqsec's plugin"
        fix = f'eval "$({export} --plugins {shlex.quote(str(folder))})"'
        yield Check(what=RMW, problem=problem, fix=fix)
    elif folder := _preload.preloaded_in(environment):
        fix = f'eval "$({export} --rmw {FASTRTPS} --plugins {shlex.quote(str(folder))})"'
        problem = f"{found}, and {FAST} is what runs the preloaded plugin"
        yield Check(what=RMW, problem=problem, fix=fix)


def folder_of(environment: Mapping[str, str]) -> Path | None:
    """The folder of the plugin that a node with this environment runs."""
    preloaded = _preload.preloaded_in(environment)
    if preloaded and environment.get(RMW) in {None, FAST}:
        return preloaded
    return folder_in(environment)
