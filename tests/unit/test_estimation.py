"""pqsec estimate: two models that agree, sizes that are those of handshakes, measured limits."""

from dataclasses import replace
from datetime import UTC, datetime
from itertools import product
from statistics import fmean

import pytest

from pqsec_pki.algorithms import PROFILES, profile_named
from pqsec_pki.benchmark import measured_rounds, suites_of
from pqsec_pki.estimation import (
    MOST_PAIRS,
    ClosedForm,
    Costs,
    Estimate,
    Scenario,
    costs_of,
    estimated,
    simulated,
    sizes_of,
)
from pqsec_pki.handshake import WireVersion
from pqsec_pki.stacks import FRAME, FRAME_MEMORY, IPFRAG_HIGH_THRESH

PQ = Scenario(participants=10, sizes=sizes_of(profile_named("pq")), costs=costs_of("pq"))
FREE = Costs(0, 0, "nothing", stack=0, repeat=0, start=0)


@pytest.mark.slow
def test_the_models_agree_over_a_grid():
    """Times of meshes within a quarter, or a round; shares of pairs within a tenth of all
    pairs, or a fifth where all share a host."""
    faults = []
    for participants, loss, hosts, staged in product(
        (2, 24), (0.0, 0.02, 0.1), (0, 1), (0.0, 20.0)
    ):
        asked = replace(
            PQ, participants=participants, loss=loss, hosts=hosts, cores=2, start_within=staged
        )
        closed, events = ClosedForm.of(asked), simulated(asked, seed=1, most=5000)
        one, other = closed.mesh(0.5), events.mesh(0.5)
        if abs(one - other) > max(0.25 * other, 1.1):
            faults.append(("mesh", asked.participants, loss, hosts, staged, one, other))
        for time in (0.6, 1.6, 4.6, 9.6, 18.6):
            apart = events.apart(time)
            if abs(closed.apart(time) - apart) > (0.2 if hosts else 0.1):
                faults.append((time, participants, loss, hosts, staged, closed.apart(time), apart))
    assert faults == []


@pytest.mark.slow
def test_without_losses_and_work_a_pair_takes_the_timers_alone():
    alone = replace(PQ, costs=FREE)
    pairs = simulated(alone, 1).pairs
    assert min(pairs) == pytest.approx(0.21, abs=0.01)  # 0.11 s, and 0.1 to 0.3 s
    assert max(pairs) == pytest.approx(0.71, abs=0.01)  # and 0.3 s more for three of ten
    assert fmean(pairs) == pytest.approx(0.40, abs=0.01)
    assert ClosedForm.of(alone).mesh(0.95) == pytest.approx(0.71, abs=0.1)


@pytest.mark.slow
def test_losses_delay_a_pair_as_expected():
    """The mean: rounds until the Request arrives, then until Reply and Final both do."""
    request, reply, final = 0.98**13, 0.98**16, 1 - (1 - 0.98**5) ** 2
    rounds = 1 / request - 1 + 1 / (reply * final) - 1
    heard = 1 - 0.02**2  # one of both announcements
    answer = 2 * 0.02 * 0.98 / heard * 0.02 * (1 / 0.98)  # the other's, by an answer of a second
    discovery = 8 * (1 / heard - 1) + answer
    many = [simulated(replace(PQ, loss=0.02, costs=FREE), seed).pairs for seed in range(2)]
    mean = fmean(each for pairs in many for each in pairs)
    assert mean == pytest.approx(0.40 + rounds + discovery, rel=0.05)


def test_the_published_discovery_times_follow_the_work_of_pairs():
    """RTI's seconds with authentication less those without (7 hosts, 6.1.0): one cost for each
    pair, as 300 participants took it. With 200 it took 20 % more than that, and with 100 half of
    it, which is a difference of a second."""
    authentication = {100: 4.3 - 3.3, 200: 17.7 - 7.2, 300: 32.8 - 13.9}
    cost = authentication[300] / _work(300)
    assert cost * _work(200) == pytest.approx(authentication[200], rel=0.21)
    assert cost * _work(100) == pytest.approx(authentication[100], abs=1.2)


def _work(participants: int) -> float:
    asked = replace(PQ, participants=participants, hosts=7, costs=replace(FREE, initiator=1))
    return sum(asked.work)


def test_datagrams_that_were_delivered_before_the_memory_was_full():
    """Measured on Linux with 5 % of frames lost, of 1000 datagrams: 298 of 14 kB, 42 of 30 kB."""
    assert _delivered_before_full(14_000, 0.05) == pytest.approx(298, rel=0.1)
    assert _delivered_before_full(30_000, 0.05) == pytest.approx(42, rel=0.2)
    assert _delivered_before_full(8_000, 0.05) > 0.7 * 1000  # all that losses leave
    assert _delivered_before_full(1_300, 0.05) == float("inf")


def _delivered_before_full(size: int, loss: float) -> float:
    """Datagrams that arrive within 30 s before incomplete ones fill the memory for fragments."""
    frames = -(-size // FRAME)
    whole = (1 - loss) ** frames
    if frames == 1:
        return float("inf")
    held = (1 - loss) * frames * FRAME_MEMORY
    return IPFRAG_HIGH_THRESH / held / (1 - whole) * whole


@pytest.mark.slow
def test_memory_for_reassembly_that_is_full_delays_the_simulation():
    asked = replace(PQ, participants=40, loss=0.05, fragment=14_000, costs=FREE)
    tight = simulated(replace(asked, threshold=200_000), seed=1, most=800)
    large = simulated(replace(asked, threshold=1 << 30), seed=1, most=800)
    assert tight.mesh(0.5) > 1.5 * large.mesh(0.5)
    notes = " ".join(estimated(replace(asked, threshold=200_000), 1).notes)
    assert "incomplete datagrams" in notes


def test_sizes_are_those_of_handshakes():
    """Never less: a stack's participant data and the longest ECDSA signatures are counted."""
    new = [each for each in PROFILES if each.key_agreement.binds_transcript]
    second = [each.in_version(WireVersion.SECOND) for each in suites_of(new)]
    for suite in (*suites_of(PROFILES), *second):
        measured = measured_rounds(suite, rounds=1, warm_up=0, now=datetime.now(UTC))
        told = sizes_of(profile_named(suite.profile), suite.version)
        for one, other in zip(
            (told.request, told.reply, told.final), measured.sizes.samples, strict=True
        ):
            assert 0.99 * other <= one < 1.1 * other + 650, suite


@pytest.mark.slow
def test_a_seed_makes_it_the_same_and_large_fleets_take_no_more_events():
    asked = replace(PQ, participants=10_000, loss=0.01)
    one = simulated(asked, seed=5)
    assert one.pairs == simulated(asked, seed=5).pairs
    assert one.pairs != simulated(asked, seed=6).pairs
    assert len(one.pairs) <= MOST_PAIRS
    assert one.events < 20 * MOST_PAIRS
    assert len(ClosedForm.of(asked).turns) == len(ClosedForm.of(PQ).turns)


@pytest.mark.slow
def test_slower_processors_cost_a_busy_fleet_more_than_their_part():
    """Who waits longer repeats more: a mesh of 30 took a quarter longer on a machine that was a
    seventh slower (bench/README.md)."""
    busy = replace(PQ, participants=30, hosts=1, cores=2)
    slower = replace(busy, costs=busy.costs.times(1.15))
    assert slower.work == pytest.approx([1.15 * each for each in busy.work])
    assert slower.busy > 1.25 * busy.busy
    [note] = [each for each in estimated(busy, 1).notes if "computes" in each]
    assert note.startswith("each host computes for 10.8 s, on processors a tenth slower 12.8 s")


@pytest.mark.slow
def test_a_network_through_which_nothing_comes_is_told():
    lost = estimated(replace(PQ, loss=0.5, fragment=64), seed=1)
    assert lost.closed.mesh(0.5) is None
    assert any("gives up" in each for each in lost.notes)


def advice_for(scenario):
    """It follows from the closed form: the simulation is as small as it can be."""
    simulation = simulated(scenario, seed=1, most=1)
    found = Estimate(scenario, ClosedForm.of(scenario), simulation).advice
    return [each.change for each in found]


def test_advice_is_what_would_help():
    large = advice_for(replace(PQ, participants=300, fragment=14_000, loss=0.01))
    assert any("1300 bytes" in each for each in large)
    assert any("ipfrag_high_thresh=12582912" in each for each in large)
    busy = advice_for(replace(PQ, participants=200, hosts=1))
    assert any("start the participants over" in each for each in busy)
    assert advice_for(PQ) == []
    # It would take longer: participants that start apart wait for an announcement.
    slower = advice_for(replace(PQ, participants=500))
    assert not any("start the participants over" in each for each in slower)
    lossy = advice_for(replace(PQ, participants=100, loss=0.1))
    assert [each for each in lossy if "profile" in each]
