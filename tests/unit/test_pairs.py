"""Every two of a keystore meet: who, where, how often, and what stands in the way."""

import multiprocessing
import os
import signal
import time
from contextlib import contextmanager
from itertools import combinations, islice
from threading import Timer

import pytest

from pqsec_pki.errors import FileError, KeystoreError, PqsecError, UnknownAlgorithmError
from pqsec_pki.selfcheck import CheckedStep, HandshakeParty, HandshakeSetup, run_handshake
from pqsec_pki.selfcheck._pool import worker_pool
from pqsec_pki.selfcheck._worker import Worker
from pqsec_pki.selfcheck.pairs import (
    BLOCK,
    WORTH_A_PROCESS,
    AllPairsJob,
    PartyRef,
    check_pairs,
    count_pairs,
)
from pqsec_pki.selfcheck.summary import Cause, Summary, faults
from tests.unit.keystores import DAY, NOW, TWO, add, adopt, made, take

FOUR = {"/a": "0-1", "/b": "1-3", "/c": "2", "/d": "7"}


@pytest.fixture
def keystore(tmp_path):
    """keystore("pq", ...) is one with these participants; more of them are called otherwise."""

    def make(profile="classical", domains="0-9", names=FOUR, folder="k"):
        return made(tmp_path / folder, profile, domains, names)

    return make


@contextmanager
def surveyed(keystore, jobs=1, now=NOW, **options):
    job = AllPairsJob(root=keystore.root, now=now, **options)
    with check_pairs(job, keystore.names(), jobs) as found:
        yield found


def told(keystore, **options):
    """(names, domain, ok) of each pair."""
    with surveyed(keystore, **options) as found:
        return [
            (each.first.party.name, each.second.party.name, each.domain, each.ok)
            for each in found.outcomes()
        ]


def tallied(keystore, **options):
    """The tally, and the faults of participants by themselves."""
    summary = Summary()
    with surveyed(keystore, **options) as found:
        for outcome in found.outcomes():
            summary.add(outcome)
        return summary, faults(found.findings.values())


def counts(summary):
    return summary.met, summary.failed, summary.apart, summary.tried


# Who meets, and where


def test_each_two_meet_on_the_first_domain_that_both_may_join(keystore):
    assert told(keystore()) == [
        ("/a", "/b", 1, True),
        ("/a", "/c", None, None),
        ("/a", "/d", None, None),
        ("/b", "/c", 2, True),
        ("/b", "/d", None, None),
        ("/c", "/d", None, None),
    ]


def test_a_domain_that_is_named_is_where_all_meet(keystore):
    found = told(keystore(names={"/a": "0-3", "/b": "1-3", "/c": "2"}), domain=3)
    assert found == [
        ("/a", "/b", 3, True),
        ("/a", "/c", None, None),
        ("/b", "/c", None, None),
    ]


def test_a_domain_that_governance_does_not_have_is_none(keystore):
    keystore = keystore(names={"/a": "0-3", "/b": "1-3"}, domains="2-9")
    assert told(keystore) == [("/a", "/b", 2, True)]


def test_domain_zero_can_be_named(keystore):
    summary, _ = tallied(keystore(names={"/a": "0-1", "/b": "1"}), domain=0)
    assert counts(summary) == (0, 0, 1, 0)


def test_a_pair_meets_as_it_does_alone(keystore):
    keystore = keystore("transition")
    alone = run_handshake(
        HandshakeSetup(keystore=keystore, domain=1, now=NOW),
        HandshakeParty(name="/a"),
        HandshakeParty(name="/b"),
    )
    with surveyed(keystore) as found:
        result = next(found.outcomes()).result
    assert (result.initiator, result.replier) == (alone.initiator, alone.replier)
    assert result.failed is None
    assert result.milliseconds > 0


def test_the_key_agreement_is_the_one_that_is_asked_for(keystore, tmp_path):
    keystore = keystore(names=TWO)
    summary, _ = tallied(keystore, key_agreement="mlkem768")
    assert counts(summary) == (1, 0, 0, 1)
    with pytest.raises(UnknownAlgorithmError):
        tallied(keystore, key_agreement="kyber")


def test_a_folder_without_a_keystore_is_refused(tmp_path):
    job = AllPairsJob(root=tmp_path, now=NOW)
    with pytest.raises(KeystoreError), check_pairs(job, ["/a", "/b"], 1):
        pass


# Stacks


def test_with_one_stack_each_pair_meets_both_ways_round(keystore):
    with surveyed(keystore(names=TWO), stacks=("pqsec", "opendds")) as found:
        parties = [(each.first.party, each.second.party) for each in found.outcomes()]
    one, other = TWO
    assert parties == [
        (PartyRef(one, "pqsec"), PartyRef(other, "opendds")),
        (PartyRef(other, "pqsec"), PartyRef(one, "opendds")),
    ]


def test_two_of_one_stack_meet_once(keystore):
    summary, _ = tallied(keystore(names=TWO), stacks=("opendds", "opendds"))
    assert counts(summary) == (1, 0, 0, 1)


def test_between_cyclone_dds_and_fast_dds_one_way_round_fails_in_each_pair(keystore):
    """Who initiates hangs on the names, so it is another side in each of the two."""
    keystore = keystore(names=("/a", "/b", "/c"))
    summary, alone = tallied(keystore, stacks=("cyclonedds", "fastdds"))
    assert counts(summary) == (3, 3, 0, 6)
    assert alone == {}
    [(cause, outcomes)] = summary.causes.items()
    assert cause.step == "reply"
    assert cause.words.startswith("Cyclone DDS (the replier) refuses: ")
    assert "only where Cyclone DDS initiates" in cause.hint
    assert len(outcomes) == 3
    for outcome in outcomes:
        stacks = dict([outcome.first.party, outcome.second.party])
        assert stacks[outcome.result.initiator] == "fastdds"


def test_a_stack_that_takes_none_of_the_keys_is_told_once(keystore):
    summary, alone = tallied(
        keystore("pq", names=("/a", "/b", "/c")), stacks=("pqsec", "cyclonedds")
    )
    assert counts(summary) == (0, 6, 0, 0)
    assert summary.causes == {}
    [((stack, cause), findings)] = alone.items()
    assert (stack, cause.step) == ("cyclonedds", "identity of NAME")
    assert "Cyclone DDS accepts no ml-dsa-65 key of a participant" in cause.words
    assert [each.party.name for each in findings] == ["/a", "/b", "/c"]


# What stands in the way


def alone_at_fault(keystore, now=NOW):
    """The one cause why one participant meets nobody, and its name."""
    summary, alone = tallied(keystore, now=now)
    names = keystore.names()
    pairs = len(names) - 1
    rest = len(list(combinations(names, 2))) - pairs
    assert counts(summary) == (rest, pairs, 0, rest)
    assert summary.causes == {}
    [((_, cause), [finding])] = alone.items()
    assert finding.failed.name == cause.step.replace("NAME", finding.party.name)
    return cause, finding.party.name


@pytest.fixture
def three(keystore):
    return keystore(domains="0", names=("/a", "/a/arm", "/b"))


def test_a_key_that_cannot_be_read_fails_all_pairs_of_its_participant(three):
    (three.root / "enclaves/a/key.pem").write_text("gone")
    cause, name = alone_at_fault(three)
    assert (cause.step, name) == ("files of NAME", "/a")
    assert f"{three.root}/enclaves/a/key.pem: " in cause.words
    assert (
        cause.hint
        == "restore it from a backup, or reissue it: `pqsec renew NAME` keeps its permissions"
    )


def test_the_certificate_of_another_fails_all_pairs_of_its_participant(three):
    take(three, "cert.pem", "/a", "/b")
    cause, name = alone_at_fault(three)
    assert (cause.step, name) == ("identity of NAME", "/b")
    assert "cert.pem: the certificate is for CN=/a" in cause.words


def test_the_permissions_of_another_fail_all_pairs_of_its_participant(three):
    take(three, "permissions.p7s", "/a", "/a/arm")
    cause, name = alone_at_fault(three)
    assert (cause.step, name) == ("documents of NAME", "/a/arm")
    assert cause.words == "NAME may not join domain 0: no grant is for CN=NAME"


@pytest.mark.parametrize("file", ["permissions.p7s", "governance.p7s"])
def test_a_document_that_is_none_fails_all_pairs_of_its_participant(three, file):
    path = three.root / "enclaves/b" / file
    path.unlink()
    path.write_text("nothing")
    cause, name = alone_at_fault(three)
    assert (cause.step, name) == ("documents of NAME", "/b")
    assert file in cause.words


def test_an_expired_participant_fails_all_its_pairs(three):
    add(three, now=NOW - 60 * DAY, **{"/late": "0"})
    cause, name = alone_at_fault(three, now=NOW + 40 * DAY)
    assert (cause.step, name) == ("identity of NAME", "/late")
    assert "the certificate of CN=NAME expired on 2026-12-21" in cause.words


def test_two_cas_of_one_name_fail_where_they_meet(keystore):
    """Each trusts the CA in its own files, so neither is at fault alone."""
    names = ("/a", "/b", "/c")
    ours = keystore(domains="0", names=names)
    other = keystore(domains="0", names=names, folder="other")
    adopt(ours, other, "/c")
    summary, alone = tallied(ours)
    assert alone == {}
    assert counts(summary) == (1, 2, 0, 3)
    assert {
        name for each in summary.causes.values() for pair in each for name in pair_of(pair)
    } == {*names}
    for cause in summary.causes:
        assert cause.step == "reply"
        assert "the certificate of CN=the initiator is not signed by this CA" in cause.words
    assert len(summary.causes) == 1


def pair_of(outcome):
    return outcome.first.party.name, outcome.second.party.name


def test_a_participant_that_vanishes_after_the_first_look_is_told(keystore):
    keystore = keystore(domains="0", names=("/a", "/b"))
    with surveyed(keystore) as found:
        found._pool.worker.setup._read.clear()
        (keystore.root / "enclaves/b/cert.pem").unlink()
        [outcome] = found.outcomes()
    assert outcome.ok is False
    assert outcome.result.failed.name == "files of /b"


def test_nothing_tried_is_no_proof(keystore):
    summary, _ = tallied(keystore(names={"/a": "1", "/b": "2"}))
    assert counts(summary) == (0, 0, 1, 0)
    assert summary.ok is False
    summary, _ = tallied(keystore(names=TWO, folder="other"))
    assert summary.ok is True


def test_sizes_do_not_part_what_has_one_cause(keystore):
    keystore = keystore("transition", "0", ("/a", "/a-long-one", "/b", "/c"))
    summary, _ = tallied(keystore, stacks=("fastdds-3.1", "fastdds-3.1"))
    assert counts(summary) == (0, 6, 0, 6)
    [cause] = summary.causes
    assert cause.words.startswith("Fast DDS 3.1 (the initiator) refuses: a message of ... bytes: ")


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("not a public key: 255 bytes", "not a public key: 256 bytes"),
        ("a message of 9000 bytes: over 8192 bytes", "a message of 9001 bytes: over 8192 bytes"),
        ("/a may not join", "/a/b may not join"),
        ("CN=/a is not signed by this CA", "CN=/a/b is not signed by this CA"),
    ],
)
def test_names_and_sizes_do_not_make_another_cause(one, other):
    found = [
        Cause.of(CheckedStep("reply", ok=False, detail=words), {name: "it"})
        for words, name in ((one, "/a"), (other, "/a/b"))
    ]
    assert found[0] == found[1]


@pytest.mark.parametrize("words", ["k/enclaves/a/key.pem", "/a/arm is late", "/a-z", "x/a"])
def test_what_only_holds_a_name_is_left_as_it_is(words):
    assert Cause.of(CheckedStep("files", ok=False, detail=words), {"/a": "it"}).words == words


# Many, on several processes


@pytest.fixture(scope="module")
def many(tmp_path_factory):
    """Just enough for two processes."""
    names = [f"/n{number}" for number in range(13)]
    return made(tmp_path_factory.mktemp("many") / "k", "classical", "0", names)


@pytest.mark.slow
def test_two_processes_say_what_one_says(many):
    assert count_pairs(many.names(), AllPairsJob(root=many.root, now=NOW)) >= WORTH_A_PROCESS
    with surveyed(many, jobs=2) as found:
        two = [(pair_of(each), each.ok, each.result.initiator) for each in found.outcomes()]
        assert len(multiprocessing.active_children()) == 2
    assert multiprocessing.active_children() == []
    with surveyed(many, jobs=1) as found:
        assert found._pool.members == ()
        one = [(pair_of(each), each.ok, each.result.initiator) for each in found.outcomes()]
    assert one == two
    assert [names for names, _, _ in one] == list(combinations(many.names(), 2))
    assert all(ok for _, ok, _ in one)


def test_a_fault_is_told_by_other_processes_too(many, tmp_path):
    path = many.root / "enclaves/n3/key.pem"
    kept = path.read_bytes()
    path.write_text("gone")
    try:
        summary, alone = tallied(many, jobs=2)
    finally:
        path.write_bytes(kept)
    assert counts(summary) == (66, 12, 0, 66)
    assert [each.party.name for [each] in alone.values()] == ["/n3"]


@pytest.mark.slow
def test_who_stops_early_leaves_no_process_behind(many):
    with surveyed(many, jobs=2) as found:
        assert len(list(islice(found.outcomes(), 3))) == 3
    assert multiprocessing.active_children() == []


def come_late(_worker, path):
    time.sleep(10)
    path.touch()


def fail(_worker, path):
    raise FileError(f"{path} is damaged", hint="restore it")


@pytest.mark.slow
def test_an_interrupt_waits_for_no_work(many, tmp_path):
    job = AllPairsJob(root=many.root, now=NOW)
    late = [tmp_path / str(number) for number in range(9)]
    with pytest.raises(KeyboardInterrupt), worker_pool(job, 2) as pool:  # noqa: PT012 -- it ends within
        assert list(pool.map(Worker.check_parties, [[], []])) == [[], []]  # they have started
        Timer(1, os.kill, [os.getpid(), signal.SIGINT]).start()
        next(pool.map(come_late, late))
    assert multiprocessing.active_children() == []
    assert not any(path.exists() for path in late)


@pytest.mark.slow
def test_an_error_in_another_process_is_told_in_full(many):
    job = AllPairsJob(root=many.root, now=NOW)
    with pytest.raises(FileError, match="k is damaged") as caught, worker_pool(job, 2) as pool:
        next(pool.map(fail, ["k", "l"]))
    assert caught.value.hint == "restore it"
    assert multiprocessing.active_children() == []


def test_a_process_that_is_killed_is_told(many):
    def kill_and_go_on():
        with surveyed(many, jobs=2) as found:
            for process in multiprocessing.active_children():
                process.kill()
            list(found.outcomes())

    with pytest.raises(PqsecError, match="a worker process was killed") as refusal:
        kill_and_go_on()
    assert "--jobs 1" in refusal.value.hint
    assert multiprocessing.active_children() == []


def test_the_processes_run_no_code_of_the_folder_where_they_start(many, tmp_path, monkeypatch):
    """A user who may write in another's working folder could make that user run commands."""
    (tmp_path / "multiprocessing.py").write_text("raise SystemExit(3)")
    monkeypatch.chdir(tmp_path)
    job = AllPairsJob(root=many.root, now=NOW)
    with worker_pool(job, 2) as pool:
        assert list(pool.map(Worker.check_parties, [[], []])) == [[], []]
    assert "PYTHONSAFEPATH" not in os.environ


def test_few_pairs_are_not_worth_a_process(keystore):
    with surveyed(keystore(), jobs=8) as found:
        assert found._pool.members == ()


def test_results_come_while_the_rest_is_still_to_be_done(keystore, monkeypatch):
    blocks = []
    meet_really = Worker.run_pairs

    def counted(worker, pairs):
        blocks.append(len(pairs))
        return meet_really(worker, pairs)

    monkeypatch.setattr(Worker, "run_pairs", counted)
    names = [f"/n{number}" for number in range(8)]
    with surveyed(keystore(names=names, domains="0")) as found:
        outcomes = found.outcomes()
        assert next(outcomes).ok
        assert blocks == [BLOCK]
        assert len(list(outcomes)) == count_pairs(names, found.job) - 1
    assert blocks == [BLOCK, 28 - BLOCK]
