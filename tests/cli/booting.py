"""A copy of this machine in which systemd boots and runs a script, with this pqsec."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pqsec_pki

BOOTED = Path(__file__).with_name("booted.sh")
SYSTEMD = Path("/lib/systemd/systemd")
CAN_BOOT = os.geteuid() == 0 and SYSTEMD.exists()
PROGRAM = """#!/bin/sh
export PYTHONHOME=/opt/python LD_LIBRARY_PATH=/opt/python/lib PYTHONPATH={paths}
exec /opt/python/bin/{python} -m pqsec_pki "$@"
"""


def boot(shared: Path, example: Path, script: str) -> None:
    """Boot, and run the script there as root, which finds /shared/pqsec and the example.

    What it leaves in /shared stays in `shared`; `out` has what it said.
    """
    shared.chmod(0o755)
    shutil.copytree(example, shared / example.name)
    packages = [each for each in sys.path if each.endswith("-packages")]
    trees = [str(Path(pqsec_pki.__file__).parents[1]), *packages]
    places = {f"tree{number}": each for number, each in enumerate(trees)}
    paths = ":".join(f"/opt/{each}" for each in places)
    python = f"python3.{sys.version_info.minor}"
    (shared / "pqsec").write_text(PROGRAM.format(paths=paths, python=python))
    (shared / "inside.sh").write_text(script)
    given = [f"{place}={path}" for place, path in places.items()]
    (shared / "out").touch()
    subprocess.run(
        ["bash", BOOTED, shared, f"python={sys.base_prefix}", *given], timeout=280, check=False
    )
