"""The rules about post-quantum signatures: each sees what was left out, broken or weakened."""

import json
import shutil

import pytest

from pqsec_pki.algorithms import SIGNATURES
from pqsec_pki.certificates import Authority, Certificate
from pqsec_pki.lint.post_quantum.keys import STOCK
from pqsec_pki.smime import Signer, document_in, sign
from tests.unit.keystores import NOW
from tests.unit.linting import TALKER, Lab

P7S = f"{TALKER}/permissions.p7s"


@pytest.fixture
def lab(tmp_path):
    return Lab(tmp_path)


@pytest.mark.parametrize("target", STOCK)
@pytest.mark.parametrize("profile", ["hybrid", "pq", "cnsa2"])
def test_a_stock_target_cannot_run_post_quantum_identities(tmp_path, profile, target):
    assert {"PQS601", "PQS602"} <= set(Lab(tmp_path, profile).found(target))


@pytest.mark.parametrize("target", STOCK)
@pytest.mark.parametrize("profile", ["transition", "classical"])
def test_a_stock_target_runs_the_others(tmp_path, profile, target):
    assert not {"PQS601", "PQS602"} & set(Lab(tmp_path, profile).found(target))


def talkers(lab):
    return Certificate.from_pem((lab / TALKER / "cert.pem").read_bytes())


def issued_by(authority, lab, *, alternative=True):
    own = talkers(lab)
    second = own.alternative_key if alternative else None
    validity = own.not_after - NOW
    return authority.issue(
        "/talker", own.public_key, alternative=second, now=NOW, validity=validity
    ).pem


def by_another_alternative_key(lab):
    """Files that an attacker who broke ECDSA could make."""
    identity = lab.authorities().identity
    other = SIGNATURES.named("ml-dsa-65").generate()
    return issued_by(Authority(identity.certificate, identity.key, other), lab)


def without_alternative_signature(lab):
    identity = lab.authorities().identity
    return issued_by(Authority(identity.certificate, identity.key, None), lab)


def without_alternative_key(lab):
    return issued_by(lab.authorities().identity, lab, alternative=False)


@pytest.mark.parametrize(
    ("make", "rules"),
    [
        (by_another_alternative_key, {"PQS603"}),
        (without_alternative_signature, {"PQS604"}),
        (without_alternative_key, {"PQS604", "PQS609", "PQS319"}),
    ],
)
def test_a_certificate_without_a_good_alternative_is_found(lab, make, rules):
    lab.put(f"{TALKER}/cert.pem", make(lab))
    assert set(lab.found()) == rules


def test_a_certificate_issued_again_is_not_complained_of(lab):
    lab.put(f"{TALKER}/cert.pem", issued_by(lab.authorities().identity, lab))
    assert lab.found() == {}


def signed(lab, countersigner):
    permissions = lab.authorities().permissions
    text = document_in((lab / P7S).read_bytes())
    signer = Signer(permissions.certificate, permissions.key)
    return sign(text, signer, countersigner=countersigner, now=NOW)


def countersigner(lab, key=None):
    counter = lab.authorities().countersigner
    return Signer(counter.certificate, key or counter.key)


def test_a_stripped_countersignature_is_found(lab):
    lab.put(P7S, signed(lab, None))
    assert set(lab.found()) == {"PQS605"}


def test_a_forged_countersignature_is_found(lab):
    other = SIGNATURES.named("ml-dsa-65").generate()
    lab.put(P7S, signed(lab, countersigner(lab, other)))
    assert set(lab.found()) == {"PQS606", "PQS319"}  # so it lacks one that must be there


def test_a_good_countersignature_is_not_complained_of(lab):
    lab.put(P7S, signed(lab, countersigner(lab)))
    assert lab.found() == {}


def test_a_countersigner_that_is_not_there_is_found(lab):
    (lab / TALKER / "permissions_ca.alt.cert.pem").unlink()
    assert set(lab.found()) == {"PQS607", "PQS319"}  # so a signature cannot be checked


def test_a_foreign_document_that_is_countersigned_asks_for_no_countersigner(tmp_path):
    """PQS607 blamed a classical keystore for a document that its permissions CA did not sign."""
    home, away = Lab(tmp_path / "home", "classical"), Lab(tmp_path / "away", "transition")
    home.put(P7S, (away / P7S).read_bytes())
    assert set(home.found()) == {"PQS340"}


def test_a_countersigner_that_was_taken_away_with_its_signatures_is_found(lab):
    lab.put(P7S, signed(lab, None))
    lab.put(f"{TALKER}/governance.p7s", signed(lab, None))
    (lab / TALKER / "permissions_ca.alt.cert.pem").unlink()
    assert "PQS607" in lab.found()


def test_an_alternative_key_that_is_not_there_is_found(lab):
    (lab / TALKER / "alt.key.pem").unlink()
    assert set(lab.found()) == {"PQS608"}


def test_who_has_no_alternative_key_needs_none(tmp_path):
    lab = Lab(tmp_path, "classical")
    assert not (lab / TALKER / "alt.key.pem").exists()
    assert lab.found() == {}


@pytest.mark.parametrize(("profile", "weaker"), [("cnsa2", "pq"), ("pq", "classical")])
def test_an_enclave_that_is_weaker_than_the_profile_is_found(tmp_path, profile, weaker):
    lab = Lab(tmp_path, profile)
    shutil.rmtree(lab / TALKER)
    other = Lab(tmp_path / "weaker", weaker)
    shutil.copytree(other / TALKER, lab / TALKER, symlinks=True)
    assert lab.found()["PQS609"].path == lab / TALKER / "cert.pem"


def test_a_stronger_key_than_the_profile_promises_is_not_complained_of(tmp_path):
    lab = Lab(tmp_path, "cnsa2")
    settings = json.loads((lab / "pqsec.json").read_bytes())
    names = Lab(tmp_path / "weaker", "pq") / "pqsec.json"
    settings["algorithms"] = json.loads(names.read_bytes())["algorithms"]
    lab.put("pqsec.json", json.dumps(settings).encode())
    assert lab.found() == {}


def foreign(lab):
    """As if pqsec had not made it."""
    (lab / "pqsec.json").unlink()
    (lab / "private/ledger.sqlite3").unlink()


def test_classical_keys_that_nobody_chose_are_told(tmp_path):
    lab = Lab(tmp_path, "classical")
    assert "PQS610" not in lab.found()
    foreign(lab)
    assert set(lab.found()) == {"PQS610"}


def test_the_transition_profile_is_no_classical_one(lab):
    foreign(lab)
    assert lab.found() == {}
