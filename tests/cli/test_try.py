"""`pqsec try`, as far as no stack is needed; tests/interop has the rest."""

import json

import pytest


@pytest.mark.parametrize(
    ("line", "words", "hint"),
    [
        ("cyclonedds /talker", "but 1 are named", "name two"),
        ("fastdds /talker /listener /more", "3 are named", "name two"),
        ("ros2 /talker", "ros2 is not run here", "--dry-run"),
        ("fastdds /talker /listener --dry-run", "not for fastdds", "ros2 --dry-run"),
        ("fastdds /talker /listener --topic ''", "the topic is empty", "omit --topic"),
        ("connext /talker /listener", "'connext' is not one of", "--help"),
        ("fastdds /talker /listener --timeout 0", "--timeout", "--help"),
        ("fastdds /talker /listener --timeout nan", "'nan' is not a finite number", "--help"),
        ("fastdds /talker /listener --domain 231", "--domain", "--help"),
        ("fastdds /talker /listener --domain 9", "domain 9", "--topic"),
    ],
)
def test_what_makes_no_sense_is_refused(pqsec, keystore, line, words, hint):
    keystore()
    pqsec(f"-k k try {line}").refused(2, words, hint=hint)


@pytest.mark.parametrize(
    ("stack", "packages"),
    [
        ("cyclonedds", "apt-get install gcc libc6-dev cyclonedds-dev cyclonedds-tools"),
        ("fastdds", "apt-get install g++ libfastrtps-dev or: apt-get install g++ libfastdds-dev"),
    ],
)
def test_a_stack_that_is_not_installed_is_named_with_its_packages(
    pqsec, keystore, tmp_path, stack, packages
):
    keystore()
    (tmp_path / "root").mkdir()
    done = pqsec(f"-k k try {stack} /talker /listener --root root")
    done.refused(3, "is not installed", hint=packages)


def pretended_stack(tmp_path):
    """What looks like an installed Cyclone DDS; whatever compiles with it fails."""
    headers = tmp_path / "root/usr/include/dds"
    headers.mkdir(parents=True)
    (headers / "version.h").write_text('#define DDS_VERSION "0.10.5"\n')
    for tool in ("idlc", "gcc"):
        path = tmp_path / "root/usr/bin" / tool
        path.parent.mkdir(exist_ok=True)
        path.write_text("#!/bin/false\n")
        path.chmod(0o755)


@pytest.mark.parametrize("topic", ["", "--topic rt/chatter"])
def test_an_unknown_participant_is_refused_before_anything_is_compiled(
    pqsec, keystore, tmp_path, topic
):
    keystore()
    pretended_stack(tmp_path)
    line = f"-k k try cyclonedds /talker /nobody --root root {topic}"
    pqsec(line, XDG_CACHE_HOME=str(tmp_path / "cache")).refused(3, "no participant /nobody")
    assert not (tmp_path / "cache").exists()


@pytest.mark.parametrize(("enable", "code"), [("true", 0), ("True", 1)])
def test_the_environment_of_ros_2_is_checked_without_running_it(pqsec, keystore, enable, code):
    made = keystore()
    pqsec("-k k issue /camera --ros-node /camera").done()
    environment = {
        "ROS_SECURITY_ENABLE": enable,
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_KEYSTORE": str(made),
    }
    done = pqsec("-k k try ros2 --dry-run /camera --json", **environment)
    assert done.code == code
    assert json.loads(done.out)["ok"] is (code == 0)
    assert list(json.loads(done.out)["participants"]) == ["/camera"]


def test_two_are_tried_on_a_domain_that_both_may_join(pqsec, keystore):
    keystore()
    pqsec("governance new --domain 0-2 -o g.yaml").done()
    pqsec("-k k sign-governance g.yaml -o k/enclaves/governance.p7s --force").done()
    pqsec("-k k issue /one /two --domain 1 --publish a").done()
    pqsec("-k k issue /far --domain 2 --publish a").done()
    pqsec("-k k try cyclonedds /one /two").refused(2, "on domain 1 neither of /one and /two")
    pqsec("-k k try cyclonedds /one /far").refused(1, "they share no domain: /one may join")


@pytest.mark.parametrize("topic", ["", "--topic rt/chatter"])
def test_credentials_that_cannot_be_trusted_are_not_tried(pqsec, keystore, tmp_path, topic):
    keystore()
    pretended_stack(tmp_path)
    ca = tmp_path / "k/public/identity_ca.cert.pem"
    ca.write_bytes(ca.read_bytes() * 2)
    line = f"-k k try cyclonedds /talker /listener --root root {topic}"
    cache = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    told = "/talker: identity_ca.cert.pem: it contains the same CA twice"
    pqsec(line, **cache).refused(1, told, hint="pqsec check", problems=2)
    assert not (tmp_path / "cache").exists()
    pqsec(f"{line} --anyway", **cache).refused(3, "")
