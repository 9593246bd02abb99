"""pqsec check has nothing to say about what pqsec writes, whatever was asked of it."""

import shutil
from functools import cache

import pytest

from pqsec_pki.documents import PRESETS
from tests.cli.conftest import NAMES, secret

OPEN = "--ignore 'PQS707=to encrypt them is most of the time of a test'"
NODES = {
    "/fleet/talker": "--ros-publish /chatter --ros-service /add_two_ints",
    "/listener": "--ros-subscribe /chatter",
}
SMALL_FOR_FAST_DDS = {"classical"}
STOCK = ("classical", "transition")


@pytest.fixture(scope="module")
def model(run_in, tmp_path_factory):
    """model("pq") is a folder with a keystore of that profile: two ROS 2 nodes, open CA keys."""

    @cache
    def make(profile):
        folder = tmp_path_factory.mktemp(profile)
        run_in(folder, f"-k k ca init --no-passphrase --profile {profile}").done()
        for name, options in NODES.items():
            run_in(folder, f"-k k issue {name} --ros-node {name} {options}").done()
        return folder

    return make


@pytest.fixture
def made(model, tmp_path):
    """made("pq") puts it into the test's own folder, as `k`."""

    def make(profile="transition"):
        shutil.copytree(model(profile), tmp_path, symlinks=True, dirs_exist_ok=True)

    return make


ONE_SIDED = {"PQS345", "PQS346"}
"""The participants here have topics without the other side."""


@pytest.fixture
def told(pqsec):
    """told() is what a check finds in `k`, rule by rule, with its severity."""

    def check(options=OPEN, path="k"):
        result = pqsec(f"check {path} --strict --json {options}").json
        found = {each["rule"]: each["severity"] for each in result["findings"]}
        return {rule: severity for rule, severity in found.items() if rule not in ONE_SIDED}

    return check


@pytest.mark.parametrize("profile", NAMES)
def test_a_keystore(pqsec, told, tmp_path, profile):
    secret(tmp_path / "secret", "open sesame, please\n")
    pqsec(f"-k k ca init --profile {profile} --passphrase-file secret").done()
    pqsec("-k k issue /talker --publish rt/a --passphrase-file secret").done()
    assert told("") == {}


@pytest.mark.parametrize("target", ["cyclonedds", "fastdds", "connext", "ros2"])
@pytest.mark.parametrize("profile", STOCK)
def test_a_keystore_for_a_stock_stack(made, told, profile, target):
    made(profile)
    too_large = target == "fastdds" and profile not in SMALL_FOR_FAST_DDS
    assert set(told(f"--target {target} {OPEN}")) == ({"PQS501"} if too_large else set())


@pytest.mark.parametrize("profile", NAMES)
def test_a_demo_but_for_its_open_keys(pqsec, told, profile):
    pqsec(f"demo k --profile {profile}").done()
    assert set(told("")) == {"PQS707"}


def test_a_participant_issued_again_with_the_rest_left(made, pqsec, told):
    made()
    pqsec("-k k issue /fleet/talker --publish rt/a --validity 30d --force").done()
    assert told() == {"PQS353": "info"}


@pytest.mark.parametrize("option", ["--rekey", "--keep-key"])
def test_participants_renewed(made, pqsec, told, option):
    made()
    pqsec(f"-k k renew --all {option}").done()
    assert told() == {"PQS353": "info"}


@pytest.mark.parametrize("profile", NAMES)
def test_a_revocation_told_as_info_until_the_participant_is_issued_again(
    made, pqsec, told, profile
):
    made(profile)
    pqsec("-k k revoke /listener --yes").done()
    robots = {"PQS351": "warning"}  # they do not have the list
    assert told() == {"PQS149": "info", **robots}
    again = "--force --after-revocation"
    pqsec(f"-k k issue /listener --publish rt/a {again}").done()
    assert told() == robots


@pytest.mark.parametrize("profile", NAMES)
@pytest.mark.parametrize("option", ["", "--embed-certificate"])
def test_documents_signed_again(made, pqsec, told, profile, option):
    made(profile)
    for command, place in (
        ("governance", "enclaves/governance"),
        ("permissions", "enclaves/fleet/talker/permissions"),
    ):
        pqsec(f"-k k sign-{command} k/{place}.xml {option} --force").done()
    assert told() == {}


@pytest.mark.parametrize("preset", [preset.name for preset in PRESETS])
def test_governance_of_a_preset(made, pqsec, told, preset):
    made()
    pqsec(f"governance new --preset {preset} -o g.yaml").done()
    pqsec("governance render g.yaml -o k/enclaves/governance.xml --force").done()
    pqsec("-k k sign-governance k/enclaves/governance.xml --force").done()
    assert "error" not in told().values()
    assert told() == {} or preset != "strict"


def test_permissions_of_a_policy(made, pqsec, told):
    made()
    pqsec("permissions new /arm /base --domain 0 -o p.yaml").done()
    pqsec("-k k issue /arm /base --policy p.yaml").done()
    assert told() == {}


def test_an_enclave_on_its_robot(made, told, tmp_path):
    made()
    shutil.copytree(tmp_path / "k/enclaves/fleet/talker", tmp_path / "robot", symlinks=False)
    assert told("", path="robot") == {}
