"""How much work and room clients get of the signer: strangers little, robots not without end."""

import json
from contextlib import contextmanager
from dataclasses import replace
from datetime import timedelta

import pytest
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509 import CertificateSigningRequestBuilder, Name

from pqsec_pki.certificates import Certificate
from pqsec_pki.credentials import ENCLAVES
from pqsec_pki.enrolment import NAMELESS, tarball
from pqsec_pki.enrolment.archive import MANIFEST, Archive
from pqsec_pki.enrolment.receipt import receipt_of
from pqsec_pki.enrolment.trust import TrustState
from pqsec_pki.keystore import RECEIPT, Keystore, Receipt
from pqsec_pki.server.call import CallKind, SignerCall
from pqsec_pki.server.configuration import EnrolmentPolicy
from tests.some_keys import some_key
from tests.unit.domains import DAY, NOW
from tests.unit.test_serve_expired import Office
from tests.unit.tls_sides import certificate

SECOND = timedelta(seconds=1)


class Home(Office):
    """The same, with receipts of its robots."""

    def __init__(self, folder):
        super().__init__(folder)
        paths = (self.file_of("/r1", name) for name in ("cert.pem", "permissions.p7s"))
        self.files = {each.name: each.read_bytes() for each in paths}
        self.files["key.pem"] = next(folder.glob("r1/**/key.pem")).read_bytes()
        self.trust = TrustState.of_new_store({})

    def receipt(self, when):
        """The next receipt of the first robot, made so long after its certificate."""
        self.trust = self.trust.with_next_receipt()
        at = NOW + when
        return receipt_of({"": {"/r1": self.files}}, {}, self.trust, installed_at=NOW, now=at)

    def send(self, receipt, *, days=0):
        return self.ask(CallKind.RECEIPT, self.certificate(), receipt, days=days)

    @property
    def lines(self):
        return len(self.keystore.ledger())


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    return Home(tmp_path_factory.mktemp("home"))


@pytest.fixture
def read(monkeypatch):
    """The ledgers that were read."""
    found, opened = [], Keystore.open_ledger

    @contextmanager
    def counted(keystore):
        found.append(keystore)
        with opened(keystore) as ledger:
            yield ledger

    monkeypatch.setattr(Keystore, "open_ledger", counted)
    return found


@pytest.mark.parametrize("kind", [CallKind.BUNDLE, CallKind.RECEIPT])
def test_for_who_shows_nothing_no_ledger_is_read(home, read, kind):
    """With 50,000 lines it took a tenth of a second of the signer for each of such requests."""
    answers = home.handler(days=0).answers([SignerCall(kind=kind) for _ in range(9)])
    assert ({each.status for each in answers}, read) == ({401}, [])


def test_for_strangers_with_certificates_the_ledger_is_read_once(home, read):
    chain, _ = certificate("ecdsa-p256", since=NOW)
    shown = Certificate.from_pem(chain).der
    calls = [SignerCall(kind=CallKind.BUNDLE, certificate=shown) for _ in range(9)]
    answers = home.handler(days=0).answers(calls)
    assert ({each.status for each in answers}, len(read)) == ({403}, 1)


def test_for_who_is_not_admitted_no_bundle_is_prepared(home, read):
    call = SignerCall(kind=CallKind.REQUEST, body=home.new("r1").der)
    answers = home.handler(days=0).answers([call] * 9)
    assert ({each.status for each in answers}, len(read)) == ({401}, 1)


def test_a_receipt_of_participants_that_are_not_there_ends_at_the_first(home):
    """10,000 of them, in 400 kB, held the signer up for twenty seconds."""
    own = Archive.unpack(home.receipt(SECOND), RECEIPT).files
    files = dict(own)
    for number in range(9):
        for path, data in own.items():
            files[path.replace(f"{ENCLAVES}/r1/", f"{ENCLAVES}/x{number}/")] = data
    status, detail = home.send(Archive(RECEIPT, {}, files).pack())
    assert (status, detail) == (400, "/x0: this keystore did not issue its certificate")
    assert home.send(home.receipt(SECOND)) == (204, "")


def test_a_request_without_a_name_is_refused(home):
    key = some_key("ecdsa-p256").handle
    made = CertificateSigningRequestBuilder().subject_name(Name([])).sign(key, SHA256())
    body = made.public_bytes(Encoding.DER)
    told = home.ask(CallKind.REQUEST, home.certificate(), body, days=80)
    assert told == (403, f"the request is refused: {NAMELESS}")


def test_a_receipt_is_of_who_sends_it(home):
    sent = home.receipt(SECOND)
    told = home.ask(CallKind.RECEIPT, home.certificate("r2"), sent, days=0)
    assert told == (403, "the receipt is not of /r2")


def test_a_robot_whose_clock_was_a_month_ahead_once_is_not_told_to_lag(tmp_path):
    """Each receipt of that month was refused, after its clock had been corrected."""
    home = Home(tmp_path)
    ahead, right, at_boot = (home.receipt(when) for when in (30 * DAY, SECOND, -20_000 * DAY))
    for each in (ahead, right, at_boot):
        call = SignerCall(kind=CallKind.RECEIPT, certificate=home.certificate().der, body=each)
        [answer] = home.handler(days=0).answers([call])
        assert answer.status == 204
        assert ("check the robot's clock" in answer.note) is (each is not right)
    newest = [each for each in home.keystore.ledger() if each.kind == RECEIPT][-1]
    assert Receipt.of(newest).number == 3
    status, detail = home.send(home.receipt(SECOND))
    assert (status, detail) == (204, "")
    assert home.send(ahead) == (204, "")  # which is there


def test_a_robot_fills_no_ledger_with_receipts(tmp_path):
    """Each is a line; some days of them made the ledger too large to be read by anybody."""
    home = Home(tmp_path)
    *receipts, last = [home.receipt(number * SECOND) for number in range(25)]
    assert {home.send(each) for each in receipts} == {(204, "")}
    before = home.lines
    refused = (429, "there were 24 receipts of /r1 within a day: ask again later")
    assert home.send(last) == refused
    assert home.send(receipts[23]) == (204, "")  # which is there
    assert home.lines == before
    assert home.send(last, days=2) == (204, "")


def test_a_robot_fills_no_ledger_with_renewals(tmp_path):
    """Where `renew: any-time` is allowed; each is two signatures and lines of the ledger."""
    home = Home(tmp_path)

    def ask(days=0.0):
        shown, new = home.certificate(), home.new("r1").der
        call = SignerCall(kind=CallKind.REQUEST, certificate=shown.der, body=new)
        handler = replace(home.handler(days=days), policy=EnrolmentPolicy(renew_any_time=True))
        [answer] = handler.answers([call])
        return answer.status, answer.detail

    assert {ask(0.5) for _ in range(23)} == {(200, "")}
    before = home.lines
    assert ask(0.9) == (429, "there were 24 certificates of /r1 within a day: ask again later")
    assert home.lines == before
    assert ask(1.1) == (200, "")  # the first of them is of longer ago
    assert ask(1.1)[0] == 429


def test_words_for_a_client_have_an_end(home):
    """They are in the log too: half a megabyte for each request."""
    manifest = json.dumps({"format": 1, "kind": RECEIPT, "files": {}}).encode()
    files = {f"{'x' * 60}{number}": b"" for number in range(100)}
    status, detail = home.send(tarball.pack({**files, MANIFEST: manifest}))
    assert (status, len(detail), detail[-3:]) == (400, 1000, "...")
