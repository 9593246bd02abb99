"""A keystore over the years, in any order of things: what is promised holds after each of them."""

import shutil
import tempfile
from datetime import timedelta
from pathlib import Path

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import State, audit, status
from pqsec_pki.lifecycle import ParticipantSpec, Renewal, issue, renew, renew_list, revoke
from pqsec_pki.selfcheck import HandshakeParty, HandshakeSetup, run_handshake
from tests.longer import LONG
from tests.unit.keystores import DAY, NOW, made

NAMES = ("/a", "/b", "/fleet/c")
YEARS = 850
"""Days; the CAs last 900."""


class Life(RuleBasedStateMachine):
    """Three participants, and for each certificate when it ends and whether it was taken back."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = Path(tempfile.mkdtemp(prefix="pqsec-life-"))
        self.keystore = made(self.folder / "k", "classical", names=())
        self.authorities = self.keystore.unlock(None)
        self.now = NOW
        self.ends: dict[str, list[tuple[str, timedelta]]] = {name: [] for name in NAMES}
        self.revoked: set[str] = set()
        self.lists = 0

    def teardown(self) -> None:
        shutil.rmtree(self.folder)

    def newest(self, name):
        return self.ends[name][-1][0] if self.ends[name] else None

    def note(self, issued):
        for each in issued:
            self.ends[each.name].append((each.serial, each.not_after))

    @rule(days=st.integers(1, 60))
    def time_goes_by(self, days):
        self.now = min(self.now + days * DAY, NOW + YEARS * DAY)

    @rule(name=st.sampled_from(NAMES), days=st.integers(1, 300), after=st.booleans())
    def issue(self, name, days, after):
        spec = ParticipantSpec(
            name=name, domains=self.keystore.domains, publish=("x",), validity=days * DAY
        )
        options = {"now": self.now, "force": True, "after_revocation": after}
        try:
            self.note(issue(self.keystore, self.authorities, [spec], **options))
        except KeystoreError:
            assert self.newest(name) in self.revoked
            assert not after

    @rule(name=st.sampled_from(NAMES), rekey=st.sampled_from([True, False, None]))
    def renew(self, name, rekey):
        try:
            terms = Renewal(rekey=rekey)
            self.note(renew(self.keystore, self.authorities, [name], terms, now=self.now))
        except KeystoreError:
            assert self.newest(name) in self.revoked | {None}
        else:
            assert self.newest(name) not in self.revoked

    @rule(name=st.sampled_from(NAMES))
    def revoke(self, name):
        good = {serial for serial, end in self.ends[name] if self.now <= end}
        try:
            found, _ = revoke(self.keystore, self.authorities, [name], now=self.now)
        except KeystoreError:
            assert not good
        else:
            assert {each.serial for each in found} == good
            self.revoked |= good

    @precondition(lambda self: self.keystore.has_revocation_list)
    @rule()
    def renew_list(self):
        renew_list(self.keystore, self.authorities, now=self.now)

    @invariant()
    def the_ledger_holds(self):
        audit(self.keystore)

    @invariant()
    def the_list_has_all_that_were_taken_back_and_are_in_force(self):
        crl = self.keystore.revocation_list
        listed = {f"{each.serial_number:x}" for each in crl.revoked} if crl else set()
        in_force = {s for each in self.ends.values() for s, end in each if self.now <= end}
        assert self.revoked & in_force <= listed <= self.revoked
        number = crl.number if crl else 0
        assert number >= self.lists
        self.lists = number

    @invariant()
    def status_tells_what_is_so(self):
        for each in status(self.keystore, now=self.now).participants:
            serial, end = self.ends[each.name][-1]
            assert (each.serial, each.not_after) == (serial, end)
            assert (each.state is State.REVOKED) == (serial in self.revoked)
            assert each.state is State.REVOKED or (each.state is State.EXPIRED) == (self.now > end)

    @invariant()
    def two_meet_if_both_are_good_and_the_list_is(self):
        first, second = NAMES[:2]
        if not (self.ends[first] and self.ends[second]):
            return
        good = all(
            self.newest(name) not in self.revoked and self.now <= self.ends[name][-1][1]
            for name in (first, second)
        )
        crl = self.keystore.revocation_list
        in_force = crl is None or self.now <= crl.next_update
        setup = HandshakeSetup(keystore=self.keystore, domain=0, now=self.now)
        report = run_handshake(setup, HandshakeParty(name=first), HandshakeParty(name=second))
        assert report.ok == (good and in_force), report.failed


TestLife = Life.TestCase
TestLife.settings = settings(
    max_examples=50 if LONG else 5,
    stateful_step_count=20,
    suppress_health_check=[HealthCheck.too_slow],
)
