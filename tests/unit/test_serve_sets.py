"""`pqsec serve` with several sets of credentials: one admission for all of them, or none."""

from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki._asn1 import Oid, encode
from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import FURTHER_REQUESTS, Certificate, certificate_request
from pqsec_pki.enrolment import install, pins_in_use, request
from pqsec_pki.errors import VerificationError
from pqsec_pki.est import (
    EST,
    PEM_FILE,
    PKCS10,
    REQUESTS,
    EstClient,
    KeyTerms,
    KnownServer,
    ServerTrust,
    TlsIdentity,
    deliver_receipt,
    enrol,
    from_base64,
    renew,
    to_base64,
)
from pqsec_pki.est.obtaining import installed_in_sets
from pqsec_pki.keystore import InstallState, Keystore, audit, layout, robot_states, status
from tests.unit.serving import Server

ROBOT, OTHER = "/fleet/r1", "/fleet/r2"
CLASSICAL, HYBRID = map(profile_named, ("classical", "hybrid"))


def clock():
    return datetime.now(UTC)


@pytest.fixture
def made(place):
    """A server of a keystore with one set, which does not run yet."""
    folder = place / "server"
    folder.mkdir()
    return Server(folder, clock() - timedelta(seconds=30), "classical")


@pytest.fixture
def server(made):
    with made.running():
        yield made


@pytest.fixture
def two(made):
    """A server of two sets."""
    made.cli("ca", "add-set", "hybrid")
    with made.running():
        yield made


def add(server):
    server.cli("ca", "add-set", "hybrid")
    server.stop()
    server.start()


def enrolled(server, token, root, name=ROBOT, *profiles):
    first, *further = profiles or (CLASSICAL, HYBRID)
    trust = ServerTrust(pins=token.server_pins)
    client = EstClient(server=token.server, trust=trust, secret=(token.id, token.secret))
    terms = KeyTerms(profile=first, further=tuple(further), pins=pins_in_use(server.keystore))
    done = enrol(client, name, root, terms, clock=clock)
    deliver_receipt(root)
    return done


def renewed(root, **choices):
    [found] = renew(KnownServer.at(root), (), root, KeyTerms(), clock=clock, **choices)
    if isinstance(found, Exception):
        raise found
    deliver_receipt(root)
    return found


def lines(server, kind):
    """Those of a kind, but for the participant whose keys are in the keystore."""
    found = server.keystore.ledger()
    return [each for each in found if each.kind == kind and each.name != "/local"]


def keys(root, name=ROBOT):
    return [
        Certificate.from_pem(files["cert.pem"]).spki
        for files in installed_in_sets(root)[name].values()
    ]


def test_a_robot_lives_with_a_server_of_two_sets(two, place):
    robot = place / "robot"
    assert enrolled(two, two.token(ROBOT), robot).renewed
    assert list(installed_in_sets(robot)[ROBOT]) == ["", "hybrid"]
    assert [each.set_name for each in lines(two, "participant")] == ["", "hybrid"]
    assert len(lines(two, "admission")) == 1
    assert not renewed(robot).changed
    before = keys(robot)
    two.configure(renew="any-time")
    two.stop()
    two.start()
    assert renewed(robot, rekey=True).renewed
    assert not {*before} & {*keys(robot)}
    keystore = Keystore.open(two.root)
    states = robot_states(keystore, status(keystore, now=clock()).participants)
    assert states[ROBOT].state is InstallState.CURRENT
    audit(keystore)


def test_a_token_is_spent_by_the_whole_and_only_by_that(two, place):
    token = two.token(ROBOT)
    for wrong in ((CLASSICAL,), (HYBRID,), (HYBRID, CLASSICAL)):
        with pytest.raises(VerificationError, match=r"it lacks|another order"):
            enrolled(two, token, place / wrong[0].name / str(len(wrong)), ROBOT, *wrong)
    assert not lines(two, "admission")
    assert not lines(two, "participant")
    enrolled(two, token, place / "robot")
    with pytest.raises(VerificationError, match="used up"):
        enrolled(two, token, place / "thief")
    assert len(lines(two, "participant")) == 2


def test_requests_that_do_not_belong_together_are_refused_and_spend_nothing(two, place):
    token = two.token(ROBOT)
    mine, others = (
        request(name, CLASSICAL, place / name[1:], further=[HYBRID]).request
        for name in (ROBOT, OTHER)
    )
    [own], [foreign] = mine.further, others.further
    swapped = mine.der.replace(own.der, foreign.der)
    for body in (swapped, own.der):
        reply = two.post(f"{EST}/simpleenroll", to_base64(body), PKCS10, token=token)
        assert reply.status == 400, reply
    assert not lines(two, "admission")


def test_a_client_of_est_gets_the_certificates_of_all_sets(two, place):
    made = request(ROBOT, CLASSICAL, place / "robot", further=[HYBRID]).request
    reply = two.post(f"{EST}/simpleenroll", to_base64(made.der), PKCS10, token=two.token(ROBOT))
    assert reply.status == 200, reply
    body = from_base64(reply.body)
    for each in made.sets:
        assert each.spki in body


def test_a_client_of_est_with_one_request_works_where_there_is_one_set(server):
    key = CLASSICAL.participant_key.generate()
    made = certificate_request(ROBOT, key)
    reply = server.post(
        f"{EST}/simpleenroll", to_base64(made.der), PKCS10, token=server.token(ROBOT)
    )
    assert reply.status == 200, reply


def test_a_robot_left_by_an_added_set_gets_it_with_its_old_key_and_a_token(server, place):
    robot = place / "robot"
    enrolled(server, server.token(ROBOT), robot, ROBOT, CLASSICAL)
    [held] = keys(robot)
    add(server)
    enrolled(server, server.token(ROBOT), robot)
    kept, new = keys(robot)
    assert kept == held != new
    keystore = Keystore.open(server.root)
    assert {each.state for each in status(keystore, now=clock()).participants} == {"valid"}


def test_a_token_without_replace_admits_no_other_key_in_any_set(two, place):
    enrolled(two, two.token(ROBOT), place / "robot")
    with pytest.raises(VerificationError, match="another key"):
        enrolled(two, two.token(ROBOT), place / "thief")


def test_a_classical_certificate_gets_no_certificate_of_a_stronger_set(two, place):
    """Whoever breaks the classical key has that certificate, and makes keys of its own."""
    robot = place / "robot"
    enrolled(two, two.token(ROBOT), robot)
    files = installed_in_sets(robot)[ROBOT][""]
    thief = request(ROBOT, CLASSICAL, place / "thief", further=[HYBRID]).request
    before = lines(two, "participant")
    reply = two.post(
        REQUESTS,
        thief.pem,
        PEM_FILE,
        identity=TlsIdentity.of(files["cert.pem"], files["key.pem"]),
    )
    assert (reply.status, "certificate of profile hybrid" in reply.detail) == (403, True), reply
    assert lines(two, "participant") == before
    identity = TlsIdentity.of(files["cert.pem"], files["key.pem"])
    again = two.post(REQUESTS, first_request(two), PEM_FILE, identity=identity)
    assert again.status == 200, again  # the same answer, which is in every handshake


def first_request(server):
    """The request that the server answered."""
    return (server.root / layout.enclave_folder(ROBOT) / layout.REQUEST).read_bytes()


def test_a_robot_left_by_an_added_set_gets_it_with_its_certificate(server, place):
    """It lacks a set, so that it may ask for it before the certificate that it has is due."""
    robot = place / "robot"
    enrolled(server, server.token(ROBOT), robot, ROBOT, CLASSICAL)
    add(server)
    made = request(ROBOT, CLASSICAL, robot, further=[HYBRID]).request
    files = installed_in_sets(robot)[ROBOT][""]
    identity = TlsIdentity.of(files["cert.pem"], files["key.pem"])
    reply = server.post(REQUESTS, made.pem, PEM_FILE, identity=identity)
    assert reply.status == 200, reply
    install(reply.body, robot, pins_in_use(server.keystore), now=clock())
    assert len(keys(robot)) == 2


def test_the_attributes_of_a_request_name_the_one_that_carries_the_others(two):
    reply = two.send("GET", f"{EST}/csrattrs")
    assert encode(Oid(FURTHER_REQUESTS)) in from_base64(reply.body)
