"""The robot's commands against `pqsec serve`: whatever stops a robot, it is served in the end."""

from datetime import UTC, datetime, timedelta
from functools import partial

import pytest

from pqsec_pki.certificates import Reason
from pqsec_pki.credentials import CERTIFICATE, REVOCATION_LIST
from pqsec_pki.enrolment import pins_in_use
from pqsec_pki.errors import PqsecError, VerificationError
from pqsec_pki.est import (
    EstClient,
    KeyTerms,
    KnownServer,
    ServerTrust,
    deliver_receipt,
    enrol,
    renew,
)
from pqsec_pki.est.obtaining import installed
from pqsec_pki.keystore import InstallState, Keystore, audit, robot_states, status
from pqsec_pki.lifecycle import revoke
from tests.running import clean_environment, run_here
from tests.unit.killing import disturbed_calls, survives
from tests.unit.serving import Server

ROBOT, OTHER = "/fleet/r1", "/fleet/r2"


def clock():
    return datetime.now(UTC)


@pytest.fixture
def server(place):
    folder = place / "server"
    folder.mkdir()
    made = Server(folder, clock() - timedelta(seconds=30), renew="any-time")
    with made.running():
        yield made


def enrolled(server, token, root, name=ROBOT):
    trust = ServerTrust(pins=token.server_pins)
    client = EstClient(server=token.server, trust=trust, secret=(token.id, token.secret))
    terms = KeyTerms(profile=server.keystore.profile, pins=pins_in_use(server.keystore))
    done = enrol(client, name, root, terms, clock=clock)
    deliver_receipt(root)
    return done


def renewed(root, *, rekey=False):
    [found] = renew(KnownServer.at(root), (), root, KeyTerms(), clock=clock, rekey=rekey)
    if isinstance(found, PqsecError):
        raise found
    deliver_receipt(root)
    return found


def certificates(server, name=ROBOT):
    """The serial numbers that were issued to it."""
    lines = server.keystore.ledger()
    return [each.serial for each in lines if each.kind == "participant" and each.name == name]


def test_a_robot_lives_with_its_server(server, place):
    robot = place / "robot"
    assert enrolled(server, server.token(ROBOT), robot).renewed
    assert not renewed(robot).changed
    before = installed(robot)[ROBOT]
    assert renewed(robot, rekey=True).renewed
    assert len(set(certificates(server))) == 2
    enrolled(server, server.token(OTHER), place / "other", OTHER)
    keystore = Keystore.open(server.root, to_change=True)
    revoke(keystore, keystore.unlock(None), [OTHER], reason=Reason.SUPERSEDED, now=clock())
    assert not renewed(robot).renewed
    assert installed(robot)[ROBOT][REVOCATION_LIST] != before.get(REVOCATION_LIST)
    with pytest.raises(VerificationError, match="revoked"):
        renewed(place / "other")
    audit(server.keystore)


def test_a_refusal_that_may_end_costs_no_request(server, place):
    """Only one that is never answered is made anew: else keys that wait would be lost."""
    robot = place / "robot"
    enrolled(server, server.token(ROBOT), robot)
    keystore = Keystore.open(server.root, to_change=True)
    revoke(keystore, keystore.unlock(None), [ROBOT], now=clock())
    sent = []
    for _ in range(2):
        with pytest.raises(VerificationError, match="revoked"):
            renewed(robot, rekey=True)
        [request] = robot.rglob("request.csr")
        sent.append(request.read_bytes())
    assert sent[0] == sent[1]


def test_a_robot_sends_its_receipt_as_a_participant_that_is_not_revoked(server, place):
    robot = place / "robot"
    for name in (ROBOT, OTHER):
        enrolled(server, server.token(name), robot, name)
    keystore = Keystore.open(server.root, to_change=True)
    revoke(keystore, keystore.unlock(None), [ROBOT], now=clock())
    line = ["renew", "--from", KnownServer.at(robot).server, "--dir", "robot"]
    code, _, said = run_here(line, cwd=place, env=clean_environment())
    assert (code, "no receipt" in said) == (1, False)
    assert REVOCATION_LIST in installed(robot)[OTHER]
    states = robot_states(keystore, status(keystore, now=clock()).participants)
    assert states[OTHER].state is InstallState.CURRENT


def test_a_stolen_token_is_of_no_use_after_the_robot(server, place):
    token = server.token(ROBOT)
    enrolled(server, token, place / "robot")
    with pytest.raises(VerificationError, match="used up"):
        enrolled(server, token, place / "thief")
    assert installed(place / "thief") == {}
    assert len(certificates(server)) == 1


@pytest.mark.slow
def test_killed_at_any_instant_a_robot_gets_one_new_certificate(server, place):
    """The server answers a repeated request as it did the first time: nothing is issued twice."""
    robot = place / "robot"
    enrolled(server, server.token(ROBOT), robot)
    for calls in disturbed_calls(20):
        before, old = len(certificates(server)), installed(robot)[ROBOT][CERTIFICATE]
        done = survives(calls, partial(renewed, robot, rekey=True))
        waits = any((robot / "requests").iterdir())
        found = renewed(robot, rekey=waits)
        begun = waits or done or found.certificate.pem != old
        assert len(certificates(server)) - before == begun
        newest = server.bundle(ROBOT).enclaves[ROBOT][CERTIFICATE]
        assert newest == found.certificate.pem == installed(robot)[ROBOT][CERTIFICATE]
        if done:
            return
    raise AssertionError("it is never done")
