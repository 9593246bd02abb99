"""Algorithms of another package, which is built and installed here."""

import json
import os
import shutil
import subprocess
import sys

import pytest

PROJECT = """
[build-system]
requires = ["hatchling"]
build-backend = "hatchling.build"
[project]
name = "lab-algorithms"
version = "1.2"
[project.entry-points."pqsec.key_agreements"]
lab-kem = "lab_algorithms:LAB_KEM"
mlkem512 = "lab_algorithms:MISSING"
mlkem768x = "lab_algorithms:THIEF"
text = "lab_algorithms:TEXT"
[project.entry-points."pqsec.signatures"]
lab-sig = "lab_algorithms:LAB_SIG"
lab-thief = "lab_algorithms:SIG_THIEF"
"""
CODE = """
from dataclasses import replace
from pqsec_pki.algorithms import KEY_AGREEMENTS, SIGNATURES
ML_KEM, OWN = KEY_AGREEMENTS.named("mlkem768"), SIGNATURES.named("mldsa44+ed25519")
LAB_KEM = replace(ML_KEM, name="lab-kem", aliases=(), wire_name="LabKEM")
THIEF = replace(ML_KEM, name="mlkem768x", aliases=())
TEXT = "text"
LAB_SIG = replace(
    OWN, name="lab-sig", aliases=(), wire_name="LabSig", token_name="LabSig", label=b"LAB",
    key_oid="1.3.6.1.4.1.99999.1", identifier=bytes.fromhex("300b06092b06010401868d1f01"),
)
SIG_THIEF = replace(LAB_SIG, name="lab-thief", key_oid=OWN.key_oid)
"""
WARNING = "pqsec: warning: the key agreement lab-kem is code of the package lab-algorithms 1.2"


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The environment of a process with the package."""
    project, site = tmp_path_factory.mktemp("project"), tmp_path_factory.mktemp("site")
    (project / "pyproject.toml").write_text(PROJECT)
    (project / "lab_algorithms.py").write_text(CODE)
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-build-isolation"]
    subprocess.run([*pip, "--no-index", "--target", site, project], check=True)
    return os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(site)])}


@pytest.fixture
def run(installed, tmp_path):
    def run(line, code=0):
        done = subprocess.run(
            [sys.executable, "-m", "pqsec_pki", *line.split()],
            cwd=tmp_path, env=installed, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == code, done.stdout + done.stderr
        return done

    return run


def test_they_are_listed_with_their_package_and_broken_ones_are_named(run):
    done = run("algorithms --json")
    rows = json.loads(done.stdout)
    found = {each["name"]: each["package"] for kind in rows.values() if isinstance(kind, list)
             for each in kind}  # fmt: skip
    assert found["lab-kem"] == found["lab-sig"] == "lab-algorithms 1.2"
    assert {name for name, package in found.items() if package} == {"lab-kem", "lab-sig"}
    assert WARNING in done.stderr
    for name, why in {
        "mlkem512": "AttributeError",
        "mlkem768x": "it would replace mlkem768 (wire_name)",
        "text": "lab_algorithms:TEXT is not a KeyAgreement",
        "lab-thief": "it would replace mldsa44-ed25519-sha512 (key_oid)",
    }.items():
        words = f"the package lab-algorithms 1.2 cannot add {name!r}: {why}"
        assert words in done.stderr


def test_a_keystore_with_both_works_and_each_process_warns_once(run):
    keys = " ".join(f"--{each}-key lab-sig" for each in ("identity", "permissions", "participant"))
    run(f"-k k ca init --no-passphrase --profile pq --kem lab-kem {keys}")
    done = run("-k k issue /a /b --publish t --subscribe t")
    assert done.stderr.count(WARNING) == 1
    assert done.stderr.count("the signature algorithm lab-sig is code of") == 1
    told = json.loads(run("-k k verify-handshake /a /b --json").stdout)
    assert (told["signature"], told["key_agreement"]) == ("LabSig", "LabKEM")


TOGETHER = """
import sys, warnings
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from pqsec_pki.algorithms import SIGNATURES, load_private_key, private_key_pem
warnings.simplefilter("ignore")
sys.setswitchinterval(1e-6)
start, names = Barrier(4), ["lab-sig", "lab-sig", "lab-sig", "mldsa44+ed25519"]
def ask(name):
    start.wait()
    row = SIGNATURES.named(name)
    assert load_private_key(private_key_pem(row.generate())).algorithm is row
    return id(row)
with ThreadPoolExecutor(4) as pool:
    print(len(set(pool.map(ask, names))))
"""


def test_threads_that_ask_for_the_same_one_at_once_get_it(installed):
    """All but the first were told that its package would replace it, by itself."""
    done = subprocess.run(
        [sys.executable, "-c", TOGETHER], env=installed, capture_output=True, text=True, check=False
    )
    assert done.stdout == "2\n", done.stderr


def test_a_broken_one_is_an_error_that_names_the_package(run):
    done = run("-k k ca init --no-passphrase --profile pq --kem mlkem768x", 3)
    assert "the package lab-algorithms 1.2 cannot add 'mlkem768x'" in done.stderr


def test_nothing_is_loaded_for_other_names(run):
    assert run("-k k ca init --no-passphrase").stderr.count("lab-algorithms") == 0
    assert "lab" not in run("bench --kem rot13", 2).stderr
    assert "lab" not in run("profiles").stderr


BROKEN_CODE = """
from dataclasses import replace
from pqsec_pki.algorithms import KEY_AGREEMENTS
ML_KEM = KEY_AGREEMENTS.named("mlkem768")
def row(name, **wrong):
    return replace(ML_KEM, **({"name": name, "aliases": (), "wire_name": name} | wrong))
class Raising(type(ML_KEM)):
    @property
    def name(self):
        raise OSError("no name today")
good = row("good")
family, aliases = row("family", family="pq"), row("aliases", aliases=None)
listed, numbered = row("listed", aliases=["a"]), row("numbered", aliases=(1,))
unsized, negative = row("unsized", public_size=None), row("negative", secret_size=-1)
huge, level = row("huge", ciphertext_size=10**400), row("level", level=6)
unregistered = row("unregistered", registered=None)
misregistered = row("misregistered", registered=replace(ML_KEM.registered, classical_level="x"))
binary, empty = row("binary", wire_name=b"x"), row("empty", wire_name="")
nul, comma = row("nul", wire_name="a\\0"), row("comma", wire_name="a,b")
long, spaced = row("long", wire_name="x" * 64), row("spaced", aliases=("a b",))
unhashable, raising = row("unhashable", private=[]), object.__new__(Raising)
prefixed = row("id-prefixed")
"""
BROKEN = {
    "family": "its family is not a Family",
    "aliases": "its aliases is not a tuple",
    "listed": "its aliases is not a tuple",
    "numbered": "its aliases has an element that is not a str",
    "unsized": "its public_size is not a int",
    "negative": "its secret_size is not from 1 to",
    "huge": "its ciphertext_size is not from 1 to",
    "level": "its level is not from 0 to 5",
    "unregistered": "its registered is not a Registered",
    "misregistered": "its classical_level is not a int",
    "binary": "its wire_name is not a str",
    "empty": "the name '' is not",
    "nul": r"the name 'a\u0000' is not",
    "comma": "the name 'a,b' is not",
    "long": f"the name '{'x' * 64}' is not",
    "spaced": "the name 'a b' is not",
    "unhashable": "TypeError: unhashable",
    "raising": "OSError: no name today",
    "id-prefixed": "its name begins with 'id-'",
    "leaving": "SystemExit: 0",
}


def by_hand(site, package, entries, *, metadata=True):
    """A package in the folder `site`, as installers leave it."""
    folder = site / f"{package}-1.0.dist-info"
    folder.mkdir()
    (folder / "entry_points.txt").write_bytes(entries)
    if metadata:
        (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")


@pytest.fixture
def run_with(tmp_path):
    """Run pqsec where the packages in the folder `site` of the test are installed."""
    path = os.pathsep.join([*sys.path, str(tmp_path / "site")])
    (tmp_path / "site").mkdir()

    def run(line, code=0):
        done = subprocess.run(
            [sys.executable, "-m", "pqsec_pki", *line.split()],
            cwd=tmp_path, env=os.environ | {"PYTHONPATH": path},
            capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == code, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        return done

    return run


def test_broken_rows_and_modules_that_leave_are_named_and_the_others_work(run_with, tmp_path):
    site = tmp_path / "site"
    (site / "broken_rows.py").write_text(BROKEN_CODE)
    (site / "leaving.py").write_text("raise SystemExit(0)")
    rows = [f"{name}=broken_rows:{name.removeprefix('id-')}" for name in ("good", *BROKEN)]
    entries = "\n".join(["[pqsec.key_agreements]", *rows[:-1], "leaving=leaving:ROW"])
    by_hand(site, "broken", entries.encode())
    done = run_with("algorithms --json")
    found = {each["name"]: each["package"] for each in json.loads(done.stdout)["key_agreements"]}
    assert [name for name, package in found.items() if package] == ["good"]
    for name, why in BROKEN.items():
        assert f"the package broken 1.0 cannot add {name!r}: {why}" in done.stderr
    run_with("-k k ca init --no-passphrase --profile pq --kem good")
    (site / "broken_rows.py").write_text("raise SystemExit(0)")
    checked = run_with("-k k check", 3).stdout
    assert "the package broken 1.0 cannot add 'good': SystemExit: 0" in checked


def test_a_package_whose_entry_points_cannot_be_read_is_named(run_with, tmp_path):
    for package, entries in (("latin", b"[x]\na = b:\xff"), ("torn", b"[x]\nno equals sign")):
        by_hand(tmp_path / "site", package, entries)
        done = run_with("algorithms --json")
        assert done.stderr.count(f"the entry points of {package} 1.0 cannot be read") == 1
        assert json.loads(done.stdout)["key_agreements"]
        error = run_with("-k k ca init --no-passphrase --kem lab-kem", 3).stderr
        assert f"the entry points of {package} 1.0 cannot be read" in error
        shutil.rmtree(tmp_path / "site" / f"{package}-1.0.dist-info")


def test_a_package_without_metadata_is_named_by_its_entry(run_with, tmp_path):
    by_hand(tmp_path / "site", "bare", b"[pqsec.signatures]\nbare=bare:ROW", metadata=False)
    assert "the package bare:ROW cannot add 'bare': ModuleNotFound" in run_with("algorithms").stderr
