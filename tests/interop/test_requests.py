"""OpenSSL 3.5 takes the requests we make, and robots that use it are enrolled with its own."""

import hashlib
import json
import shutil
import subprocess

import pytest

from pqsec_pki.algorithms import PROFILES
from pqsec_pki.certificates import CertificateRequest
from pqsec_pki.enrolment import Bundle, install, request, validate_csrs
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.lifecycle import ParticipantSpec, issue
from tests.interop.conftest import DOMAINS, LAB_PROFILES, YEAR, Lab

pytestmark = pytest.mark.interop

NAME = "/lab/robot"
KEYS = {
    "classical": ("EC", "-pkeyopt", "ec_paramgen_curve:P-256"),
    "classical rsa": ("RSA", "-pkeyopt", "rsa_keygen_bits:2048"),
    "pq": ("ML-DSA-65",),
    "cnsa2": ("ML-DSA-87",),
}
"""Lab profile -> what makes a participant's key of it."""


@pytest.mark.parametrize(
    "profile",
    [each for each in PROFILES if each.name != "hybrid"],  # composites: no OpenSSL has them
    ids=lambda each: each.name,
)
def test_openssl_takes_our_request(openssl35, tmp_path, profile):
    made = request(NAME, profile, tmp_path)
    text = openssl35("req", "-in", made.path, "-noout", "-verify", "-subject", "-text").decode()
    assert f"CN={NAME}" in text.replace(" = ", "=")
    public = openssl35("req", "-in", made.path, "-noout", "-pubkey")
    assert openssl35("pkey", "-in", made.path.parent / "key.pem", "-pubout") == public


@pytest.mark.slow(but=2)
@pytest.mark.parametrize("profile", KEYS)
def test_a_robot_whose_keys_openssl_made_is_enrolled(openssl35, tmp_path, now, profile):
    robot = tmp_path / "robot"
    waiting = robot / "requests/lab+robot"
    waiting.mkdir(parents=True)
    key, csr = waiting / "key.pem", tmp_path / "request.pem"
    openssl35("genpkey", "-algorithm", *KEYS[profile], "-out", key)
    openssl35("req", "-new", "-key", key, "-subj", r"/CN=\/lab\/robot", "-out", csr)
    asked = CertificateRequest.from_pem(csr.read_bytes())
    lab = Lab.create(tmp_path / "lab", LAB_PROFILES[profile], now)
    keys = validate_csrs([asked], lab.keystore.profiles, names=[NAME])
    spec = ParticipantSpec(
        name=NAME, domains=DOMAINS, publish=("t",), validity=YEAR, keys=keys[NAME]
    )
    issue(lab.keystore, lab.authorities, [spec], now=now)
    bundle = Bundle.of(lab.keystore, [NAME], now=now)
    (tmp_path / "bundle").write_bytes(bundle.to_bytes())
    install(tmp_path / "bundle", robot, bundle.roles, now=now)
    folder = robot / "current/enclaves/lab/robot"
    openssl35("verify", "-CAfile", folder / "identity_ca.cert.pem", folder / "cert.pem")
    public = openssl35("x509", "-in", folder / "cert.pem", "-noout", "-pubkey")
    assert openssl35("pkey", "-in", folder / "key.pem", "-pubout") == public
    # Its receipt needs no pqsec either
    data = (robot / "installed.receipt").read_bytes()
    statement = Archive.unpack(data, "receipt").files[f"enclaves{NAME}/receipt.p7s"]
    (tmp_path / "receipt.p7s").write_bytes(statement)
    trust = ("-certfile", folder / "cert.pem", "-CAfile", folder / "identity_ca.cert.pem")
    read = openssl35(
        *("cms", "-verify", "-text", "-purpose", "any", *trust, "-in", tmp_path / "receipt.p7s")
    )
    files = {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.iterdir()
        if not path.name.endswith(("key.pem", ".proof"))
    }
    assert json.loads(read)["files"] == files


def test_tar_reads_a_bundle(requires, labs, tmp_path):
    tar = requires(shutil.which("tar"), "tar", "apt-get install tar")
    keystore = labs("transition").keystore
    bundle = Bundle.of(keystore, ["/lab/alice"], now=labs("transition").now)
    (tmp_path / "bundle").write_bytes(bundle.to_bytes())
    subprocess.run([tar, "xzf", "bundle"], cwd=tmp_path, check=True)
    assert (tmp_path / "enclaves/lab/alice/cert.pem").read_bytes() == (
        keystore.root / "enclaves/lab/alice/cert.pem"
    ).read_bytes()
