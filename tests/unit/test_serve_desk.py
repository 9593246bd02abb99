"""What the signer does with several requests at once."""

from pqsec_pki.documents import DomainSet
from pqsec_pki.lifecycle import ParticipantSpec
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
