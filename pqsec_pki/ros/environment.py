"""The environment of a secured node, from a script of `pqsec export ros2`."""

import os
import shlex
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from pqsec_pki.errors import FileError, PqsecError
from pqsec_pki.stacks import Stack
from pqsec_pki.vendors import ENCLAVE_OVERRIDE, SECURED

_OF_THE_SHELL = frozenset({"_", "PWD", "OLDPWD", "SHLVL"})


def secured_variables(
    enclave: str, script: str = "", options: str = "", *, present: Mapping[str, str]
) -> dict[str, str]:
    """The variables that a process of that enclave needs, which `present` does not have so.

    They are those that `script` sets, a file that `pqsec export ros2` wrote, or if it is empty,
    what `pqsec export ros2` prints with these options, and the enclave. PqsecError if there is no
    script, or it does not secure nodes.
    """
    text = _read(Path(script)) if script else _exported(enclave, options, present)
    name = script or "the export"
    done = _run(["sh", "-ec", f"{text}\nexec env -0"], present, name)
    found = dict(each.split("=", 1) for each in done.split("\0") if each)
    if any(found.get(each) != value for each, value in SECURED.items()):
        raise PqsecError(
            f"{name} does not secure the nodes of {enclave}", hint="write it with `pqsec export`"
        )
    found = {k: v for k, v in found.items() if present.get(k) != v and k not in _OF_THE_SHELL}
    return found | {ENCLAVE_OVERRIDE: enclave}


def missing(package: str, error: ModuleNotFoundError) -> ModuleNotFoundError:
    """What to raise where ROS 2's Python is needed and another runs."""
    return ModuleNotFoundError(
        f"this needs ROS 2's {package}, and {error.name} is not there: run it with the Python of"
        " ROS 2, after `. /opt/ros/DISTRO/setup.sh`",
        name=error.name,
    )


def _read(script: Path) -> str:
    try:
        return script.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileError(f"{script} cannot be read: {error}") from error


def _exported(enclave: str, options: str, present: Mapping[str, str]) -> str:
    command = ["export", Stack.ROS2, enclave, *shlex.split(options)]
    module = [sys.executable, "-P", "-m", "pqsec_pki"]  # no modules of the present folder
    return _run([*module, *command], present, shlex.join(["pqsec", *command]))


def _run(command: list[str], present: Mapping[str, str], name: str) -> str:
    done = subprocess.run(  # noqa: S603 -- the script is the user's, as for `. ./ros2.sh`
        command, env=dict(present), stdout=subprocess.PIPE, check=False
    )
    if done.returncode:
        raise PqsecError(f"{name} failed with exit code {done.returncode}; its messages are above")
    return os.fsdecode(done.stdout)
