"""One request for all sets of credentials: what it proves, and what is refused, all or nothing."""

import os
from dataclasses import replace

import pytest

from pqsec_pki.algorithms import load_private_key, profile_named
from pqsec_pki.algorithms._composite import Composite
from pqsec_pki.certificates import Certificate, CertificateRequest, Reason, certificate_request
from pqsec_pki.certificates.requesting import _signed
from pqsec_pki.credentials import KEY
from pqsec_pki.documents import DomainSet
from pqsec_pki.enrolment import (
    Bundle,
    SignRequest,
    accept,
    install,
    key_places,
    pins_in_use,
    request,
    sign,
    validate_csrs,
)
from pqsec_pki.enrolment.csr_validation import keys_in
from pqsec_pki.errors import MalformedError, UsageError, VerificationError
from pqsec_pki.keystore import Keystore, audit, layout
from pqsec_pki.lifecycle import ParticipantSpec, add_set, issue, revoke
from pqsec_pki.lint import check
from tests.unit.keystores import DAY, NOW

CLASSICAL, HYBRID, PQ = map(profile_named, ("classical", "hybrid", "pq"))
BOTH = (CLASSICAL, HYBRID)
ROBOT, OTHER = "/fleet/r1", "/fleet/r2"
YEAR = 365 * DAY


def create(root, *profiles):
    return Keystore.create(
        root,
        *(profiles or BOTH),
        name="Lab",
        domains=DomainSet.of(0),
        validity=900 * DAY,
        passphrase=None,
        now=NOW,
    )


@pytest.fixture
def keystore(tmp_path):
    return create(tmp_path / "k")


def pairs(*profiles):
    """New keys for each profile."""
    return [
        (each.participant_key.generate(), each.alternative_key and each.alternative_key.generate())
        for each in profiles
    ]


def asked_for(name=ROBOT, keys=None):
    """A request for all sets, with these keys or new ones."""
    first, *further = keys or pairs(*BOTH)
    return certificate_request(name, *first, further=further)


def with_further(made, key, *further):
    """The request's keys in another one, which carries others; its holder signs that."""
    ders = [each.der for each in further]
    return CertificateRequest.from_der(_signed(made.common_name, key, None, further=ders))


def validated(made, profiles=BOTH):
    return validate_csrs([made], profiles, names=[made.common_name])[made.common_name]


def spec(name, keys=None):
    return ParticipantSpec(
        name=name, domains=DomainSet.of(0), publish=("t",), validity=YEAR, keys=keys
    )


def issued(keystore, *requests, **choices):
    specs = [spec(each.common_name, keys_in(each)) for each in requests]
    return issue(keystore, keystore.unlock(None), specs, now=NOW, **choices)


def halves(key):
    """A composite key with `key` as its traditional half."""
    row = HYBRID.participant_key
    assert isinstance(row, Composite)
    return row.private_key((row.ml_dsa.generate().handle, key.handle))


def certificate(keystore, name=ROBOT):
    path = keystore.folder / layout.enclave_folder(name) / layout.CERTIFICATE
    return Certificate.from_pem(path.read_bytes())


# What a request proves


def test_one_request_has_keys_for_all_sets_and_proves_each():
    made = asked_for()
    made.verify()
    keys = validated(CertificateRequest.from_pem(made.pem))
    assert [each.key.algorithm for each in keys.sets] == [each.participant_key for each in BOTH]
    assert {each.request for each in keys.sets} == {made.fingerprint}


def test_a_request_for_one_set_is_what_it_was():
    [(key, _)] = pairs(CLASSICAL)
    made = certificate_request(ROBOT, key)
    assert (made.further, made.first_key) == ((), None)
    assert len(validated(made, [CLASSICAL]).sets) == 1


@pytest.mark.parametrize(
    ("profiles", "problem"),
    [
        ((CLASSICAL,), "it lacks keys of profile hybrid"),
        ((HYBRID,), "it lacks keys of profile classical"),
        ((CLASSICAL, CLASSICAL), "it has 2 keys ecdsa-p256, for one set"),
        ((CLASSICAL, CLASSICAL, HYBRID), "it has 2 keys ecdsa-p256, for one set"),
        ((CLASSICAL, PQ), "which no set of credentials here has"),
        ((CLASSICAL, HYBRID, PQ), "which no set of credentials here has"),
        ((HYBRID, CLASSICAL), "another order than the sets of credentials here"),
    ],
)
def test_a_request_that_is_not_for_exactly_the_sets_is_refused(profiles, problem):
    with pytest.raises(VerificationError, match=problem):
        validated(asked_for(keys=pairs(*profiles)))


def test_a_request_for_two_sets_is_refused_where_there_is_one():
    with pytest.raises(VerificationError, match="which no set of credentials here has"):
        validated(asked_for(), [CLASSICAL])


def test_a_request_of_one_robot_beside_one_of_another_is_refused():
    [mine, *_], own = keys = pairs(*BOTH), asked_for(OTHER)
    made = asked_for(keys=keys[0])
    stolen = with_further(made, mine[0], *own.further)
    with pytest.raises(VerificationError) as caught:
        stolen.verify()
    assert any(f"its subject is CN={OTHER}" in each for each in caught.value.lines)
    assert any("not made beside the first one" in each for each in caught.value.lines)


def test_a_request_of_another_subject_is_refused_beside_the_very_key_it_names():
    (key, _), (second, _) = pairs(*BOTH)
    der = _signed(OTHER, second, None, first=key.public_key.spki)
    made = CertificateRequest.from_der(_signed(ROBOT, key, None, further=[der]))
    with pytest.raises(VerificationError, match=f"its subject is CN={OTHER}"):
        made.verify()


def test_a_replayed_request_of_the_same_robot_is_refused_beside_another_key():
    """Whoever breaks the classical algorithm has no proof for a hybrid key of its own."""
    seen = asked_for()
    [(thief, _)] = pairs(CLASSICAL)
    with pytest.raises(VerificationError, match="not made beside the first one"):
        with_further(seen, thief, *seen.further).verify()


def test_a_request_without_the_mark_is_refused_beside_any_key():
    (key, _), (second, _) = pairs(*BOTH)
    alone = certificate_request(ROBOT, second)
    with pytest.raises(VerificationError, match="it names another key, or none"):
        with_further(alone, key, alone).verify()


def test_a_request_that_is_swapped_on_its_way_is_refused():
    keys = pairs(*BOTH)
    mine, other = asked_for(keys=keys), asked_for(keys=[keys[0], *pairs(HYBRID)])
    [there], [instead] = mine.further, other.further
    assert len(there.der) == len(instead.der) or pytest.skip("of another length")
    swapped = CertificateRequest.from_der(mine.der.replace(there.der, instead.der))
    with pytest.raises(VerificationError) as caught:
        swapped.verify()
    assert caught.value.lines == (
        "no proof that the requester has the private key: bad ecdsa-p256 signature",
    )


def test_a_further_request_that_is_taken_out_is_refused_alone():
    [further] = asked_for().further
    with pytest.raises(VerificationError, match="came alone"):
        validated(further, [HYBRID])


@pytest.mark.parametrize("at", [0, 1])
def test_each_key_needs_its_own_proof(at):
    made, other = asked_for(), asked_for()
    sets = [*made.sets]
    sets[at] = replace(sets[at], signature=other.sets[at].signature)
    forged = replace(sets[0], further=(sets[1],))
    with pytest.raises(VerificationError, match="no proof that the requester has the private key"):
        forged.verify()


def test_requests_are_not_carried_in_depth_nor_without_end():
    [(key, _)] = pairs(CLASSICAL)
    inner = asked_for()
    deep = _signed(ROBOT, key, None, further=[inner.der])
    with pytest.raises(MalformedError, match="carries further ones"):
        CertificateRequest.from_der(deep)
    [one] = inner.further
    for many in ([one.der] * 9, [os.urandom(40)]):
        with pytest.raises(MalformedError):
            CertificateRequest.from_der(_signed(ROBOT, key, None, further=many))


# What is issued for it


@pytest.mark.parametrize("second", [HYBRID, PQ])
def test_all_sets_are_issued_for_one_request(tmp_path, second):
    keystore = create(tmp_path / "k", CLASSICAL, second)
    made = asked_for(keys=pairs(CLASSICAL, second))
    keys = validated(made, keystore.profiles)
    issue(keystore, keystore.unlock(None), [spec(ROBOT, keys)], now=NOW)
    for each, asked in zip(keystore.sets, made.sets, strict=True):
        assert certificate(each).spki == asked.spki
        assert not each.has_key(ROBOT)
        with each.open_ledger() as ledger:
            [line] = ledger.of_name("participant", ROBOT)
        assert line.details["request"] == made.fingerprint
    audit(keystore)
    assert "PQS010" not in {each.rule.id for each in check([keystore.root], now=NOW).findings}


def test_keys_for_some_of_the_sets_are_issued_nothing(keystore):
    [(key, _)] = pairs(CLASSICAL)
    before = keystore.lines()
    with pytest.raises(VerificationError, match="1 of 2 sets"):
        issued(keystore, certificate_request(ROBOT, key))
    assert keystore.lines() == before


def test_a_composite_key_is_refused_whose_half_is_the_classical_key(keystore):
    [(key, _)] = pairs(CLASSICAL)
    before = keystore.lines()
    with pytest.raises(VerificationError, match="one key is for two sets"):
        issued(keystore, asked_for(keys=[(key, None), (halves(key), None)]))
    assert keystore.lines() == before


def test_a_composite_key_is_refused_whose_half_is_the_classical_key_of_another(keystore):
    keys = pairs(*BOTH)
    taken = asked_for(OTHER, [*pairs(CLASSICAL), (halves(keys[0][0]), None)])
    with pytest.raises(VerificationError, match=f"{OTHER}: its key is that of {ROBOT}"):
        issued(keystore, asked_for(keys=keys), taken)
    issued(keystore, asked_for(keys=keys))
    with pytest.raises(VerificationError, match=f"{OTHER}: its key is that of {ROBOT}"):
        issued(keystore, taken)
    assert not keystore.has(OTHER)


def test_a_classical_key_is_refused_that_is_half_of_the_composite_key_of_another(keystore):
    [(key, _)] = pairs(CLASSICAL)
    issued(keystore, asked_for(keys=[*pairs(CLASSICAL), (halves(key), None)]))
    with pytest.raises(VerificationError, match=f"{OTHER}: its key is that of {ROBOT}"):
        issued(keystore, asked_for(OTHER, [(key, None), *pairs(HYBRID)]))


def test_a_key_is_refused_whose_half_was_compromised(keystore):
    [(key, _)] = pairs(CLASSICAL)
    issued(keystore, asked_for(keys=[(key, None), *pairs(HYBRID)]))
    authorities = keystore.unlock(None)
    revoke(keystore, authorities, [ROBOT], reason=Reason.KEY_COMPROMISE, now=NOW)
    asked = asked_for(OTHER, [*pairs(CLASSICAL), (halves(key), None)])
    with pytest.raises(VerificationError, match="revoked as compromised"):
        issued(keystore, asked)


def test_check_finds_a_composite_key_whose_half_is_the_classical_key(keystore):
    (first, _), _ = keys = pairs(*BOTH)
    issued(keystore, asked_for(keys=keys))
    view = keystore.sets[1]
    made = (
        keystore.unlock(None)
        .sets[1]
        .identity.issue(ROBOT, halves(first).public_key, number=1, now=NOW, validity=YEAR)
    )
    path = view.folder / layout.enclave_folder(ROBOT) / layout.CERTIFICATE
    path.write_bytes(made.pem)
    found = [each for each in check([keystore.root], now=NOW).findings if each.path == path]
    assert any("has the key of" in each.message for each in found if each.rule.id == "PQS010")


# The robot, and the machine with the CAs


def test_a_robot_gets_all_sets_for_one_request(tmp_path, keystore):
    robot = tmp_path / "robot"
    made = request(ROBOT, CLASSICAL, robot, further=[HYBRID]).request
    issued(keystore, made)
    bundle = Bundle.of(keystore, [ROBOT], now=NOW, keys=False)
    install(bundle.to_bytes(), robot, pins_in_use(keystore), now=NOW)
    for place in ("", "sets/hybrid/"):
        [key] = (robot / "current").glob(f"{place}enclaves/fleet/r1/{KEY}")
        load_private_key(key.read_bytes())
    assert not [*(robot / "requests").iterdir()]


def test_a_participant_left_by_an_added_set_asks_for_what_it_lacks(tmp_path):
    keystore, robot = create(tmp_path / "k", CLASSICAL), tmp_path / "robot"
    issued(keystore, request(ROBOT, CLASSICAL, robot).request)
    bundle = Bundle.of(keystore, [ROBOT], now=NOW, keys=False)
    install(bundle.to_bytes(), robot, pins_in_use(keystore), now=NOW)
    added = add_set(
        keystore, keystore.unlock(None), HYBRID, validity=900 * DAY, passphrase=None, now=NOW
    )
    assert added.left == (ROBOT,)
    keystore = Keystore.open(keystore.root)
    held = certificate(keystore)
    made = request(ROBOT, CLASSICAL, robot, further=[HYBRID]).request
    assert made.spki == held.spki  # the classical key stays
    issued(keystore, made, force=True)
    bundle = Bundle.of(keystore, [ROBOT], now=NOW + DAY, keys=False)
    install(bundle.to_bytes(), robot, pins_in_use(keystore), now=NOW + DAY)
    assert (robot / "current/sets/hybrid/enclaves/fleet/r1/key.pem").exists()


def test_a_request_that_waits_stays_while_one_of_its_keys_is_not_installed(tmp_path):
    keystore, robot = create(tmp_path / "k", CLASSICAL), tmp_path / "robot"
    issued(keystore, request(ROBOT, CLASSICAL, robot).request)
    bundle = Bundle.of(keystore, [ROBOT], now=NOW, keys=False).to_bytes()
    install(bundle, robot, pins_in_use(keystore), now=NOW)
    request(ROBOT, CLASSICAL, robot, further=[HYBRID])
    install(bundle, robot, now=NOW + DAY)
    assert [*(robot / "requests").rglob("sets/hybrid/key.pem")]


def test_an_offline_ca_answers_for_all_sets(tmp_path, keystore):
    made = [
        request(name, CLASSICAL, tmp_path / name[1:], further=[HYBRID]).request
        for name in (ROBOT, OTHER)
    ]
    asked = SignRequest(tuple(made), (spec(ROBOT), spec(OTHER)))
    asked = SignRequest.from_bytes(asked.to_bytes(now=NOW))
    answer = sign(asked, keystore, keystore.unlock(None), now=NOW)
    done = accept(answer, asked, tmp_path / "out", pins=pins_in_use(keystore), now=NOW)
    assert [each.name for each in done] == [ROBOT, OTHER]


def test_an_answer_with_another_key_in_a_further_set_is_not_accepted(tmp_path, keystore):
    keys = pairs(*BOTH)
    mine, swapped = asked_for(keys=keys), asked_for(keys=[keys[0], *pairs(HYBRID)])
    asked, other = (SignRequest((each,), (spec(ROBOT),)) for each in (mine, swapped))
    data = asked.to_bytes(now=NOW)
    asked, other = (
        SignRequest.from_bytes(data),
        replace(other, sha256=SignRequest.from_bytes(data).sha256),
    )
    answer = sign(other, keystore, keystore.unlock(None), now=NOW)
    with pytest.raises(VerificationError, match="is for another key than in the request"):
        accept(answer, asked, tmp_path / "out", now=NOW)


def test_keys_in_tokens_are_for_sets_that_there_are(tmp_path):
    with pytest.raises(UsageError, match=r"have no sets/pq/key\.pem"):
        key_places(BOTH, {"sets/pq/key.pem": "pkcs11:token=a;object=b"})
