"""What the signer does with several requests at once."""

import pytest

from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import MalformedError
from pqsec_pki.lifecycle import ParticipantSpec
from pqsec_pki.server.call import CallKind, SignerCall
from pqsec_pki.server.desk import Desk
from pqsec_pki.server.requester import Admitted
from pqsec_pki.server.waiting import WaitingRoom
from tests.unit.keystores import DAY, NOW, made


def test_a_batch_with_a_replacement_replaces_nobody_else(tmp_path):
    """A name with files and without a token that replaces it lost its key beside another's."""
    keystore = made(tmp_path / "k", "classical")
    before = {name: keystore.participant(name).certificate for name in ("/talker", "/listener")}
    room = WaitingRoom(tmp_path / "waiting", 1)
    desk = Desk(keystore, keystore.unlock(None), None, lambda: NOW + DAY, room)
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
    failures = desk._issue(batch)
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
