"""examples/operations under a systemd that has booted: installed as its README says, and run.

So the units' sandbox is there, and what it refuses is found.
"""

import json
import re
from pathlib import Path

import pytest

from tests.cli.booting import CAN_BOOT, boot
from tests.cli.conftest import secret
from tests.longer import LONG

FOLDER = Path(__file__).parents[2] / "examples/operations"
INSIDE = """
set -ex
mv /shared/passphrase /shared/operations/ca-passphrase
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
    requires(CAN_BOOT or None, "systemd, and root to boot it", "apt-get install systemd")
    shared = tmp_path_factory.mktemp("booted")
    secret(shared / "passphrase", "correct horse battery staple\n")
    [install] = re.findall(
        r"## Install\n\n```sh\n(.*?)```", (FOLDER / "README.md").read_text(), re.DOTALL
    )
    boot(shared, FOLDER, INSIDE.format(install=install))
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
