"""EST clients of others, of Debian 13, at our server: strongSwan, Bouncy Castle, curl and OpenSSL.

`.ci/long` runs them from Debian sid too.
"""

import base64
import os
import shutil
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest

from pqsec_pki.certificates import Certificate
from pqsec_pki.est import EST
from pqsec_pki.server import begin_server
from tests.longer import LONG
from tests.unit.serving import HOST, Server

pytestmark = [pytest.mark.interop, pytest.mark.timeout(300)]

SUITES = ["trixie", *(["sid"] if LONG else [])]
JARS = ("bcprov", "bcutil", "bcpkix", "bctls")
EC = ("-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256")
PKCS10 = ("-H", "Content-Type: application/pkcs10", "--data-binary", "@-")


class Clients:
    """Programs of another Debian, and a folder that they share with the test."""

    def __init__(self, root, folder):
        self.root, self.folder = root, folder

    def run(self, *command, data=b""):
        """What a program of that root prints."""
        place = f"/{self.folder.relative_to(self.root)}"
        become_root = [] if os.geteuid() == 0 else ["unshare", "-r"]
        line = [*become_root, "chroot", self.root, "env", f"--chdir={place}", *command]
        return ran(line, data)


def ran(line, data=b""):
    done = subprocess.run(line, input=data, capture_output=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr.decode()
    return done.stdout


@pytest.fixture(params=SUITES)
def clients(request, requires):
    suite = request.param
    kept = Path.home() / ".cache/pqsec-ci" / f"est-clients-{suite}"
    there = os.environ.get(f"PQSEC_EST_CLIENTS_{suite.upper()}") or (
        kept if kept.exists() else None
    )
    root = Path(requires(there, f"EST clients of Debian {suite}", f"run .ci/est-clients {suite}"))
    (root / "tmp").mkdir(exist_ok=True)
    with TemporaryDirectory(dir=root / "tmp") as folder:
        yield Clients(root, Path(folder))


def served(folder, profile):
    """A server with the TLS certificates that `pqsec serve --init` makes."""
    now = datetime.now(UTC)
    made = Server(folder, now, profile, renew="any-time", classical=profile == "classical")
    first = folder / "first/serve.yaml"
    first.parent.mkdir()
    begin_server(f"https://{HOST}:{made.port}", first, made.root, now=now)
    for number, kind in enumerate(("tls-pq", "tls-classical")):
        for end in ("pem", "key"):
            shutil.copy(first.parent / f"{kind}.{end}", folder / f"{number}.{end}")
    return made


@pytest.fixture(scope="module")
def classical(tmp_path_factory):
    made = served(tmp_path_factory.mktemp("classical"), "classical")
    with made.running():
        yield made


@pytest.fixture(scope="module")
def post_quantum(tmp_path_factory):
    made = served(tmp_path_factory.mktemp("pq"), "pq")
    with made.running():
        yield made


def test_strongswan_enrols_and_renews(clients, classical):
    shutil.copy(classical.folder / "1.pem", clients.folder)
    server = ("--url", f"https://{HOST}:{classical.port}", "--cacert", "1.pem")
    clients.run("pki", "--estca", *server, "--caout", "root.pem", "--outform", "pem")
    found = next(clients.folder.glob("root*.pem")).read_bytes()
    assert Certificate.from_pem(found).der == classical.keystore.identity_ca.der
    token = classical.token("/fleet/r1", replaces=True)
    user = ("--userpass", f"{token.id}:{token.secret}")
    for key, shown in (("1", user), ("2", ("--cert", "1.crt", "--key", "1.key"))):
        made = clients.run("pki", "--gen", "--type", "ecdsa", "--size", "256", "--outform", "pem")
        (clients.folder / f"{key}.key").write_bytes(made)
        asked = clients.run("pki", "--req", "--in", f"{key}.key", "--dn", "CN=/fleet/r1")
        (clients.folder / f"{key}.req").write_bytes(asked)
        got = clients.run("pki", "--est", *server, "--in", f"{key}.req", *shown, "--outform", "pem")
        (clients.folder / f"{key}.crt").write_bytes(got)
        assert Certificate.from_pem(got).subject_name == "CN=/fleet/r1"


def test_libest_enrols_and_renews(clients, classical):
    shutil.copy(classical.folder / "1.pem", clients.folder)
    at = ("-s", HOST, "-p", str(classical.port), "-o", ".")

    def estclient(*words):
        clients.run("env", "EST_OPENSSL_CACERT=1.pem", "estclient", *at, *words)
        return clients.folder / "cert-0-0.pem"

    clients.run("openssl", "genpkey", *EC, "-out", "own.key")
    estclient("-g")
    found = base64.b64decode((clients.folder / "cacert-0-0.pkcs7").read_bytes())
    assert classical.keystore.identity_ca.der in found
    token = classical.token("/fleet/r3", replaces=True)
    user = ("-u", token.id, "-h", token.secret, "--common-name", "/fleet/r3")
    enrolled = estclient("-e", *user, "-x", "own.key", "-z", "--pem-output")
    first = enrolled.rename(clients.folder / "own.crt")
    renewed = estclient("-r", "-c", "own.crt", "-k", "own.key", "--pem-output")
    names = [Certificate.from_pem(each.read_bytes()).subject_name for each in (first, renewed)]
    assert names == ["CN=/fleet/r3"] * 2
    assert first.read_bytes() != renewed.read_bytes()


def test_bouncy_castle_enrols_and_renews_with_a_link_to_its_connection(
    clients, classical, requires
):
    java = (
        requires(shutil.which("javac"), "Java", "apt-get install openjdk-17-jdk-headless")
        and "java"
    )
    jars = ":".join(str(clients.root / "usr/share/java" / f"{each}.jar") for each in JARS)
    token = classical.token("/fleet/r2", replaces=True)
    at = f"{HOST}:{classical.port}"
    given = (at, classical.folder / "1.pem", token.id, token.secret, "/fleet/r2")
    source = Path(__file__).with_name("EstClient.java")
    said = ran([java, "-XX:TieredStopAtLevel=1", "-cp", jars, source, *given]).decode()
    lines = [line.split(" ", 1) for line in said.splitlines()]
    assert [what for what, _ in lines].count("LINKED") == 3  # one without the password
    found = dict(lines)
    assert base64.b64decode(found["CA"]) == classical.keystore.identity_ca.der
    certificates = [
        Certificate.from_der(base64.b64decode(found[each])) for each in ("ENROLLED", "RENEWED")
    ]
    assert {each.subject_name for each in certificates} == {"CN=/fleet/r2"}
    assert certificates[0].spki != certificates[1].spki


def test_curl_and_openssl_enrol_and_renew_with_ml_dsa(clients, post_quantum):
    """Post-quantum throughout: X25519MLKEM768, ML-DSA-65 on both sides."""
    shutil.copy(post_quantum.folder / "0.pem", clients.folder)
    url = f"https://{HOST}:{post_quantum.port}{EST}"
    known = ("curl", "-sS", "--fail", "-v", "--stderr", "log", "--cacert", "0.pem")

    def curl(path, *more, data=b""):
        return base64.b64decode(clients.run(*known, *more, url + path, data=data))

    def certificates(der):
        return clients.run("openssl", "pkcs7", "-inform", "DER", "-print_certs", data=der)

    def asked(key):
        words = ("-newkey", "ML-DSA-65", "-nodes", "-keyout", key, "-outform", "DER")
        (clients.folder / "empty").touch()
        subject = ("-config", "empty", "-subj", "/CN=\\/fleet\\/r1")
        return base64.encodebytes(clients.run("openssl", "req", "-new", *words, *subject))

    (clients.folder / "cas.pem").write_bytes(certificates(curl("/cacerts")))
    token = post_quantum.token("/fleet/r1", replaces=True)
    user = ("--user", f"{token.id}:{token.secret}")
    own = ("--cert", "1.crt", "--key", "1.key")
    for number, path, shown in ((1, "/simpleenroll", user), (2, "/fleet/simplereenroll", own)):
        der = curl(path, *shown, *PKCS10, data=asked(f"{number}.key"))
        (clients.folder / f"{number}.crt").write_bytes(certificates(der))
        clients.run("openssl", "verify", "-CAfile", "cas.pem", f"{number}.crt")
        log = (clients.folder / "log").read_text()
        assert "X25519MLKEM768" in log
