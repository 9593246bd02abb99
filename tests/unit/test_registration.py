"""Registration authorities: an order is performed if, and only if, its grant covers all of it."""

import json
import shutil
from dataclasses import replace
from datetime import timedelta

import pytest

from pqsec_pki.algorithms import SIGNATURES, profile_named
from pqsec_pki.approvals import EnrolmentOrder, OrderedName, RegistrationGrant, SignedGrant
from pqsec_pki.documents import DomainSet
from pqsec_pki.domain import perform_order, read_domain, role_value
from pqsec_pki.enrolment import SignRequest, accept, install, ordered, request, sign
from pqsec_pki.enrolment.archive import Archive
from pqsec_pki.errors import (
    ExistsError,
    KeystoreError,
    MalformedError,
    PqsecError,
    UsageError,
    VerificationError,
)
from pqsec_pki.keystore import (
    audit,
    change,
    enrolled_by,
    grant_entry,
    load_certificate,
    registrations,
    write_anchor,
)
from pqsec_pki.lifecycle import (
    ParticipantSpec,
    add_registration,
    end_registrations,
    issue,
    revoke,
    sign_head,
)
from pqsec_pki.server.call import CallKind, SignerCall
from pqsec_pki.server.call_handling import CallHandler
from pqsec_pki.server.configuration import EnrolmentPolicy
from pqsec_pki.server.waiting import WaitingRequests
from pqsec_pki.server.waiting_folder import RequestFolder
from tests.unit.approving import PEOPLE, Council
from tests.unit.domains import NOW, Scene

DAY = timedelta(days=1)
DOMAIN = """
name: Lab
profile: PROFILE
domains: 0-3
roles:
  robot:
    publish: [rt$name/pose]
    subscribe: ["true", "5"]
  arm: {domains: 5, nodes: [{node: $name, minimum: true}]}
  other: {publish: [secret]}
participants:
  - {name: /there, role: robot}
"""

UNSIGNED = "the order is not signed by line1, or was changed"
NAMED = "role: robot}\n  - {name: '/fleet/r{1..2}', role: robot, validity: 90d}"


class Line(Scene):
    """A keystore whose RA, a production line, may enrol three robots and arms."""

    def __init__(self, folder, profile="classical"):
        folder.mkdir(exist_ok=True)
        super().__init__(folder, DOMAIN.replace("PROFILE", profile))
        self.folder, self.profile = folder, profile_named(profile)
        self.apply()
        self.key = SIGNATURES.named("ecdsa-p256").generate()

    @property
    def cas(self):
        return self.keystore.unlock(None)

    def grant(self, **changes):
        desired = read_domain(self.file)
        with self.keystore.open_ledger() as ledger:
            origin = ledger.origin
        return RegistrationGrant(
            **{
                "authority": "line1",
                "key": self.key.public_key,
                "names": ("/fleet/*",),
                "roles": {
                    each: role_value(desired.roles[each], desired.domains)
                    for each in ("robot", "arm")
                },
                "begins": NOW,
                "ends": NOW + 30 * DAY,
                "longest": 90 * DAY,
                "most": 3,
                "ledger": origin,
                **changes,
            }
        )

    def add(self, **changes):
        return add_registration(self.keystore, self.cas, self.grant(**changes), now=NOW).grant

    def requests(self, *names):
        made = [request(name, self.profile, self.folder / "robots", force=True) for name in names]
        return tuple(each.request for each in made)

    def order(self, grant, *names, role="robot", validity=90 * DAY, now=NOW, key=None):
        requests = self.requests(*names)
        return ordered(requests, grant, key or self.key, role, validity=validity, now=now)

    def server(self, folder):
        """What answers robots, with the domain file as it is now; it renews at any time."""
        waiting = WaitingRequests(RequestFolder(folder), 1)
        policy, desired = EnrolmentPolicy(renew_any_time=True), read_domain(self.file)
        return CallHandler(self.keystore, self.cas, desired, lambda: NOW, waiting, policy)

    def perform(self, order, now=NOW, **options):
        """As it goes through the file."""
        read = SignRequest.from_bytes(order.to_bytes(now=NOW))
        return perform_order(read, self.keystore, self.cas, now=now, **options)


@pytest.fixture
def line(tmp_path):
    return Line(tmp_path / "line")


def refused(line, order, words, error=VerificationError, now=NOW, **options):
    """It is refused for that reason, and nothing is issued or recorded."""
    before = line.keystore.as_found.head
    with pytest.raises(error, match=words):
        line.perform(order, now, **options)
    assert line.keystore.as_found.head == before


@pytest.mark.parametrize("profile", ["classical", "hybrid", "transition"])
def test_what_was_ordered_is_issued_with_the_rights_of_its_role(tmp_path, profile):
    line = Line(tmp_path / "line", profile)
    grant = line.add()
    order = line.order(grant, "/fleet/r1", "/fleet/r2")
    data = order.to_bytes(now=NOW)
    answer = line.perform(order)
    found = accept(answer, SignRequest.from_bytes(data), tmp_path / "out", now=NOW)
    install(found[0].path, line.folder / "robots", (), now=NOW, trust_first=True)
    xml = (line.root / "enclaves/fleet/r1/permissions.xml").read_text()
    assert "rt/fleet/r1/pose" in xml
    [kept] = registrations(line.keystore)
    assert (kept.used, kept.state(NOW)) == (2, "valid")
    assert enrolled_by(line.keystore, "line1") == ["/fleet/r1", "/fleet/r2"]
    audit(line.keystore)
    line.change("role: robot}", NAMED)
    assert line.steps() == []  # a domain file that names them finds nothing to change


def test_each_role_is_the_same_in_a_grant(line):
    desired = read_domain(line.file)
    for name, role in desired.roles.items():
        value = json.loads(json.dumps(role_value(role, desired.domains), sort_keys=True))
        grant = line.grant(roles={name: value})
        again = SignedGrant.from_file(grant.signed_by([line.key]).to_file()).grant
        assert again.digest == grant.digest
    order = line.order(line.add(), "/fleet/a", role="arm")
    line.perform(order)
    xml = (line.root / "enclaves/fleet/a/permissions.xml").read_text()
    assert "<id>5</id>" in xml
    assert "rt/fleet/a" in xml or "ros_discovery_info" in xml


def test_a_role_that_needs_values_of_the_domain_file_is_not_granted(line):
    line.change("publish: [secret]", "publish: [$site/x]")
    desired = read_domain(line.file)
    with pytest.raises(UsageError, match=r"other needs \$site"):
        role_value(desired.roles["other"], desired.domains)


def test_a_domain_file_that_is_edited_later_changes_no_grant(line):
    grant = line.add()
    line.change("rt$name/pose", "anything/at/all")
    line.perform(line.order(grant, "/fleet/r1"))
    xml = (line.root / "enclaves/fleet/r1/permissions.xml").read_text()
    assert "anything" not in xml


def test_a_renewal_over_the_network_gives_the_rights_of_the_order_or_none(line, tmp_path):
    """Within its grant for robots, a registration authority got the rights of another role so."""
    line.perform(line.order(line.add(), "/fleet/r1"))
    there = "{name: /there, role: robot}"
    line.change(there, f"{there}\n  - {{name: /fleet/r1, role: other, order: orders/}}")
    held = load_certificate(line.root / "enclaves/fleet/r1/cert.pem")
    [renewal] = line.requests("/fleet/r1")
    call = SignerCall(kind=CallKind.REQUEST, certificate=held.der, body=renewal.der)
    before = line.keystore.head
    [answer] = line.server(tmp_path / "waiting").answers([call])
    words = "/fleet/r1 was enrolled by an order with other rights than the domain file has"
    assert (answer.status, words in answer.detail) == (403, True)
    assert line.keystore.head == before
    line.change("role: other, order", "role: robot, order")
    [answer] = line.server(tmp_path / "waiting").answers([call])
    assert answer.status == 200


def test_another_name_is_refused(line):
    grant = line.add()
    refused(line, line.order(grant, "/fleet/r1", "/hall/r1"), "/hall/r1: the grant is for /fleet")
    refused(line, line.order(grant, "/fleet/r1/deep"), "the grant is for")
    refused(line, line.order(grant, "/x/fleet/r1"), "the grant is for")


def forged(line, grant, *names, key=None, now=NOW, expires=7 * DAY, **changes):
    """An order that `ordered` would not make."""
    requests = line.requests(*names)
    items = tuple(
        replace(OrderedName(name, "robot", 90 * DAY, each.fingerprint), **changes)
        for name, each in zip(names, requests, strict=True)
    )
    order = EnrolmentOrder.signed(grant.digest, items, key or line.key, now=now, validity=expires)
    return replace(
        SignRequest(requests, (), order=order), specs=specs([each.name for each in items])
    )


def specs(names):
    return tuple(ParticipantSpec(name=n, domains=DomainSet.of(0), validity=DAY) for n in names)


def test_another_role_is_refused(line):
    grant = line.add()
    refused(line, forged(line, grant, "/fleet/r1", role="other"), "the role other is not granted")
    with pytest.raises(UsageError, match="no role other"):
        line.order(grant, "/fleet/r1", role="other")


def test_a_role_is_left_out_only_where_the_grant_has_one(line):
    """Of several, the first of them was never a choice of who orders."""
    with pytest.raises(UsageError, match="the grant has several roles") as caught:
        line.order(line.grant(), "/fleet/r1", role=None)
    assert caught.value.hint == "--role: robot, arm"
    [name, *_] = roles = line.grant().roles
    order = line.order(line.grant(roles={name: roles[name]}), "/fleet/r1", role=None)
    assert [each.role for each in order.order.items] == [name]


def test_a_certificate_that_is_valid_for_too_long_is_refused(line):
    grant = line.add()
    refused(line, line.order(grant, "/fleet/r1", validity=91 * DAY), "91 days were ordered, and 90")
    refused(line, line.order(grant, "/fleet/r1", validity=-DAY), "-1 days were ordered")
    refused(line, line.order(grant, "/fleet/r1", validity=DAY * 0), "0 days were ordered")


def test_a_grant_that_expired_or_has_not_begun_is_refused(line):
    grant = line.add(begins=NOW + DAY, ends=NOW + 2 * DAY)
    order = line.order(grant, "/fleet/r1")
    refused(line, order, "begins on")
    refused(line, order, "expired on", now=NOW + 2 * DAY)
    line.perform(order, NOW + DAY)


def test_a_revoked_grant_is_refused(line):
    grant = line.add()
    assert end_registrations(line.keystore, line.cas, ["line1"], now=NOW)
    refused(line, line.order(grant, "/fleet/r1"), "the grant of line1 was revoked")
    again = line.add(ends=NOW + 31 * DAY)
    refused(line, line.order(grant, "/fleet/r1"), "the grant of line1 was revoked")
    line.perform(line.order(again, "/fleet/r1"))


def test_ending_needs_a_name_that_was_granted(line):
    line.add()
    with pytest.raises(KeystoreError, match="no registration authority line2"):
        end_registrations(line.keystore, line.cas, ["line2"], now=NOW)
    end_registrations(line.keystore, line.cas, ["line1"], now=NOW)
    assert end_registrations(line.keystore, line.cas, ["line1"], now=NOW) == []


def test_two_grants_of_one_name_at_a_time_are_refused(line):
    line.add()
    with pytest.raises(ExistsError, match="line1 has a grant"):
        line.add(most=100)


def test_the_count_is_of_all_orders_together(line):
    grant = line.add()
    line.perform(line.order(grant, "/fleet/r1", "/fleet/r2"))
    refused(line, line.order(grant, "/fleet/r3", "/fleet/r4"), "2 participants .* 1 of 3 are left")
    line.perform(line.order(grant, "/fleet/r3"))
    assert registrations(line.keystore)[0].state(NOW) == "used up"
    refused(line, line.order(grant, "/fleet/r4"), "0 of 3 are left")


def test_what_was_revoked_still_counts(line):
    grant = line.add()
    line.perform(line.order(grant, "/fleet/r1", "/fleet/r2", "/fleet/r3"))
    revoke(line.keystore, line.cas, ["/fleet/r1"], now=NOW)
    sign_head(line.keystore, line.cas)
    refused(line, line.order(grant, "/fleet/r4"), "0 of 3 are left")


def test_an_order_is_performed_once_and_answered_again(line):
    order = line.order(line.add(), "/fleet/r1")
    first = line.perform(order)
    head = line.keystore.head
    again = line.perform(order, NOW + 40 * DAY)  # after the end of the order and of the grant
    assert line.keystore.head == head
    names = set(Archive.unpack(first, "sign answer").files)
    assert names == set(Archive.unpack(again, "sign answer").files)


def test_a_replayed_order_does_not_bring_back_what_was_revoked(line):
    order = line.order(line.add(), "/fleet/r1")
    line.perform(order)
    revoke(line.keystore, line.cas, ["/fleet/r1"], now=NOW)
    sign_head(line.keystore, line.cas)
    refused(line, order, "was performed, and /fleet/r1 was changed since")
    shutil.rmtree(line.root / "enclaves/fleet/r1")
    refused(line, order, "was performed, and /fleet/r1 was changed since")


def test_an_order_does_not_answer_with_what_was_issued_since(line):
    order = line.order(line.add(), "/fleet/r1")
    line.perform(order)
    spec = ParticipantSpec(name="/fleet/r1", domains=DomainSet.of(0), validity=DAY)
    issue(line.keystore, line.cas, [spec], now=NOW, force=True)
    refused(line, order, "was performed, and /fleet/r1 was changed since")


def test_a_name_that_is_or_was_issued_cannot_be_ordered(line):
    grant = line.add(names=("/**",))
    refused(line, line.order(grant, "/there"), "already issued: /there", KeystoreError)
    revoke(line.keystore, line.cas, ["/there"], now=NOW)
    sign_head(line.keystore, line.cas)
    shutil.rmtree(line.root / "enclaves/there")
    refused(line, line.order(grant, "/there"), "already issued: /there", KeystoreError)


def test_an_order_that_was_found_late_is_refused(line):
    order = line.order(line.add(), "/fleet/r1")
    refused(line, order, "the order expired", now=NOW + 7 * DAY)


def test_an_order_of_the_future_is_refused(line):
    grant = line.add()
    refused(line, line.order(grant, "/fleet/r1", now=NOW + 2 * DAY), "which is in the future")


def test_an_order_by_another_key_is_refused(line):
    grant, other = line.add(), SIGNATURES.named("ecdsa-p256").generate()
    refused(line, forged(line, grant, "/fleet/r1", key=other), "order is not signed by line1")
    with pytest.raises(VerificationError, match="is not that of line1"):
        line.order(grant, "/fleet/r1", key=other)


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("grant", "0" * 64, "a grant that this keystore does not have"),
        ("at", "2026-01-01T00:00:00+00:00", UNSIGNED),
        ("expires", "2036-01-01T00:00:00+00:00", UNSIGNED),
        ("enrol.name", "/fleet/r9", UNSIGNED),
        ("enrol.role", "arm", UNSIGNED),
        ("enrol.hours", 24, UNSIGNED),
        ("enrol.request", "0" * 64, UNSIGNED),
    ],
)
def test_an_edited_order_is_refused(line, field, value, words):
    order = line.order(line.add(), "/fleet/r1").order
    content = json.loads(order.to_file())
    top, _, below = field.partition(".")
    if below:
        content[top][0][below] = value
    else:
        content[top] = value
    edited = EnrolmentOrder.from_file(json.dumps(content).encode())
    assert edited.digest != order.digest
    requests = line.requests("/fleet/r1")
    names = [each.name for each in edited.items]
    refused(line, SignRequest(requests, specs(names), order=edited), words)


def test_another_request_than_the_one_ordered_is_refused(line):
    order = line.order(line.add(), "/fleet/r1")
    refused(
        line, replace(order, requests=line.requests("/fleet/r1")), "not those that were ordered"
    )


def test_a_request_for_another_name_than_ordered_is_refused(line):
    swapped = forged(line, line.add(), "/fleet/r2", name="/fleet/r1")
    refused(line, swapped, "its name is not one of the allowed names")


def test_one_request_that_was_ordered_twice_is_refused(line):
    grant = line.add()
    once = forged(line, grant, "/fleet/r1")
    items = (*once.order.items, *once.order.items)
    order = EnrolmentOrder.signed(grant.digest, items, line.key, now=NOW, validity=DAY)
    twice = replace(once, requests=once.requests * 2, specs=once.specs * 2, order=order)
    refused(line, twice, "2 requests are for /fleet/r1")


def test_the_grant_of_another_keystore_is_refused(line, tmp_path):
    other = Line(tmp_path / "other")
    other.key = line.key
    order = line.order(other.add(), "/fleet/r1")
    refused(line, order, "a grant that this keystore does not have")


def recorded(line, signed):
    """Write a grant into the ledger, as somebody can who may write there."""
    with change(line.root, line.cas) as transaction:
        transaction.record(grant_entry(signed, NOW))


def test_a_grant_that_the_identity_ca_did_not_sign_is_refused(line):
    """An attacker who writes into the ledger, but has no CA key."""
    grant = line.grant()
    recorded(line, grant.signed_by([line.key]))
    refused(line, line.order(grant, "/fleet/r1"), "is not signed by the identity CA")


def test_a_copy_of_a_revoked_grant_under_another_hash_is_refused(line):
    grant = line.add()
    order = line.order(grant, "/fleet/r1")
    end_registrations(line.keystore, line.cas, ["line1"], now=NOW)
    [kept] = registrations(line.keystore)
    copied = replace(grant_entry(kept.signed, NOW), sha256="0" * 64)
    with change(line.root, line.cas) as transaction:
        transaction.record(copied)
    refused(line, order, "is damaged .it has another grant", KeystoreError)


def test_a_grant_for_another_ledger_is_refused(line, tmp_path):
    """The same CAs, in a copy of the keystore that became another one."""
    grant = line.grant(ledger="pqsec-ledger/0000")
    recorded(line, grant.signed_by([line.cas.identity.key]))
    refused(line, line.order(grant, "/fleet/r1"), "for another keystore")


def test_in_profile_transition_both_keys_of_the_ca_must_have_signed_a_grant(tmp_path):
    line = Line(tmp_path / "line", "transition")
    grant = line.grant()
    recorded(line, grant.signed_by([line.cas.identity.key]))
    refused(line, line.order(grant, "/fleet/r1"), "with all its keys")


def test_a_ledger_that_was_rolled_back_is_found_out(line):
    """The revocation is gone from the ledger: the head that the CAs signed over it is not."""
    ledger = line.root / "private/ledger.sqlite3"
    grant = line.add()
    before = ledger.read_bytes()
    end_registrations(line.keystore, line.cas, ["line1"], now=NOW)
    ledger.write_bytes(before)
    refused(line, line.order(grant, "/fleet/r1"), "the end was cut off")


def test_a_keystore_that_was_rolled_back_as_a_whole_is_found_out_by_anchors(line, tmp_path):
    grant, anchors = line.add(), tmp_path / "anchors"
    shutil.copytree(line.root, tmp_path / "before", symlinks=True)
    end_registrations(line.keystore, line.cas, ["line1"], now=NOW)
    write_anchor(line.keystore, anchors)
    shutil.rmtree(line.root)
    shutil.copytree(tmp_path / "before", line.root, symlinks=True)
    order = line.order(grant, "/fleet/r1")
    refused(line, order, "the end was cut off", anchors=anchors)
    refused(line, order, "has no anchors", anchors=tmp_path / "empty")


def test_a_ca_key_cannot_be_that_of_a_registration_authority(line):
    with pytest.raises(VerificationError, match="that key is a CA's"):
        line.add(key=line.cas.permissions.key.public_key)


@pytest.mark.parametrize(
    "changes",
    [
        {"names": ()},
        {"names": ("fleet/*",)},
        {"roles": {}},
        {"most": 0},
        {"most": 100_001},
        {"ends": NOW},
        {"longest": timedelta(0)},
        {"authority": "a/b"},
    ],
)
def test_a_grant_without_a_limit_is_refused(line, changes):
    with pytest.raises(UsageError):
        line.grant(**changes)


def test_an_order_is_not_issued_as_another_request(line):
    order = line.order(line.add(), "/fleet/r1")
    with pytest.raises(VerificationError, match="is performed by its grant"):
        sign(order, line.keystore, line.cas, now=NOW)
    plain = replace(order, order=None)
    with pytest.raises(UsageError, match="no registration authority ordered"):
        perform_order(plain, line.keystore, line.cas, now=NOW)


@pytest.mark.parametrize("data", [b"", b"{}", b"[]", b'{"grant": 1, "signatures": []}'])
def test_what_is_no_grant_or_order_is_malformed(data):
    with pytest.raises(MalformedError):
        SignedGrant.from_file(data)
    with pytest.raises(MalformedError):
        EnrolmentOrder.from_file(data)


def test_half_a_character_in_a_grant_is_malformed(line):
    """It has no canonical form: `sign-request export` ended with a traceback."""
    data = SignedGrant(line.add(), ()).to_file().replace(b'"5"', b'"\\ud800"')
    assert b"ud800" in data
    with pytest.raises(MalformedError, match="surrogates not allowed"):
        SignedGrant.from_file(data)


@pytest.mark.parametrize("rules", [5, None, "x", [], {"publish": 5}, {"publish": [None]}])
def test_a_role_of_a_grant_that_is_none_is_refused(line, rules):
    value = {"domains": "0", "placeholders": [], "rules": rules}
    grant = line.add(roles={"robot": value})
    refused(line, line.order(grant, "/fleet/r1"), "robot|nothing|text|expected", PqsecError)


def with_approvals(tmp_path):
    line = Line(tmp_path / "line")
    council = Council(tmp_path / "council")
    text = (council.folder / "domain.yaml").read_text()
    policy = text[text.index("approvals:") :]
    for name in PEOPLE:
        shutil.copy(council.folder / f"{name}.pub.pem", line.folder)
    return line, policy


def test_a_grant_of_before_the_rule_of_approvals_is_not_enough(tmp_path):
    line, policy = with_approvals(tmp_path)
    grant = line.add()
    line.perform(line.order(grant, "/fleet/r1"))
    line.write(line.file.read_text() + policy)
    line.apply()
    order = line.order(grant, "/fleet/r2")
    refused(line, order, "approvals are needed for rights that grow", KeystoreError)
    with pytest.raises(KeystoreError, match="approvals are needed for rights that grow"):
        line.add(authority="line2")
    end_registrations(line.keystore, line.cas, ["line1"], now=NOW)  # less may be done, by default
    approved = replace(line.keystore, approved=True)
    made = add_registration(approved, line.cas, line.grant(authority="line2"), now=NOW)
    line.perform(line.order(made.grant, "/fleet/r2"))


def test_where_every_change_needs_approvals_the_end_of_a_grant_does_too(tmp_path):
    line, policy = with_approvals(tmp_path)
    line.add()
    line.write(line.file.read_text() + policy.replace("required: 2", "required: 2, for: all"))
    line.apply()
    with pytest.raises(KeystoreError, match="approvals are needed for every change"):
        end_registrations(line.keystore, line.cas, ["line1"], now=NOW)
