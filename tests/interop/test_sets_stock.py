"""Real stacks run the first set of credentials of a keystore that has several."""

import json
import os
import subprocess
import sys

import pytest

from pqsec_pki.documents import ros
from pqsec_pki.errors import VerificationError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.trial import MACHINE, MissingStackError, TopicRoute, Trial, find, run_trial
from pqsec_pki.vendors import Options, export, write
from tests.interop.conftest import DOMAINS, LAB_PROFILES, TOPIC, YEAR
from tests.interop.roots import TRIXIE

pytestmark = pytest.mark.interop

STACKS = {
    "cyclonedds 0.10.2": ("cyclonedds", MACHINE),
    "fastdds 2.9.1": ("fastdds", MACHINE),
    "fastdds 3.1.2": ("fastdds", TRIXIE),
}
"""The last one cannot send what is longer than 8192 bytes."""
SETS = ("classical,hybrid", "classical,pq")
TALKER, LISTENER = "/lab/talker", "/lab/listener"


@pytest.fixture(scope="module")
def keystores(tmp_path_factory, now):
    """keystores("classical,hybrid") is a keystore with these sets, and a node's rights."""
    made = {}

    def keystore(profiles) -> Keystore:
        if profiles not in made:
            root = tmp_path_factory.mktemp("sets") / "k"
            chosen = [LAB_PROFILES[each] for each in profiles.split(",")]
            options = {"domains": DOMAINS, "validity": 10 * YEAR, "now": now, "passphrase": None}
            made[profiles] = Keystore.create(root, *chosen, name="Lab", **options)
            may = {"domains": DOMAINS, "validity": YEAR}
            needs = ros.node_minimum(TALKER)
            published = (*needs.publish, TOPIC)
            specs = [
                ParticipantSpec(name=TALKER, publish=published, subscribe=needs.subscribe, **may),
                ParticipantSpec(name=LISTENER, subscribe=(TOPIC,), **may),
            ]
            issue(made[profiles], made[profiles].unlock(None), specs, now=now)
        return made[profiles]

    return keystore


@pytest.fixture
def installation(requires):
    """installation("fastdds 3.1.2") is that stack."""

    def found(name):
        stack, root = STACKS[name]
        remedy = "run .ci/trixie" if root == TRIXIE else f"install {stack}"
        try:
            return requires(find(stack, root), name, remedy)
        except MissingStackError as error:
            return requires(None, name, error.hint)

    return found


@pytest.mark.slow(but=3)
@pytest.mark.parametrize("profiles", SETS)
@pytest.mark.parametrize("name", STACKS)
def test_two_participants_meet_in_stock_stacks_with_the_first_set(
    keystores, installation, now, name, profiles
):
    which = installation(name)
    assert f"{which.build.stack} {which.version}" == name
    trial = Trial(installation=which, keystore=keystores(profiles), timeout=60, now=now)
    route = TopicRoute(sender=TALKER, receiver=LISTENER, domain=0, topic=TOPIC)
    report = run_trial(trial, route)
    told = "\n".join(f"-- {each.role.name}\n{each.log}" for each in report.trial_run.outcomes)
    assert report.accepted, told
    assert report.unauthenticated_heard is False, told
    assert report.plugged == ()
    assert report.warnings == ()


def test_a_first_set_for_pqsec_peers_is_not_tried_in_a_stock_stack(keystores, installation, now):
    which = installation("cyclonedds 0.10.2")
    trial = Trial(installation=which, keystore=keystores("pq,classical"), timeout=1, now=now)
    route = TopicRoute(sender=TALKER, receiver=LISTENER, domain=0, topic=TOPIC)
    with pytest.raises(VerificationError, match="stock stacks see only the first set"):
        run_trial(trial, route)


@pytest.mark.slow
def test_the_command_tries_the_first_set(keystores, installation):
    installation("cyclonedds 0.10.2")
    keystore = keystores("classical,hybrid")
    words = f"-k {keystore.root} try cyclonedds {TALKER} {LISTENER} --topic {TOPIC} --json"
    done = subprocess.run(
        [sys.executable, "-m", "pqsec_pki", *words.split()],
        env=os.environ,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        timeout=300,
        check=False,
    )
    told = json.loads(done.stdout)
    assert (done.returncode, told["ok"], told["warnings"]) == (0, True, [])


@pytest.mark.parametrize("profiles", SETS)
def test_a_node_of_ros_2_finds_the_first_set(ros2, keystores, now, tmp_path, profiles):
    keystore = keystores(profiles)
    made = export("ros2", keystore, TALKER, Options(), now=now)
    write(made, tmp_path / "export")
    run = ros2.node(
        tmp_path, f". '{tmp_path}/export/{made.main}'", "--ros-args", "--enclave", TALKER
    )
    folder = keystore.root / "enclaves/lab/talker"
    assert f"Found security directory: {folder}" in run.said
    assert made.environment["ROS_SECURITY_KEYSTORE"] == str(keystore.root)
