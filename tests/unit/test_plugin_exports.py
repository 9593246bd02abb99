"""Exports with pqsec's own plugin: what they name, what they take, and what they refuse."""

import re
import shlex
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path, PurePosixPath

import pytest
from lxml import etree

from pqsec_pki.algorithms import PROFILES, load_private_key, private_key_pem, profile_named
from pqsec_pki.documents import DomainSet, ros
from pqsec_pki.errors import FileError, UsageError, VerificationError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.lint import RULES, Finding, Violation
from pqsec_pki.plugin import LIBRARY, NAMES
from pqsec_pki.plugin.building import CompileError
from pqsec_pki.selfcheck import HandshakeParty, HandshakeSetup, run_handshake
from pqsec_pki.stacks import FRAME, FRAME_MEMORY, IPFRAG_HIGH_THRESH, stack_named
from pqsec_pki.vendors import FASTRTPS, Options, export, exporter_of
from pqsec_pki.vendors.ros2 import preflight
from tests.unit.keystores import DAY, NOW

NAME = "/talker"
PROFILE_NAMES = [each.name for each in PROFILES]
NOT_STOCK = [each.name for each in PROFILES if not each.runs_in_stock]
BOTH = ("cyclonedds", "ros2")
CYCLONE = "{https://cdds.io/config}"
ALTERNATIVE = {"alt.key.pem", "permissions_ca.alt.cert.pem"}


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    """model("pq") is a keystore of that profile, whose /talker is a node of ROS 2."""
    found = {}

    def keystore(profile):
        if profile not in found:
            root, zero = tmp_path_factory.mktemp(profile) / "k", DomainSet.parse("0")
            options = {"domains": zero, "validity": 9 * DAY, "now": NOW, "passphrase": None}
            made = Keystore.create(root, profile_named(profile), name="Lab", **options)
            life = ros.node_minimum(NAME)
            may = {"publish": (*life.publish, "x"), "subscribe": life.subscribe}
            spec = ParticipantSpec(name=NAME, domains=zero, validity=DAY, **may)
            issue(made, made.unlock(None), [spec], now=NOW)
            found[profile] = made
        return found[profile]

    return keystore


@pytest.fixture
def own(model, tmp_path):
    """own("pq") is a copy, and /talker's folder in it."""

    def copy(profile):
        shutil.copytree(model(profile).root, tmp_path / "k", symlinks=True)
        return Keystore.open(tmp_path / "k"), tmp_path / f"k/enclaves{NAME}"

    return copy


@pytest.fixture
def folder(tmp_path) -> Path:
    """Where the plugin is; nothing here loads it."""
    return put_plugin(tmp_path / "the plugin's")


def put_plugin(place):
    place.mkdir(parents=True)
    (place / LIBRARY).touch()
    for name in NAMES:
        (place / name).symlink_to(LIBRARY)
    return place


def exported(stack, keystore, plugin, **options):
    return export(stack_named(stack), keystore, NAME, Options(plugin=plugin, **options), now=NOW)


def libraries(made):
    root = etree.fromstring(made.files["cyclonedds.xml"].encode())
    found = [each.get("path") for each in root.iter(f"{CYCLONE}Library")]
    return dict(zip(["authentication", "cryptography", "access control"], found, strict=True))


@pytest.mark.parametrize("profile", PROFILE_NAMES)
def test_cyclone_loads_ours_for_all_but_encryption(model, folder, profile):
    found = libraries(exported("cyclonedds", model(profile), folder))
    ours = str(folder / LIBRARY)
    assert found["authentication"] == found["access control"] == ours
    assert "dds_security_crypto" in found["cryptography"]


def test_cyclones_own_encryption_can_be_named_beside_it_and_must_fit(
    model, folder, library, tmp_path
):
    """Or else a process of 11 would load the one of Debian's 0.10.2, and crash."""
    cyclone = library.cyclone(tmp_path / "11", "11.0.1", "libddsc.so.11")
    crypto, keystore = cyclone / "libdds_security_crypto.so", model("pq")
    for version in (None, "11.0.1"):
        made = exported("cyclonedds", keystore, folder, crypto=crypto, version=version)
        found = libraries(made)
        assert found["cryptography"] == str(crypto)
        assert found["authentication"] == str(folder / LIBRARY)
        assert "not located" not in str(made.notes)
    with pytest.raises(VerificationError, match=r"libddsc\.so\.11\.0\.1.* can crash") as refusal:
        exported("cyclonedds", keystore, folder, crypto=crypto, version="0.10.2")
    assert "--crypto" in refusal.value.hint
    with pytest.raises(UsageError, match="does not name security plugins"):
        exported("ros2", keystore, folder, crypto=crypto)


def test_encryption_of_another_cyclone_is_never_found_for_a_version(model, folder):
    """Whatever this machine has, it is not 9999.0."""
    made = exported("cyclonedds", model("pq"), folder, version="9999.0")
    assert libraries(made)["cryptography"] == "dds_security_crypto"
    assert "not located" in str(made.notes)


@pytest.mark.parametrize("profile", PROFILE_NAMES)
@pytest.mark.parametrize("stack", BOTH)
def test_what_the_plugin_takes_is_written_without_a_warning(model, folder, stack, profile):
    made = exported(stack, model(profile), folder)
    assert made.warnings == ()
    assert "PQSEC_AGENT=private" in str(made.notes)


@pytest.mark.parametrize("profile", NOT_STOCK)
@pytest.mark.parametrize("stack", BOTH)
def test_without_it_the_hint_names_it(model, stack, profile):
    with pytest.raises(VerificationError, match="for pqsec peers only") as refusal:
        exported(stack, model(profile), None)
    assert "--plugin" in refusal.value.hint


def test_other_stacks_cannot_load_it(model, folder):
    with pytest.raises(UsageError, match=r"Connext.* cannot load") as refusal:
        exported("connext", model("pq"), folder)
    assert "cyclonedds, fastdds, opendds, ros2" in refusal.value.hint


@pytest.mark.parametrize(
    ("stack", "name"), [("cyclonedds", LIBRARY), *(("ros2", n) for n in NAMES)]
)
def test_a_plugin_that_is_not_installed_is_named_with_its_command(model, folder, stack, name):
    (folder / name).unlink()
    with pytest.raises(FileError, match=name) as refusal:
        exported(stack, model("pq"), folder)
    assert "pqsec plugin install" in refusal.value.hint


@pytest.mark.parametrize("stack", BOTH)
def test_on_another_machine_it_is_taken_for_granted(model, stack):
    at = PurePosixPath("/robot/enclaves/talker")
    made = exported(stack, model("pq"), Path("/opt/pqsec"), at=at)
    assert "/opt/pqsec" in str(made.files[made.main])
    with pytest.raises(UsageError, match="not an absolute path"):
        exported(stack, model("pq"), Path("opt/pqsec"), at=at)


FLAWS = {
    "stock peers": ("pq", "pqsec.toml", 'peers = "stock"', "accepts no ml-dsa-65 key"),
    "settings": ("pq", "pqsec.toml", "peers: stock", "not TOML"),
    "alternative key": ("transition", "alt.key.pem", "", "alt.key.pem"),
    "revocation list": ("pq", "crl.pem", "nonsense", "crl.pem"),
}


@pytest.mark.parametrize("stack", BOTH)
@pytest.mark.parametrize("flaw", FLAWS)
def test_what_the_plugin_refuses_is_refused(own, folder, stack, flaw):
    profile, file, text, words = FLAWS[flaw]
    keystore, enclave = own(profile)
    (enclave / file).unlink(missing_ok=True)
    if text:
        (enclave / file).write_text(text)
    with pytest.raises(VerificationError, match=words):
        exported(stack, keystore, folder)
    assert words in str(exported(stack, keystore, folder, anyway=True).warnings)


@pytest.mark.parametrize("stack", BOTH)
def test_documents_that_were_altered_are_refused(own, folder, stack):
    keystore, enclave = own("pq")
    path = enclave / "permissions.p7s"
    path.write_bytes(path.read_bytes().replace(b"<topic>x<", b"<topic>*<"))
    with pytest.raises(VerificationError, match="changed"):
        exported(stack, keystore, folder)


@pytest.mark.parametrize("password", [None, "open sesame", "wrong"])
def test_an_encrypted_key_is_asked_about_where_the_passphrase_is_known(own, folder, password):
    keystore, enclave = own("pq")
    key = load_private_key((enclave / "key.pem").read_bytes())
    (enclave / "key.pem").write_bytes(private_key_pem(key, b"open sesame"))
    if password == "wrong":
        with pytest.raises(VerificationError, match="plugin refuses /talker"):
            exported("cyclonedds", keystore, folder, password=password)
    else:
        assert exported("cyclonedds", keystore, folder, password=password).warnings == ()


def test_what_other_plugins_make_of_it_does_not_matter(model, folder):
    about_stacks = {rule for rule in RULES.values() if rule.stacks}
    assert {rule.id for rule in about_stacks} >= {"PQS601", "PQS602", "PQS267"}
    stack, ours = exporter_of(stack_named("ros2")), Options(plugin=folder)
    for rule in RULES.values():
        own_of_ros = {each.value for each in rule.stacks} <= {"ros2"}
        judged = stack.severity(_finding(rule), ours)
        assert judged == (rule.severity if own_of_ros else None)
        assert stack.severity(_finding(rule), Options()) == rule.severity


def _finding(rule):
    return Finding.of(rule, Violation("x"), Path("x"))


# ROS 2


def environment(made, **before):
    """The variables of a shell that read the script in twice."""
    script = made.files["ros2.sh"]
    done = subprocess.run(
        ["sh", "-euc", f"{script}\n{script}\nenv -0"],
        env={"PATH": "/usr/bin:/bin", **before},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return dict(line.split("=", 1) for line in done.stdout.split("\0") if line)


def test_ros_2_finds_ours_first_and_keeps_what_was_there(model, folder):
    made = exported("ros2", model("pq"), folder)
    found = environment(made, LD_LIBRARY_PATH="/a:/b c", CYCLONEDDS_URI="file:///x.xml")
    assert found["LD_LIBRARY_PATH"].split(":") == [str(folder), str(folder), "/a", "/b c"]
    assert found["CYCLONEDDS_URI"].startswith("file:///x.xml,<CycloneDDS>")
    assert "<FragmentSize>1300B" in found["CYCLONEDDS_URI"]
    assert found["RMW_IMPLEMENTATION"] == "rmw_cyclonedds_cpp"
    without = environment(made)
    assert without["LD_LIBRARY_PATH"] == f"{folder}:{folder}"
    assert without["CYCLONEDDS_URI"].startswith("<CycloneDDS>")


def test_the_commands_of_ros_2_say_the_same_as_the_script(model, folder, tmp_path):
    made = exported("ros2", model("pq"), folder)
    commands = made.commands(tmp_path)
    script = made.files["ros2.sh"].splitlines()
    exports = [line for line in script if line.startswith("export ")]
    assert exports == [line for line in commands if line.startswith("export ")]
    assert shlex.quote(str(folder)) in exports[-2]


def test_without_the_plugin_ros_2_is_told_of_none(model):
    text = exported("ros2", model("transition"), None).files["ros2.sh"]
    assert not any(word in text for word in ("LD_LIBRARY_PATH", "RMW_IMPLEMENTATION", "CYCLONE"))


def test_small_handshakes_need_no_fragments(model, folder):
    assert "CYCLONEDDS_URI" not in exported("ros2", model("classical"), folder).files["ros2.sh"]


@pytest.mark.parametrize(
    ("stack", "rmw", "setting"),
    [
        ("cyclonedds", None, None),
        ("ros2", "cyclonedds", None),
        ("ros2", FASTRTPS, "fastdds.max_message_size"),
        ("fastdds", None, "fastdds.max_message_size"),
        ("opendds", None, "SedpMaxMessageSize"),
    ],
)
def test_the_datagrams_of_large_handshakes_are_told(model, stack, rmw, setting):
    """Never less than what is sent, and the memory for as many peers as it says."""
    at = PurePosixPath("/robot/enclaves/talker")
    made = exported(stack, model("pq"), Path("/opt/pqsec"), rmw=rmw, at=at, anyway=True)
    found = " ".join(made.notes)
    size = int(re.search(r"up to (\d+) bytes", found)[1])
    frames = -(-size // FRAME)
    assert 0 <= size - largest_sent(model("pq")) < 16
    assert ("the export limits datagrams to 1400 bytes" in found) == (setting is None)
    assert (f"in one datagram {frames} IP fragments" in found) == (setting is not None)
    if setting:
        assert setting in found
        assert f": of {IPFRAG_HIGH_THRESH // (frames * FRAME_MEMORY)} peers" in found


def largest_sent(keystore):
    """Bytes of the largest message of a handshake with NAME."""
    other = ParticipantSpec(name="/other", domains=DomainSet.parse("0"), validity=DAY)
    if other.name not in keystore.names():
        issue(keystore, keystore.unlock(None), [replace(other, publish=("x",))], now=NOW)
    party = (HandshakeParty(name=each) for each in (NAME, other.name))
    report = run_handshake(HandshakeSetup(keystore=keystore, domain=0, now=NOW), *party)
    assert report.ok
    return max(len(each.data) for each in report.sent if each.sender == NAME)


def test_stock_stacks_are_told_of_their_own_messages(model):
    """Those of certificates with two keys; the larger ones of pqsec's suites are not sent."""
    stock, ours = (
        " ".join(exported("fastdds", model("transition"), plugin, anyway=True, **how).notes)
        for plugin, how in ((None, {}), (Path("/p"), {"at": PurePosixPath("/r/enclaves/talker")}))
    )
    sizes = [int(re.search(r"up to (\d+) bytes", each)[1]) for each in (stock, ours)]
    assert sizes[0] < sizes[1]


@pytest.mark.parametrize("stack", ["cyclonedds", "fastdds", "connext"])
def test_the_datagrams_of_small_handshakes_are_not_told(model, stack):
    assert "datagram" not in " ".join(exported(stack, model("classical"), None).notes)


@pytest.mark.parametrize("name", ["a:b", "a;b", "$ORIGIN"])
def test_a_folder_that_the_loader_would_misread_is_refused(model, tmp_path, name):
    with pytest.raises(UsageError, match="the loader finds nothing"):
        exported("ros2", model("pq"), put_plugin(tmp_path / name))


@pytest.mark.parametrize(("profile", "more"), [("pq", set()), ("transition", ALTERNATIVE)])
def test_a_robot_gets_what_the_plugin_reads_too(model, profile, more):
    at = PurePosixPath("/robot/enclaves/talker")
    plain = exported("ros2", model(profile), None, at=at, anyway=True)
    made = exported("ros2", model(profile), Path("/opt/pqsec"), at=at)
    assert {Path(name).name for name in made.files.keys() - plain.files.keys()} == more


def checks(keystore, **variables):
    found = preflight(keystore, NAME, variables, now=NOW)
    return {each.what: each for each in found}


def test_the_preflight_takes_what_the_plugin_takes_if_it_will_be_loaded(model, folder):
    keystore = model("pq")
    good = environment(exported("ros2", keystore, folder))
    assert all(each.ok for each in checks(keystore, **good).values())
    without = checks(keystore, **{**good, "LD_LIBRARY_PATH": "/usr/lib"})
    assert not without["cert.pem (PQS601)"].ok
    assert "RMW_IMPLEMENTATION" not in without


@pytest.mark.parametrize("value", [None, "rmw_fastrtps_cpp", "rmw_cyclonedds_cpp "])
def test_the_preflight_sees_that_nobody_loads_the_plugin(model, folder, value):
    keystore = model("pq")
    variables = environment(exported("ros2", keystore, folder)) | {"RMW_IMPLEMENTATION": value}
    found = checks(keystore, **{k: v for k, v in variables.items() if v is not None})
    assert "only rmw_cyclonedds_cpp loads" in found["RMW_IMPLEMENTATION"].problem
    assert f"--plugins {shlex.quote(str(folder))}" in found["RMW_IMPLEMENTATION"].fix


def test_the_preflight_sees_whose_plugin_comes_first(model, folder, tmp_path):
    keystore = model("pq")
    good = environment(exported("ros2", keystore, folder))
    other = tmp_path / "other"
    other.mkdir()
    (other / NAMES[0]).write_text("Cyclone DDS's own")
    found = checks(keystore, **{**good, "LD_LIBRARY_PATH": f"{other}:{folder}"})
    assert not found["cert.pem (PQS601)"].ok


def test_the_preflight_asks_the_plugin(own, folder):
    keystore, enclave = own("pq")
    good = environment(exported("ros2", keystore, folder))
    (enclave / "pqsec.toml").write_text('peers = "stock"')
    assert "accepts no ml-dsa-65 key" in checks(keystore, **good)["credentials"].problem


def test_of_what_a_compiler_says_errors_are_told_or_else_the_first_lines():
    said = "In file shim.c:\n\nshim.c:1: error:  no\n   note: here\nld: cannot find -lx\n"
    assert CompileError.of(said).output == "shim.c:1: error: no; ld: cannot find -lx"
    assert CompileError.of("\n  odd\n\nwords").output == "odd; words"
