"""pqsec migrate plan on the command line."""


def test_a_plan_and_its_rehearsal(domains, pqsec):
    root = domains("classical")
    result = pqsec(f"-k {root} migrate plan --stack cyclonedds --rehearse").done()
    assert result.out.startswith("from profile classical to pq: 3 steps\n\n1. change the keystore")
    assert "  2027-01-01  new acquisitions" in result.out
    assert "  pq: 2 reissued, 1 pair authenticated each other\n" in result.out
    value = pqsec(f"-k {root} migrate plan --to cnsa2 --stack cyclonedds --json").done().json
    assert set(value) == {"from", "to", "steps", "deadlines"}
    assert [each["level"] for each in value["steps"]] == [0, 0, 5]
    assert value["deadlines"][0]["date"] == "2026-09-11"
    pqsec(f"-k {root} migrate plan --stack connext").refused(2, "connext")
    pqsec("-k missing migrate plan").refused(3, "missing")
