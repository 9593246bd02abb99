"""pqsec ra, and orders in pqsec sign-request, as users run them."""

from datetime import timedelta

import pytest

from pqsec_pki.cli import _settings
from tests.unit.approving import make_key

ADD = "-k k ra add line1 --key line1.pub.pem --allow-name /fleet/* --role robot --max-count 2"
ADD += " --validity 30d"
CSR = "r/requests/fleet+r1/request.csr"
ORDER = f"sign-request export {CSR} --grant line1.grant --key line1.pem -o order"
SIGN = "-k k sign-request sign order -o answer --ra-only"
DOMAIN = """
profile: classical
roles:
  robot: {publish: [rt$name/pose]}
  arm: {publish: [rt$site/pose]}
"""


@pytest.fixture
def lab(pqsec, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "domain.yaml").write_text(DOMAIN)
    make_key(tmp_path, "line1")
    make_key(tmp_path, "other")
    pqsec("-k k apply --yes --no-passphrase").done()
    pqsec("request /fleet/r1 --profile classical --dir r").done()
    return tmp_path


def test_a_registration_authority_enrols_a_robot(pqsec, lab):
    told = pqsec(f"{ADD} --json").done().json
    assert (told["authority"], told["most"], told["written"]) == ("line1", 2, "line1.grant")
    pqsec(ADD).refused(3, "line1.grant exists")
    pqsec(f"{ADD} --force").refused(3, "line1 has a grant", hint="pqsec ra revoke line1")
    pqsec(ORDER).done()
    shown = pqsec("-k k sign-request sign order --show --json").done().json
    assert (shown["ordered_by"], shown["done"]) == ("line1", False)
    assert shown["participants"][0] == {
        "name": "/fleet/r1",
        "role": "robot",
        "hours": 90 * 24,
        "request": shown["participants"][0]["request"],
    }
    pqsec(SIGN).done()
    pqsec(SIGN).done()
    (lab / "other").write_text("x")
    other = SIGN.replace("-o answer", "-o other")
    pqsec(other).refused(3, "other exists", hint="another -o")
    assert pqsec("-k k sign-request sign order --show").done().out.count("and performed") == 1
    pqsec("sign-request import answer --request order --bundles out").done()
    pqsec("install out/fleet+r1.bundle --dir r --trust-first").done()
    [grant] = pqsec("-k k ra list --json").done().json["registration_authorities"]
    assert (grant["state"], grant["used"]) == ("valid", 1)
    listed = pqsec("-k k ra list --format csv").done().out.splitlines()[1]
    assert listed.startswith("line1,valid,20")
    assert f",1,2,/fleet/*,robot,{90 * 24}," in listed
    refused = pqsec("-k k ra list --enrolled line1 --format csv")
    refused.refused(2, "--format csv lists all grants")
    assert pqsec("-k k ra list --enrolled line1").done().out == "/fleet/r1\n"
    assert pqsec("-k k ra list --grant line1").done().out == (lab / "line1.grant").read_text()
    pqsec("-k k log --verify").done()
    assert "ended, used for 1" in pqsec("-k k ra revoke line1").done().out
    assert "had ended before" in pqsec("-k k ra revoke line1").done().out
    another = ADD.replace("--max-count 2", "--max-count 3")
    pqsec(f"{another} --force").done()


def test_an_order_performed_again_later_keeps_its_answer(pqsec, lab, monkeypatch):
    """A second run makes its bundles again, with another time and the same files."""
    pqsec(ADD).done()
    pqsec(ORDER).done()
    pqsec(SIGN).done()
    answer = (lab / "answer").read_bytes()
    later = _settings.now() + timedelta(seconds=2)
    monkeypatch.setattr(_settings, "now", lambda: later)
    pqsec(SIGN).done()
    assert (lab / "answer").read_bytes() == answer


def test_what_nobody_ordered_needs_a_human(pqsec, lab):
    pqsec(f"sign-request export {CSR} --publish t -o order").done()
    pqsec(SIGN).refused(1, "no registration authority ordered this")
    assert not (lab / "k/enclaves/fleet").exists()


def test_an_order_is_not_loosened_by_options(pqsec, lab):
    pqsec(ADD).done()
    pqsec(ORDER).done()
    for option in ("--force", "--after-revocation", "--reuse-compromised-key"):
        pqsec(f"{SIGN} {option}").refused(2, "and nothing else")
    pqsec(f"{SIGN} --allow-name /hall/*").refused(1, "not one of the allowed names")
    pqsec(f"{SIGN} --sha256 00").refused(1, "its SHA-256 is")


def test_mistakes_are_named(pqsec, lab):
    pqsec(ADD).done()
    for option in ("--publish t", "--ros-node /n", "--policy p.yaml", "--domain 3"):
        pqsec(f"{ORDER} {option}").refused(2, f"{option.split()[0]} cannot be ordered")
    lone = ORDER.replace("--key line1.pem ", "")
    pqsec(lone).refused(2, "--grant and --key need each other")
    pqsec(f"{ORDER} --validity 1y").refused(2, "365 days were ordered, and 90 days at most")
    elsewhere = ADD.replace("line1", "other").replace("/fleet", "/hall")
    pqsec(elsewhere).done()
    pqsec(ORDER.replace("line1", "other")).refused(2, "/fleet/r1: the grant is for /hall/*")
    pqsec(f"sign-request export {CSR} --role x -o order").refused(2, "--role needs both")
    pqsec(f"{ORDER} --role arm").refused(2, "the grant has no role arm")
    pqsec(ORDER.replace("line1.pem", "other.pem")).refused(1, "is not that of line1")
    pqsec(ORDER.replace("line1.grant", CSR)).refused(3, "not a grant of pqsec")
    again = ADD.replace("line1 ", "line2 ", 1)
    pqsec(again.replace("--role robot", "--role rbot")).refused(
        2, "no role rbot", hint="did you mean"
    )
    pqsec(again.replace("--role robot", "--role arm")).refused(2, "needs $site")
    pqsec(again.replace("line1.pub.pem", "line1.pem")).refused(
        3, "a private key", hint="`openssl pkey -in line1.pem -pubout`"
    )
    pqsec(again.replace("/fleet/*", "fleet")).refused(2, "names begin with a slash")
    pqsec("-k k ra list --grant line3").refused(3, "no registration authority line3")
    pqsec("-k k ra revoke line3").refused(3, "no registration authority line3")
    assert not (lab / "line2.grant").exists()


def test_a_restored_copy_is_refused_with_anchors(pqsec, lab):
    pqsec(ADD).done()
    pqsec("-k k ra revoke line1").done()
    pqsec("-k k log --anchor anchors").done()
    (lab / "k/private/ledger.sqlite3").write_bytes((lab / "k/private/ledger.sqlite3").read_bytes())
    pqsec(ORDER).done()
    pqsec(f"{SIGN} --anchor nowhere").refused(1, "nowhere has no anchors")
    pqsec(f"{SIGN} --anchor anchors").refused(1, "the grant of line1 was revoked")
