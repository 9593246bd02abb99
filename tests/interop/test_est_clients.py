"""EST clients of others, of Debian 13, at our server: strongSwan, Bouncy Castle, curl and OpenSSL.

`.ci/long` runs them from Debian sid too.
"""

import base64
import shutil
from datetime import UTC, datetime
from pathlib import Path

import pytest

from pqsec_pki.certificates import Certificate
from pqsec_pki.est import EST
from pqsec_pki.server import begin_server
from tests.interop.est_clients import ran
from tests.unit.serving import HOST, Server

pytestmark = [pytest.mark.interop, pytest.mark.timeout(300)]

JARS = ("bcprov", "bcutil", "bcpkix", "bctls")
EC = ("-algorithm", "EC", "-pkeyopt", "ec_paramgen_curve:P-256")
PKCS10 = ("-H", "Content-Type: application/pkcs10", "--data-binary", "@-")


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


def test_strongswan_enrols_and_renews(est_clients, classical):
    shutil.copy(classical.folder / "1.pem", est_clients.folder)
    server = ("--url", f"https://{HOST}:{classical.port}", "--cacert", "1.pem")
    est_clients.run("pki", "--estca", *server, "--caout", "root.pem", "--outform", "pem")
    found = next(est_clients.folder.glob("root*.pem")).read_bytes()
    assert Certificate.from_pem(found).der == classical.keystore.identity_ca.der
    token = classical.token("/fleet/r1", replaces=True)
    user = ("--userpass", f"{token.id}:{token.secret}")
    for key, shown in (("1", user), ("2", ("--cert", "1.crt", "--key", "1.key"))):
        made = est_clients.run(
            "pki", "--gen", "--type", "ecdsa", "--size", "256", "--outform", "pem"
        )
        (est_clients.folder / f"{key}.key").write_bytes(made)
        asked = est_clients.run("pki", "--req", "--in", f"{key}.key", "--dn", "CN=/fleet/r1")
        (est_clients.folder / f"{key}.req").write_bytes(asked)
        got = est_clients.run(
            "pki", "--est", *server, "--in", f"{key}.req", *shown, "--outform", "pem"
        )
        (est_clients.folder / f"{key}.crt").write_bytes(got)
        assert Certificate.from_pem(got).subject_name == "CN=/fleet/r1"


def test_libest_enrols_and_renews(est_clients, classical):
    shutil.copy(classical.folder / "1.pem", est_clients.folder)
    at = ("-s", HOST, "-p", str(classical.port), "-o", ".")

    def estclient(*words):
        est_clients.run("env", "EST_OPENSSL_CACERT=1.pem", "estclient", *at, *words)
        return est_clients.folder / "cert-0-0.pem"

    est_clients.run("openssl", "genpkey", *EC, "-out", "own.key")
    estclient("-g")
    found = base64.b64decode((est_clients.folder / "cacert-0-0.pkcs7").read_bytes())
    assert classical.keystore.identity_ca.der in found
    token = classical.token("/fleet/r3", replaces=True)
    user = ("-u", token.id, "-h", token.secret, "--common-name", "/fleet/r3")
    enrolled = estclient("-e", *user, "-x", "own.key", "-z", "--pem-output")
    first = enrolled.rename(est_clients.folder / "own.crt")
    renewed = estclient("-r", "-c", "own.crt", "-k", "own.key", "--pem-output")
    names = [Certificate.from_pem(each.read_bytes()).subject_name for each in (first, renewed)]
    assert names == ["CN=/fleet/r3"] * 2
    assert first.read_bytes() != renewed.read_bytes()


@pytest.mark.slow
def test_bouncy_castle_enrols_and_renews_with_a_link_to_its_connection(
    est_clients, classical, requires
):
    java = (
        requires(shutil.which("javac"), "Java", "apt-get install openjdk-17-jdk-headless")
        and "java"
    )
    jars = ":".join(str(est_clients.root / "usr/share/java" / f"{each}.jar") for each in JARS)
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


def test_curl_and_openssl_enrol_and_renew_with_ml_dsa(est_clients, post_quantum):
    """Post-quantum throughout: X25519MLKEM768, ML-DSA-65 on both sides."""
    shutil.copy(post_quantum.folder / "0.pem", est_clients.folder)
    url = f"https://{HOST}:{post_quantum.port}{EST}"
    known = ("curl", "-sS", "--fail", "-v", "--stderr", "log", "--cacert", "0.pem")

    def curl(path, *more, data=b""):
        return base64.b64decode(est_clients.run(*known, *more, url + path, data=data))

    def certificates(der):
        return est_clients.run("openssl", "pkcs7", "-inform", "DER", "-print_certs", data=der)

    def asked(key):
        words = ("-newkey", "ML-DSA-65", "-nodes", "-keyout", key, "-outform", "DER")
        (est_clients.folder / "empty").touch()
        subject = ("-config", "empty", "-subj", "/CN=\\/fleet\\/r1")
        return base64.encodebytes(est_clients.run("openssl", "req", "-new", *words, *subject))

    (est_clients.folder / "cas.pem").write_bytes(certificates(curl("/cacerts")))
    token = post_quantum.token("/fleet/r1", replaces=True)
    user = ("--user", f"{token.id}:{token.secret}")
    own = ("--cert", "1.crt", "--key", "1.key")
    for number, path, shown in ((1, "/simpleenroll", user), (2, "/fleet/simplereenroll", own)):
        der = curl(path, *shown, *PKCS10, data=asked(f"{number}.key"))
        (est_clients.folder / f"{number}.crt").write_bytes(certificates(der))
        est_clients.run("openssl", "verify", "-CAfile", "cas.pem", f"{number}.crt")
        log = (est_clients.folder / "log").read_text()
        assert "X25519MLKEM768" in log
