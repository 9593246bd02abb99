"""pqsec try ros2 --dry-run: would a node run secured, started from this shell?"""

import subprocess

import pytest

from pqsec_pki.cli._paragraph import WIDTH
from tests.cli.conftest import clean_environment

OK = """\
ok    ROS_SECURITY_ENABLE
ok    ROS_SECURITY_STRATEGY
ok    ROS_SECURITY_KEYSTORE
ok    ROS_SECURITY_ENCLAVE_OVERRIDE
ok    files
ok    credentials
ok    ROS_DOMAIN_ID 0
ok    node /talker

ROS 2 would run /talker secured from this shell: --ros-args --enclave /talker
"""


@pytest.fixture
def shell(pqsec, keystore):
    """A keystore `k` with /talker as a ROS 2 node; and the environment its export gives."""
    keystore()
    pqsec("-k k issue /talker --force --ros-node /talker --ros-publish /chatter").done()
    return pqsec("-k k --json export ros2 /talker -o out").done().json["environment"]


def test_all_is_well_in_the_environment_of_the_export(pqsec, shell):
    assert pqsec("-k k try ros2 /talker --dry-run", **shell).done().out == OK


def test_the_script_can_be_evaluated_as_it_is_printed(pqsec, shell, tmp_path):
    script = pqsec("-k k export ros2 /talker").done().out
    done = subprocess.run(
        ["sh", "-euc", f"{script}\nenv -0"],
        env=clean_environment(),
        capture_output=True,
        text=True,
        check=True,
    )
    assert (
        shell.items() <= dict(each.split("=", 1) for each in done.stdout.split("\0")[:-1]).items()
    )


def test_an_empty_environment_would_run_it_unsecured(pqsec, shell):
    result = pqsec("-k k try ros2 /talker --dry-run")
    assert (result.code, result.err) == (1, "")
    assert "FAIL  ROS_SECURITY_ENABLE            is not set: nodes run unsecured" in result.out
    assert result.out.endswith('To fix it:\n  eval "$(pqsec export ros2 /talker)"\n')


def test_keys_that_stacks_refuse_need_the_plugin_in_every_way_out(pqsec, keystore):
    keystore(profile="pq")
    pqsec("-k k issue /talker --force --ros-node /talker").done()
    said = pqsec("-k k try ros2 /talker --dry-run").out
    assert '  eval "$(pqsec export ros2 /talker --plugin)"\n' in said
    assert 'export ros2 /talker)"' not in said
    assert "Or run pqsec's plugin in it: --plugin." in said


def test_one_letter_makes_the_difference(pqsec, shell):
    result = pqsec("-k k --json try ros2 /talker --dry-run", **shell | {"ROS_SECURITY_ENABLE": "1"})
    assert result.code == 1
    assert result.json["ok"] is False
    [wrong] = [each for each in result.json["participants"]["/talker"] if not each["ok"]]
    assert wrong["problem"].startswith("is '1', not true")


def test_a_participant_that_is_no_node_is_told_what_it_lacks(pqsec, shell):
    result = pqsec("-k k try ros2 /talker /listener --dry-run", **shell)
    assert result.code == 1
    assert result.out.startswith(OK)
    assert "may not publish ros_discovery_info" in result.out


def test_a_keystore_without_participants_is_no_success(pqsec):
    pqsec("-k empty ca init --no-passphrase").done()
    pqsec("-k empty try ros2 --dry-run").refused(3, "no participant", hint="pqsec issue")


def test_long_lines_are_broken_below_what_they_say(pqsec, shell):
    lines = pqsec("-k k try ros2 /listener --dry-run", **shell).out.splitlines()
    start = next(each.index("CN=/listener may not") for each in lines if "may not publish" in each)
    long = [number for number, each in enumerate(lines) if each.startswith("FAIL  node")]
    assert all(lines[number + 1].startswith(" " * start + "r") for number in long)
    assert max(map(len, lines)) <= WIDTH


def test_nobody_is_an_error(pqsec, shell):
    pqsec("-k k try ros2 /nobody --dry-run", **shell).refused(3, "no participant /nobody")
