"""Exports: what stacks are configured with, read back; what is refused, and why."""

import shutil
import stat
from importlib import import_module
from pathlib import Path, PurePosixPath

import pytest
from lxml import etree

from pqsec_pki.algorithms import load_private_key, private_key_pem
from pqsec_pki.errors import ExistsError, FileError, KeystoreError, UsageError, VerificationError
from pqsec_pki.keystore import Keystore
from pqsec_pki.problems import Code
from pqsec_pki.stacks import FAST_DDS_LIMIT, Stack, stack_named
from pqsec_pki.vendors import Export, Options, StackEnclave, export, exporter_of, write
from pqsec_pki.vendors.cyclone_plugins import NAMES, find_cyclone_plugins
from pqsec_pki.vendors.exports import FOLDER
from tests.unit.keystores import NOW, made

FAST, CYCLONE = "{http://www.eprosima.com}", "{https://cdds.io/config}"
XML = ("cyclonedds", "fastdds", "connext")
NEW = {"fastdds": "3.6.2"}
"""Versions for which nothing has to be said."""
ODD_NAMES = ["with space", "a & b", "<tag>", "it's", "año-日本", "100%41", "$HOME", "{x}"]
SECRETS = ["open sesame", "<a> & 'b' \"c\"", "pässwört"]
CREDENTIALS = {
    *("identity_ca.cert.pem", "cert.pem", "key.pem"),
    *("permissions_ca.cert.pem", "governance.p7s", "permissions.p7s"),
}


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    """models("transition") is a keystore of that profile, not to be changed."""
    keystores = {}

    def model(profile):
        if profile not in keystores:
            folder = tmp_path_factory.mktemp(profile) / "keystore"
            keystores[profile] = made(folder, profile)
        return keystores[profile]

    return model


@pytest.fixture
def own(models, tmp_path):
    """own("a & b") is a keystore in a folder of that name, to be changed."""

    def copied(name="keystore", profile="classical"):
        root = tmp_path / name
        shutil.copytree(models(profile).root, root, symlinks=True)
        return Keystore.open(root)

    return copied


def encrypted(keystore, passphrase=SECRETS[0]):
    """The keystore, in which /talker's key is encrypted."""
    path = keystore.root / "enclaves/talker/key.pem"
    path.write_bytes(private_key_pem(load_private_key(path.read_bytes()), passphrase.encode()))
    return keystore


def unchecked(stack, keystore, **options):
    """The export of /talker, without the check that comes before."""
    wanted = Options(**options)
    enclave = StackEnclave.find(keystore, "/talker", wanted.at)
    return exporter_of(stack_named(stack)).make(enclave, wanted)


def checked(stack, keystore, **options):
    return export(stack_named(stack), keystore, "/talker", Options(**options), now=NOW)


def root_of(made):
    return etree.fromstring(made.files[made.main].encode())


def texts(made):
    """All texts of the elements of its XML."""
    root = root_of(made)
    return [element.text for element in root.iter() if element.text and element.text.strip()]


def files_named(found):
    return {Path(text.removeprefix("file://")) for text in found if text.startswith("file:///")}


def properties(made):
    """Name -> value, of Fast DDS's XML or of Connext's."""
    root = root_of(made)
    pairs = [[child.text for child in element] for element in root.iter() if len(element) == 2]
    return {name: value for name, value in pairs if name and "." in name}


@pytest.mark.parametrize("name", ODD_NAMES)
@pytest.mark.parametrize("stack", XML)
def test_the_files_it_names_are_the_participants(own, stack, name):
    keystore = own(name)
    named = files_named(texts(unchecked(stack, keystore, version=NEW.get(stack))))
    assert {path.name for path in named} == CREDENTIALS
    assert {path.parent for path in named} == {keystore.root / "enclaves/talker"}
    assert all(path.is_file() for path in named)


@pytest.mark.parametrize("stack", XML)
@pytest.mark.parametrize("flaw", ["a\nb", "a\tb", "a\x7fb", "a\udcffb"])
def test_a_path_that_no_configuration_can_carry_is_refused(own, stack, flaw):
    keystore = own(flaw)
    with pytest.raises(UsageError, match="and a configuration cannot"):
        unchecked(stack, keystore)


def test_a_path_that_is_no_text_stands_in_the_header_byte_for_byte(own):
    made = unchecked("opendds", own("a\udcffb"))
    assert "a\\377b/enclaves/talker/key.pem" in made.files["pqsec_participant.h"]


@pytest.mark.parametrize("stack", XML)
def test_a_relative_keystore_is_named_absolutely(models, stack, monkeypatch):
    root = models("classical").root
    monkeypatch.chdir(root.parent)
    made = unchecked(stack, Keystore.open(Path(root.name)))
    assert {path.parent for path in files_named(texts(made))} == {root / "enclaves/talker"}


@pytest.mark.parametrize("stack", XML)
def test_the_files_can_be_said_to_be_elsewhere(models, stack):
    made = unchecked(stack, models("classical"), at=PurePosixPath("/etc/robot"))
    assert files_named(texts(made)) == {Path("/etc/robot") / name for name in CREDENTIALS}


@pytest.mark.parametrize("stack", ["cyclonedds", "ros2"])
@pytest.mark.parametrize("at", ['/a"\x1b[2J\nb', "\x1b[2J\nb"])
def test_a_place_that_is_refused_sends_nothing_to_the_terminal(models, stack, at):
    with pytest.raises(UsageError, match="u001b") as refusal:
        unchecked(stack, models("classical"), at=PurePosixPath(at))
    assert str(refusal.value).isprintable()


def test_where_they_are_must_be_absolute(models):
    with pytest.raises(UsageError, match="not an absolute path"):
        checked("cyclonedds", models("classical"), at=PurePosixPath("etc/robot"))


@pytest.mark.parametrize("stack", ["cyclonedds", "fastdds"])
def test_a_revocation_list_is_named_where_there_is_one(own, stack):
    keystore = own()
    assert "crl.pem" not in str(texts(unchecked(stack, keystore)))
    (keystore.root / "enclaves/talker/crl.pem").touch()
    named = files_named(texts(unchecked(stack, keystore)))
    assert keystore.root / "enclaves/talker/crl.pem" in named


@pytest.mark.parametrize("stack", ["opendds", "connext"])
def test_who_cannot_be_told_of_a_revocation_list_is_warned_of(own, stack):
    keystore = own()
    assert "revoked" not in str(unchecked(stack, keystore).warnings)
    (keystore.root / "enclaves/talker/crl.pem").touch()
    assert "accepts revoked participants" in str(unchecked(stack, keystore).warnings)


# Cyclone DDS


def element(made, path):
    root = root_of(made)
    return root.find("/".join(f"{CYCLONE}{part}" for part in path.split("/")))


def test_cyclones_datagrams_fit_a_frame_where_certificates_are_large(models):
    small, large = (unchecked("cyclonedds", models(name)) for name in ("classical", "transition"))
    assert element(small, "Domain/General") is None
    assert element(large, "Domain/General/MaxMessageSize").text == "1400B"
    assert element(large, "Domain/General/FragmentSize").text == "1300B"


def test_cyclone_on_loopback_leaves_the_machine_by_no_interface(models):
    made = unchecked("cyclonedds", models("classical"), loopback=True)
    interfaces = element(made, "Domain/General/Interfaces")
    assert [each.attrib for each in interfaces] == [{"address": "127.0.0.1"}]
    assert element(made, "Domain/General/AllowMulticast").text == "false"


def cyclones_plugins(made):
    """Kind -> path, as written."""
    found = [each.get("path") for each in root_of(made).iter(f"{CYCLONE}Library")]
    return dict(zip(["auth", "crypto", "ac"], found, strict=True))


def test_cyclones_plugins_are_named_by_path_where_there_is_one(models, library, tmp_path):
    folder = library.cyclone(tmp_path / "a & b", "0.10.2", "libddsc.so.0debian")
    made = unchecked("cyclonedds", models("classical"), plugins=folder)
    element_of = element(made, "Domain/Security/Authentication/Library")
    assert element_of.get("initFunction") == "init_authentication"
    assert element_of.get("path") == str(folder / "libdds_security_auth.so")
    elsewhere = unchecked("cyclonedds", models("classical"), at=PurePosixPath("/robot"))
    assert cyclones_plugins(elsewhere)["crypto"] == "dds_security_crypto"
    assert "not located" in str(elsewhere.notes)


OF = {"0.10.2": "libddsc.so.0debian", "11.0.1": "libddsc.so.11"}
"""Versions of Cyclone DDS, and what their plugins load."""


@pytest.fixture
def cyclones(library, tmp_path):
    """Version -> the folder with that Cyclone DDS and its plugins."""
    return {
        version: library.cyclone(tmp_path / version, version, soname)
        for version, soname in OF.items()
    }


@pytest.mark.parametrize("version", ["11.0.1", "11", "0.10.5", "0.11"])
def test_plugins_of_another_cyclone_are_refused(models, cyclones, version):
    """A process of 11.0.1 that loaded those of 0.10.2 died by SIGSEGV."""
    keystore, folder = models("classical"), cyclones["0.10.2"]
    with pytest.raises(VerificationError, match=r"libddsc\.so\.0\.10\.2.* can crash") as refusal:
        checked("cyclonedds", keystore, plugins=folder, version=version)
    assert "--plugins" in refusal.value.hint
    assert "--stack-version" in refusal.value.hint
    anyway = checked("cyclonedds", keystore, plugins=folder, version=version, anyway=True)
    assert "can crash" in str(anyway.warnings)


@pytest.mark.parametrize("version", [None, "0.10.2", "0.10"])
def test_plugins_of_the_same_cyclone_are_named_and_labelled(models, cyclones, version):
    folder = cyclones["0.10.2"]
    made = checked("cyclonedds", models("classical"), plugins=folder, version=version)
    assert set(map(Path.parent.fget, map(Path, cyclones_plugins(made).values()))) == {folder}
    assert "Cyclone DDS 0.10.2" in made.files[made.main]


@pytest.mark.parametrize("kind", ["auth", "crypto", "ac"])
def test_plugins_of_two_cyclones_in_one_folder_are_refused(models, cyclones, kind):
    name = f"lib{NAMES[kind]}.so"
    shutil.copy(cyclones["11.0.1"] / name, cyclones["0.10.2"] / name)
    with pytest.raises(VerificationError, match="can crash"):
        checked("cyclonedds", models("classical"), plugins=cyclones["0.10.2"])


def test_plugins_that_are_not_there_are_refused(models, cyclones, tmp_path):
    with pytest.raises(VerificationError, match="no such file"):
        checked("cyclonedds", models("classical"), plugins=tmp_path)
    (cyclones["11.0.1"] / "libdds_security_ac.so").write_text("INPUT(-lother)")
    with pytest.raises(VerificationError, match="not a library"):
        checked("cyclonedds", models("classical"), plugins=cyclones["11.0.1"])


def test_plugins_of_another_machine_are_not_looked_for_on_this_one(models, cyclones):
    made = checked(
        "cyclonedds",
        models("classical"),
        plugins=cyclones["0.10.2"],
        version="11.0.1",
        at=PurePosixPath("/robot"),
    )
    assert cyclones_plugins(made)["ac"].startswith(str(cyclones["0.10.2"]))


def test_the_plugin_for_encryption_can_be_said_and_must_fit_the_others(models, cyclones):
    keystore, crypto = models("classical"), cyclones["11.0.1"] / "libdds_security_crypto.so"
    with pytest.raises(VerificationError, match="can crash"):
        checked("cyclonedds", keystore, plugins=cyclones["0.10.2"], crypto=crypto)
    made = checked("cyclonedds", keystore, plugins=cyclones["11.0.1"], crypto=crypto)
    assert cyclones_plugins(made)["crypto"] == str(crypto)
    at = PurePosixPath("/robot")
    with pytest.raises(UsageError, match="not an absolute path"):
        checked("cyclonedds", keystore, crypto=Path("crypto.so"), at=at)


@pytest.mark.parametrize("stack", ["fastdds", "opendds", "connext"])
def test_plugins_are_for_cyclone_alone(models, stack):
    with pytest.raises(UsageError, match="does not name security plugins"):
        checked(stack, models("classical"), plugins=Path("/usr/lib"))
    with pytest.raises(UsageError, match="does not name security plugins"):
        checked(stack, models("classical"), crypto=Path("/usr/lib/libdds_security_crypto.so"))


def test_plugins_are_found_where_distributions_put_them(library, tmp_path):
    folder = tmp_path / "usr/lib/x86_64-linux-gnu/libddsc0debian"
    folder.mkdir(parents=True)
    for name in NAMES.values():
        (folder / f"lib{name}.so").touch()
    assert find_cyclone_plugins(tmp_path) is None  # nothing loads an empty file
    library.cyclone(folder, "0.10.2", "libddsc.so.0debian")
    assert find_cyclone_plugins(tmp_path) == folder
    (folder.parent / "libddsc-that-leads-to-itself").symlink_to("libddsc-that-leads-to-itself")
    (tmp_path / "usr/lib/here").symlink_to(folder)  # the same folder is no second one
    assert find_cyclone_plugins(tmp_path) == folder
    library.cyclone(tmp_path / "usr/local/lib", "11.0.1", "libddsc.so.11")
    assert find_cyclone_plugins(tmp_path) is None
    for place, version in ((folder, (0, 10, 2)), (tmp_path / "usr/local/lib", (11, 0, 1))):
        assert find_cyclone_plugins(tmp_path, lambda each, of=version: each.release == of) == place


def test_what_cyclone_would_replace_is_protected(own):
    made = unchecked("cyclonedds", own("${HOME}"))
    ca = element(made, "Domain/Security/Authentication/IdentityCA").text
    assert "/$${:-}{HOME}/enclaves" in ca


@pytest.mark.parametrize("name", ['a"b', "a\\b"])
def test_a_path_that_cyclone_reads_otherwise_is_refused(own, name):
    keystore = own(name)
    with pytest.raises(UsageError, match="opens no documents"):
        unchecked("cyclonedds", keystore)
    for stack in ("fastdds", "connext"):
        named = files_named(texts(unchecked(stack, keystore)))
        assert {path.parents[2].name for path in named} == {name}


# Fast DDS


def test_fast_dds_properties_are_what_it_was_measured_with(models):
    keystore = models("classical")
    found = properties(unchecked("fastdds", keystore))
    folder = f"file://{keystore.root}/enclaves/talker"
    assert found == {
        "dds.sec.auth.plugin": "builtin.PKI-DH",
        "dds.sec.auth.builtin.PKI-DH.identity_ca": f"{folder}/identity_ca.cert.pem",
        "dds.sec.auth.builtin.PKI-DH.identity_certificate": f"{folder}/cert.pem",
        "dds.sec.auth.builtin.PKI-DH.private_key": f"{folder}/key.pem",
        "dds.sec.auth.builtin.PKI-DH.preferred_key_agreement": "ECDH",
        "dds.sec.access.plugin": "builtin.Access-Permissions",
        "dds.sec.access.builtin.Access-Permissions.permissions_ca": (
            f"{folder}/permissions_ca.cert.pem"
        ),
        "dds.sec.access.builtin.Access-Permissions.governance": f"{folder}/governance.p7s",
        "dds.sec.access.builtin.Access-Permissions.permissions": f"{folder}/permissions.p7s",
        "dds.sec.crypto.plugin": "builtin.AES-GCM-GMAC",
    }


@pytest.mark.parametrize(
    ("version", "namespace", "variables"),
    [
        ("2.9.1", "fastRTPS_Profiles", ["FASTRTPS_DEFAULT_PROFILES_FILE"]),
        ("3.6.2", "eprosima.com", ["FASTDDS_DEFAULT_PROFILES_FILE"]),
        (
            None,
            "fastRTPS_Profiles",
            ["FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE"],
        ),
    ],
)
def test_fast_dds_of_each_generation_is_told_in_its_way(models, version, namespace, variables):
    made = unchecked("fastdds", models("classical"), version=version)
    assert root_of(made).tag.endswith(f"{namespace}}}dds")
    assert sorted(made.variables(Path("/conf"))) == variables
    assert set(made.variables(Path("/conf")).values()) == {"/conf/fastdds.xml"}


def test_fast_dds_on_loopback_uses_one_transport(models):
    made = unchecked("fastdds", models("classical"), version="3.6.2", loopback=True)
    root = root_of(made)
    assert root.find(f".//{FAST}useBuiltinTransports").text == "false"
    assert {each.text for each in root.iter(f"{FAST}address")} == {"127.0.0.1"}
    assert {each.text for each in root.iter(f"{FAST}transport_id")} == {"loopback"}


@pytest.mark.parametrize("version", [".".join(map(str, each)) for each in FAST_DDS_LIMIT.versions])
def test_fast_dds_that_cannot_send_large_messages_is_refused_them(models, version):
    with pytest.raises(VerificationError, match="over 8192") as refusal:
        checked("fastdds", models("transition"), version=version)
    assert "classical profile" in refusal.value.hint
    checked("fastdds", models("classical"), version=version)


@pytest.mark.parametrize("version", ["2.9.1", "2.14.3", "2.14.5", "3.1.0", "3.2.3", "3.6", "2.6"])
def test_fast_dds_that_sends_large_messages_is_not_complained_of(models, version):
    assert checked("fastdds", models("transition"), version=version).warnings == ()


@pytest.mark.parametrize("version", [None, "3", "3.1", "2", "2.14"])
def test_fast_dds_of_unsaid_version_comes_with_a_warning(models, version):
    assert "PQS501" in str(checked("fastdds", models("transition"), version=version).warnings)


def test_what_fast_dds_would_replace_is_refused(own):
    with pytest.raises(UsageError, match="would replace"):
        unchecked("fastdds", own("${HOME}"))


# Connext


def test_connext_loads_its_plugins_with_the_standards_properties(models):
    found = properties(unchecked("connext", models("classical")))
    assert found.pop("com.rti.serv.load_plugin") == "com.rti.serv.secure"
    assert {name.rpartition(".")[0] for name in found} == {
        *("com.rti.serv.secure", "dds.sec.auth", "dds.sec.access")
    }


def test_what_connext_would_replace_is_refused(own):
    with pytest.raises(UsageError, match="would replace"):
        unchecked("connext", own("$(HOME)"))


@pytest.mark.parametrize("stack", ["opendds", "connext"])
def test_a_stack_that_was_not_run_says_so(models, stack):
    assert "not run" in str(unchecked(stack, models("classical")).warnings)
    with pytest.raises(UsageError, match="to one machine"):
        unchecked(stack, models("classical"), loopback=True)


# OpenDDS


def protect(keystore, kind):
    """Write that kind of rtps_protection into the governance, whose signature then fails."""
    path = keystore.root / "enclaves/governance.p7s"
    path.write_bytes(path.read_bytes().replace(b"kind>SIGN<", b"kind>%s<" % kind.encode()))
    return keystore


@pytest.mark.parametrize("kind", ["SIGN", "ENCRYPT"])
@pytest.mark.parametrize("version", ["3.13.3", "3.13", "3.2"])
def test_opendds_before_3_14_is_refused_protected_rtps_messages(own, kind, version):
    """It makes no participant: `RTPS protection is unsupported`."""
    keystore = protect(own(), kind)
    with pytest.raises(VerificationError, match="rtps_protection_kind") as refusal:
        unchecked("opendds", keystore, version=version)
    assert "3.14" in refusal.value.hint
    assert "rtps_protection_kind" in str(
        unchecked("opendds", keystore, version=version, anyway=True).warnings
    )


@pytest.mark.parametrize(
    ("version", "kind", "warned"),
    [
        (None, "SIGN", True),
        ("3", "SIGN", True),
        ("3.14", "SIGN", False),
        ("3.34.0", "ENCRYPT", False),
        ("3.13.3", "NONE", False),
        (None, "NONE", False),
    ],
)
def test_opendds_is_warned_of_protected_rtps_messages_where_it_may_be_old(
    own, version, kind, warned
):
    made = unchecked("opendds", protect(own(), kind), version=version)
    assert ("rtps_protection_kind" in str(made.warnings)) is warned


def test_what_was_run_of_opendds_is_said(own):
    keystore = protect(own(), "NONE")
    assert "not run" not in str(unchecked("opendds", keystore, version="3.13.3").warnings)
    assert "not run" in str(unchecked("opendds", keystore, version="3.34").warnings)


# Passphrases


@pytest.mark.parametrize(
    ("stack", "reference"),
    [
        ("cyclonedds", "${PQSEC_KEY_PASSWORD:?must contain the passphrase of the key}"),
        ("connext", "$(PQSEC_KEY_PASSWORD)"),
    ],
)
def test_a_passphrase_is_left_to_the_environment(own, stack, reference):
    made = unchecked(stack, encrypted(own()), version=NEW.get(stack))
    assert reference in texts(made)
    assert not made.is_private
    assert "set PQSEC_KEY_PASSWORD" in str(made.notes)


def test_opendds_reads_the_passphrase_in_the_program(own):
    keystore = encrypted(own())
    made = unchecked("opendds", keystore)
    assert 'std::getenv("PQSEC_KEY_PASSWORD")' in made.files["pqsec_participant.h"]
    assert "a wrong one" in str(made.notes)  # it makes a participant all the same
    with pytest.raises(UsageError, match="not a place for a passphrase"):
        unchecked("opendds", keystore, password="open sesame")


@pytest.mark.parametrize("secret", SECRETS)
@pytest.mark.parametrize("stack", XML)
def test_a_passphrase_that_is_given_stands_there_and_makes_it_private(own, stack, secret):
    made = unchecked(stack, encrypted(own(), secret), password=secret)
    assert secret in texts(made)
    assert made.is_private
    assert secret not in repr(made) + repr(Options(password=secret))


@pytest.mark.parametrize("version", [None, "2.9.1", "3.6.2"])
def test_fast_dds_needs_the_passphrase_in_the_file(own, version):
    with pytest.raises(UsageError, match="from the profile only") as refusal:
        unchecked("fastdds", encrypted(own()), version=version)
    assert "--password-file" in refusal.value.hint


@pytest.mark.parametrize(
    ("stack", "secret", "why"),
    [
        ("cyclonedds", "hush hush ", "trims"),
        ("fastdds", "hush${HOME}b", "would replace"),
        ("connext", "hush$(HOME)b", "would replace"),
        *((stack, "hush\thush", "and a configuration cannot") for stack in XML),
        ("fastdds", "   ", "only spaces"),  # 2.9.1 then made an unsecured participant
    ],
)
def test_a_passphrase_that_the_stack_would_change_is_refused(own, stack, secret, why):
    with pytest.raises(UsageError, match=why) as refusal:
        unchecked(stack, encrypted(own(), secret), password=secret, version=NEW.get(stack))
    assert "hush" not in f"{refusal.value} {refusal.value.hint}"


def test_a_passphrase_for_a_key_that_is_not_encrypted_is_refused(models):
    with pytest.raises(UsageError, match="not encrypted"):
        checked("cyclonedds", models("classical"), password="open sesame")


# What comes before


@pytest.mark.parametrize("profile", ["pq", "hybrid", "cnsa2"])
@pytest.mark.parametrize("stack", ["cyclonedds", "fastdds", "opendds", "connext"])
def test_what_no_stock_stack_takes_is_refused(models, stack, profile):
    with pytest.raises(VerificationError, match="for pqsec peers only") as refusal:
        checked(stack, models(profile))
    assert "transition profile" in refusal.value.hint
    made = checked(stack, models(profile), anyway=True)
    assert "for pqsec peers only" in str(made.warnings)


@pytest.mark.parametrize("profile", ["transition", "classical"])
@pytest.mark.parametrize("stack", ["cyclonedds", "fastdds"])
def test_what_the_stack_takes_is_written(models, stack, profile):
    assert checked(stack, models(profile), version=NEW.get(stack)).warnings == ()


def test_a_damaged_participant_is_refused(own):
    keystore = own()
    path = keystore.root / "enclaves/talker/permissions.p7s"
    path.write_bytes(path.read_bytes().replace(b"<topic>x<", b"<topic>*<"))
    with pytest.raises(VerificationError, match="changed"):
        checked("cyclonedds", keystore)
    assert "changed" in str(checked("cyclonedds", keystore, anyway=True).warnings)


@pytest.mark.parametrize("name", sorted(CREDENTIALS - {"cert.pem"}))
def test_a_missing_file_is_named(own, name):
    keystore = own()
    (keystore.root / "enclaves/talker" / name).unlink()
    with pytest.raises(KeystoreError, match=f"lacks {name}"):
        checked("fastdds", keystore, version="3.6.2")


@pytest.mark.parametrize(("name", "error"), [("/nobody", KeystoreError), ("a b", UsageError)])
def test_a_participant_that_is_none_is_refused(models, name, error):
    with pytest.raises(error):
        export(stack_named("cyclonedds"), models("classical"), name, Options(), now=NOW)


@pytest.mark.parametrize(
    ("stack", "version"),
    [("cyclonedds", "0.9.1"), ("cyclonedds", "0"), ("fastdds", "1.9"), ("fastdds", "4.0")],
)
def test_a_version_with_another_configuration_is_refused(models, stack, version):
    with pytest.raises(UsageError, match="does not know the configuration"):
        checked(stack, models("classical"), version=version)


@pytest.mark.parametrize("version", ["", "jazzy", "3.x", "1.2.3.4.5", "-1", "99999", "3 1", "٣"])
def test_what_is_no_version_is_refused(version):
    with pytest.raises(UsageError, match="not a version"):
        _ = Options(version=version).release


def test_a_stack_is_found_by_name():
    assert stack_named("FastDDS").product == "Fast DDS"
    with pytest.raises(UsageError, match="no stack named") as refusal:
        stack_named("zenoh")
    assert all(stack in refusal.value.hint for stack in Stack)


# Writing


def sample(**more):
    return Export(
        stack="s", participant="/p", files={"main": "text"} | more.pop("files", {}), **more
    )


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def tree(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.fixture
def key(tmp_path):
    path = tmp_path / "source" / "key.pem"
    path.parent.mkdir()
    path.write_bytes(b"private")
    return path


@pytest.mark.usefixtures("umask")
def test_a_new_folder_has_all_files_and_what_is_secret_is_private(tmp_path, key):
    goal = tmp_path / "new" / "conf"
    paths = write(sample(files={"enclaves/talker/key.pem": key}), goal)
    assert paths == [goal / "main", goal / "enclaves/talker/key.pem"]
    assert [path.read_bytes() for path in paths] == [b"text", b"private"]
    assert [mode(path) for path in (*paths, goal)] == [0o644, 0o600, 0o700]
    assert tree(goal.parent)[0] == "conf"


@pytest.mark.usefixtures("umask")
@pytest.mark.parametrize(("is_private", "modes"), [(True, [0o600, 0o700]), (False, [0o644, 0o755])])
def test_the_modes_are_those_of_what_is_in_it(tmp_path, is_private, modes):
    goal = tmp_path / "conf"
    [path] = write(sample(is_private=is_private), goal)
    assert [mode(path), mode(goal)] == modes


def test_in_a_folder_that_is_there_nothing_is_replaced_unless_forced(tmp_path):
    (tmp_path / "main").write_text("mine")
    with pytest.raises(ExistsError):
        write(sample(files={"a": "new"}), tmp_path)
    assert tree(tmp_path) == ["main"]
    write(sample(files={"a": "new"}), tmp_path, force=True)
    assert [(tmp_path / name).read_text() for name in tree(tmp_path)] == ["new", "text"]


def test_a_link_is_replaced_and_not_followed(tmp_path):
    (tmp_path / "victim").write_text("mine")
    (tmp_path / "conf").mkdir()
    (tmp_path / "conf/main").symlink_to(tmp_path / "victim")
    write(sample(is_private=True), tmp_path / "conf", force=True)
    assert (tmp_path / "victim").read_text() == "mine"
    assert mode(tmp_path / "conf/main") == 0o600


@pytest.mark.parametrize("there", [True, False])
def test_a_failure_leaves_nothing(tmp_path, there):
    goal = tmp_path / "conf"
    if there:
        goal.mkdir()
    before = tree(tmp_path)
    with pytest.raises(FileError):
        write(sample(files={"a": tmp_path / "gone"}), goal)
    assert tree(tmp_path) == before


def test_a_file_that_comes_in_the_meantime_is_not_replaced(tmp_path, monkeypatch):
    def too_early(path):
        path.write_text("mine")

    monkeypatch.setattr(import_module("pqsec_pki.vendors.exports"), "refuse_existing", too_early)
    with pytest.raises(ExistsError):
        write(sample(), tmp_path)
    assert tree(tmp_path) == ["main"]
    assert (tmp_path / "main").read_text() == "mine"


def test_a_folder_in_the_place_of_a_file_is_a_refusal_and_nothing_is_replaced(tmp_path):
    (tmp_path / "main").write_text("mine")
    (tmp_path / "a").mkdir()
    with pytest.raises(FileError, match="a folder is in its place"):
        write(sample(files={"a": "new"}), tmp_path, force=True)
    assert tree(tmp_path) == ["a", "main"]
    assert (tmp_path / "main").read_text() == "mine"


def test_a_file_in_the_place_of_the_folder_is_a_refusal(tmp_path):
    (tmp_path / "conf").write_text("mine")
    with pytest.raises(FileError):
        write(sample(), tmp_path / "conf", force=True)
    assert tree(tmp_path) == ["conf"]


@pytest.mark.parametrize(
    ("stack", "name"),
    [("cyclonedds", "a,b"), ("connext", "a;b"), ("opendds", "a\ntouch b"), ("fastdds", "a\x1bb")],
)
def test_a_folder_that_the_variable_cannot_name_is_refused(models, tmp_path, stack, name):
    made = unchecked(stack, models("classical"))
    with pytest.raises(UsageError, match="cannot use a folder"):
        write(made, tmp_path / name)
    assert tree(tmp_path) == []


def test_commands_are_quoted_for_the_shell(tmp_path):
    folder = tmp_path / "it's a folder"
    made = sample(environment={"V": f"file://{FOLDER}/main"}, steps=(f"run {FOLDER}/main",))
    quoted = "'" + str(folder).replace("'", "'\"'\"'")
    assert made.commands(folder) == [f"export V='file://{quoted[1:]}/main'", f"run {quoted}'/main"]


@pytest.mark.parametrize("stack", list(Stack))
def test_credentials_that_cannot_be_trusted_are_exported_only_if_told_to(own, stack):
    keystore = own()
    ca = keystore.root / "public/identity_ca.cert.pem"
    ca.write_bytes(ca.read_bytes() * 2)
    # No suppression speaks for the trust decision.
    ignored = "ignore:\n  - rule: PQS319\n    reason: we need it\n"
    (keystore.root / "enclaves/talker/.pqsec-check.yaml").write_text(ignored)
    with pytest.raises(VerificationError) as refusal:
        checked(stack, keystore)
    assert Code.CA_DOUBLED in refusal.value.codes
    if stack != "ros2":  # which has its own reasons too
        assert "contains the same CA twice" in str(checked(stack, keystore, anyway=True).warnings)
