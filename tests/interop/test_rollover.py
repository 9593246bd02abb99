"""Robots of a real fleet go over to a new identity CA one by one: processes of the real stacks.

A round is what `pqsec ca rotate --overlap` makes of a keystore. Alice has the files of one
round, bob those of another, and a sample goes from each to the other; or it does not.
"""

import os
import shutil
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import mkdtemp

import pytest

from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import Rollover, Scope
from pqsec_pki.trial import (
    Act,
    Installation,
    TopicRoute,
    Trial,
    TrialPlugin,
    TrialSetup,
    built,
    credentialed,
    plugin,
    run_peers,
    run_trial,
    unique_text,
)
from tests.interop.conftest import LAB_PROFILES, TOPIC, Lab
from tests.unit.keystores import begin_overlap, finish_overlap, rotate, switch_overlap

pytestmark = pytest.mark.interop

ALICE, BOB = "/lab/alice", "/lab/bob"
ROUNDS = ("old", "begun", "switched", "finished")
NEIGHBOURS = [("old", "begun"), ("begun", "switched"), ("switched", "finished")]
APART = [("old", "switched"), ("begun", "finished")]
AT_ONCE = 4 if os.geteuid() == 0 else 1
"""Most of what they do is waiting. Who is not root has but one network for all."""
LONGEST, LEAST = 30.0, 4.0
"""Seconds: to meet, and to be sure that two do not; a meeting takes less than one."""


@pytest.fixture(scope="module")
def rounds(tmp_path_factory, now):
    """rounds(profile) are copies of a keystore, by what was done last."""
    folder = tmp_path_factory.mktemp("rounds")

    def make(profile: str) -> dict[str, Path]:
        lab = Lab.create(folder / profile, LAB_PROFILES[profile], now)
        keystore = lab.keystore
        terms = Rollover(profile=keystore.profile, scope=Scope.IDENTITY)
        how = {"kept": lab.authorities, "passphrase": None, "now": now}
        made = {}
        for name, step in (
            ("old", lambda: None),
            ("begun", lambda: begin_overlap(keystore, terms, **how)),
            ("switched", lambda: switch_overlap(keystore, terms, **how)),
            ("finished", lambda: finish_overlap(keystore, now=now)),
        ):
            step()
            made[name] = folder / f"{profile}-{name}"
            shutil.copytree(keystore.root, made[name], symlinks=True)
        return made

    return cache(make)


@dataclass(frozen=True)
class Fleet:
    """Two robots, each with the files of a round, that run one stack."""

    installation: Installation
    rounds: dict[str, Path]
    folder: Path
    now: object
    plugin: TrialPlugin | None = None

    def mixed(self, of_alice: str, of_bob: str) -> Keystore:
        """A keystore in which bob has the files of his round, and alice those of hers."""
        root = Path(mkdtemp(dir=self.folder)) / "k"
        shutil.copytree(self.rounds[of_bob], root, symlinks=True)
        hers = root / f"enclaves{ALICE}"
        shutil.rmtree(hers)
        shutil.copytree(self.rounds[of_alice] / f"enclaves{ALICE}", hers)
        return Keystore.open(root)

    def trial(self, keystore: Keystore, *, good: bool) -> Trial:
        return Trial(
            installation=self.installation,
            keystore=keystore,
            timeout=LONGEST if good else LEAST,
            anyway=True,  # no export is made of the files of another round
            now=self.now,
            plugin=self.plugin,
        )

    def refused(self, of_alice: str, of_bob: str) -> str:
        """What the stack said when the two did not meet."""
        way = TopicRoute(sender=ALICE, receiver=BOB, domain=0, topic=TOPIC)
        report = run_trial(self.trial(self.mixed(of_alice, of_bob), good=False), way)
        assert not report.accepted
        assert not report.sender.matched
        return "\n".join(each.log for each in report.trial_run.outcomes)

    def failures(self, *pairs: tuple[str, str]) -> list[str]:
        """What went wrong where samples should go both ways, and a stranger get none."""
        trials = [self.trial(self.mixed(*pair), good=True) for pair in pairs]
        ways = [
            TopicRoute(sender=sender, receiver=receiver, domain=0, topic=TOPIC)
            for sender, receiver in ((ALICE, BOB), (BOB, ALICE))
        ]
        with ThreadPoolExecutor(AT_ONCE) as pool:
            reports = pool.map(lambda one: run_trial(*one), product(trials, ways))
        return [
            "\n".join(each.log for each in report.trial_run.outcomes)
            for report in reports
            if not report.ok
        ]


@pytest.fixture
def fleet(request, rounds, stack_in, tmp_path, now) -> Iterator[Fleet]:
    """Robots with Fast DDS, or with Cyclone DDS and pqsec's plugin or its own ones."""
    stack, _, of = request.param.partition(" of ")
    name, _, ours = stack.partition(" with ")
    which = stack_in(name, of or "bookworm")
    with ExitStack() as opened:
        yield Fleet(
            installation=which,
            rounds=rounds("pq" if ours else "classical"),
            folder=tmp_path,
            now=now,
            plugin=opened.enter_context(plugin()) if ours else None,
        )


TAKING_PART = ["fastdds", "fastdds of trixie", "cyclonedds with plugin"]
SWITCHING = ["cyclonedds", "cyclonedds of trixie"]


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("fleet", TAKING_PART, indirect=True)
def test_a_robot_meets_those_of_the_round_before_and_after(fleet):
    assert fleet.failures(*NEIGHBOURS) == []


@pytest.mark.slow
@pytest.mark.parametrize("fleet", TAKING_PART, indirect=True)
def test_who_missed_a_round_is_refused(fleet):
    with ThreadPoolExecutor(AT_ONCE) as pool:
        assert all(pool.map(lambda pair: fleet.refused(*pair), APART))


@pytest.mark.slow
@pytest.mark.parametrize("fleet", SWITCHING, indirect=True)
def test_cyclones_own_plugins_trust_who_issues_alone(fleet):
    assert fleet.failures(("old", "begun"), ("switched", "finished")) == []
    assert "unable to get local issuer certificate" in fleet.refused("begun", "switched")


@pytest.mark.parametrize("fleet", SWITCHING, indirect=True)
def test_no_configuration_has_cyclones_own_plugins_trust_a_folder(fleet, tmp_path):
    trial = fleet.trial(fleet.mixed("begun", "begun"), good=False)
    trusted = tmp_path / "trusted"
    trusted.mkdir()
    for number, each in enumerate(("old", "finished")):
        ca = fleet.rounds[each] / "public/identity_ca.cert.pem"
        shutil.copy(ca, trusted / f"{number}.pem")
    roles = [
        credentialed(trial, ALICE, Act.SEND, tmp_path, unique_text()),
        credentialed(trial, BOB, Act.RECEIVE, tmp_path),
    ]
    for path in tmp_path.glob("*/cyclonedds.xml"):
        element = f"<TrustedCADirectory>{trusted}</TrustedCADirectory></Authentication>"
        path.write_text(path.read_text().replace("</Authentication>", element))
    program = fleet.installation.peer(built(fleet.installation))
    went = run_peers(TrialSetup(program=program, domain=0, topic=TOPIC, timeout=LEAST), roles)
    for outcome in went.outcomes:
        assert not outcome.joined
        assert "Cannot specify both CRL and trusted_ca_list" in outcome.log


@pytest.fixture(scope="module")
def permissions_rounds(tmp_path_factory, now):
    """permissions_rounds(name) are the same of permissions CAs, the new one called so."""
    folder = tmp_path_factory.mktemp("permissions")

    def make(name: str) -> dict[str, Path]:
        lab = Lab.create(folder / name, LAB_PROFILES["classical"], now)
        terms = Rollover(profile=lab.keystore.profile, scope=Scope.PERMISSIONS, name=name)
        made = {each: folder / f"{name}-{each}" for each in ROUNDS}
        for each in ("old", "begun"):
            shutil.copytree(lab.keystore.root, made[each], symlinks=True)
        rotate(lab.keystore, terms, kept=lab.authorities, passphrase=None, now=now)
        for each in ("switched", "finished"):
            shutil.copytree(lab.keystore.root, made[each], symlinks=True)
        place = "public/permissions_ca.cert.pem"
        both = b"".join((made[each] / place).read_bytes() for each in ("old", "finished"))
        for each in ("begun", "switched"):
            (made[each] / place).write_bytes(both)
        return made

    return cache(make)


@pytest.fixture
def permissions_fleet(stack_in, permissions_rounds, tmp_path, now):
    """permissions_fleet(where, name) are robots with Fast DDS that go over to such a CA."""
    return lambda where, name: Fleet(
        installation=stack_in("fastdds", where),
        rounds=permissions_rounds(name),
        folder=tmp_path,
        now=now,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("where", "name", "gap"),
    [
        ("trixie", "Lab", None),  # the name that the old one has
        ("trixie", "Other", ("switched", "finished")),
        ("bookworm", "Lab", ("begun", "switched")),
        ("bookworm", "Other", ("switched", "finished")),
    ],
)
def test_fast_dds_goes_over_to_a_permissions_ca_at_most_of_the_same_name(
    permissions_fleet, where, name, gap
):
    fleet = permissions_fleet(where, name)
    if gap is None:
        assert fleet.failures(*NEIGHBOURS) == []
    else:
        assert fleet.refused(*gap)
