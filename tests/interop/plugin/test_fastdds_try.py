"""`pqsec try fastdds --plugin`: real participants of Fast DDS with our plugin, as export
configures them. The circumstances are those of Cyclone DDS's."""

import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial

import pytest

from pqsec_pki.trial import (
    Act,
    Installation,
    TopicRoute,
    TrialReport,
    TrialRun,
    TrialSetup,
    built,
    credentialed,
    run_peers,
    run_trial,
    unauthenticated,
    unique_text,
)
from tests.interop.conftest import LAB_PROFILES, TOPIC
from tests.interop.plugin.processes import PATIENCE
from tests.interop.plugin.test_plugin_try import (
    AT_ONCE,
    REFUSAL,
    come_from_another_ca,
    logs,
    meet_stock_peers,
)
from tests.interop.roots import ROOTS
from tests.interop.trials import (
    OTHER,
    RECEIVER,
    SENDER,
    Case,
    Laboratory,
    alter_the_permissions,
    encrypt_the_keys,
    let_the_sender_expire,
    revoke_the_sender,
)
from tests.longer import LONG

pytestmark = pytest.mark.interop


def have_permissions_of_another_ca(lab, root, now, who=SENDER):
    """Those of the same name, that the CA of another keystore signed."""
    before = (root / f"enclaves{who}" / "permissions.p7s").read_bytes()
    other = root.with_name("copy")
    shutil.copytree(root, other, symlinks=True)
    come_from_another_ca(lab, other, now, who)
    foreign = (other / f"enclaves{who}" / "permissions.p7s").read_bytes()
    assert foreign != before
    (root / f"enclaves{who}" / "permissions.p7s").write_bytes(foreign)


MET = {
    **{f"{profile} {where}": (where, Case(profile, profile=profile), ())
       for profile in LAB_PROFILES for where in ROOTS},
    "encrypted keys": (
        "bookworm", Case("", profile="pq", alter=encrypt_the_keys, password="Correct-Horse_1"), ()
    ),
    **{f"stock {who}": ("bookworm", Case("", profile="transition", alter=meet_stock_peers), (who,))
       for who in (SENDER, RECEIVER)},
}  # fmt: skip
"""Where, in what circumstances, and who runs Fast DDS's own plugin."""
BAD = {
    "revoked": (revoke_the_sender, "was revoked on"),
    "rogue CA": (come_from_another_ca, "not signed by this CA"),
    "foreign permissions": (have_permissions_of_another_ca, "but by another certificate"),
    "expired": (let_the_sender_expire, "expired on"),
    "altered": (alter_the_permissions, "changed after signing"),
}
"""What may be wrong with one of two, and what is said."""
BEGINS = RECEIVER
"""The one of the two with the smaller GUID, which follows from its name."""


def bad(title: str, who: str) -> Case:
    return Case("", profile="pq", alter=partial(BAD[title][0], who=who))


REFUSED = {
    **{f"denied topic {where}": (where, Case("", profile="pq", topic=OTHER), SENDER, (),
                                 "says whether it may") for where in ROOTS},
    **{f"{title}, who {'begins' if who == BEGINS else 'answers'}, {where}":
           (where, bad(title, who), who, (), BAD[title][1])
       for title in BAD for where in ROOTS for who in (SENDER, RECEIVER)
       if LONG or (where == "bookworm") == (who == SENDER)},
    **{f"unasked, stock {who}": ("bookworm", Case("", profile="transition"), SENDER, (who,), said)
       for who, said in ((SENDER, "the peer asks for 'DH"), (RECEIVER, "not say that it knows"))},
}  # fmt: skip
"""Where, in what circumstances, who sends, and what is said. In the gate, each begins in one."""


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory, now) -> Laboratory:
    return Laboratory.create(tmp_path_factory.mktemp("trials"), now)


@pytest.fixture(scope="module")
def reports(stack_in, laboratory, plugin_for, selected) -> Iterator[Callable[[str], TrialReport]]:
    """reports(name) is what came of it; several run at once."""
    met = {name: MET[name] for name in MET if name in selected("name")}
    refused = {name: REFUSED[name] for name in REFUSED if name in selected("name")}

    def run(where: str, case: Case, sender: str, stock: tuple[str, ...], **how) -> TrialReport:
        installation, ours = stack_in("fastdds", where), plugin_for(where)
        trial = laboratory.trial(installation, case, plugin=ours, stock=stock, **how)
        receiver = RECEIVER if sender == SENDER else SENDER
        return run_trial(
            trial, TopicRoute(sender=sender, receiver=receiver, domain=0, topic=case.topic)
        )

    for where in {each[0] for each in (*met.values(), *refused.values())}:
        built(stack_in("fastdds", where))
        plugin_for(where)
    with ThreadPoolExecutor(AT_ONCE) as pool:
        found: dict[str, Future[TrialReport]] = {}
        for name, (where, case, stock) in met.items():
            found[name] = pool.submit(run, where, case, SENDER, stock, timeout=PATIENCE)
        for name, (*how, _) in refused.items():
            # `anyway`, for what an export would refuse too.
            found[name] = pool.submit(run, *how, timeout=REFUSAL, anyway=True)
        yield lambda name: found[name].result()


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("name", MET)
def test_two_meet_and_a_stranger_gets_nothing(reports, requires, name):
    report = reports(name)
    assert report.ok, logs(report)
    assert set(report.plugged) == {SENDER, RECEIVER} - set(MET[name][2])
    wire = requires(report.trial_run.wire, "a wire to watch", "run the tests as root")
    assert wire.packets > 100
    assert report.readable is False


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("name", REFUSED)
def test_nothing_passes_and_it_is_said_why(reports, name):
    report, said = reports(name), REFUSED[name][-1]
    assert report.receiver.received is None, logs(report)
    assert report.unauthenticated.received is None
    assert not any(each.signal for each in report.trial_run.outcomes)
    told = [each for each in report.findings if said in each.said]
    assert told, (report.findings, logs(report))
    assert all(each.cause and each.remedy for each in told)


@dataclass(frozen=True)
class Meeting:
    """Two with credentials, each in its stack, and a third without."""

    sending: str
    """Stack and where it is."""
    receiving: str
    sender: str

    def run(self, found, laboratory: Laboratory, plugin_for) -> TrialRun:
        first, second = found(self.sending), found(self.receiving)
        receiver = next(each for each in (SENDER, RECEIVER) if each != self.sender)
        trial = laboratory.trial(
            first,
            Case("", profile="pq"),
            receiving=second,
            plugin=plugin_for(self.sending.split()[1]),
            timeout=PATIENCE,
        )
        others = replace(trial, plugin=plugin_for(self.receiving.split()[1]))
        folder = trial.keystore.root.parent
        roles = [
            credentialed(trial, self.sender, Act.SEND, folder, unique_text()),
            credentialed(others, receiver, Act.RECEIVE, folder),
            unauthenticated(first, Act.RECEIVE, folder),
        ]
        setup = TrialSetup(
            program=first.peer(built(first)), domain=0, topic=TOPIC, timeout=trial.timeout
        )
        return run_peers(setup, roles)


def both_ways(one: str, other: str) -> list[Meeting]:
    """Each sends, and each begins the handshake; in the gate, each begins once."""
    senders = (SENDER, RECEIVER) if LONG else (SENDER,)
    return [Meeting(*each, sender) for each in ((one, other), (other, one)) for sender in senders]


MIXED = [
    *both_ways("cyclonedds bookworm", "fastdds bookworm"),
    *both_ways("cyclonedds bookworm", "fastdds trixie"),
    *both_ways("cyclonedds trixie", "fastdds trixie"),
    *both_ways("fastdds bookworm", "fastdds trixie"),
]
"""Fast DDS 3.1.2 alone waits for a second announcement, which the others do not send."""


@pytest.fixture(scope="module")
def meetings(stack_in, laboratory, plugin_for, selected) -> Iterator[Callable[[Meeting], TrialRun]]:
    """What came of a meeting; several run at once."""
    mixed = [meeting for meeting in MIXED if meeting in selected("meeting")]

    def found(name: str) -> Installation:
        return stack_in(*name.split())

    for meeting in mixed:
        for each in (meeting.sending, meeting.receiving):
            built(found(each))
            plugin_for(each.split()[1])
    with ThreadPoolExecutor(AT_ONCE) as pool:
        began = {each: pool.submit(each.run, found, laboratory, plugin_for) for each in mixed}
        yield lambda meeting: began[meeting].result()


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("meeting", MIXED, ids=lambda each: f"{each.sending}-{each.receiving}")
def test_one_in_one_stack_and_one_in_another_meet(meetings, meeting):
    went = meetings(meeting)
    sender, receiver, stranger = went.outcomes
    log = f"{sender.log}\n{receiver.log}"
    assert receiver.received == sender.role.text, log
    assert (stranger.joined, stranger.received) == (True, None)
    assert went.wire is None or (went.wire.packets and not went.wire.readable)
