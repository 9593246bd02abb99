"""pqsec and OpenSSL read the same in hostile S/MIME and PEM: a few thousand files in each run.

The long job reads a million of each: python -m tests.fuzz.differential --inputs 1000000
"""

import random
import shutil

import pytest

from pqsec_pki.algorithms import SIGNATURES, private_key_pem
from tests.fuzz import differential

INPUTS = 400
FIXED = 20261122


@pytest.fixture(scope="module")
def kinds():
    return differential.kinds()


@pytest.fixture(scope="module")
def peers(openssl, openssl35):
    """The libraries of both: one, where the machine's own OpenSSL is a 3.5."""
    programs = {shutil.which(openssl.path), shutil.which(openssl35.path)}
    with differential.peers(sorted(programs)) as found:
        assert len({each.version for each in found}) == len(programs)
        yield found


@pytest.mark.slow(but=4)
@pytest.mark.interop
@pytest.mark.parametrize("seed", [FIXED, random.SystemRandom().randrange(1 << 32)], ids=["", "new"])
@pytest.mark.parametrize("name", ["smime", "certificates", "lists", "requests", "chains", "keys"])
def test_what_we_read_openssl_reads_too(kinds, peers, name, seed):
    print("seed", seed)  # a run that fails shows it: tests.fuzz.differential --seed
    result = differential.run(kinds[name], peers, INPUTS, seed)
    assert not result.findings, (seed, result.findings, result.examples)
    assert result.taken > INPUTS / 20  # else it says little


@pytest.mark.interop
def test_what_openssl_reads_does_not_depend_on_what_it_read_before(peers):
    """Behind a damaged block it looks at the oldest error that was left, if any was."""
    key = private_key_pem(SIGNATURES.named("ecdsa-p256").generate())
    damaged = b"-----BEGIN CERTIFICATE-----\nMIIBc\n-----END CERTIFICATE-----\n"
    header = b"Proc-Type: 4,ENCRYPTED\nDEK-Info: FOO,00\n"
    unknown_cipher = b"-----BEGIN EC PRIVATE KEY-----\n%s\nAAAA\n-----END EC PRIVATE KEY-----\n"
    for peer in peers:
        refused, found = peer.ask(b"K", [unknown_cipher % header, damaged + key])
        assert (len(refused), len(found)) == (0, 1), peer.version
