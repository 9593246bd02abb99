"""pqsec migrate plan on the command line."""

import pytest

from tests.unit.test_migration import DOMAIN


def test_a_plan_and_its_rehearsal(domains, pqsec):
    root = domains("classical")
    result = pqsec(f"-k {root} migrate plan --stack cyclonedds --rehearse").done()
    assert result.out.startswith("from profile classical to pq: 3 steps\n\n1. change the keystore")
    assert "  2027-01-01  new acquisitions" in result.out
    assert "  pq: 2 reissued, 1 pair authenticated each other\n" in result.out
    told = pqsec(f"-k {root} migrate plan --to cnsa2 --stack cyclonedds --steps new/steps --json")
    value = told.done().json
    assert set(value) == {"from", "to", "steps", "deadlines", "files"}
    assert pqsec(f"-k {root} apply {value['files'][0]} --check").code == 1
    assert [each["level"] for each in value["steps"]] == [0, 0, 5]
    assert value["deadlines"][0]["date"] == "2026-09-11"
    pqsec(f"-k {root} migrate plan --stack connext").refused(2, "connext")
    pqsec("-k missing migrate plan").refused(3, "missing")


def test_a_plan_that_gives_up_protection_against_quantum_computers_says_so(keystore, pqsec):
    root = keystore("transition")
    line = f"-k {root} migrate plan --to classical --stack cyclonedds"
    result = pqsec(line).done()
    lost = "no protection against quantum computers, which can"
    files = f"certificates and documents: {lost} forge them (before: NIST level 3)"
    traffic = (
        f"traffic between robots with pqsec's plugin: {lost} decrypt recordings of it"
        " (before: NIST level 3)"
    )
    note = "note: profile classical protects less against quantum computers than profile transition"
    assert f"   lost     {files}\n   lost     {traffic}\n" in result.out
    assert note in result.err
    assert "skipped  certificates and documents keep" not in result.out
    [step] = pqsec(f"{line} --json").done().json["steps"]
    assert step["lost"] == [files, traffic]
    rotation = pqsec(f"-k {root} ca rotate --profile classical").done().out
    assert f"  - Protection is lost: {files}.\n" in rotation
    (root / "back.yaml").write_text(
        "profile: classical\nmigrate_from: transition\nparticipants: []"
    )
    assert f"; {files}; {traffic})" in pqsec(f"-k {root} plan {root}/back.yaml").out


def test_a_plan_that_gives_up_no_protection_does_not_say_so(keystore, pqsec):
    root = keystore("classical")
    for target in ("transition", "pq"):
        result = pqsec(f"-k {root} migrate plan --to {target} --stack cyclonedds").done()
        assert "lost" not in result.out
        assert "protects less" not in result.err


@pytest.mark.slow
def test_a_rehearsal_that_fails_ends_with_1(keystore, pqsec):
    root = keystore("classical")
    topics = "".join(f" --publish rt/some/very/long/topic/name/number{n:06d}" for n in range(4500))
    pqsec(f"-k {root} issue /large{topics}").done()
    found = pqsec(f"-k {root} migrate plan --stack cyclonedds --rehearse")
    assert found.code == 1
    assert "  pq: 3 reissued, 1 pair authenticated each other\n" in found.out
    assert "    not: /large, /talker: final: a sample larger than 266240 bytes\n" in found.out


def test_the_stacks_of_a_domain_file_and_its_steps(pqsec, tmp_path):
    (tmp_path / "names.txt").write_text("/talker\n/listener\n")
    (tmp_path / "domain.yaml").write_text(DOMAIN)
    pqsec("-k k apply --yes --no-passphrase").done()
    pqsec("-k k migrate plan domain.yaml --steps steps").refused(3, "names.txt")
    told = pqsec("-k k migrate plan domain.yaml --steps .").done().out
    assert "   needs    Fast DDS 3.1: use another version" in told
    assert "OpenDDS" not in told
    assert told.endswith(
        "\n\npqsec apply 1-transition.yaml\npqsec apply 2-transition.yaml\npqsec apply 3-pq.yaml\n"
    )
    pqsec("-k k migrate plan domain.yaml --steps .").refused(3, "1-transition.yaml exists")
    (tmp_path / "1-transition.yaml").write_text("edited")
    pqsec("-k k migrate plan domain.yaml --steps . --force").done()
    told = pqsec("-k k plan 1-transition.yaml")
    assert told.code == 1
    assert told.out == (
        "change the profile  (from classical to transition: new CAs, and new certificates for 2"
        " participants)\n1 change; 0 participants are up to date\n"
    )
    pqsec("-k k apply 1-transition.yaml").refused(
        2, "no terminal to ask", shows="change the profile"
    )
    done = pqsec("-k k apply 1-transition.yaml --yes --no-passphrase").done()
    assert done.out == "change the profile: done\n"
    assert "restart all participants" in done.err
    pqsec("-k k apply 2-transition.yaml --check").done()
    pqsec("-k k apply 3-pq.yaml --yes").refused(2, "passphrase")
    done = pqsec("-k k apply 3-pq.yaml --yes --no-passphrase --json").done()
    assert [each["action"] for each in done.json["steps"]] == ["change-profile"]
    assert pqsec("-k k check").code == 0
