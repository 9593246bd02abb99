"""Requests for several sets of credentials, by commands."""

import pytest

TWO = "--profile classical,hybrid"
CSR = "credentials/requests/fleet+r1/request.csr"


@pytest.fixture
def k(pqsec, tmp_path):
    """A keystore with two sets."""
    pqsec(f"-k k ca init {TWO} --no-passphrase").done()
    return tmp_path / "k"


def test_a_robot_gets_both_sets_by_one_request(pqsec, k, tmp_path):
    pqsec(f"request /fleet/r1 {TWO}").done()
    facts = pqsec(f"inspect {CSR}").done().out
    assert "verified: the requester has the private key of each set" in facts
    pqsec(f"-k k issue /fleet/r1 --csr {CSR} --publish t").done()
    pqsec("install fleet+r1.bundle --trust-first").done()
    current = tmp_path / "credentials/current"
    for each in (current, current / "sets/hybrid"):
        assert (each / "enclaves/fleet/r1/key.pem").exists()
    pqsec("-k k check").done()
    # Its rights are changed by answering the same request again.
    again = "-k k issue /fleet/r1 --csr k/enclaves/fleet/r1/request.pem --force --publish t,u"
    pqsec(f"{again} --bundles out").done()
    pqsec("install out/fleet+r1.bundle").done()


def test_a_request_for_one_set_names_the_command_for_all(pqsec, k):
    pqsec("request /fleet/r1 --profile classical").done()
    done = pqsec(f"-k k issue /fleet/r1 --csr {CSR} --publish t")
    assert done.code == 1
    assert "it lacks keys of profile hybrid" in done.err
    assert f"`pqsec request {TWO}` makes one for all sets here" in done.err
    assert not (k / "enclaves/fleet").exists()


def test_other_algorithms_are_for_one_profile(pqsec):
    done = pqsec(f"request /fleet/r1 {TWO} --participant-key ed25519")
    assert (done.code, "are for a keystore with one profile" in done.err) == (2, True)


def test_a_robot_left_by_an_added_set_asks_with_the_key_that_it_has(pqsec, tmp_path):
    pqsec("-k k ca init --profile classical --no-passphrase").done()
    pqsec("request /fleet/r1 --profile classical").done()
    pqsec(f"-k k issue /fleet/r1 --csr {CSR} --publish t").done()
    pqsec("install fleet+r1.bundle --trust-first").done()
    key = tmp_path / "credentials/current/enclaves/fleet/r1/key.pem"
    before = key.read_bytes()
    pqsec("-k k ca add-set hybrid").done()
    pqsec(f"request /fleet/r1 {TWO}").done()
    pqsec(f"-k k issue /fleet/r1 --csr {CSR} --publish t --force --bundles out").done()
    pins = pqsec("-k k ca show --pins").done().out.split()
    options = " ".join(f"--ca-fingerprint {each}" for each in pins if ":" in each)
    pqsec(f"install out/fleet+r1.bundle {options}").done()
    assert key.read_bytes() == before
    assert (tmp_path / "credentials/current/sets/hybrid/enclaves/fleet/r1/key.pem").exists()


def test_an_offline_ca_signs_requests_for_both_sets(pqsec, k):
    pqsec(f"request /fleet/r1 /fleet/r2 {TWO} --csr both.csr").done()
    pqsec("sign-request export both.csr --publish t -o asked").done()
    pqsec("-k k sign-request sign asked -o answer --allow-name '/fleet/*'").done()
    pqsec("sign-request import answer --request asked --bundles out").done()
