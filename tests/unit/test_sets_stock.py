"""Keystores with several sets of credentials as stock stacks see them: the first set, no more."""

import json
import shutil
from collections import Counter
from pathlib import PurePosixPath

import pytest
from cryptography import x509

from pqsec_pki.algorithms import profile_named
from pqsec_pki.errors import KeystoreError, VerificationError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import add_set, revoke
from pqsec_pki.lint import check, largest_messages
from pqsec_pki.plugin import LIBRARY, NAMES
from pqsec_pki.selfcheck import STACKS as SIMULATED
from pqsec_pki.selfcheck import verify_handshake
from pqsec_pki.smime import signers_in
from pqsec_pki.stacks import FAST_DDS_LIMIT, Stack
from pqsec_pki.vendors import EXPORTERS, Options, export, preflight
from tests.unit.keystores import DAY, NOW, TWO, made

SETS = ("classical,hybrid", "classical,pq", "classical,hybrid,cnsa2")
STACKS = [each.stack for each in EXPORTERS]
ROS_NODE = {
    "ROS_SECURITY_ENABLE": "true",
    "ROS_SECURITY_STRATEGY": "Enforce",
}


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """models("classical,hybrid") is a keystore with these sets, not to be changed."""
    keystores = {}

    def model(profiles):
        if profiles not in keystores:
            keystores[profiles] = made(tmp_path_factory.mktemp("k") / "keystore", profiles)
        return keystores[profiles]

    return model


@pytest.fixture
def own(models, tmp_path):
    """own("classical,hybrid") is a copy, to be changed."""

    def copied(profiles):
        shutil.copytree(models(profiles).root, tmp_path / "k", symlinks=True)
        return Keystore.open(tmp_path / "k", to_change=True)

    return copied


def exported(stack, keystore, **options):
    return export(stack, keystore, "/talker", Options(**options), now=NOW)


def content(made, root):
    """All of an export, with files of the keystore as their content; `root` is its folder."""
    files = {
        name: source.replace(str(root), "K") if isinstance(source, str) else source.read_bytes()
        for name, source in made.files.items()
    }
    warnings = [each.replace(str(root), "K") for each in made.warnings]
    texts = {key: value.replace(str(root), "K") for key, value in made.environment.items()}
    steps = [each.replace(str(root), "K") for each in made.steps]
    return files, texts, steps, made.notes, warnings, made.is_private, made.unfit_folder


def all_exports(keystore):
    """What each stack gets, where the files are and for another machine."""
    place = PurePosixPath("/robot/enclaves/talker")
    return {
        (stack, at): content(exported(stack, keystore, at=at, anyway=True), keystore.root)
        for stack in STACKS
        for at in (None, place)
    }


# An export for a stock stack


@pytest.mark.parametrize("profiles", SETS)
@pytest.mark.parametrize("stack", STACKS)
def test_a_stock_stack_gets_the_export_of_a_classical_keystore(models, stack, profiles):
    several, alone = models(profiles), models("classical")
    found, wanted = (
        content(exported(stack, each, anyway=True), each.root) for each in (several, alone)
    )
    assert found == wanted
    assert "sets" not in str(found)


def test_the_files_that_are_copied_are_those_of_the_first_set(models):
    keystore = models("classical,hybrid")
    made = exported(Stack.ROS2, keystore, at=PurePosixPath("/robot/enclaves/talker"), anyway=True)
    copied = {name: path for name, path in made.files.items() if not isinstance(path, str)}
    assert {name.rpartition("/")[2] for name in copied} == {
        *("identity_ca.cert.pem", "cert.pem", "key.pem"),
        *("permissions_ca.cert.pem", "governance.p7s", "permissions.p7s"),
    }
    first = keystore.root / "enclaves/talker"
    assert {path.parent for path in copied.values()} == {first}


@pytest.mark.parametrize("profiles", SETS)
def test_the_first_set_has_the_files_fields_and_algorithms_of_a_classical_keystore(
    models, profiles
):
    several, alone = models(profiles), models("classical")
    assert shape(several.root) == shape(alone.root)


def shape(root):
    """The files of the first set, and of each the fields and algorithms."""
    found = {}
    for part in ("public", "private", "enclaves"):
        for path in sorted((root / part).rglob("*")):
            place = str(path.relative_to(root))
            if path.is_symlink():
                found[place] = str(path.readlink())
            elif path.suffix in {".pem", ".p7s", ".xml"}:
                found[place] = described(path)
    return found


def described(path):
    data = path.read_bytes()
    if path.suffix == ".xml":
        return data
    if path.suffix == ".p7s":
        content = signers_in(data)
        signers = [
            (each.issuer, each.identifier, each.digest, each.has_attributes, each.countersigners)
            for each in content.signers
        ]
        return signers, len(content.certificates)
    if b"PRIVATE KEY" in data:
        return len(data)
    certificate = x509.load_pem_x509_certificate(data)
    return (
        certificate.subject.rfc4514_string(),
        certificate.issuer.rfc4514_string(),
        certificate.signature_algorithm_oid.dotted_string,
        certificate.public_key().curve.name,
        [each.oid.dotted_string for each in certificate.extensions],
        certificate.not_valid_before_utc,
        certificate.not_valid_after_utc,
    )


@pytest.mark.parametrize("profile", ["hybrid", "pq"])
def test_adding_a_set_changes_no_octet_of_what_stock_stacks_read_nor_of_their_exports(own, profile):
    keystore = own("classical")
    revoke(keystore, keystore.unlock(None), ["/listener"], now=NOW)
    files, exports = octets(keystore.root), all_exports(keystore)
    options = {"validity": 900 * DAY, "passphrase": None, "now": NOW + DAY}
    add_set(keystore, keystore.unlock(None), profile_named(profile), **options)
    keystore = Keystore.open(keystore.root)
    assert len(keystore.sets) == 2
    assert octets(keystore.root) == files
    assert all_exports(keystore) == exports


def octets(root):
    """Each file and link of the first set but the ledger and its heads, with its time."""
    return {
        str(path.relative_to(root)): (
            path.readlink() if path.is_symlink() else path.read_bytes(),
            path.lstat().st_mtime_ns,
            path.lstat().st_ino,
        )
        for part in ("public", "private", "enclaves")
        for path in sorted((root / part).rglob("*"))
        if (path.is_file() or path.is_symlink())
        and not path.name.startswith("ledger.")
        and path.name != "seen.json"
    }


@pytest.mark.parametrize("version", [".".join(map(str, each)) for each in FAST_DDS_LIMIT.versions])
@pytest.mark.parametrize("profiles", SETS)
def test_a_version_that_cannot_send_large_messages_is_given_the_small_ones(
    models, profiles, version
):
    assert exported(Stack.FASTDDS, models(profiles), version=version).warnings == ()


@pytest.mark.parametrize("stack", STACKS)
@pytest.mark.parametrize("profiles", ["pq,classical", "hybrid,pq"])
def test_a_first_set_that_no_stock_stack_reads_is_told(models, stack, profiles):
    first = profiles.split(",")[0]
    with pytest.raises(VerificationError, match=f"only the first set .* profile {first}") as told:
        exported(stack, models(profiles))
    order = "classical,pq" if "classical" in profiles else "classical,hybrid,pq"
    assert f"ca init --profile {order}`" in told.value.hint
    forced = exported(stack, models(profiles), anyway=True)
    assert "stock stacks see only the first set" in str(forced.warnings)


def test_one_set_that_no_stock_stack_reads_is_not_told_to_be_the_first(models):
    with pytest.raises(VerificationError) as told:
        exported(Stack.CYCLONEDDS, models("pq"))
    assert "first set" not in str(told.value)


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize("file", ["cert.pem", "permissions.p7s"])
def test_an_export_tells_that_a_participant_lacks_a_set(own, number, file):
    keystore = own("classical,hybrid")
    path = keystore.sets[number].folder / "enclaves/talker" / file
    path.unlink()
    if number:
        [warning] = exported(Stack.CYCLONEDDS, keystore).warnings
        assert f"{path} is missing" in warning
    else:
        with pytest.raises(KeystoreError):
            exported(Stack.CYCLONEDDS, keystore)


@pytest.mark.parametrize("number", [0, 1])
def test_an_export_tells_that_a_set_lacks_the_revocation_list(own, number):
    keystore = own("classical,hybrid")
    revoke(keystore, keystore.unlock(None), ["/listener"], now=NOW)
    path = keystore.sets[number].revocation_list_path
    path.unlink()
    if number:
        [warning] = exported(Stack.CYCLONEDDS, keystore).warnings
        assert f"{path} is missing" in warning
    else:
        with pytest.raises((KeystoreError, VerificationError)):
            exported(Stack.CYCLONEDDS, keystore)


def test_an_export_tells_that_a_whole_set_is_gone(own):
    keystore = own("classical,hybrid")
    shutil.rmtree(keystore.root / "sets")
    with pytest.raises(
        KeystoreError, match=r"sets/hybrid/public/permissions_ca\.cert\.pem: no such"
    ):
        exported(Stack.CYCLONEDDS, keystore)
    warnings = str(exported(Stack.CYCLONEDDS, keystore, anyway=True).warnings)
    assert "sets/hybrid/public/identity_ca.cert.pem is missing" in warnings
    assert "and 4 more" in warnings


@pytest.mark.parametrize("profiles", ["classical", "classical,hybrid"])
def test_a_keystore_that_lacks_a_signer_of_the_head_is_not_one_whose_ledger_may_not_be_read(
    own, profiles
):
    keystore = own(profiles)
    (keystore.sets[-1].folder / "public/permissions_ca.cert.pem").unlink()
    with pytest.raises(KeystoreError, match="cannot be compared with its signed head"):
        keystore.open_ledger()


def test_an_export_tells_nothing_of_what_another_participant_lacks(own):
    keystore = own("classical,hybrid")
    shutil.rmtree(keystore.root / "sets/hybrid/enclaves/listener")
    assert exported(Stack.CYCLONEDDS, keystore).warnings == ()


def test_nothing_is_exported_of_a_keystore_whose_settings_lack_a_set(own):
    keystore = own("classical,hybrid")
    path = keystore.root / "pqsec.json"
    text = path.read_text()
    path.write_text(made_alone(text))
    with pytest.raises(KeystoreError, match="hybrid"):
        exported(Stack.CYCLONEDDS, Keystore.open(keystore.root))


def made_alone(text):
    """The settings without further sets, as somebody who may write them makes them."""
    found = json.loads(text)
    return json.dumps(found | {"algorithms": found["algorithms"][:1]})


# ROS 2


def ros_node(keystore):
    return {**ROS_NODE, "ROS_SECURITY_KEYSTORE": str(keystore.root)}


def problems(keystore):
    checks = preflight(keystore, "/talker", ros_node(keystore), now=NOW)
    return {each.what: each.problem for each in checks if each.problem}


def test_a_ros_2_node_is_checked_with_the_first_set(models):
    assert problems(models("classical,hybrid")) == problems(models("classical"))


def test_a_ros_2_node_cannot_run_with_a_first_set_for_pqsec_peers(models):
    found = problems(models("pq,classical"))
    assert "stock stacks see only the first set" in found["files"]


def test_a_ros_2_node_with_the_plugin_is_not_taken_to_run_with_the_first_set(models, tmp_path):
    (tmp_path / LIBRARY).write_bytes(b"")
    (tmp_path / NAMES[0]).symlink_to(LIBRARY)
    keystore = models("classical,hybrid")
    variables = {**ros_node(keystore), "LD_LIBRARY_PATH": str(tmp_path)}
    checks = {each.what: each for each in preflight(keystore, "/talker", variables, now=NOW)}
    assert "further sets of credentials (hybrid)" in checks["files"].problem


# What `pqsec check` says


def found(keystore, *targets):
    """Rule, and the set of the file."""
    report = check([keystore.root], now=NOW, targets=targets)
    return Counter(
        (each.rule.id, each.path.is_relative_to(keystore.root / "sets")) for each in report.findings
    )


@pytest.mark.parametrize("profiles", SETS)
@pytest.mark.parametrize("stack", Stack)
def test_a_check_for_a_stock_stack_finds_in_the_first_set_what_it_finds_in_a_classical_keystore(
    models, stack, profiles
):
    wanted = found(models("classical"), stack)
    several = found(models(profiles), stack)
    of_first = Counter({each: number for each, number in several.items() if not each[1]})
    assert of_first == wanted
    unencrypted = {("PQS707", True), ("PQS345", True)}  # these matter to no stack alone
    assert set(several - of_first) <= unencrypted


def test_a_check_for_a_stock_stack_finds_a_first_set_for_pqsec_peers(models):
    assert ("PQS601", False) in found(models("pq,classical"), Stack.CYCLONEDDS)


def test_a_further_set_by_itself_is_not_for_stock_stacks(models):
    folder = models("classical,hybrid").sets[1].folder / "enclaves/talker"
    report = check([folder], now=NOW, targets=[Stack.CYCLONEDDS])
    assert "PQS601" in {each.rule.id for each in report.findings}


@pytest.mark.parametrize("profiles", ["pq,classical", "classical,pq", "cnsa2,pq,classical"])
def test_a_key_is_as_strong_as_the_profile_of_its_own_set_requires(models, profiles):
    assert "PQS609" not in {rule for rule, _ in found(models(profiles))}


def test_a_weak_key_in_a_further_set_is_found(own):
    keystore = own("classical,pq")
    place = "enclaves/talker/cert.pem"
    shutil.copyfile(keystore.root / place, keystore.sets[1].folder / place)
    assert ("PQS609", True) in found(keystore)


# Sizes


def stock_bytes(keystore, stack):
    """Bytes of each message of a handshake between two of that stack."""
    stacks = (stack, stack)
    report = verify_handshake(keystore, *TWO, domain=0, now=NOW, stacks=stacks)
    assert report.ok
    return [len(each.data) for each in report.sent]


@pytest.mark.parametrize("profiles", SETS)
@pytest.mark.parametrize("stack", [each for each in SIMULATED if each.is_stock], ids=str)
def test_stock_handshakes_have_the_bytes_of_classical_ones(models, profiles, stack):
    several, alone = (stock_bytes(models(each), stack) for each in (profiles, "classical"))
    for one, other in zip(several, alone, strict=True):
        assert one <= 1.02 * other
    assert sum(several) <= 1.02 * sum(alone)


def test_the_largest_message_of_each_set_is_between_peers_of_its_profile(models):
    keystore = models("classical,hybrid")
    report = check([keystore.root], now=NOW)
    sizes = {each.enclave.folder: each.message for each in largest_messages(report.inventory)}
    for profile, view in zip(("classical", "hybrid"), keystore.sets, strict=True):
        alone = models(profile)
        [wanted] = {
            each.message
            for each in largest_messages(check([alone.root], now=NOW).inventory)
            if each.enclave.name == "/talker"
        }
        assert abs(sizes[view.folder / "enclaves/talker"] - wanted) < 32


@pytest.mark.parametrize(("number", "told"), [(9, None), (12, "messages of 12 participants")])
def test_a_participant_with_two_sets_takes_the_memory_of_one_message(tmp_path, number, told):
    names = [f"/robot{each}" for each in range(number)]
    keystore = made(tmp_path / "many", "classical,hybrid", names=tuple(names))
    for each in keystore.sets:
        for path in (each.folder / "enclaves").glob("*/permissions.p7s"):
            path.write_bytes(path.read_bytes() + bytes(250_000))  # only its size counts here
    findings = check([keystore.root], now=NOW).findings
    messages = [each.message for each in findings if each.rule.id == "PQS505"]
    assert len(messages) == (told is not None)
    assert not told or told in messages[0]
