"""Keys in tokens, with what only Debian sid has: tokens with ML-DSA, OpenSSL's pkcs11-provider."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.interop.conftest import TOPIC
from tests.interop.tokens import Token
from tests.longer import LONG

pytestmark = [
    pytest.mark.interop,
    pytest.mark.timeout(300),
    pytest.mark.skipif(not LONG, reason="in .ci/long: Debian sid changes daily"),
]

NAMES = ("alice", "bob")
CONFIGURATION = """
openssl_conf = all
[all]
providers = both
[both]
default = own
pkcs11 = token
[own]
activate = 1
[token]
activate = 1
module = {libraries}/ossl-modules/pkcs11.so
pkcs11-module-path = {libraries}/softhsm/libsofthsm2.so
pkcs11-module-token-pin = file:{pin}
"""


@pytest.fixture(scope="module")
def sid(requires) -> Path:
    return Path(requires(os.environ.get("PQSEC_SID"), "Debian sid", "run .ci/sid"))


def issued(token, profile) -> None:
    token.pqsec("ca", "init", "--profile", profile, "--no-passphrase")
    for name in NAMES:
        place = ("--participant-key-uri", f"pkcs11:token=lab;object={name}")
        token.pqsec("issue", name, *place, "--publish", TOPIC, "--subscribe", TOPIC)


def test_two_whose_ml_dsa_keys_are_in_a_token_shake_hands(sid, tmp_path):
    token = Token.ml_dsa(tmp_path, sid)
    issued(token, "pq")
    private = token.objects().split("Private Key Object")[1:]
    assert len(private) == 2
    assert all("never extractable" in each for each in private)
    assert "/alice to /bob" in token.pqsec("verify-handshake", *NAMES)


def test_openssl_uses_the_reference_as_a_key(sid, token, openssl):
    """What it signs with the file `key.pem` is a signature by the certificate's key."""
    issued(token, "classical")
    enclave = token.folder / "k/enclaves/alice"
    pin, message = token.folder / "pin-alone", token.folder / "message"
    pin.write_text(token.pin_file.read_text().strip())
    message.write_text("a message")
    libraries = sid / "usr/lib/x86_64-linux-gnu"
    configuration = token.folder / "openssl.cnf"
    configuration.write_text(CONFIGURATION.format(libraries=libraries, pin=pin))
    loader = (sid / "usr/lib64/ld-linux-x86-64.so.2", "--library-path", libraries)
    signed = token.folder / "signature"
    words = ("pkeyutl", "-sign", "-rawin", "-digest", "sha256", "-in", message, "-out", signed)
    done = subprocess.run(
        [*loader, sid / "usr/bin/openssl", *words, "-inkey", enclave / "key.pem"],
        env={**token.environment, "OPENSSL_CONF": str(configuration)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    public = token.folder / "public.pem"
    openssl("x509", "-in", enclave / "cert.pem", "-noout", "-pubkey", "-out", public)
    openssl("dgst", "-sha256", "-verify", public, "-signature", signed, message)
