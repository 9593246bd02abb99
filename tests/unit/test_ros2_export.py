"""pqsec export ros2: the script, the folder for a robot, and what is checked before ROS 2 does."""

import subprocess
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path, PurePosixPath

import pytest

from pqsec_pki.algorithms import load_private_key, private_key_pem, profile_named
from pqsec_pki.documents import DomainSet, ros
from pqsec_pki.errors import KeystoreError, PqsecError, UsageError, VerificationError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.stacks import stack_named
from pqsec_pki.vendors import Options, export, write
from pqsec_pki.vendors.enclave import SIX
from pqsec_pki.vendors.ros2 import preflight

ROS2 = stack_named("ros2")
DAY = timedelta(days=1)
LIFE = ros.node_minimum("/talker")


@dataclass(frozen=True)
class Domain:
    """A keystore and its CAs, unlocked."""

    keystore: Keystore
    now: object

    def issue(self, name="/talker", needs=LIFE, domains="0", *, more=()):
        spec = ParticipantSpec(
            name=name,
            publish=(*needs.publish, *more),
            subscribe=needs.subscribe,
            domains=DomainSet.parse(domains),
            validity=DAY,
        )
        issue(self.keystore, self.keystore.unlock(None), [spec], now=self.now)
        return self.keystore.root / f"enclaves{name}"

    def export(self, name="/talker", **options):
        return export(ROS2, self.keystore, name, Options(**options), now=self.now)

    def good(self):
        """The environment in which /talker is secured."""
        return dict(self.export().environment)

    def preflight(self, name="/talker", **changed):
        variables = self.good() | changed
        found = preflight(
            self.keystore, name, {k: v for k, v in variables.items() if v is not None}, now=self.now
        )
        return {each.what: each.problem for each in found}


@pytest.fixture
def domain(tmp_path, now) -> Domain:
    options = {"domains": DomainSet.parse("0-3"), "validity": 100 * DAY, "now": now}
    profile = profile_named("classical")
    keystore = Keystore.create(tmp_path / "k", profile, name="Lab", passphrase=None, **options)
    return Domain(keystore, now)


def read_in(script: Path) -> dict[str, str]:
    """The variables after a POSIX shell has read the script."""
    done = subprocess.run(
        ["sh", "-euc", '. "$1" && env -0', "sh", script],
        env={"ROS_SECURITY_ENCLAVE_OVERRIDE": "/other", "PATH": "/usr/bin:/bin"},
        capture_output=True,
        check=True,
        text=True,
    )
    assert done.stderr == ""
    pairs = dict(line.split("=", 1) for line in done.stdout.split("\0") if line)
    return {name: value for name, value in pairs.items() if name.startswith("ROS_")}


ODD = [
    "plain",
    "with space",
    "it's",
    '"quoted"',
    "$HOME",
    "`id`",
    "a;b",
    "caf\u00e9",
    "\\n",
    "*",
    "{folder}",
]


@pytest.mark.parametrize("folder", ODD)
def test_the_script_sets_exactly_what_secures(domain, tmp_path, folder):
    domain.issue()
    root = domain.keystore.root.rename(tmp_path / folder)
    made = export(ROS2, Keystore.open(root), "/talker", Options(), now=domain.now)
    write(made, tmp_path / "out")
    assert read_in(tmp_path / "out" / "ros2.sh") == {
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
        "ROS_SECURITY_KEYSTORE": str(root),
    }
    assert made.variables(tmp_path / "out") == read_in(tmp_path / "out" / "ros2.sh")
    assert made.commands(tmp_path)[-1] == "ros2 run PACKAGE NODE --ros-args --enclave /talker"
    assert (list(made.files), made.warnings) == (["ros2.sh"], ())


def test_the_script_is_read_in_as_it_says_of_itself(domain, tmp_path):
    """A dot looks along PATH for a name without a slash, and in sh and zsh nowhere else."""
    domain.issue()
    write(domain.export(), tmp_path)
    (line,) = (t for t in (tmp_path / "ros2.sh").read_text().splitlines() if t[:5] == "#   .")
    command = f'{line.removeprefix("#   ")} && echo "$ROS_SECURITY_STRATEGY"'
    done = subprocess.run(["sh", "-c", command], cwd=tmp_path, stdout=subprocess.PIPE, check=True)
    assert done.stdout == b"Enforce\n"


@pytest.mark.parametrize("loopback", [True, False])
def test_the_commands_do_what_the_script_does(domain, tmp_path, loopback):
    domain.issue(domains="2")
    made = domain.export(loopback=loopback)
    write(made, tmp_path)
    *setting, _ = made.commands(tmp_path)
    (tmp_path / "commands").write_text("\n".join(setting))
    assert read_in(tmp_path / "commands") == read_in(tmp_path / "ros2.sh")


def test_the_script_keeps_to_one_machine_if_told(domain, tmp_path):
    domain.issue()
    write(domain.export(loopback=True), tmp_path / "out")
    assert read_in(tmp_path / "out" / "ros2.sh")["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


@pytest.mark.parametrize(("wanted", "given"), [(None, "2"), ("3", "3"), ("0", "2"), ("x", "2")])
def test_the_script_names_a_domain_where_0_will_not_do(domain, tmp_path, wanted, given):
    domain.issue(domains="2-3")
    shell = {} if wanted is None else {"ROS_DOMAIN_ID": wanted}
    made = domain.export(environment=shell)
    write(made, tmp_path / "out")
    assert read_in(tmp_path / "out" / "ros2.sh")["ROS_DOMAIN_ID"] == given
    assert made.warnings == ()


@pytest.mark.parametrize(
    ("profile", "shell", "noted"),
    [
        ("classical", {}, False),
        ("transition", {}, True),
        ("transition", {"RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}, True),
        ("transition", {"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}, False),
    ],
)
def test_what_some_versions_of_fast_dds_cannot_send_is_noted(tmp_path, now, profile, shell, noted):
    options = {"domains": DomainSet.parse("0"), "validity": 100 * DAY, "now": now}
    root = tmp_path / "k"
    keystore = Keystore.create(root, profile_named(profile), name="L", passphrase=None, **options)
    domain = Domain(keystore, now)
    domain.issue()
    notes = domain.export(environment=shell).notes
    assert any("Fast DDS 2.14.5" in note for note in notes) is noted


def test_a_folder_for_a_robot_has_all_that_ros_reads_and_no_more(domain, tmp_path):
    enclave = domain.issue()
    (enclave / "crl.pem").write_bytes(b"a list")
    made = domain.export(at=PurePosixPath("/opt/robot/enclaves/talker"), anyway=True)
    write(made, tmp_path / "out")
    copied = tmp_path / "out" / "enclaves" / "talker"
    assert {path.name for path in copied.iterdir()} == {*SIX, "crl.pem"}
    assert not [path for path in copied.iterdir() if path.is_symlink()]
    assert all(p.read_bytes() == (enclave / p.name).read_bytes() for p in copied.iterdir())
    assert (copied / "key.pem").stat().st_mode & 0o777 == 0o600
    assert read_in(tmp_path / "out" / "ros2.sh")["ROS_SECURITY_KEYSTORE"] == "/opt/robot"
    assert not (tmp_path / "out" / "private").exists()


@pytest.mark.parametrize("at", ["/opt/robot", "/talker", "/opt/enclaves/other", "enclaves/talker"])
def test_a_place_where_ros_finds_no_enclave_is_refused(domain, at):
    domain.issue()
    with pytest.raises(UsageError, match=r"enclaves/talker|absolute"):
        domain.export(at=PurePosixPath(at))


@pytest.mark.parametrize("name", ["/robot-1", "/robot.1", "/1st"])
def test_a_name_that_ros_does_not_take_is_refused(domain, name):
    domain.issue(name)
    with pytest.raises(UsageError, match="ROS 2 does not accept the enclave name"):
        domain.export(name)
    *_, last = preflight(domain.keystore, name, {}, now=domain.now)
    assert "ROS 2 does not accept the enclave name" in last.problem


@pytest.mark.parametrize("file", SIX)
def test_a_missing_file_is_named(domain, file):
    (domain.issue() / file).unlink()
    with pytest.raises(KeystoreError, match=f"lacks {file}"):
        domain.export()


def test_an_encrypted_key_is_refused(domain):
    path = domain.issue() / "key.pem"
    path.write_bytes(private_key_pem(load_private_key(path.read_bytes()), b"secret"))
    with pytest.raises(VerificationError, match="ROS 2 cannot open it"):
        domain.export()
    with pytest.raises(UsageError, match="no setting for a passphrase"):
        domain.export(password="secret")


def test_a_participant_that_no_node_can_run_with_is_refused(domain):
    domain.issue(needs=ros.topic_publisher("/chatter"))
    with pytest.raises(VerificationError, match="may not publish ros_discovery_info"):
        domain.export()


def without(topic):
    """What a node needs, less that topic."""
    kept = ([each for each in way if each != topic] for way in LIFE)
    return ros.Endpoints(*map(tuple, kept))


@pytest.mark.parametrize("topic", sorted({*LIFE.publish, *LIFE.subscribe} - {ros.DISCOVERY}))
def test_a_topic_without_which_a_node_ends_is_named(domain, topic):
    domain.issue(needs=without(topic))
    made = domain.export(anyway=True)  # of one of them `pqsec check` knows, and stops there
    way = "publish" if topic in LIFE.publish else "subscribe to"
    assert f"node /talker: it would exit at start: it may not {way} {topic}" in made.warnings


@pytest.mark.parametrize(
    "needs",
    [
        ros.node_minimum("/other/node"),
        ros.Endpoints(
            publish=(ros.DISCOVERY, "rt/*", "rr/other/node/*Reply"),
            subscribe=(ros.DISCOVERY, "rq/other/node/*Request"),
        ),
        ros.Endpoints(
            publish=(ros.DISCOVERY, "rt/*", "rr/_ros2cli_*"),
            subscribe=(ros.DISCOVERY, "rq/_ros2cli_*"),
        ),
        ros.Endpoints(publish=("*",), subscribe=("*",)),
    ],
    ids=["its topics", "patterns", "any that begins so", "all"],
)
def test_a_node_that_is_called_otherwise_than_its_enclave_can_live(domain, needs):
    domain.issue(needs=needs)
    assert not [text for text in domain.export().warnings if text.startswith("node ")]


def test_nodes_that_begin_so_are_told_what_they_lack(domain):
    publish = (ros.DISCOVERY, "rt/rosout", "rt/parameter_events", "rr/lab/cli_*")
    domain.issue(needs=ros.Endpoints(publish=publish, subscribe=(ros.DISCOVERY,)))
    problem = domain.preflight()["node /lab/cli_*"]
    assert problem.startswith("it would exit at start: it may not subscribe to rq/lab/cli_x/")


@pytest.mark.parametrize("pattern", ["rr/9*", "rr//*", "rr/lab/9*", "rr/lab//cli_*"])
def test_a_pattern_by_which_no_node_can_be_called_tells_of_no_node(domain, pattern):
    domain.issue(needs=ros.Endpoints(publish=(ros.DISCOVERY, pattern), subscribe=(ros.DISCOVERY,)))
    assert domain.preflight()["node /talker"].startswith("it would exit at start")


NEAR = {
    "ROS_SECURITY_ENABLE": ["1", "True", "TRUE", "true ", "yes"],
    "ROS_SECURITY_STRATEGY": ["enforce", "ENFORCE", "Enforced", "1"],
}
NEAR_MISSES = [(name, value) for name, values in NEAR.items() for value in values]


@pytest.mark.parametrize(("name", "value"), NEAR_MISSES)
def test_an_environment_that_is_nearly_right_is_warned_of(domain, name, value):
    domain.issue()
    (warning,) = domain.export(environment={name: value}).warnings
    assert f"in this shell {name} is {value!r}, not " in warning
    at = PurePosixPath("/opt/robot/enclaves/talker")
    assert domain.export(environment={name: value}, at=at).warnings == ()


@pytest.mark.parametrize(
    "shell",
    [
        {},
        {"ROS_SECURITY_ENABLE": "true", "ROS_SECURITY_STRATEGY": "Enforce"},
        {"ROS_SECURITY_ENABLE": "false", "ROS_SECURITY_STRATEGY": "Permissive"},
        {"ROS_SECURITY_ENABLE": "", "ROS_SECURITY_STRATEGY": ""},
    ],
)
def test_an_environment_that_means_what_it_says_is_not(domain, shell):
    domain.issue()
    assert domain.export(environment=shell).warnings == ()


@pytest.mark.parametrize(
    ("text", "words"), [("5", "ROS_DOMAIN_ID 5: no governance rule"), ("x", "is not a number")]
)
def test_a_domain_that_is_not_for_it_is_warned_of(domain, text, words):
    domain.issue()
    (warning,) = domain.export(environment={"ROS_DOMAIN_ID": text}).warnings
    assert words in warning


def test_preflight_finds_nothing_wrong_where_nothing_is(domain):
    domain.issue(more=["rt/chatter"])
    assert domain.preflight() == dict.fromkeys(
        [
            *("ROS_SECURITY_ENABLE", "ROS_SECURITY_STRATEGY", "ROS_SECURITY_KEYSTORE"),
            *("ROS_SECURITY_ENCLAVE_OVERRIDE", "files", "credentials"),
            *("ROS_DOMAIN_ID 0", "node /talker"),
        ],
        "",
    )


@pytest.mark.parametrize(
    ("what", "value", "words"),
    [
        ("ROS_SECURITY_ENABLE", None, "is not set: nodes run unsecured"),
        ("ROS_SECURITY_ENABLE", "1", "is '1', not true: nodes run unsecured"),
        ("ROS_SECURITY_STRATEGY", None, "is not set: a node without its files runs unsecured"),
        ("ROS_SECURITY_STRATEGY", "enforce", "is 'enforce', not Enforce"),
        ("ROS_SECURITY_KEYSTORE", None, "is not set: ROS 2 stops"),
        ("ROS_SECURITY_KEYSTORE", "", "is '': ROS 2 stops"),
        ("ROS_SECURITY_KEYSTORE", "k", "not absolute"),
        ("ROS_SECURITY_KEYSTORE", "/other", "this keystore is /"),
        ("ROS_SECURITY_ENCLAVE_OVERRIDE", "/other", "overrides --enclave"),
    ],
)
def test_preflight_sees_every_letter_of_the_environment(domain, what, value, words):
    domain.issue()
    found = domain.preflight(**{what: value})
    assert {name for name, problem in found.items() if problem} == {what}
    assert words in found[what]


def test_preflight_takes_another_path_to_the_same_keystore(domain, tmp_path):
    domain.issue()
    (tmp_path / "link").symlink_to(domain.keystore.root)
    for path in ("link", "k/", "k/../k"):
        found = domain.preflight(ROS_SECURITY_KEYSTORE=f"{tmp_path}/{path}")
        assert not any(found.values()), path


def test_preflight_takes_a_name_without_its_slash(domain):
    domain.issue()
    assert domain.preflight("talker") == domain.preflight("/talker")


@pytest.mark.parametrize(
    ("number", "what", "words"),
    [
        ("2", "ROS_DOMAIN_ID 2", "no allow_rule for domain 2"),
        ("7", "ROS_DOMAIN_ID 7", "no governance rule"),
        ("-1", "ROS_DOMAIN_ID", "is not a number"),
    ],
)
def test_preflight_asks_governance_and_permissions_about_the_domain(domain, number, what, words):
    domain.issue()
    assert words in domain.preflight(ROS_DOMAIN_ID=number)[what]


def test_preflight_tells_what_is_wrong_with_the_credentials(domain):
    enclave, other = domain.issue(), domain.issue("/other")
    (enclave / "key.pem").write_bytes((other / "key.pem").read_bytes())
    found = preflight(domain.keystore, "/talker", {}, now=domain.now)
    assert "PQS304" in " ".join(each.what for each in found if not each.ok)


@pytest.mark.parametrize("file", ["governance.p7s", "permissions.p7s"])
def test_preflight_survives_a_document_that_is_none(domain, file):
    enclave = domain.issue()
    (enclave / file).unlink()
    (enclave / file).write_bytes(b"no document\n")
    found = list(preflight(domain.keystore, "/talker", {}, now=domain.now))
    assert (found[-1].what, found[-1].ok) == ("files", False)
    assert file in found[-1].problem


def test_preflight_of_nobody_is_an_error(domain):
    with pytest.raises(PqsecError, match="no participant /nobody"):
        list(preflight(domain.keystore, "/nobody", {}, now=domain.now))
