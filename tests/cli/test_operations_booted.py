"""examples/operations under a systemd that has booted: installed as its README says, and run.

So the units' sandbox is there, and what it refuses is found.
"""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import pqsec_pki
from tests.cli.conftest import secret
from tests.longer import LONG

FOLDER = Path(__file__).parents[2] / "examples/operations"
BOOTED = Path(__file__).with_name("booted.sh")
SYSTEMD = Path("/lib/systemd/systemd")
PROGRAM = """#!/bin/sh
export PYTHONHOME=/opt/python LD_LIBRARY_PATH=/opt/python/lib PYTHONPATH={paths}
exec /opt/python/bin/{python} -m pqsec_pki "$@"
"""
INSIDE = """
set -ex
cd /shared/operations
install -m 755 /shared/pqsec /usr/bin/pqsec
mkdir -p /etc/prometheus
{install}
home=/var/lib/pqsec
install -o pqsec -m 0600 ca-passphrase $home/passphrase
as_user() {{ runuser -u pqsec -- pqsec -k $home/robots "$@"; }}
as_user ca init --name Robots --passphrase-file $home/passphrase
as_user issue /short --publish rt/a --validity 20d --passphrase-file $home/passphrase
as_user issue /long --subscribe rt/a --passphrase-file $home/passphrase
rm $home/passphrase
as_user status --json > /shared/before.json
systemctl start pqsec-renew.service pqsec-crl.service
systemctl start pqsec-metrics.service
as_user status --json > /shared/after.json
as_user log > /shared/log
cp /var/lib/prometheus/node-exporter/pqsec.prom /shared
systemctl is-active pqsec-{{renew,crl,metrics}}.timer > /shared/timers
sed -i s:/long:/lost: $home/robots/private/ledger.sqlite3
! systemctl start pqsec-renew.service
journalctl --unit pqsec-renew --no-pager > /shared/altered
"""


@pytest.fixture(scope="module")
def night(tmp_path_factory, requires):
    """What a machine left that booted, took the units and ran each service once."""
    can = os.geteuid() == 0 and SYSTEMD.exists()
    requires(can or None, "systemd, and root to boot it", "apt-get install systemd")
    shared = tmp_path_factory.mktemp("booted")
    shared.chmod(0o755)
    shutil.copytree(FOLDER, shared / "operations")
    secret(shared / "operations/ca-passphrase", "correct horse battery staple\n")
    packages = [each for each in sys.path if each.endswith("-packages")]
    trees = [str(Path(pqsec_pki.__file__).parents[1]), *packages]
    places = {f"tree{number}": each for number, each in enumerate(trees)}
    paths = ":".join(f"/opt/{each}" for each in places)
    python = f"python3.{sys.version_info.minor}"
    (shared / "pqsec").write_text(PROGRAM.format(paths=paths, python=python))
    [install] = re.findall(
        r"## Install\n\n```sh\n(.*?)```", (FOLDER / "README.md").read_text(), re.DOTALL
    )
    (shared / "inside.sh").write_text(INSIDE.format(install=install))
    given = [f"{place}={path}" for place, path in places.items()]
    (shared / "out").touch()
    subprocess.run(
        ["bash", BOOTED, shared, f"python={sys.base_prefix}", *given], timeout=280, check=False
    )
    assert (shared / "altered").exists(), (shared / "out").read_text()
    return shared


pytestmark = [
    pytest.mark.interop,
    pytest.mark.timeout(300),
    pytest.mark.skipif(not LONG, reason="in .ci/long: it boots Debian's systemd, as root"),
]


def serials(path):
    return {each["name"]: each["serial"] for each in json.loads(path.read_text())["participants"]}


def test_the_services_do_their_work_in_their_sandbox(night):
    before, after = serials(night / "before.json"), serials(night / "after.json")
    assert after["/short"] != before["/short"]
    assert after["/long"] == before["/long"]
    assert " crl (" in (night / "log").read_text()
    assert 'kind="participant",name="/short"' in (night / "pqsec.prom").read_text()
    assert (night / "timers").read_text().split() == ["active"] * 3


def test_a_ledger_that_was_altered_fails_the_nightly_service(night):
    said = (night / "altered").read_text()
    assert "pqsec: error: " in said
    assert "Failed with result 'exit-code'" in said
