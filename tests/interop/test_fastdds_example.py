"""The program of examples/fastdds with Fast DDS 3; tests/docs run it with 2.9.1."""

import os
import re
import shutil
import subprocess
import tempfile
from datetime import timedelta
from pathlib import Path

import pytest

from pqsec_pki.documents import DomainSet
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.stacks import stack_named
from pqsec_pki.vendors import Options, export, write
from tests.interop.conftest import LAB_PROFILES

pytestmark = pytest.mark.interop

SOURCE = Path(__file__).parents[2] / "examples/fastdds/hello.cpp"
PLAIN = re.compile(r"(?s)<propertiesPolicy>.*</propertiesPolicy>")


@pytest.fixture
def hello(stack_in, tmp_path):
    """hello(profile, "send") is the program, started with that file of profiles."""
    found = stack_in("fastdds", "trixie")
    with tempfile.TemporaryDirectory(dir=found.root / "tmp") as folder:
        shutil.copy(SOURCE, folder)
        compiling = ("g++", "-o", "hello", SOURCE.name, "-lfastdds", "-lfastcdr")
        subprocess.run(found.tool(compiling, f"/tmp/{Path(folder).name}"), check=True)
        shutil.copy(Path(folder) / "hello", tmp_path)

    def start(profile: Path, act: str) -> subprocess.Popen:
        return subprocess.Popen(
            [*found.peer(tmp_path / "hello"), act],
            env=os.environ | {"FASTDDS_DEFAULT_PROFILES_FILE": str(profile)},
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )

    return start


@pytest.fixture
def profiles(tmp_path, now):
    """profiles("talker") is the file that the example's export writes for 3.1.2."""
    times = {"validity": timedelta(days=30), "domains": DomainSet.of(78)}
    made = {"name": "Lab", "passphrase": None, "now": now}
    keystore = Keystore.create(tmp_path / "k", LAB_PROFILES["classical"], **made, **times)
    specs = [
        ParticipantSpec(name="/talker", publish=("words",), **times),
        ParticipantSpec(name="/listener", subscribe=("words",), **times),
    ]
    issue(keystore, keystore.unlock(None), specs, now=now)

    def profile(name: str) -> Path:
        options = Options(version="3.1.2", loopback=True)
        made = export(stack_named("fastdds"), keystore, name, options, now=now)
        return write(made, tmp_path / name)[0]

    return profile


@pytest.mark.slow
def test_it_runs_secured_and_who_has_no_credentials_gets_nothing(hello, profiles, tmp_path):
    talker, listener = profiles("talker"), profiles("listener")
    unsecured = tmp_path / "open.xml"
    unsecured.write_text(PLAIN.sub("", listener.read_text()))
    for receiver, said in ((listener, b"received hello\n"), (unsecured, b"")):
        with hello(talker, "send"), hello(receiver, "receive") as process:
            assert process.communicate(timeout=300)[0] == said
