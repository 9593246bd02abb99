"""OpenSSL, with which the stacks verify, judges chains and signers of tests/unit as expected."""

import subprocess

import pytest

from pqsec_pki.algorithms import pem
from tests.unit import signers
from tests.unit.chains import CASES

pytestmark = pytest.mark.interop


@pytest.mark.parametrize("any_openssl", ["system", "3.5"], indirect=True)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_openssl_judges_a_chain_as_expected(case, any_openssl, put):
    ca, leaf = (
        put(f"{each}.pem", pem("CERTIFICATE", getattr(case, each))) for each in ("ca", "leaf")
    )
    options = []
    if case.crl:
        options = ["-crl_check", "-CRLfile", put("crl.pem", pem("X509 CRL", case.crl))]
    words = [any_openssl.path, "verify", "-CAfile", ca, *options, leaf]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    expected = case.accepted or (case.older and any_openssl.version < (3, 5))
    assert (done.returncode == 0) == expected, done.stderr


READERS = [("smime", "-noverify"), ("cms", "-noverify"), ("smime", "-purpose", "any")]


@pytest.mark.parametrize("any_openssl", ["system", "3.5"], indirect=True)
@pytest.mark.parametrize("reader", READERS, ids=" ".join)
@pytest.mark.parametrize("case", signers.CASES, ids=str)
def test_openssl_finds_a_signer_as_expected(case, reader, any_openssl, put):
    message, ca = put("message.p7s", case.message), put("ca.pem", pem("CERTIFICATE", case.ca))
    pinned = ["-verify", "-text", "-nointern", "-certfile", ca, "-CAfile", ca, "-in", message]
    words = [any_openssl.path, *reader, *pinned]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert (done.returncode == 0) == case.accepted, done.stderr
