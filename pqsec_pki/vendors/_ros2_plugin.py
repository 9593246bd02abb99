"""pqsec's own plugin under ROS 2.

rmw_cyclonedds names the libraries itself, whatever is configured (rmw_node.cpp), so the folder
where ours have these names goes first where the loader looks. It takes a configuration for the
rest: a post-quantum handshake in datagrams that fit a frame of Ethernet.
"""

import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path

from pqsec_pki.credentials import ALT_KEY, PERMISSIONS_ALT_CA
from pqsec_pki.errors import UsageError, shown
from pqsec_pki.plugin.settings import FILE as SETTINGS
from pqsec_pki.vendors.enclave import Enclave
from pqsec_pki.vendors.export import Options
from pqsec_pki.vendors.own_plugin import PATH, folder_in
from pqsec_pki.vendors.ros2_check import Check

RMW, CYCLONE = "RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp"
NOTE = "ROS 2 must have its package rmw_cyclonedds_cpp, and a Cyclone DDS with security"
EXTRA = (ALT_KEY, PERMISSIONS_ALT_CA, SETTINGS)
"""What the plugin reads beside the files that ROS 2 knows, where it is there."""
_URI = "CYCLONEDDS_URI"
_FRAGMENTS = (
    "<CycloneDDS><Domain><General><MaxMessageSize>1400B</MaxMessageSize>"
    "<FragmentSize>1300B</FragmentSize></General></Domain></CycloneDDS>"
)
_UNFIT = set(":;$")
"""What the loader takes for its own in LD_LIBRARY_PATH (ld.so(8))."""


def variables(options: Options) -> dict[str, str]:
    """Those that hold one value, whatever was there."""
    return {RMW: CYCLONE} if options.plugin else {}


def assignments(enclave: Enclave, options: Options) -> tuple[str, ...]:
    """Those that keep what was there, in the words of a shell.

    UsageError for a folder that the loader cannot be told of.
    """
    if options.plugin is None:
        return ()
    folder = str(options.plugin.absolute())
    if unfit := sorted(_UNFIT & set(folder)):
        raise UsageError(
            f"{shown(folder)}: the loader finds nothing in a folder with {unfit[0]!r} in its name",
            hint="install the plugin elsewhere: `pqsec plugin install --dir DIR`",
        )
    first = f'{PATH}={shlex.quote(folder)}"${{{PATH}:+:${PATH}}}"'
    more = f'{_URI}="${{{_URI}:+${_URI},}}"{shlex.quote(_FRAGMENTS)}'
    return (first, more) if enclave.has_large_handshake else (first,)


def files(enclave: Enclave) -> Iterator[Path]:
    """The files of the enclave that only the plugin reads."""
    yield from (path for name in EXTRA if (path := enclave.folder / name).is_file())


def loaded(environment: Mapping[str, str], participant: str) -> Iterator[Check]:
    """Whether who finds the plugin also loads it; nothing where it is not to be found."""
    folder = folder_in(environment)
    if folder is None:
        return
    export = f"pqsec export ros2 {participant} --plugin --plugins {shlex.quote(str(folder))}"
    value = environment.get(RMW)
    found = "is not set" if value is None else f"is {shown(value)!r}"
    problem = "" if value == CYCLONE else f"{found}, and only {CYCLONE} loads pqsec's plugin"
    yield Check(what=RMW, problem=problem, fix=f'eval "$({export})"')
