"""pqsec and OpenSSL read the same in hostile S/MIME and PEM: a few thousand files in each run.

And stacks decide by policies as pqsec says, and what crashes them pqsec does not sign. The long job
has a million files of each kind, or a million answers: python -m tests.fuzz.differential
"""

import random
import shutil
from datetime import timedelta

import pytest

from pqsec_pki.algorithms import SIGNATURES, private_key_pem
from pqsec_pki.documents import DomainSet, Governance, Grant, Permissions
from tests.fuzz import differential, documents, libcrypto
from tests.longer import LONG

INPUTS = 400
DOCUMENTS = 60
FIXED = 20261122
SEEDS = {"": FIXED} | ({"new": random.SystemRandom().randrange(1 << 32)} if LONG else {})
"""In the longer job also another one each time: what it finds must not refuse another change."""


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
@pytest.mark.parametrize("seed", SEEDS.values(), ids=SEEDS)
@pytest.mark.parametrize("name", ["smime", "certificates", "lists", "requests", "chains", "keys"])
def test_what_we_read_openssl_reads_too(kinds, peers, name, seed):
    print("seed", seed)  # a run that fails shows it: tests.fuzz.differential --seed
    result = differential.run(kinds[name], peers, INPUTS, seed)
    assert not result.findings, (seed, result.findings, result.examples)
    assert result.taken > INPUTS / 20  # else it says little


@pytest.fixture(scope="module")
def some_stack(plugins, fastdds):
    """Those that are always there; others take part if they are there."""


@pytest.mark.slow(but=2)
@pytest.mark.interop
@pytest.mark.parametrize("seed", SEEDS.values(), ids=SEEDS)
@pytest.mark.parametrize("name", ["policies", "documents"])
def test_what_we_say_of_a_document_the_stacks_do(kinds, some_stack, name, seed):
    print("seed", seed)
    with kinds[name].peers([]) as peers:
        result = differential.run(kinds[name], peers, DOCUMENTS, seed)
    assert not result.findings, (seed, result.findings, result.examples)
    assert result.answers > DOCUMENTS * len(peers)


@pytest.mark.interop
def test_a_document_that_crashes_a_stack_is_kept_and_the_next_one_is_answered(
    kinds, some_stack, now
):
    governance = Governance.protected(DomainSet.of(0)).to_xml()
    grant = {"subject_name": documents.SUBJECT, "publish": ["a"], "domains": DomainSet.of(0)}
    until = {"not_before": now - timedelta(days=1), "not_after": now + timedelta(days=1)}
    permissions = Permissions(grants=(Grant.least(**grant, **until),)).to_xml()
    empty = governance.replace(b"<topic_expression>*<", b"<topic_expression><")
    asked = permissions, b"0", b"join", b"publish\0a"
    files = [libcrypto.pack([each, *asked]) for each in (empty, governance) * 2]
    kind = kinds["documents"]
    with kind.peers([]) as peers:
        for peer in peers:
            crash, first, again, second = kind.ask(peer, files)
            assert crash == again == [b"crash", b"SIGSEGV"], peer.stack.name
            assert first == second == [b"", b"yyyy"]
    assert {letters for _, letters in kind.read(files[0])} == {"cccc"}


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
