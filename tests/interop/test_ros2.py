"""ROS 2 finds what we make for it, and what it makes of an environment that is nearly right."""

from pathlib import Path

import pytest

from pqsec_pki.documents import ros
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.stacks import stack_named
from pqsec_pki.vendors import Options, export, write
from pqsec_pki.vendors.messages import recognise
from tests.interop.conftest import DOMAINS, LAB_PROFILES, YEAR, Lab

pytestmark = pytest.mark.interop

TALKER = ("--ros-args", "--enclave", "/lab/talker")
NOBODY = ("--ros-args", "--enclave", "/lab/nobody")
FOUND = "Found security directory: {folder}"
STOP = "This Fast DDS version doesn't have the security libraries"


@pytest.fixture(scope="session")
def keystore(tmp_path_factory, now) -> Keystore:
    """A keystore with /lab/talker, in a folder that a shell would trip over."""
    lab = Lab.create(tmp_path_factory.mktemp("ros2") / "it's a $k", LAB_PROFILES["transition"], now)
    needs = ros.node_minimum("/lab/talker")
    topics = {"publish": (*needs.publish, "rt/chatter"), "subscribe": needs.subscribe}
    spec = ParticipantSpec(name="/lab/talker", domains=DOMAINS, validity=YEAR, **topics)
    issue(lab.keystore, lab.authorities, [spec], now=now)
    return lab.keystore


@pytest.fixture
def script(keystore, now, tmp_path):
    """script(**options) is the path of the script of /lab/talker's export."""

    def make(**options) -> Path:
        made = export(stack_named("ros2"), keystore, "/lab/talker", Options(**options), now=now)
        write(made, tmp_path / "export", force=True)
        return tmp_path / "export" / made.main

    return make


@pytest.fixture
def node(ros2, script, tmp_path):
    """node(lines for the shell after the script, ...) is what became of a node."""

    def start(more="", arguments=TALKER):
        return ros2.node(tmp_path, f". '{script()}'\n{more}", *arguments)

    return start


def explained(run):
    return [found.message.texts[0] for found in recognise(run.said, stack="ros2")]


def test_a_node_finds_its_enclave_with_the_exported_script(node, keystore):
    run = node()
    folder = keystore.root / "enclaves" / "lab" / "talker"
    assert FOUND.format(folder=folder) in run.said
    assert STOP in run.said
    assert not run.lives
    assert explained(run) == [STOP, FOUND]


def test_a_node_finds_an_enclave_that_was_exported_for_another_machine(ros2, script, tmp_path):
    robot = tmp_path / "robot"
    exported = script(at=robot / "enclaves" / "lab" / "talker").parent
    exported.rename(robot)
    run = ros2.node(tmp_path, f". '{robot}/ros2.sh'", *TALKER)
    assert FOUND.format(folder=robot / "enclaves" / "lab" / "talker") in run.said
    assert STOP in run.said
    assert not [path for path in robot.rglob("*") if path.is_symlink()]


def test_the_script_frees_the_enclave_from_an_override(ros2, script, tmp_path):
    first = "export ROS_SECURITY_ENCLAVE_OVERRIDE=/lab/nobody"
    assert STOP in ros2.node(tmp_path, f"{first}\n. '{script()}'", *TALKER).said
    run = ros2.node(tmp_path, f". '{script()}'\n{first}", *TALKER)
    assert "lab/nobody' does not exist" in run.said


def test_an_enclave_that_is_not_there_is_named(node, keystore):
    run = node(arguments=NOBODY)
    folder = keystore.root / "enclaves" / "lab" / "nobody"
    assert f"SECURITY ERROR: directory '{folder}' does not exist" in run.said
    assert not run.lives
    assert explained(run) == ["SECURITY ERROR: directory '{folder}' does not exist"]


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("value", ["1", "True", "TRUE", "yes", "' true'"])
def test_another_word_than_true_runs_unsecured_and_silently(node, value):
    run = node(f"export ROS_SECURITY_ENABLE={value}", NOBODY)
    assert run.lives
    assert "ecur" not in run.said


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("value", ["enforce", "ENFORCE", "true", "''"])
def test_another_word_than_enforce_runs_unsecured_without_an_enclave(node, value):
    assert node(f"export ROS_SECURITY_STRATEGY={value}", NOBODY).lives


@pytest.mark.parametrize("line", ["unset ROS_SECURITY_KEYSTORE", "ROS_SECURITY_KEYSTORE="])
def test_a_keystore_that_is_not_named_is_an_error_without_a_word(node, line):
    run = node(line)
    assert not run.lives
    assert explained(run) == ["failed to initialize rcl: error not set"]


def test_a_relative_name_of_an_enclave_is_refused(node):
    run = node(arguments=("--ros-args", "--enclave", "lab/talker"))
    assert not run.lives
    assert explained(run) == ["Enclave name is not valid: '{reason}'"]


def test_what_these_wheels_cannot_see_is_checked_by_the_export(ros2, keystore, script, tmp_path):
    """Fast DDS without security looks at no file: a missing one makes no difference there."""
    key = keystore.root / "enclaves" / "lab" / "talker" / "key.pem"
    path, away = script(), key.with_suffix(".away")
    key.rename(away)
    try:
        assert STOP in ros2.node(tmp_path, f". '{path}'", *TALKER).said
        with pytest.raises(KeystoreError, match=r"lacks key\.pem"):
            script()
    finally:
        away.rename(key)
