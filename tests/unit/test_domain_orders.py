"""Orders that a domain file names: `apply` enrols by them what grant and file have in common."""

from dataclasses import replace

import pytest

from pqsec_pki.algorithms import SIGNATURES
from pqsec_pki.certificates import Reason
from pqsec_pki.domain import read_domain
from pqsec_pki.errors import InvalidDocumentError, KeystoreError, VerificationError
from pqsec_pki.keystore import audit, registrations
from pqsec_pki.lifecycle import add_registration, end_registrations, revoke, sign_head
from tests.unit.approving import PEOPLE, make_key
from tests.unit.domains import NOW
from tests.unit.test_registration import DAY, Line, forged

ORDERED = """
  - {name: "/fleet/r{1..2}", role: robot, validity: 90d, order: robots.order}
"""
BOTH = "/fleet/r1", "/fleet/r2"


class OrderedLine(Line):
    """Its domain file names an order."""

    def __init__(self, folder):
        super().__init__(folder)
        self.write(self.file.read_text() + ORDERED)

    def bring(self, order, file="robots.order"):
        """The order arrives."""
        (self.folder / file).write_bytes(order.to_bytes(now=NOW))

    def why(self, **options):
        """Why nobody is enrolled: the same for both."""
        found = self.plan(**options)
        assert not found.steps
        assert [each.name for each in found.blocked] == [*BOTH]
        [why] = {each.why for each in found.blocked}
        return why


@pytest.fixture
def line(tmp_path):
    return OrderedLine(tmp_path / "line")


def test_what_was_ordered_is_enrolled_in_one_change_and_recorded(line):
    assert line.why() == "is in no order yet (new)"
    line.bring(line.order(line.add(), *BOTH))
    [first, _] = line.plan().steps
    assert (first.action, first.why) == ("enrol", "ordered by line1, for 90 days")
    line.apply()
    assert line.allowed("/fleet/r1") == [["rt/fleet/r1/pose"], ["true", "5"]]
    assert registrations(line.keystore)[0].used == 2
    kinds = [each.kind for each in line.keystore.ledger()]
    assert kinds.count("ra-order") == 1
    audit(line.keystore)
    assert line.steps(prune=True) == []
    assert not line.plan().blocked
    (line.folder / "robots.order").unlink()
    assert line.plan().in_order


def test_one_order_for_each_robot_in_a_folder(line):
    line.change("robots.order", "orders/")
    (line.folder / "orders").mkdir()
    grant = line.add()
    line.bring(line.order(grant, "/fleet/r2"), "orders/fleet+r2.order")
    assert line.steps() == [("enrol", "/fleet/r2")]
    line.bring(line.order(grant, "/fleet/r1"), "orders/fleet+r1.order")
    line.apply()
    assert registrations(line.keystore)[0].used == 2


def test_without_a_keystore_nobody_is_enrolled(line, tmp_path):
    line.bring(line.order(line.add(), *BOTH))
    line.root = tmp_path / "none"
    [first, _] = line.plan().blocked
    assert first.why == "has an order, and there is no grant yet"


LIMITS = {
    "another name": ({"names": ("/hall/*",)}, "/fleet/r1: the grant is for /hall/*"),
    "too many": ({"most": 1}, "2 participants were ordered, and 1 of 1 are left"),
    "too long": ({"longest": 89 * DAY}, "90 days were ordered, and 89 days at most are granted"),
    "not yet": ({"begins": NOW + DAY}, "the grant of line1 begins on"),
}


@pytest.mark.parametrize("flaw", LIMITS)
def test_what_the_grant_does_not_cover_is_not_enrolled(line, flaw):
    limits, words = LIMITS[flaw]
    line.bring(line.order(line.add(**limits), *BOTH))
    assert words in line.why()


def test_a_revoked_grant_enrols_nobody(line):
    line.bring(line.order(line.add(), *BOTH))
    end_registrations(line.keystore, line.cas, ["line1"], now=NOW)
    assert "the grant of line1 was revoked" in line.why()


def test_a_grant_that_was_revoked_since_the_plan_enrols_nobody(line):
    line.bring(line.order(line.add(), *BOTH))
    found = line.plan()
    end_registrations(line.keystore, line.cas, ["line1"], now=NOW)
    assert line.take(found) == []
    assert not (line.root / "enclaves/fleet").exists()


def test_an_expired_order_enrols_nobody(line):
    line.bring(line.order(line.add(), *BOTH))
    assert "the order expired on" in line.why(now=NOW + 7 * DAY)


def test_a_forged_order_enrols_nobody(line):
    other = SIGNATURES.named("ecdsa-p256").generate()
    line.bring(forged(line, line.add(), *BOTH, key=other))
    assert "the order is not signed by line1" in line.why()


def test_a_ledger_that_was_rolled_back_enrols_nobody(line):
    ledger = line.root / "private/ledger.sqlite3"
    line.bring(line.order(line.add(), *BOTH))
    before = ledger.read_bytes()
    end_registrations(line.keystore, line.cas, ["line1"], now=NOW)
    ledger.write_bytes(before)
    with pytest.raises(KeystoreError, match=r"lacks lines: .* it was rolled back"):
        line.plan()
    assert not (line.root / "enclaves/fleet").exists()


def test_an_order_without_a_signature_enrols_nobody(line):
    """Requests with the rights that somebody wishes, or alone, where an order must be."""
    order = line.order(line.add(), *BOTH)
    line.bring(replace(order, order=None))
    assert "no registration authority ordered this" in line.why()
    (line.folder / "robots.order").write_bytes(order.requests[0].pem)
    assert "its order is refused" in line.why()


def test_an_order_for_more_than_the_file_names_enrols_nobody(line):
    line.bring(line.order(line.add(), *BOTH, "/fleet/r3"))
    assert "/fleet/r3: the domain file does not name this order for it" in line.why()


def test_an_order_for_fewer_enrols_these(line):
    line.bring(line.order(line.add(), "/fleet/r1"))
    found = line.plan()
    assert [each.name for each in found.steps] == ["/fleet/r1"]
    assert "is not in" in found.blocked[0].why


def test_a_role_that_is_wider_in_the_file_than_in_the_grant_enrols_nobody(line):
    """Neither the file's rights, which were not granted, nor rights that the plan did not show."""
    line.bring(line.order(line.add(), *BOTH))
    line.change("publish: [rt$name/pose]", "publish: [rt$name/pose, everything]")
    found = line.plan()
    assert not [step for step in found.steps if step.name in BOTH]
    assert "its role (robot) has other rights in the grant" in found.blocked[0].why


def test_an_order_for_another_role_than_the_files_enrols_nobody(line):
    line.bring(line.order(line.add(), *BOTH, role="arm"))
    assert "its role (robot) has other rights in the grant" in line.why()


def test_an_order_for_longer_than_the_file_has_enrols_nobody(line):
    line.change("validity: 90d", "validity: 30d")
    line.bring(line.order(line.add(), *BOTH))
    assert "90 days were ordered, and the domain file has 30 days" in line.why()


def test_an_order_that_is_replaced_later_changes_nobody(line):
    grant = line.add(most=9)
    line.bring(line.order(grant, *BOTH))
    line.apply()
    line.bring(line.order(grant, *BOTH, role="arm"))
    for new_keys in (False, True):
        assert "an order enrols new names only" in line.why(new_keys=new_keys)


def test_an_order_does_not_bring_back_who_was_revoked(line):
    order = line.order(line.add(), *BOTH)
    line.bring(order)
    line.apply()
    revoke(line.keystore, line.cas, [*BOTH], reason=Reason.KEY_COMPROMISE, now=NOW)
    sign_head(line.keystore, line.cas)
    found = line.plan()
    assert not found.steps
    assert sorted(each.name for each in found.ended) == sorted(BOTH)


def test_a_lost_certificate_is_not_replaced_by_an_order(line):
    line.bring(line.order(line.add(), *BOTH))
    line.apply()
    line.file_of("/fleet/r1", "cert.pem").unlink()
    [blocked] = line.plan().blocked
    assert "an order enrols new names only, and its certificate is missing" in blocked.why


def test_another_order_than_was_planned_is_not_performed(line):
    grant = line.add(most=9)
    line.bring(line.order(grant, *BOTH))
    found = line.plan()
    line.bring(line.order(grant, *BOTH))
    with pytest.raises(VerificationError, match="another order than when the plan was made"):
        line.take(found)
    assert registrations(line.keystore)[0].used == 0


def test_an_order_that_fails_keeps_nobody_else_from_it_and_is_not_done_by_halves(line):
    line.bring(line.order(line.add(), *BOTH))
    line.change("{name: /there", "{name: /new, role: robot}\n  - {name: /there")
    found = line.plan()
    (line.folder / "robots.order").unlink()
    with pytest.raises(KeystoreError, match="there is no file"):
        line.take(found)
    assert line.keystore.has("/new")
    assert not any(map(line.keystore.has, BOTH))


def test_a_request_and_an_order_are_not_for_one_item(line):
    line.change("order: robots.order", "order: robots.order, request: inbox/")
    with pytest.raises(InvalidDocumentError, match="a request and an order"):
        read_domain(line.file)


def demand(line):
    """The domain file demands approvals, and so the ledger does."""
    for name in PEOPLE:
        make_key(line.folder, name)
    of = ", ".join(f"{name}: {name}.pub.pem" for name in PEOPLE)
    line.write(line.file.read_text() + f"approvals: {{required: 2, of: {{{of}}}}}\n")
    line.apply()


def test_a_grant_that_nobody_approved_does_not_do_without_approvals(line):
    grant = line.add()
    demand(line)
    line.bring(line.order(grant, *BOTH))
    [step, _] = line.plan().steps
    assert not step.approved
    with pytest.raises(KeystoreError, match="approvals are needed for rights that grow"):
        line.take(line.plan())
    assert not any(map(line.keystore.has, BOTH))


def test_what_is_within_an_approved_grant_needs_no_more_approvals(line):
    demand(line)
    approved = replace(line.keystore, approved=True)
    grant = add_registration(approved, line.cas, line.grant(), now=NOW).grant
    line.bring(line.order(grant, *BOTH))
    assert all(step.approved for step in line.plan().steps)
    line.apply()
    assert registrations(line.keystore)[0].used == 2
