"""OpenSSL 3.5 derives the secrets that we derive, from our shares and from its own.

Its hybrids are those of TLS (RFC 10024), put together by its own code.
"""

import subprocess

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS
from pqsec_pki.algorithms._diffie_hellman import ModpKey, P
from pqsec_pki.errors import VerificationError
from tests.fuzz import libcrypto
from tests.interop import evp

pytestmark = pytest.mark.interop

GROUPS = {
    "ecdh-p256": "EC:P-256",
    "ecdh-p384": "EC:P-384",
    "dh-modp-2048-256": "DH:dh_2048_256",
    "mlkem768": "ML-KEM-768",
    "mlkem1024": "ML-KEM-1024",
    "x25519mlkem768": "X25519MLKEM768",
    "secp256r1mlkem768": "SecP256r1MLKEM768",
    "secp384r1mlkem1024": "SecP384r1MLKEM1024",
}
MODP = KEY_AGREEMENTS.named("dh-modp-2048-256")
every_row = pytest.mark.parametrize("row", list(KEY_AGREEMENTS), ids=lambda row: row.name)
of_fixed_size = pytest.mark.parametrize(
    "row", [row for row in KEY_AGREEMENTS if row is not MODP], ids=lambda row: row.name
)
IN_ML_KEM = {"mlkem768": 0, "mlkem1024": 0, "x25519mlkem768": 0}
"""An octet of each ciphertext that is ML-KEM's: the first, or else the last."""


class Conversation:
    """With evp.py: each method is one of its lines. See there."""

    def __init__(self, process):
        self._process = process
        self.version = self._answer()

    def generate(self, row):
        return self._ask("generate", GROUPS[row.name])[0]

    def encapsulate(self, row, public):
        return self._ask("encapsulate", GROUPS[row.name], plain(row, public).hex())

    def decapsulate(self, row, ciphertext):
        return self._ask("decapsulate", plain(row, ciphertext).hex())[0]

    def _ask(self, *words):
        print(*words, file=self._process.stdin, flush=True)
        first, *rest = self._answer().split()
        if first == "refused":
            raise evp.RefusedError(" ".join(rest))
        return [bytes.fromhex(octets) for octets in (first, *rest)]

    def _answer(self):
        line = self._process.stdout.readline()
        assert line, self._process.stderr.read()
        return line


def plain(row, octets):
    """`octets` as OpenSSL reads them: a MODP number without DER, as long as the prime."""
    if row is not MODP:
        return octets
    header = 2 + (octets[1] & 0x7F) if len(octets) > 256 else 0
    return int.from_bytes(octets[header:]).to_bytes(256)


@pytest.fixture(scope="module")
def peer(openssl35):
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    with subprocess.Popen(
        libcrypto.command(openssl35.path, evp.__file__), text=True, **pipes
    ) as process:
        yield Conversation(process)
        process.stdin.close()


def flipped(octets, at):
    at %= len(octets)
    return octets[:at] + bytes([octets[at] ^ 1]) + octets[at + 1 :]


def test_the_library_is_that_of_the_command(peer, openssl35):
    assert peer.version.split()[1] == openssl35("version").decode().split()[1]


@every_row
def test_openssl_encapsulates_to_our_key(peer, row):
    own = row.generate()
    ciphertext, secret = peer.encapsulate(row, own.public)
    assert own.decapsulate(ciphertext) == secret


@every_row
def test_we_encapsulate_to_a_key_of_openssl(peer, row):
    ciphertext, secret = row.encapsulate(peer.generate(row))
    assert peer.decapsulate(row, ciphertext) == secret


def test_a_modp_secret_that_is_short_is_short_for_both(peer):
    theirs = peer.generate(MODP)
    base = power = int.from_bytes(theirs)
    exponent = 1
    while power.bit_length() > 255 * 8:
        exponent, power = exponent + 1, power * base % P
    own = MODP.key_pair(ModpKey(exponent))
    secret = own.decapsulate(theirs)
    assert len(secret) < 256
    assert peer.decapsulate(MODP, own.public) == secret


@of_fixed_size
def test_shares_and_secrets_of_openssl_have_the_sizes_the_row_says(peer, row):
    ciphertext, secret = peer.encapsulate(row, public := peer.generate(row))
    sizes = (row.public_size, row.ciphertext_size, row.secret_size)
    assert (len(public), len(ciphertext), len(secret)) == sizes


@of_fixed_size
@pytest.mark.parametrize(
    "change",
    [lambda share: share[:-1], lambda share: share + b"\0", lambda share: b"\xff" * len(share)],
    ids=["short", "long", "all ones"],
)
def test_a_share_that_openssl_refuses_we_refuse(peer, row, change):
    bad = change(peer.generate(row))
    with pytest.raises(evp.RefusedError):
        peer.encapsulate(row, bad)
    with pytest.raises(VerificationError):
        row.encapsulate(bad)


def test_an_x25519_share_that_fixes_the_secret_is_refused_by_both(peer):
    row = KEY_AGREEMENTS.named("x25519mlkem768")
    bad = peer.generate(row)[:-32] + bytes(32)
    with pytest.raises(evp.RefusedError):
        peer.encapsulate(row, bad)
    with pytest.raises(VerificationError):
        row.encapsulate(bad)


@pytest.mark.parametrize("name", [name for name in GROUPS if "mlkem" in name])
def test_a_changed_ml_kem_ciphertext_parts_the_two(peer, name):
    row = KEY_AGREEMENTS.named(name)
    ciphertext, secret = row.encapsulate(peer.generate(row))
    theirs = peer.decapsulate(row, flipped(ciphertext, IN_ML_KEM.get(name, -1)))
    assert len(theirs) == len(secret)
    assert theirs != secret


@pytest.mark.parametrize("name", [name for name in GROUPS if name.startswith(("ecdh", "secp"))])
def test_a_point_off_the_curve_is_refused_by_both(peer, name):
    row = KEY_AGREEMENTS.named(name)
    own, [ciphertext, _] = row.generate(), row.encapsulate(peer.generate(row))
    bad = flipped(ciphertext, 20)
    with pytest.raises(evp.RefusedError):
        peer.decapsulate(row, bad)
    with pytest.raises(VerificationError):
        own.decapsulate(bad)
