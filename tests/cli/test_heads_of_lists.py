"""`revoke` and `ca crl` sign a head of the ledger at once, if that asks for nothing more."""

import pytest

from pqsec_pki.algorithms import SIGNATURES, private_key_pem
from pqsec_pki.keystore import Keystore
from pqsec_pki.keystore.heads import read_head

COMMANDS = "revoke /talker --yes", "ca crl"


def unsigned(root):
    """How many lines no head is over."""
    return len(Keystore.open(root).lines()) - read_head(root).head.size


@pytest.mark.parametrize("command", COMMANDS)
def test_a_head_is_over_the_new_lines(keystore, pqsec, command):
    root = keystore()
    pqsec(f"-k {root} {command}").done()
    assert unsigned(root) == 0


def test_one_passphrase_opens_both_cas(locked, pqsec):
    pqsec("-k k issue /talker --publish x --passphrase-file right").done()
    pqsec("-k k revoke /talker --yes --passphrase-file wrong").refused(3, "passphrase")
    pqsec("-k k revoke /talker --yes --passphrase-file right").done()
    assert unsigned(locked) == 0
    pqsec("-k k log --verify").done()


@pytest.mark.parametrize("flaw", ["another passphrase", "damaged", "a folder"])
def test_a_revocation_does_not_fail_without_the_permissions_key(keystore, pqsec, flaw):
    root = keystore()
    path = root / "private/permissions_ca.key.pem"
    key = SIGNATURES.named("ecdsa-p256").generate()
    if flaw == "another passphrase":
        path.write_bytes(private_key_pem(key, b"another one, of the others"))
    elif flaw == "damaged":
        path.write_bytes(b"nothing")
    else:
        path.unlink()
        path.mkdir()
    pqsec(f"-k {root} revoke /talker --yes").done()
    assert unsigned(root) > 0
