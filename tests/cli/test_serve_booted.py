"""examples/serve under a systemd that has booted: set up as its README says, and asked by a robot.

So the units' sandbox is there, the users are two, and what either is refused is found.
"""

import json
import re
from pathlib import Path

import pytest

from tests.cli.booting import CAN_BOOT, boot
from tests.longer import LONG

FOLDER = Path(__file__).parents[2] / "examples/serve"
DOMAIN = """
name: Booted
roles: {robot: {publish: [rt/pose]}}
participants: [{name: "/r{1..3}", role: robot, request: requests/}]
"""
INSIDE = """
set -ex
tries=0
cd /shared/serve
mkdir -p /opt/pqsec/bin
install -m 755 /shared/pqsec /opt/pqsec/bin/pqsec
cat > domain.yaml << 'END'
DOMAIN
END
BLOCKS
token() {
    as_signer enrolment-token create /r$1 --config /etc/pqsec/serve.yaml -o /var/lib/pqsec/$1
    install -m 0600 /var/lib/pqsec/$1 /shared/$1.token  # as on the robot, where it is root's
    rm /var/lib/pqsec/$1
}
enrol() { pqsec enrol --token-file /shared/$1.token --dir /shared/robot$1; }
rights() { grep -E '^(Uid|Gid|CapEff|NoNewPrivs|Seccomp):' /proc/$1/status; }
pqsec() { /opt/pqsec/bin/pqsec "$@"; }
token 1
enrol 1
systemctl restart pqsec-signer pqsec-serve
token 2
enrol 2
front=$(systemctl show -P MainPID pqsec-serve) signer=$(systemctl show -P MainPID pqsec-signer)
rights $front > /shared/front
rights $signer > /shared/signer
ls /var/lib/pqsec/keystore > /shared/outside
ls /proc/$front/root/var/lib/pqsec/keystore > /shared/inside 2>&1 || true
nsenter -t $signer -n tail -n +3 /proc/net/dev > /shared/network
stat -c '%U:%G %a %n' /var/lib/pqsec/state /var/lib/pqsec/state/signer.sock > /shared/modes
systemctl kill --signal=KILL pqsec-signer
sleep 0.5
until curl -sf http://127.0.0.1:9180/readyz || [ $((tries++)) = 200 ]; do sleep 0.1; done
token 3
enrol 3
[ $(systemctl show -P MainPID pqsec-serve) = $front ]
as_signer status --json > /shared/status.json

cd /srv  # one service of root, whose front is of another user
cp /etc/pqsec/domain.yaml .
pqsec -k keystore apply domain.yaml --yes --no-passphrase || true
pqsec -k keystore serve --config serve.yaml --init https://127.0.0.1:8444
sed -i 's|9180|9181|; s|^state:.*|state: state\\nfront_user: pqsec-front|' serve.yaml
chgrp pqsec-front tls-*.key && chmod 0640 tls-*.key
/opt/pqsec/bin/pqsec serve --config serve.yaml &
until curl -sf http://127.0.0.1:9181/readyz || [ $((tries++)) = 200 ]; do sleep 0.1; done
rights $(cat /proc/$!/task/*/children) > /shared/front-of-root
pqsec -k keystore enrolment-token create /r1 --config serve.yaml -o /shared/4.token
enrol 4
kill $!
wait $!
id -u pqsec-front > /shared/done
"""


@pytest.fixture(scope="module")
def machine(tmp_path_factory, requires):
    """What a machine left that booted and served three robots."""
    requires(CAN_BOOT or None, "systemd, and root to boot it", "apt-get install systemd")
    shared = tmp_path_factory.mktemp("booted")
    blocks = re.findall(r"```sh\n(.*?)```", (FOLDER / "README.md").read_text(), re.DOTALL)
    text = "\n".join(blocks).replace("https://enrol.example:8443", "https://127.0.0.1:8443")
    boot(shared, FOLDER, INSIDE.replace("DOMAIN", DOMAIN.strip()).replace("BLOCKS", text))
    assert (shared / "done").exists(), (shared / "out").read_text()[-5000:]
    return shared


pytestmark = [
    pytest.mark.interop,
    pytest.mark.timeout(300),
    pytest.mark.skipif(not LONG, reason="in .ci/long: it boots Debian's systemd, as root"),
]


def rights(machine, who):
    """The user of the process, its capabilities, and whether it may get more, or ask all."""
    lines = (machine / who).read_text().splitlines()
    return {name: value.split() for name, value in (line.split(":") for line in lines)}


def test_robots_enrol_at_services_of_two_users(machine):
    found = json.loads((machine / "status.json").read_text())["participants"]
    assert [each["name"] for each in found] == ["/r1", "/r2", "/r3"]
    assert {each["robot"] for each in found} == {"current"}


def test_the_front_sees_no_keystore_and_has_no_rights(machine):
    user = (machine / "done").read_text().strip()
    front, signer = rights(machine, "front"), rights(machine, "signer")
    assert front["Uid"] == [user] * 4 != signer["Uid"]
    for each in (front, signer):
        assert (each["CapEff"], each["NoNewPrivs"]) == (["0" * 16], ["1"])
        assert each["Seccomp"] == ["2"]
    assert "private" in (machine / "outside").read_text().split()
    assert "private" not in (machine / "inside").read_text().split()


def test_the_signer_has_no_network_and_lets_its_group_ask(machine):
    [line] = (machine / "network").read_text().splitlines()
    assert line.strip().startswith("lo:")
    assert (machine / "modes").read_text().splitlines() == [
        "pqsec:pqsec-front 750 /var/lib/pqsec/state",
        "pqsec:pqsec-front 660 /var/lib/pqsec/state/signer.sock",
    ]


def test_the_front_of_a_server_of_root_is_another_user(machine):
    user = (machine / "done").read_text().strip()
    front = rights(machine, "front-of-root")
    assert (front["Uid"], front["CapEff"]) == ([user] * 4, ["0" * 16])
