"""What the signer does with several requests at once, and with calls that it refuses."""

import os
import socket
import struct
from contextlib import suppress
from datetime import timedelta

import pytest

from pqsec_pki.documents import DomainSet
from pqsec_pki.domain import create_keystore, read_domain
from pqsec_pki.enrolment import pins_in_use, request
from pqsec_pki.errors import MalformedError, VerificationError
from pqsec_pki.est import EnrolmentToken
from pqsec_pki.lifecycle import ParticipantSpec, revoke
from pqsec_pki.server import record_token
from pqsec_pki.server.call import MAX_BODY, MAX_HEADER, CallKind, SignerCall, unpacked
from pqsec_pki.server.call_handling import CallHandler
from pqsec_pki.server.requester import Admitted
from pqsec_pki.server.signer import SignerProcess, listening
from pqsec_pki.server.waiting import WaitingRequests
from pqsec_pki.server.waiting_folder import RequestFolder
from tests.unit.keystores import DAY, NOW, made
from tests.unit.serving import DOMAIN


def test_a_batch_with_a_replacement_replaces_nobody_else(tmp_path):
    """A name with files and without a token that replaces it lost its key beside another's."""
    keystore = made(tmp_path / "k", "classical")
    before = {name: keystore.participant(name).certificate for name in ("/talker", "/listener")}
    waiting = WaitingRequests(RequestFolder(tmp_path / "waiting"), 1)
    handler = CallHandler(keystore, keystore.unlock(None), None, lambda: NOW + DAY, waiting)
    batch = [
        Admitted(
            name=name,
            by="token",
            spec=ParticipantSpec(
                name=name, domains=DomainSet.of(0), publish=("rt/x",), validity=30 * DAY
            ),
            replaces=name == "/talker",
        )
        for name in before
    ]
    failures = handler._issue(batch)
    assert list(failures) == ["/listener"]
    assert "already" in str(failures["/listener"])
    assert keystore.participant("/talker").certificate != before["/talker"]
    assert keystore.participant("/listener").certificate == before["/listener"]


@pytest.mark.parametrize("text", ["\ud800", "\u00e9", 7, None, []])
@pytest.mark.parametrize("key", ["label", "address", "token", "secret"])
def test_a_call_with_what_no_client_can_send_is_refused(key, text):
    """Half a character in a token's name made the signer fail, and say so with 500."""
    header = {"kind": CallKind.ENROL, "label": "", "address": "", "token": "", "secret": ""}
    header |= {"certificate": "", "chain": []}
    assert SignerCall.of(header, b"").kind is CallKind.ENROL
    with pytest.raises(MalformedError, match="not a call"):
        SignerCall.of(header | {key: text}, b"")


class Message:
    """Octets of a message whose lengths are these, made when they are taken."""

    def __init__(self, header, body):
        self.asked = []
        self._lengths = struct.pack(">II", header, body)

    def take(self, size):
        self.asked.append(size)
        return (self._lengths, b"{}".ljust(size), bytes(size))[len(self.asked) - 1]


@pytest.mark.parametrize("sizes", [(MAX_HEADER + 1, 0), (2, MAX_BODY + 1), (2**32 - 1, 2**32 - 1)])
def test_a_message_that_claims_to_be_too_large_is_refused_before_it_is_read(sizes):
    """The process that faces the network could fill the memory of the one with the keys."""
    message = Message(*sizes)
    with pytest.raises(MalformedError, match="is too large"):
        unpacked(message.take)
    assert message.asked == [8]


def test_a_message_with_the_largest_header_is_read():
    message = Message(MAX_HEADER, 1)
    assert unpacked(message.take) == ({}, b"\0")
    assert message.asked == [8, MAX_HEADER, 1]


class Served:
    """A keystore with a token for two robots, and the handler that answers them."""

    def __init__(self, folder):
        self.folder, domain = folder, folder / "domain.yaml"
        domain.write_text(DOMAIN.format(profile="classical"))
        self.desired = read_domain(domain)
        keystore = create_keystore(self.desired, folder / "k", passphrase=None, now=NOW)
        self.keystore, self.ledger = keystore, keystore.root / "private/ledger.sqlite3"
        self.token = EnrolmentToken.new(
            server="https://x",
            server_pins=frozenset(),
            cas=pins_in_use(keystore),
            names="/fleet/*",
            profile="classical",
            not_after=NOW + DAY,
        )
        record_token(keystore, self.token, uses=2, replaces=False, now=NOW)
        self.handler = self.started()

    def started(self):
        waiting = WaitingRequests(RequestFolder(self.folder / "waiting"), 1)
        cas = self.keystore.unlock(None)
        clock = lambda: NOW  # noqa: E731 -- short
        return CallHandler(self.keystore, cas, self.desired, clock, waiting, revocation_list=DAY)

    def ask(self, name):
        asked = request(name, self.keystore.profile, self.folder / "robots", force=True).request
        token, secret = self.token.id, self.token.secret
        call = SignerCall(kind=CallKind.REQUEST, token=token, secret=secret, body=asked.der)
        [answer] = self.handler.answers([call])
        return answer

    def rolled_back(self, data):
        before = self.ledger.read_bytes()
        self.ledger.write_bytes(data)
        return before


def test_with_a_ledger_that_was_rolled_back_nothing_is_issued(tmp_path):
    """Uses of tokens and revocations were gone: what was used up or revoked counted again."""
    served = Served(tmp_path)
    old = served.ledger.read_bytes()
    assert served.ask("/fleet/r1").status == 200
    revoke(served.keystore, served.handler.authorities, ["/fleet/r1"], now=NOW)
    whole = served.rolled_back(old)
    for _ in range(2):
        answer = served.ask("/fleet/r2")
        assert (answer.status, answer.retry_after) == (503, 60)
        assert "the ledger lacks" in answer.note
        with pytest.raises(VerificationError, match="the ledger lacks"):
            served.handler.keep_list()
        served.handler = served.started()  # it lacks what the CAs signed a head of
    served.rolled_back(whole)
    assert served.ask("/fleet/r2").status == 200


def test_lines_that_the_server_has_seen_are_missed_without_a_signed_head(tmp_path):
    """The end of a token is in no signed head until the next change by the CAs."""
    served = Served(tmp_path)
    old = served.ledger.read_bytes()
    record_token(
        served.keystore,
        EnrolmentToken.new(
            server="https://x",
            server_pins=frozenset(),
            cas=served.token.cas,
            names="/other",
            profile="classical",
            not_after=NOW + timedelta(hours=1),
        ),
        uses=1,
        replaces=False,
        now=NOW,
    )
    assert served.ask("/nobody").status == 403
    served.rolled_back(old)
    assert served.ask("/fleet/r1").status == 503


def test_a_call_of_another_user_is_not_answered(tmp_path):
    """Root can connect whatever the mode of the socket is."""
    served, log = Served(tmp_path), []
    path, own = tmp_path / "signer", os.getuid()
    call = SignerCall(kind=CallKind.HEAD)
    with listening(path) as listener:
        for users, answered in ({own}, True), ({own + 1}, False), (set(), False):
            process = SignerProcess(
                listener=listener,
                load=lambda _: served.handler,
                users=frozenset(users),
                log=log.append,
                pass_on=lambda: None,
                front_listens=lambda: True,
            )
            with socket.socket(socket.AF_UNIX) as link:
                link.settimeout(60)
                link.connect(str(path))
                link.sendall(call.to_bytes())
                process._serve(process._arrived())
                answer = b""
                with suppress(ConnectionResetError):  # what it sent was not read
                    answer = link.makefile("rb").read()
            assert bool(answer) is answered
    refused = [each["detail"] for each in log if each["event"] == "a call is refused"]
    assert refused == ["another user may not ask the signer"] * 2
