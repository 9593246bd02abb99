"""pqsec cbom on the command line."""

import json
import subprocess
import sys

import pytest

from tests.cli.conftest import clean_environment


@pytest.fixture
def keystore(domains, tmp_path):
    """A keystore, in the test's folder as `k`."""
    (tmp_path / "k").symlink_to(domains("transition"))
    return tmp_path / "k"


def test_the_same_bytes_in_every_process(keystore, pqsec, process):
    printed = pqsec("-k k cbom").done().out
    for seed in "12":
        assert process("-k k cbom", PYTHONHASHSEED=seed).done().out == printed
    written = pqsec("cbom k -o k.cdx.json").done()
    assert written.out.startswith("k.cdx.json: algorithm ")
    assert (keystore.parent / "k.cdx.json").read_text() == printed
    assert "timestamp" in json.loads(pqsec("cbom k --timestamp").done().out)["metadata"]


def test_as_json(keystore, pqsec):
    value = pqsec("-k k cbom --json").done().json
    assert set(value) == {"document", "components", "unread"}
    assert json.loads(value["document"])["specVersion"] == "1.7"
    assert value["components"]["certificate"] == 5


def test_what_cannot_be_read_is_told(pqsec, tmp_path):
    (tmp_path / "cert.pem").write_text(
        "-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"
    )
    result = pqsec("cbom .")
    assert result.code == 3
    assert result.err.startswith("pqsec: note: not in the bill: cert.pem: ")
    assert "pqsec: error: the bill is incomplete: a file cannot be read" in result.err
    assert json.loads(result.out)["specVersion"] == "1.7"
    pqsec("cbom missing").refused(3, "missing")


def test_without_the_library(keystore):
    code = "import sys; sys.modules['cyclonedx'] = None; from pqsec_pki.cli import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "cbom", "k"],
        cwd=keystore.parent,
        env=clean_environment(),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 3
    assert done.stderr.splitlines() == [
        "pqsec: error: the library for CycloneDX is not installed",
        "pqsec: hint: pip install 'cyclonedx-python-lib>=11.6,<12'",
    ]
