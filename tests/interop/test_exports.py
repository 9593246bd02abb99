"""Real stacks read what `export` writes: Cyclone DDS, Fast DDS; for OpenDDS, a compiler."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pqsec_pki.algorithms import load_private_key, private_key_pem
from pqsec_pki.errors import UsageError, VerificationError
from pqsec_pki.keystore import Keystore
from pqsec_pki.stacks import stack_named
from pqsec_pki.trial import find
from pqsec_pki.vendors import Options, StackEnclave, export, exporter_of, write
from pqsec_pki.vendors.cyclone_plugins import find_cyclone_plugins, read_plugin
from tests.interop.conftest import NOT_STOCK, STOCK
from tests.interop.fastdds_shim import find_compiler
from tests.interop.kept import contents, kept
from tests.interop.roots import TRIXIE

pytestmark = pytest.mark.interop

HERE = Path(__file__).parent
ODD = "a & <b> 'c' é 100%41 {}"
OURS = ("CYCLONEDDS_URI", "FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")
CREATE = """
import ctypes, sys
sys.exit(ctypes.CDLL(sys.argv[1]).dds_create_participant(0, None, None) <= 0)
"""
SECRETS = ["open sesame", "<a> & 'b' \"c\"", "pässwört", "a\\b$c"]


@pytest.fixture
def own(labs, tmp_path):
    """own("transition", "a & b") is that lab's keystore, copied into a folder of that name."""

    def copied(profile="classical", name="keystore"):
        root = tmp_path / name
        shutil.copytree(labs(profile).keystore.root, root, symlinks=True)
        return Keystore.open(root)

    return copied


@pytest.fixture
def exported(now, tmp_path):
    """exported("fastdds", keystore) is the environment for a process that is /lab/alice."""

    def made(stack, keystore, **options):
        wanted = Options(loopback=stack != "opendds", **options)
        written = export(stack_named(stack), keystore, "/lab/alice", wanted, now=now)
        folder = tmp_path / f"{ODD} conf"
        write(written, folder)
        return written.variables(folder)

    return made


def run(command, variables):
    kept = {name: value for name, value in os.environ.items() if name not in OURS}
    return subprocess.run(
        command,
        env=kept | variables,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        errors="replace",
    )


def spoil(keystore):
    """The permissions that /lab/alice shows are no longer what was signed."""
    path = keystore.root / "enclaves/lab/alice/permissions.p7s"
    path.write_bytes(path.read_bytes().replace(b"rt/chatter", b"rt/secrets"))


def encrypt(keystore, secret):
    path = keystore.root / "enclaves/lab/alice/key.pem"
    path.write_bytes(private_key_pem(load_private_key(path.read_bytes()), secret.encode()))


@pytest.fixture(scope="session")
def cyclone(plugins, requires):
    """cyclone(variables) is a process that makes a participant of Cyclone DDS."""
    libraries = sorted(plugins.parent.glob("libddsc.so.*"))
    library = requires(
        libraries[0] if libraries else None, "Cyclone DDS", "apt-get install libddsc0debian"
    )
    return lambda variables: run([sys.executable, "-c", CREATE, library], variables)


@pytest.fixture(scope="session")
def fast(requires):
    """fast(variables) is a process that makes a participant of Fast DDS and tells of it."""
    remedy = "apt-get install --no-install-recommends g++ libfastrtps-dev"
    compiler = requires(find_compiler(), "g++ with Fast DDS's headers", remedy)
    source = HERE / "fastdds_profile.cpp"
    command = [compiler, "-o", "profile", str(source), "-lfastrtps", "-lfastcdr"]
    inputs = command, find("fastdds").library.build, contents(source)
    folder = kept("profile", inputs, lambda there: subprocess.run(command, cwd=there, check=True))
    return lambda variables: run([folder / "profile"], variables)


@pytest.fixture
def start(request, cyclone, fast):
    """The one or the other: parametrise it, indirectly."""
    return {"cyclonedds": cyclone, "fastdds": fast}[request.param]


both = pytest.mark.parametrize(
    ("start", "stack"),
    [("cyclonedds", "cyclonedds"), ("fastdds", "fastdds")],
    indirect=["start"],
    ids=["cyclonedds", "fastdds"],
)


@pytest.mark.slow(but=2)
@both
@pytest.mark.parametrize("profile", STOCK)
def test_a_participant_starts_with_what_is_written(start, stack, own, exported, profile):
    done = start(exported(stack, own(profile, ODD)))
    assert done.returncode == 0, done.stderr


@both
def test_the_participant_is_secured(start, stack, own, exported):
    keystore = own()
    variables = exported(stack, keystore)
    assert start(variables).returncode == 0
    spoil(keystore)
    assert start(variables).returncode == 1


@both
@pytest.mark.parametrize("profile", NOT_STOCK)
def test_what_is_refused_the_stack_refuses_too(start, stack, own, exported, profile):
    assert start(exported(stack, own(profile), anyway=True)).returncode == 1


@both
@pytest.mark.parametrize("secret", SECRETS)
def test_the_passphrase_in_the_file_opens_the_key(start, stack, own, exported, secret):
    keystore = own()
    encrypt(keystore, secret)
    done = start(exported(stack, keystore, password=secret))
    assert done.returncode == 0, done.stderr


def test_cyclone_replaces_nothing_in_a_passphrase(cyclone, own, exported):
    keystore, secret = own(), "a$${HOME}b"
    encrypt(keystore, secret)
    assert cyclone(exported("cyclonedds", keystore, password=secret)).returncode == 0


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("secret", [*SECRETS, " spaces around "])
def test_cyclone_reads_the_passphrase_from_the_environment(cyclone, own, exported, secret):
    keystore = own()
    encrypt(keystore, secret)
    variables = exported("cyclonedds", keystore)
    assert cyclone(variables | {"PQSEC_KEY_PASSWORD": secret}).returncode == 0
    assert cyclone(variables | {"PQSEC_KEY_PASSWORD": "wrong"}).returncode == 1
    without = cyclone(variables)
    assert without.returncode == 1
    assert "PQSEC_KEY_PASSWORD: must contain the passphrase" in without.stderr


@pytest.mark.parametrize("name", ['a"b', "a\\b"])
def test_cyclone_does_not_find_documents_in_the_folders_that_are_refused(
    cyclone, own, exported, name
):
    keystore = own()
    variables = exported("cyclonedds", keystore)
    other = keystore.root.rename(keystore.root.with_name(name))
    conf = Path(variables["CYCLONEDDS_URI"].removeprefix("file://"))
    conf.write_text(conf.read_text().replace(f"/{keystore.root.name}/", f"/{name}/"))
    done = cyclone(variables)
    assert done.returncode == 1
    assert "could not be found" in done.stderr
    with pytest.raises(UsageError, match="opens no documents"):
        exported("cyclonedds", Keystore.open(other))


@pytest.mark.parametrize("name", ["${HOME}", "$HOME", "$${A:-b}"])
def test_cyclone_replaces_nothing_in_paths(cyclone, own, exported, name):
    done = cyclone(exported("cyclonedds", own(name=name)))
    assert done.returncode == 0, done.stderr


def test_fast_dds_has_the_values_that_were_meant(fast, own, exported):
    keystore = own(name=ODD)
    done = fast(exported("fastdds", keystore))
    said = dict(line.split("=", 1) for line in done.stdout.splitlines())
    folder = f"file://{keystore.root}/enclaves/lab/alice"
    assert said["dds.sec.auth.builtin.PKI-DH.private_key"] == f"{folder}/key.pem"
    assert (
        said["dds.sec.access.builtin.Access-Permissions.governance"] == f"{folder}/governance.p7s"
    )
    assert done.stderr == ""


def test_fast_dds_runs_unsecured_with_a_passphrase_of_spaces(fast, own, exported):
    """Which is why the export refuses it."""
    keystore = own()
    encrypt(keystore, "   ")
    variables = exported("fastdds", keystore, password="stand-in")
    profile = Path(variables["FASTRTPS_DEFAULT_PROFILES_FILE"])
    profile.write_text(profile.read_text().replace("stand-in", "   "))
    done = fast(variables)
    assert done.returncode == 0
    assert "dds.sec" not in done.stdout


def test_fast_dds_runs_unsecured_where_it_cannot_read_the_file(fast, tmp_path):
    """Which is why the export warns of it."""
    done = fast({"FASTRTPS_DEFAULT_PROFILES_FILE": str(tmp_path / "gone.xml")})
    assert done.returncode == 0
    assert "dds.sec" not in done.stdout


def test_opendds_header_compiles_and_holds_the_values_that_were_meant(own, tmp_path, requires):
    compiler = requires(shutil.which("g++"), "g++", "apt-get install g++")
    keystore = own(name=f'{ODD} "??/ \\')
    encrypt(keystore, "secret")
    enclave = StackEnclave.find(keystore, "/lab/alice")
    write(exporter_of(stack_named("opendds")).make(enclave, Options()), tmp_path / "conf")
    (tmp_path / "dds").mkdir()
    shutil.copy(HERE / "opendds_stub.h", tmp_path / "dds/DdsDcpsInfrastructureC.h")
    (tmp_path / "main.cpp").write_text(
        '#include "conf/pqsec_participant.h"\n#include <iostream>\n'
        "int main() { DDS::DomainParticipantQos qos; pqsec::secure(qos);\n"
        "auto& all = qos.property.value;\n"
        'for (unsigned i = 0; i < all.length(); ++i) std::cout << all[i].name << "="'
        ' << all[i].value << "\\n"; }\n'
    )
    options = ["-std=c++11", "-trigraphs", "-Wall", "-Werror", f"-I{tmp_path}"]
    program = tmp_path / "program"
    subprocess.run([compiler, *options, "-o", program, tmp_path / "main.cpp"], check=True)
    for unset in ({}, {"PQSEC_KEY_PASSWORD": ""}):  # OpenDDS would make a useless participant
        done = run([program], unset)
        assert (done.returncode < 0, done.stdout) == (True, "")
        assert "PQSEC_KEY_PASSWORD must contain the passphrase" in done.stderr
    said = run([program], {"PQSEC_KEY_PASSWORD": "secret"}).stdout
    folder = f"file://{keystore.root}/enclaves/lab/alice"
    assert said.splitlines() == [
        f"dds.sec.auth.identity_ca={folder}/identity_ca.cert.pem",
        f"dds.sec.auth.identity_certificate={folder}/cert.pem",
        f"dds.sec.auth.private_key={folder}/key.pem",
        f"dds.sec.access.permissions_ca={folder}/permissions_ca.cert.pem",
        f"dds.sec.access.governance={folder}/governance.p7s",
        f"dds.sec.access.permissions={folder}/permissions.p7s",
        "dds.sec.auth.password=secret",
    ]


def test_the_plugins_of_two_real_cyclones_are_told_apart(requires, plugins, labs, now):
    """Debian 12 and 13 give libddsc one soname, 0debian: the file beside the plugins differs."""
    newer = requires(find_cyclone_plugins(TRIXIE), "Cyclone DDS of Debian trixie", "run .ci/trixie")
    folders = {
        ".".join(map(str, read_plugin(folder / "libdds_security_auth.so").release)): folder
        for folder in (plugins, newer)
    }
    assert len(folders) == 2
    for mine, folder in folders.items():
        for version in folders:
            wanted = Options(version=version, plugins=folder)
            stack, keystore = stack_named("cyclonedds"), labs("classical").keystore
            if version == mine:
                made = export(stack, keystore, "/lab/alice", wanted, now=now)
                assert f"Cyclone DDS {version}" in made.files[made.main]
                continue
            with pytest.raises(VerificationError, match="can crash"):
                export(stack, keystore, "/lab/alice", wanted, now=now)
