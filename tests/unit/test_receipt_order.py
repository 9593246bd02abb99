"""Receipts are ordered by the numbers that robots and CAs give, never by a robot's clock."""

import json
import shutil
from datetime import UTC, datetime, timedelta

import pytest

from pqsec_pki.certificates import Certificate
from pqsec_pki.certificates.authority import BACKDATE
from pqsec_pki.enrolment import Bundle, import_receipts, rollback
from pqsec_pki.enrolment.credential_store import CredentialStore
from pqsec_pki.enrolment.receipt import read_receipts
from pqsec_pki.enrolment.trust import TrustState
from pqsec_pki.errors import KeystoreError, VerificationError
from pqsec_pki.keystore import InstallState, Keystore, robot_states, status
from pqsec_pki.lifecycle import Renewal, renew
from pqsec_pki.problems import Code
from pqsec_pki.server.receipt_taking import take_receipts
from tests.unit.enrolling import DAY, LATER, put
from tests.unit.keystores import made

ARM = "/arm"
MONTH = 30 * DAY
BEGAN = LATER - BACKDATE
"""When certificates begin that are issued then."""
BOOT = datetime(1970, 1, 1, 0, 1, tzinfo=UTC)
"""The time of a robot without a battery for its clock."""


class Fleet:
    """A keystore, and robots that run the same participant."""

    def __init__(self, place):
        self.place = place
        self.keystore = made(place / "k", "classical", names=(ARM, "/leg"))

    def install(self, robot="robot", *, now=LATER, **options):
        """Install the newest bundle by that clock of the robot; its receipt."""
        put(self.place / robot, Bundle.of(self.keystore, [ARM], now=LATER), now, **options)
        return self.receipt(robot)

    def receipt(self, robot="robot"):
        return CredentialStore(self.place / robot).receipt.read_bytes()

    def renew(self):
        renew(self.keystore, self.keystore.unlock(None), [ARM], Renewal(), now=LATER)

    def import_(self, *receipts, **options):
        """Import these receipts, from files whose names say nothing, by the CA's clock."""
        paths = []
        for number, data in enumerate(receipts):
            paths.append(self.place / f"{number}.receipt")
            paths[-1].write_bytes(data)
        return import_receipts(self.keystore, paths, now=LATER, **options)

    def send(self, *receipts):
        """Send them to the server."""
        for each in receipts:
            done = take_receipts(self.keystore, ARM, each, now=LATER)
        return done

    def refuses(self, receipt, **options):
        head = self.keystore.head
        with pytest.raises(VerificationError) as caught:
            self.import_(receipt, **options)
        assert caught.value.codes == {Code.OLDER}
        assert self.keystore.head == head
        return caught.value

    @property
    def state(self):
        [arm] = status(self.keystore, [ARM], now=LATER).participants
        return robot_states(self.keystore, [arm])[ARM]


@pytest.fixture(scope="module")
def original(memory):
    return Fleet(memory).keystore.root


@pytest.fixture
def fleet(original, place):
    found = Fleet.__new__(Fleet)
    found.place = place
    shutil.copytree(original, place / "k", symlinks=True)
    found.keystore = Keystore.open(place / "k", to_change=True)
    return found


def said_in(receipt):
    return read_receipts(receipt)[0].receipt


WAYS = {"file": Fleet.import_, "server": Fleet.send}
over_both = pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)


@over_both
@pytest.mark.parametrize("ahead", [timedelta(hours=2), MONTH], ids=str)
def test_a_robot_whose_clock_was_ahead_once_is_believed_after_it_was_corrected(fleet, way, ahead):
    """Its receipts were refused until that time came."""
    [done] = way(fleet, fleet.install(now=LATER + ahead, trust_first=True))
    assert "in the future by this clock: check the robot's clock" in done.clock
    fleet.renew()
    [done] = way(fleet, fleet.install(now=LATER))
    assert done.clock is None
    assert fleet.state.state is InstallState.CURRENT


@over_both
def test_a_robot_that_starts_in_1970_is_believed(fleet, way):
    """It was told for ever to lag."""
    way(fleet, fleet.install())
    for minutes in (0, 0, 5):
        fleet.renew()
        [done] = way(fleet, fleet.install(now=BOOT + timedelta(minutes=minutes)))
        assert "before its certificate began: check the robot's clock" in done.clock
        assert fleet.state.state is InstallState.CURRENT
        assert fleet.state.receipt == done.receipt


def test_a_clock_that_is_right_to_the_second_is_not_told_as_wrong(fleet):
    fleet.install(trust_first=True)
    fleet.renew()
    [done] = fleet.import_(fleet.install(now=BEGAN))
    assert done.clock is None


def test_a_certificate_without_a_number_counts_as_the_oldest(fleet, monkeypatch):
    receipt = fleet.install(trust_first=True)
    monkeypatch.setattr(Certificate, "number", None)  # as of other tools
    assert fleet.import_(receipt)


@over_both
def test_a_clock_that_goes_back_after_the_installation_makes_no_receipt_that_is_refused(fleet, way):
    fleet.install(now=LATER + MONTH)
    again = fleet.install(now=BOOT)  # the same files: only the receipt is made again
    assert said_in(again).installed_at == LATER + MONTH
    assert said_in(again).made_at == BOOT
    way(fleet, again)
    assert fleet.state.receipt == said_in(again)


@over_both
def test_two_receipts_of_one_second_are_ordered(fleet, way):
    first = fleet.install()
    fleet.renew()
    second = fleet.install()
    assert said_in(first).made_at == said_in(second).made_at
    way(fleet, first)
    way(fleet, second)
    assert fleet.state.receipt == said_in(second)


def test_a_folder_of_receipts_is_recorded_in_the_order_of_their_numbers(fleet):
    first = fleet.install(now=LATER + MONTH)
    fleet.renew()
    second = fleet.install(now=LATER)
    rollback(fleet.place / "robot", now=BOOT, older=True)  # signs with the older certificate
    third = fleet.receipt()
    done = fleet.import_(third, first, second)
    assert [each.receipt.number for each in done] == [1, 2, 3]
    assert fleet.state.state is InstallState.OUTDATED
    assert fleet.state.receipt == said_in(third)


@pytest.mark.parametrize("clock", [BOOT, LATER, LATER + MONTH], ids=str)
def test_an_earlier_receipt_does_not_come_back_whatever_the_clock_was(fleet, clock):
    early = fleet.install(now=clock)
    fleet.renew()
    fleet.import_(fleet.install())
    assert "receipt 1 of its store; receipt 2 is recorded" in str(fleet.refuses(early))
    assert fleet.state.state is InstallState.CURRENT
    with pytest.raises(VerificationError, match="receipt 2 is recorded"):
        fleet.send(early)


def test_a_robot_that_was_replaced_does_not_come_back_with_the_receipts_it_still_has(fleet):
    fleet.import_(fleet.install("old"))
    again = fleet.install("old")  # with a larger number than any of the new robot's
    fleet.renew()
    new = fleet.install("new", now=BOOT)
    fleet.import_(new)
    assert said_in(new).number < said_in(again).number
    assert said_in(new).store != said_in(again).store
    assert "of a store with an older certificate" in str(fleet.refuses(again))
    assert fleet.state.receipt == said_in(new)


def test_receipts_of_a_replaced_and_the_new_robot_are_recorded_in_their_order(fleet):
    old = [fleet.install("old", now=LATER + MONTH) for _ in range(3)]
    fleet.renew()
    new = fleet.install("new", now=BOOT)
    rolled = [fleet.install("new", now=BOOT)]
    done = fleet.import_(*rolled, *reversed(old), new)
    assert [each.receipt.store == said_in(new).store for each in done] == [False] * 3 + [True] * 2
    assert fleet.state.receipt == said_in(rolled[0])


@over_both
def test_a_robot_that_is_set_up_again_is_believed_with_its_first_receipt(fleet, way):
    """With the same certificate: the later line counts."""
    for _ in range(3):
        way(fleet, fleet.install())
    (fleet.place / "robot/trust.json").unlink()
    first = fleet.install(now=BOOT)
    assert said_in(first).number == 1
    way(fleet, first)
    assert fleet.state.receipt == said_in(first)


def test_the_store_whose_receipt_was_recorded_last_decides(fleet):
    fleet.import_(fleet.install("old"))
    fleet.renew()
    fleet.import_(fleet.install("new"))
    again = fleet.install("new")
    fleet.renew()
    fleet.import_(fleet.install("old"))  # it is used again
    assert "of a store with an older certificate" in str(fleet.refuses(again))


def test_two_copies_of_one_store_do_not_both_use_a_number(fleet):
    fleet.install()
    shutil.copytree(fleet.place / "robot", fleet.place / "copy", symlinks=True)
    fleet.import_(fleet.install())
    other = fleet.install("copy", now=LATER + DAY)
    assert "receipt 2 of its store; receipt 2 is recorded" in str(fleet.refuses(other))


def test_a_rollback_does_not_let_a_robot_in_that_was_replaced_before(fleet):
    old = fleet.install("old")
    fleet.install("new")
    fleet.renew()
    between = fleet.install("old")
    fleet.renew()
    fleet.import_(fleet.install("new"))
    rollback(fleet.place / "new", now=LATER, older=True)
    fleet.import_(fleet.receipt("new"))
    for each in (between, old):
        fleet.refuses(each)


def test_a_robot_restored_from_a_backup_is_refused_until_older_then_believed(fleet):
    fleet.install()
    shutil.copytree(fleet.place / "robot", fleet.place / "backup", symlinks=True)
    fleet.renew()
    fleet.import_(*(fleet.install() for _ in range(5)))
    shutil.rmtree(fleet.place / "robot")
    (fleet.place / "backup").rename(fleet.place / "robot")
    rolled = fleet.install(now=LATER + timedelta(minutes=1))
    error = fleet.refuses(rolled)
    assert "receipt 2 of its store; receipt 6 is recorded" in str(error)
    assert error.hint == "--older records it anyway, if the robot was restored from a backup"
    [done] = fleet.import_(rolled, older=True)
    assert not done.already
    assert fleet.state.receipt == said_in(rolled)
    following = fleet.install(now=BOOT)
    fleet.send(following)  # without --older
    assert fleet.state.receipt == said_in(following)


# The number


@pytest.mark.parametrize("older", [False, True], ids=["", "older"])
def test_neither_rollback_nor_an_older_bundle_sets_the_number_back(fleet, older):
    robot, first = fleet.place / "robot", Bundle.of(fleet.keystore, [ARM], now=LATER)
    receipts = [fleet.install()]
    if older:
        fleet.renew()
        receipts.append(fleet.install())
    else:
        put(robot, Bundle.of(fleet.keystore, ["/leg"], now=LATER))
    rollback(robot, now=BOOT, older=older)
    receipts.append(fleet.receipt())
    put(robot, first, now=BOOT, older=older)
    receipts.append(fleet.receipt())
    assert [said_in(each).number for each in receipts] == ([1, 2, 3, 4] if older else [1, 3, 4])
    assert len({said_in(each).store for each in receipts}) == 1


def test_the_number_is_saved_before_the_receipt_that_has_it(fleet, monkeypatch):
    """A process that is killed between the two must not give the number twice."""
    first = fleet.install()

    def killed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(CredentialStore, "save_receipt", killed)
    with pytest.raises(KeyboardInterrupt):
        fleet.install()
    monkeypatch.undo()
    assert fleet.receipt() == first
    assert said_in(fleet.install()).number == 3


@pytest.mark.parametrize(
    "receipts",
    [
        *({}, [], None, {"store": "0" * 32}, {"made": 1}),
        *({"store": each, "made": 1} for each in (7, "", "0" * 31, "G" * 32, "0" * 32 + "\n")),
        *({"store": "0" * 32, "made": each} for each in (-1, True, "1", None, 1.0)),
    ],
    ids=str,
)
def test_a_damaged_count_of_receipts_is_an_error(fleet, receipts):
    fleet.install()
    value = json.loads((fleet.place / "robot/trust.json").read_bytes())
    assert TrustState.from_json(json.dumps(value).encode()).receipts == 1
    with pytest.raises(KeystoreError, match="cannot be read"):
        TrustState.from_json(json.dumps({**value, "receipts": receipts}).encode())
