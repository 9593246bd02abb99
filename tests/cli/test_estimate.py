"""pqsec estimate: its table, its JSON, its plot, and what it refuses."""

import json

import pytest
from lxml import etree

from pqsec_pki.handshake import MAX_SAMPLE

FLEET = "estimate --participants 4 --profile pq --loss 2%"


@pytest.mark.parametrize(("given", "said"), [("2%", "2%"), ("5", "5%"), ("0.05%", "0.05%")])
def test_a_loss_is_printed_as_it_is_given(pqsec, given, said):
    told = pqsec(f"estimate --participants 2 --profile pq --loss {given}").done().out
    assert f", {said} of all frames lost" in told.splitlines()[0]


def test_the_table_has_both_models_and_the_range(pqsec):
    out = pqsec(FLEET).done().out
    assert "handshakes      6" in out
    assert "closed form  simulation" in out
    assert "valid for" in out


def test_the_same_seed_gives_the_same_json(pqsec):
    one, other, third = (pqsec(f"{FLEET} --json --seed {seed}").done().json for seed in (1, 1, 2))
    assert one == other
    assert one["simulation"] != third["simulation"]
    assert one["closed_form"] == third["closed_form"]
    assert one["frames"] == {"request": 13, "reply": 16, "final": 5}


def test_a_keystore_has_the_sizes_of_its_own_documents(pqsec, tmp_path):
    store = tmp_path / "k"
    pqsec(f"ca init -k {store} --no-passphrase --profile classical").done()
    many = " ".join(f"--publish rt/topic{each}" for each in range(200))
    pqsec(f"issue -k {store} --publish a /one /two").done()
    small = pqsec(f"estimate -k {store} --json").done().json
    pqsec(f"issue -k {store} {many} /three").done()
    large = pqsec(f"estimate -k {store} --json").done().json
    assert (small["participants"], small["profile"]) == (2, "classical")
    assert large["handshakes"] == 3
    assert large["sample_bytes"]["reply"] > small["sample_bytes"]["reply"] + 1000
    pqsec(f"estimate -k {store} --profile pq").refused(2, "the keystore has profile classical")


def test_costs_are_those_of_bench(pqsec, tmp_path):
    bench = tmp_path / "bench.json"
    bench.write_text(pqsec("bench --profile pq --rounds 2 --warm-up 0 --json").done().out)
    costs = pqsec(f"{FLEET} --costs {bench} --json").done().json["costs"]
    median = json.loads(bench.read_text())["suites"][0]["cpu_ms"]["initiator"]["p50"]
    assert costs["initiator"] == median
    sides = '{"initiator": {"p50": %s}, "responder": {"p50": 1}}'
    for text in (
        *("[]", '{"suites": [1]}', "[" * 100_000, '{"suites": []}'),
        *(
            f'{{"suites": [{{"profile": "pq", "wire_version": 1, "cpu_ms": {sides % each}}}]}}'
            for each in ("9" * 400, "1e308", "1e7", "NaN", "-1")
        ),
    ):
        bench.write_text(text)
        assert "not the JSON of `pqsec bench`" in pqsec(f"{FLEET} --costs {bench}").err


def test_the_second_version_takes_fewer_frames_and_is_advised_where_frames_get_lost(
    pqsec, tmp_path
):
    lossy = "estimate --participants 4 --profile pq --loss 10%"
    first, second = (pqsec(f"{lossy} --wire-version {each} --json").done().json for each in (1, 2))
    assert (second["wire_version"], second["frames"]) == (
        2,
        {"request": 9, "reply": 12, "final": 3},
    )
    assert second["closed_form"]["mesh_median_s"] < 0.8 * first["closed_form"]["mesh_median_s"]
    assert second["costs"]["responder"] > first["costs"]["responder"]
    assert "messages of version 2 (wire_versions = [2, 1]" in str(first["advice"])
    assert "messages of version 2" not in str(second["advice"])
    classical = "estimate --participants 4 --profile classical --loss 10%"
    assert "messages of version 2" not in pqsec(classical).done().out
    pqsec(f"{classical} --wire-version 2").refused(2, "have only version 1")
    store = tmp_path / "k"
    pqsec(f"ca init -k {store} --no-passphrase --profile pq").done()
    pqsec(f"issue -k {store} --publish a /one /two").done()
    own, other = (
        pqsec(f"estimate -k {store} --wire-version {each} --json").done().json for each in (1, 2)
    )
    assert other["sample_bytes"]["reply"] < 0.75 * own["sample_bytes"]["reply"]


def test_the_plot_is_svg_and_stays_without_force(pqsec, tmp_path):
    plot = tmp_path / "mesh.svg"
    pqsec(f"{FLEET} --plot {plot}").done()
    root = etree.fromstring(plot.read_bytes())
    assert len(root.findall(".//{http://www.w3.org/2000/svg}polyline")) == 2
    assert "exists" in pqsec(f"{FLEET} --plot {plot}").err
    pqsec(f"{FLEET} --plot {plot} --force").done()


def test_what_makes_no_fleet_is_refused(pqsec, tmp_path):
    for line, words in (
        ("estimate --participants 1", "--participants"),
        ("estimate --participants 5 --loss 51%", "not a loss from 0% to 50%"),
        ("estimate --participants 5 --loss nan", "not a loss from 0% to 50%"),
        ("estimate --participants 5 --fragment 0", "--fragment"),
        ("estimate --participants 5 --start-within nan", "'nan' is not a finite number"),
        ("estimate --participants 5 --start-within inf", "--start-within"),
        (f"estimate --participants 5 --ipfrag-high-thresh 1{'0' * 309}", "--ipfrag-high-thresh"),
    ):
        pqsec(line).refused(2, words)
    store = tmp_path / "k"
    pqsec(f"ca init -k {store} --no-passphrase --profile classical").done()
    pqsec(f"estimate -k {store}").refused(2, "0 participants, not two")


def test_a_participant_with_messages_that_no_peer_reads_is_named(pqsec, tmp_path):
    store = tmp_path / "k"
    pqsec(f"ca init -k {store} --no-passphrase --profile classical").done()
    pqsec(f"issue -k {store} /one /two").done()
    permissions = store / "enclaves" / "two" / "permissions.p7s"
    permissions.write_bytes(permissions.read_bytes() + bytes(MAX_SAMPLE))
    pqsec(f"estimate -k {store}").refused(3, "message of /two", f"at most {MAX_SAMPLE}")


def test_each_set_of_credentials_of_a_keystore_is_predicted(pqsec, tmp_path):
    for store, profiles in (("k", "classical,hybrid"), ("c", "classical"), ("h", "hybrid")):
        pqsec(f"ca init -k {store} --no-passphrase --profile {profiles}").done()
        pqsec(f"issue -k {store} --publish a /one /two").done()
    told = pqsec("estimate -k k --loss 10% --json").done().json
    sets = [told, *told["further"]]
    assert [each["profile"] for each in sets] == ["classical", "hybrid"]
    for each, store in zip(sets, "ch", strict=True):
        alone = pqsec(f"estimate -k {store} --json").done().json
        assert alone["further"] == []
        for name, size in alone["sample_bytes"].items():
            assert abs(each["sample_bytes"][name] - size) < 64
    assert "version 2" in str(sets[1]["advice"])
    assert "version 2" not in str(sets[0]["advice"])
    lines = pqsec("estimate -k k").done().out.splitlines()
    assert sum("2 participants on 2 hosts" in each for each in lines) == 2
    one = pqsec("estimate -k k --profile hybrid --json").done().json
    assert (one["profile"], one["further"]) == ("hybrid", [])
    assert one["sample_bytes"] == sets[1]["sample_bytes"]
    pqsec("estimate -k k --profile hybrid --wire-version 2 --plot mesh.svg").done()
    for line, words in (
        ("--profile pq", "the keystore has profiles classical, hybrid"),
        ("--plot other.svg", "name one with --profile: classical, hybrid"),
        ("--wire-version 2", "classical have only version 1"),
    ):
        pqsec(f"estimate -k k {line}").refused(2, words)
    assert not (tmp_path / "other.svg").exists()


def test_a_set_that_a_participant_lacks_is_named(pqsec, tmp_path):
    pqsec("ca init -k k --no-passphrase --profile classical,hybrid").done()
    pqsec("issue -k k --publish a /one /two").done()
    (tmp_path / "k/sets/hybrid/enclaves/two").rename(tmp_path / "two")
    pqsec("estimate -k k").refused(2, "the set hybrid of the keystore has 1 participant, not two")
    pqsec("estimate -k k --profile classical").done()
