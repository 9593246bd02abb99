"""`renew_expired`: a robot that was off past the end of its certificate renews, and no more."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import Certificate
from pqsec_pki.domain import apply, read_domain
from pqsec_pki.enrolment import Bundle, install, pins_in_use, request
from pqsec_pki.est import KeyTerms, KnownServer, ServerTrust, renew
from pqsec_pki.lifecycle import revoke
from pqsec_pki.server.call import CallKind, SignerCall
from pqsec_pki.server.call_handling import CallHandler
from pqsec_pki.server.configuration import EnrolmentPolicy
from pqsec_pki.server.waiting import WaitingRequests
from pqsec_pki.server.waiting_folder import RequestFolder
from tests.unit.domains import DAY, NOW, Scene
from tests.unit.serving import HOST, Robot, Server

FILE = """
profile: classical
validity: 90d
roles: {robot: {publish: [rt$name/pose]}}
participants:
  - {name: "/r{1..2}", role: robot, request: requests/}
"""


SECOND = timedelta(seconds=1)


class Office(Scene):
    """A keystore with two robots, and the handler of its server."""

    def __init__(self, folder):
        super().__init__(folder, FILE)
        (folder / "requests").mkdir()
        for name in ("r1", "r2"):
            (folder / f"requests/{name}.csr").write_bytes(self.new(name).pem)
        self.apply()

    def new(self, name):
        """A request for new keys."""
        folder = self.file.parent / name
        return request(f"/{name}", profile_named("classical"), folder, force=True).request

    def certificate(self, name="r1"):
        return Certificate.from_pem(self.file_of(f"/{name}", "cert.pem").read_bytes())

    def ask(self, kind, shown, body=b"", *, days=95, window=30 * DAY):
        """The answer so many days after the certificates began, of 90."""
        handler = self.handler(days=days, window=window)
        [answer] = handler.answers([SignerCall(kind=kind, certificate=shown.der, body=body)])
        return answer.status, answer.detail

    def handler(self, *, days=95, window=timedelta()):
        """The handler of the server, so many days after the certificates began."""
        keystore = self.keystore
        waiting = WaitingRequests(RequestFolder(self.file.parent / "waiting"), 9)
        return CallHandler(
            keystore,
            keystore.unlock(None),
            read_domain(self.file),
            lambda: NOW + days * DAY,
            waiting,
            EnrolmentPolicy(renew_expired=window),
        )


@pytest.fixture
def office(tmp_path):
    return Office(tmp_path)


EXPIRED = 403, "its certificate expired: it needs a new enrolment token"


def test_a_certificate_counts_from_its_first_to_its_last_second(office):
    shown, end = office.certificate(), office.certificate().not_after + 30 * DAY
    call = SignerCall(kind=CallKind.REENROL, certificate=shown.der, body=office.new("r1").der)

    def status(when):
        handler = replace(office.handler(window=30 * DAY), clock=lambda: when)
        [answer] = handler.answers([call])
        return answer.status, answer.detail.partition(":")[0]

    code, words = status(shown.not_before - SECOND)
    assert (code, "is not valid before" in words) == (403, True)  # it said that it expired
    assert status(end + SECOND) == (403, "its certificate expired")
    assert status(shown.not_before) == (403, "its certificate is not due")
    assert status(end) == (200, "")


def test_a_renewal_gives_the_rights_that_the_domain_file_has_now(office):
    office.file.write_text(FILE.replace("rt$name/pose", "rt$name/odom"))
    shown, new = office.certificate(), office.new("r1").der
    assert office.ask(CallKind.REQUEST, shown, new, days=80) == (200, "")
    assert b"odom" in office.file_of("/r1", "permissions.p7s").read_bytes()


@pytest.mark.parametrize("kind", [CallKind.REQUEST, CallKind.REENROL])
def test_an_expired_certificate_renews_within_the_window(office, kind):
    old, new = office.certificate(), office.new("r1").der
    assert office.ask(kind, old, new, window=timedelta()) == EXPIRED
    assert office.ask(kind, old, new, days=121) == EXPIRED
    assert office.ask(kind, old, new) == (200, "")
    assert office.certificate() != old
    lines = len(office.keystore.ledger())
    assert office.ask(kind, old, new) == (200, "")
    assert len(office.keystore.ledger()) == lines
    assert office.ask(kind, old, office.new("r1").der) == (
        403,
        "this is not the current certificate of /r1",
    )


@pytest.mark.parametrize("kind", [CallKind.BUNDLE, CallKind.RECEIPT])
def test_it_does_nothing_but_renew(office, kind):
    assert office.ask(kind, office.certificate()) == EXPIRED


def test_it_renews_no_other_participant(office):
    body = office.new("r2").der
    status, detail = office.ask(CallKind.REQUEST, office.certificate(), body)
    assert (status, detail) == (403, "the client certificate is not for /r2")


def test_it_does_not_renew_after_it_was_revoked(office):
    keystore, old = office.keystore, office.certificate()
    revoke(keystore, keystore.unlock(None), ["/r1"], now=NOW + 80 * DAY)
    status, detail = office.ask(CallKind.REQUEST, old, office.new("r1").der)
    assert (status, detail) == (403, "the client certificate was revoked")


def test_it_does_not_renew_after_its_successor_was_revoked(office):
    """What has expired cannot be revoked itself."""
    old, new = office.certificate(), office.new("r1").der
    assert office.ask(CallKind.REQUEST, old, new) == (200, "")
    keystore = office.keystore
    revoke(keystore, keystore.unlock(None), ["/r1"], now=NOW + 96 * DAY)
    for body in (new, office.new("r1").der):
        found = office.ask(CallKind.REQUEST, old, body, days=97)
        assert found == (403, "/r1 was revoked")


def test_it_does_not_renew_what_the_domain_file_does_not_name(office):
    office.change("/r{1..2}", "/r2")
    status, detail = office.ask(CallKind.REQUEST, office.certificate(), office.new("r1").der)
    assert (status, detail) == (403, "/r1 is not in the domain file")


def test_a_robot_that_was_off_for_too_long_renews_over_tls(tmp_path):
    past = datetime.now(UTC) - 95 * DAY
    server = Server(tmp_path, past - DAY, "classical", renew_expired="30d")
    robot = Robot(server, tmp_path / "robot", "/fleet/r1")
    (tmp_path / "requests").mkdir()
    (tmp_path / "requests/fleet+r1.csr").write_bytes(robot.request.pem)
    apply(read_domain(tmp_path / "domain.yaml"), server.root, passphrase=None, now=past)
    given = Bundle.of(server.keystore, ["/fleet/r1"], now=past, keys=False)
    install(given.to_bytes(), robot.root, pins_in_use(server.keystore), now=past)
    known = KnownServer(server=f"https://{HOST}:{server.port}", trust=ServerTrust(server.pins()))
    with server.running(measured=True):
        [done] = renew(known, (), robot.root, KeyTerms(), clock=lambda: datetime.now(UTC))
    assert done.renewed
    assert done.certificate.not_after > datetime.now(UTC)
