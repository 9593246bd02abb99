"""The report: its values are what the rooms answer, and its page shows any text safely."""

import base64
import csv
import hashlib
import io
import json
import re
import shutil
from collections import Counter
from dataclasses import replace
from datetime import timedelta
from html.parser import HTMLParser
from itertools import pairwise, product

import pytest

from pqsec_pki.access import SPEC
from pqsec_pki.algorithms import profile_named
from pqsec_pki.cli._printing import as_json
from pqsec_pki.credentials import anchors
from pqsec_pki.documents import (
    Criteria,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    ros,
)
from pqsec_pki.enrolment import import_receipts, install
from pqsec_pki.enrolment.credential_store import CredentialStore
from pqsec_pki.errors import KeystoreError, MalformedError
from pqsec_pki.keystore import InstallState, Keystore, list_delivery
from pqsec_pki.lifecycle import ParticipantSpec, issue, renew, revoke, sign_governance
from pqsec_pki.lint import Severity
from pqsec_pki.migration import MigrationPlan, MigrationStep, StackNeeds, plan_migration
from pqsec_pki.policy import fleet_in, who_may_use
from pqsec_pki.report import changes_since, csv_of, html_of, read_earlier, report_of
from pqsec_pki.report.picture import is_routine, matrix_of, picture_of
from pqsec_pki.report.rows import HEADER
from pqsec_pki.report.values import FindingGroup, FindingPlace, Gap, HolderExtent, Right, Strength
from pqsec_pki.selfcheck import stack_named
from pqsec_pki.smime import _reading
from tests.unit.enrolling import ROBOT, answered, asked_of
from tests.unit.keystores import DAY, NOW, made

ROBOTS = [f"/r{number}" for number in range(1, 5)]
NAMES = [*ROBOTS, "/fleet/boss", "/tb3_1/camera", "/tb3_2/camera", "/tb3_1/arm", "/tb3_2/arm"]


def rights_of_spec(name):
    """What a participant of the test's domain may publish and subscribe."""
    if name == "/fleet/boss":
        return ["rt/*/cmd_vel", "rt/all"], ["rt/*/odom"]
    if name in ROBOTS:
        return [f"rt{name}/odom"], [f"rt{name}/cmd_vel", "rt/all"]
    robot = name.split("/")[1]
    return ([f"rt/{robot}/image"], []) if name.endswith("camera") else ([], [f"rt/{robot}/image"])


def spec(name, publish, subscribe, domains="0-1"):
    return ParticipantSpec(
        name=name,
        domains=DomainSet.parse(domains),
        publish=tuple(publish),
        subscribe=tuple(subscribe),
        validity=90 * DAY,
    )


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    place = tmp_path_factory.mktemp("report") / "k"
    keystore = Keystore.create(
        place,
        profile_named("transition"),
        name="Test",
        domains=DomainSet.parse("0-2"),
        validity=900 * DAY,
        passphrase=None,
        now=NOW,
    )
    issue(
        keystore,
        keystore.unlock(None),
        [spec(name, *rights_of_spec(name)) for name in NAMES],
        now=NOW,
    )
    return place


@pytest.fixture
def keystore(root, tmp_path):
    shutil.copytree(root, tmp_path / "k", symlinks=True)
    return Keystore.open(tmp_path / "k", to_change=True)


@pytest.fixture(scope="module")
def report(root):
    return report_of(Keystore.open(root), now=NOW, command="pqsec report")


def test_each_document_is_parsed_and_verified_once_for_all_sections(root, monkeypatch):
    parsed, verified = Counter(), Counter()
    read, verify = _reading.read, anchors.verify

    def counted_read(message):
        parsed[message] += 1
        return read(message)

    def counted_verify(file, *arguments, **options):
        verified[file.message] += 1
        return verify(file, *arguments, **options)

    monkeypatch.setattr(_reading, "read", counted_read)
    monkeypatch.setattr(anchors, "verify", counted_verify)
    report_of(Keystore.open(root), now=NOW)
    documents = [each.read_bytes() for each in root.glob("enclaves/**/permissions.p7s")]
    assert [parsed[each] for each in documents] == [1] * len(NAMES)
    assert [verified[each] for each in documents] == [1] * len(NAMES)


def unfolded(report):
    """All rights, out of the rows for people."""
    unit = {}
    for group in report.rights.groups:
        before, _, after = group.label.partition("{name}")
        for name in group.members:
            unit[name] = (
                name[len(before) : len(name) - len(after)] if len(group.members) > 1 else ""
            )
    for row, side in product(report.rights.rows, ("publish", "subscribe")):
        for holder in row.publishers if side == "publish" else row.subscribers:
            for topic in row.topics:
                parts = topic.split("/")
                for name in holder.group.members:
                    may = {
                        HolderExtent.ALL: True,
                        HolderExtent.OWN: unit[name] in parts,
                        HolderExtent.OTHERS: unit[name] not in parts,
                        HolderExtent.SOME: name in holder.members,
                    }[holder.extent]
                    if may:
                        yield name, side, topic, row.domains


def test_folded_rights_are_exactly_those_of_who_may(root, report):
    fleet = fleet_in(Keystore.open(root), NOW, SPEC)
    told = [
        (name, action, each.row.topic, str(each.domains))
        for each in who_may_use(fleet, now=NOW, interpretation=SPEC).rows
        for action, names in (("publish", each.row.publishers), ("subscribe", each.row.subscribers))
        for name in names
    ]
    assert sorted(unfolded(report)) == sorted(told)
    assert [(e.participant, e.action, e.topic, e.domains) for e in report.rights.every] == told


def test_robots_with_the_same_rights_are_one_group_and_their_topics_one_row(report):
    groups = {each.label: len(each.members) for each in report.rights.groups}
    assert groups == {"/fleet/boss": 1, "/{name}": 4, "/{name}/arm": 2, "/{name}/camera": 2}
    rows = {each.label: each for each in report.rights.rows}
    row = rows["rt/{name}/cmd_vel"]
    assert len(row.topics) == 4
    assert [(each.group.label, each.extent) for each in row.subscribers] == [("/{name}", "own")]
    assert [each.group.label for each in row.publishers] == ["/fleet/boss"]
    assert len(rows["rt/{name}/image"].topics) == 2


def test_each_right_names_the_rule_that_decided(root, report):
    for row in report.rights.rows:
        for holder in (*row.publishers, *row.subscribers):
            path, _, line = holder.place.rpartition(":")
            assert "allow_rule" in (root / path).read_text().splitlines()[int(line) - 1]
            assert "allow_rule of grant" in holder.reason


def test_endings_are_those_of_the_certificates_and_grants(root, report):
    found = {(each.kind, f"{each.at:%Y-%m-%d}"): len(each.names) for each in report.endings}
    end, far = (f"{NOW + days * DAY:%Y-%m-%d}" for days in (90, 900))
    assert found.pop(("participant's certificate", end)) == len(NAMES)
    assert found.pop(("participant's permissions", end)) == len(NAMES)
    assert found == {(kind, far): 1 for kind in ("identity CA", "permissions CA", "countersigner")}


@pytest.mark.parametrize(
    ("profile", "expected"),
    [
        ("classical", {Strength.BROKEN}),
        ("transition", {Strength.BROKEN, Strength.PARTLY, Strength.HOLDS}),
        ("pq", {Strength.HOLDS}),
    ],
)
def test_what_a_quantum_computer_breaks_follows_the_profile(tmp_path, profile, expected):
    keystore = Keystore.create(
        tmp_path / "k",
        profile_named(profile),
        name="Test",
        domains=DomainSet.parse("0"),
        validity=900 * DAY,
        passphrase=None,
        now=NOW,
    )
    issue(keystore, keystore.unlock(None), [spec("/a", ["x"], [], "0")], now=NOW)
    report = report_of(keystore, now=NOW)
    assert {each.strength for each in report.exposures} == expected
    [people] = [each for each in report.exposures if each.use.startswith("participants'")]
    assert people.names == ("/a",)
    assert not report.gaps


@pytest.fixture(scope="module")
def migrating(root):
    """The report with the plan of a migration, and the plan."""
    keystore = Keystore.open(root)
    stacks = (stack_named("cyclonedds"), stack_named("opendds"))
    plan = plan_migration(keystore, profile_named("cnsa2"), stacks, now=NOW)
    return report_of(keystore, now=NOW, migration=lambda: plan), plan


def test_the_page_and_the_csv_have_the_whole_plan_of_a_migration(migrating, report):
    found, plan = migrating
    page, rows = Page(html_of(found)), read_csv(csv_of(found))
    rows = [row for row in rows if row[0] == "migration"]
    assert len(plan.steps) == 2
    for number, step in enumerate(plan.steps, 1):
        assert f"{number}. {step.title}" in page.text
        texts = [step.how, step.mixed, *step.commands, *step.if_skipped]
        texts += [text for each in step.stacks for text in (each.stack, each.needs)]
        assert [text for text in texts if text not in page.text] == []
        alike = [(row[2], row[3]) for row in rows if row[1] == f"step {number}"]
        assert alike == [("step", step.title), ("how", step.how), *step.facts()]
    for each in plan.deadlines:
        assert each.source in page.text
        assert ["migration", "date", "", each.what, "", str(each.day), each.source] in rows
    told = json.loads(as_json({"expected": plan.to_json(), **found.to_json()}))
    assert told["migration"] == told["expected"]
    assert "Migration" not in Page(html_of(report)).text
    assert report.migration is None


def test_a_migration_that_cannot_be_planned_is_a_gap(root):
    def plan():
        raise KeystoreError("the CA cannot be changed")

    found = report_of(Keystore.open(root), now=NOW, migration=plan)
    assert found.gaps == (Gap("Migration", "the CA cannot be changed"),)
    assert found.migration is None
    assert "Migration: the CA cannot be changed" in Page(html_of(found)).text


def test_the_same_keystore_and_time_give_the_same_bytes(root, report):
    again = report_of(Keystore.open(root), now=NOW, command="pqsec report")
    for form in (html_of, csv_of):
        assert form(again) == form(report)
    assert as_json(again.to_json()) == as_json(report.to_json())


def test_what_robots_run_is_told_by_their_receipts(tmp_path):
    keystore = made(tmp_path / "k", "classical", names=("/arm", "/leg"))
    before = report_of(keystore, now=NOW)
    assert {each.state for each in before.robots} == {InstallState.UNKNOWN}
    assert "no receipt of a robot was imported" in html_of(before)
    robot = tmp_path / "robot"
    bundle = answered(keystore, asked_of(keystore, robot))
    (tmp_path / "bundle").write_bytes(bundle.to_bytes())
    install(tmp_path / "bundle", robot, bundle.roles, now=NOW)
    import_receipts(keystore, [CredentialStore(robot).receipt], now=NOW)
    [current] = [each for each in report_of(keystore, now=NOW).robots if each.name == ROBOT]
    assert (current.state, current.changed) == (InstallState.CURRENT, ())
    assert current.runs == current.should_run
    later = NOW + timedelta(hours=1)
    document = Governance.from_xml((keystore.root / "enclaves/governance.xml").read_bytes())
    sign_governance(keystore, keystore.unlock(None), document, now=later)
    report = report_of(keystore, now=later)
    [outdated] = [each for each in report.robots if each.name == ROBOT]
    assert (outdated.state, outdated.changed) == (InstallState.OUTDATED, ("governance.p7s",))
    assert "Files that differ" in html_of(report)
    [row] = [row for row in read_csv(csv_of(report)) if row[:2] == ["robot", ROBOT]]
    assert row[3].startswith("outdated: runs ")


def test_who_lacks_the_revocation_list_is_told_until_all_have_it(tmp_path):
    keystore = made(tmp_path / "k", "classical", names=("/arm", "/thief"))
    assert report_of(keystore, now=NOW).delivery is None
    cas = keystore.unlock(None)
    renew(keystore, cas, ["/arm"], now=NOW)
    revoke(keystore, cas, ["/thief"], now=NOW)
    report = report_of(keystore, now=NOW)
    assert report.delivery == list_delivery(keystore, now=NOW)
    page, rows = html_of(report), list(read_csv(csv_of(report)))
    assert "1 of 1 robots do not have list 1 yet" in page
    assert "they accept /thief (publish x)" in page
    assert "ca crl --show" in page
    assert "1 earlier certificate valid until" in page
    assert ["robot", "/arm", "lacks the list", "no receipt"] in [row[:4] for row in rows]
    assert ["participant", "/arm", "classical", "superseded"] in [row[:4] for row in rows]
    assert report.to_json()["delivery"].accepted[0].name == "/thief"


# What cannot be read


@pytest.mark.parametrize(
    ("broken", "lost", "still"),
    [
        ("enclaves/governance.p7s", "rights", "participants"),
        ("private/ledger.sqlite3", "participants", "rights"),
        ("public/identity_ca.cert.pem", "authorities", "events"),
    ],
)
def test_what_cannot_be_read_is_a_gap_and_not_an_empty_section(keystore, broken, lost, still):
    (keystore.root / broken).write_bytes(b"damaged")
    report = report_of(keystore, now=NOW)
    assert getattr(report, lost) is None
    assert getattr(report, still) is not None
    assert any(broken in each.reason for each in report.gaps)
    page = html_of(report)
    assert "This report is incomplete" in page
    assert "This part is missing" in page
    assert json.loads(as_json(report.to_json()))[lost] is None
    assert sorted({row[0] for row in read_csv(csv_of(report)) if row[0] == "gap"}) == ["gap"]


def test_who_is_left_out_is_named_with_the_reason(keystore):
    shutil.copy(
        keystore.root / "enclaves/r1/permissions.p7s", keystore.root / "enclaves/r2/permissions.p7s"
    )
    report = report_of(keystore, now=NOW)
    assert list(report.rights.refused) == ["/r2"]
    page = html_of(report)
    assert "no grant is for" in page
    errors = sum(len(each.places) for each in report.findings.groups if each.severity == "error")
    assert errors
    assert f"{errors} error{'s' * (errors > 1)}, " in page


# Compared with an earlier one


@pytest.fixture
def earlier(report, tmp_path):
    path = tmp_path / "old.json"
    path.write_text(as_json(report.to_json()))
    return path


def test_without_a_change_there_is_none(keystore, report, earlier):
    changes = changes_since(read_earlier(earlier), report, keystore)
    assert (changes.count, changes.ledger, changes.unknown) == (0, "", ())
    assert "no changes" in html_of(report, changes)


def test_what_was_issued_renewed_revoked_and_granted_is_told(keystore, earlier):
    later = NOW + timedelta(hours=1)
    cas = keystore.unlock(None)
    issue(keystore, cas, [spec("/new", ["rt/all"], [])], now=later)
    renew(keystore, cas, ["/r1"], now=later)
    revoke(keystore, cas, ["/r2"], now=later)
    report = report_of(keystore, now=later)
    changes = changes_since(read_earlier(earlier), report, keystore)
    events = {each.what.partition(" (")[0]: each.names for each in changes.events}
    assert events["issued"] == ("/new",)
    assert events["renewed"] == ("/r1",)
    assert events["revoked"] == ("/r2",)
    assert changes.appeared == ("/new",)
    assert {each.partition(":")[0] for each in changes.changed} == {"/r1", "/r2"}
    assert [str(each) for each in changes.granted] == ["/new may publish rt/all on 0-1"]
    assert {each.participant for each in changes.removed} == {"/r2"}
    assert changes.ledger == ""


def test_a_ledger_that_was_rewritten_since_is_told(keystore, report, earlier, tmp_path):
    value = json.loads(earlier.read_text())
    value["evidence"]["head"] = "0" * 64
    earlier.write_text(json.dumps(value))
    changes = changes_since(read_earlier(earlier), report, keystore)
    assert "truncated or rewritten" in changes.ledger
    assert changes.ledger in html_of(report, changes)


@pytest.mark.parametrize(
    "text",
    [
        *("", "[]", "{}", "null", "\x00", '{"format": "pqsec-report", "format_version": 99}'),
        '{"format": "pqsec-report", "format_version": 1, "at": 3, "evidence": null}',
        "[" * 100_000,
    ],
)
def test_another_file_is_refused(tmp_path, text):
    path = tmp_path / "old.json"
    path.write_text(text)
    with pytest.raises(MalformedError, match="not a report"):
        read_earlier(path)


def test_values_of_another_kind_in_an_earlier_report_are_refused(earlier):
    value = json.loads(earlier.read_text())
    parts = ("participants", "rights", "findings", "authorities", "evidence")
    cases = [{part: bad} for part in parts for bad in (0, False, "", 7)]
    cases += [{part: []} for part in ("rights", "findings", "evidence")]
    cases += [{"participants": {}}, {"authorities": {}}]
    for lines in (-1, True, 1.5, float("inf"), "3"):
        cases.append({"evidence": {**value["evidence"], "lines": lines}})
    for case in cases:
        earlier.write_text(json.dumps({**value, **case}))
        with pytest.raises(MalformedError, match="not a report"):
            read_earlier(earlier)


def test_what_one_report_could_not_read_is_no_change_but_not_known(keystore, report, earlier):
    parts = ("participants", "rights", "findings", "authorities")
    value = json.loads(earlier.read_text())
    whole = read_earlier(earlier)
    earlier.write_text(json.dumps({**value, **dict.fromkeys(parts)}))
    lacking = replace(report, **dict.fromkeys(parts))
    for changes in (
        changes_since(read_earlier(earlier), report, keystore),
        changes_since(whole, lacking, keystore),
    ):
        assert changes.count == 0
        assert changes.unknown == ("participants", "CAs and revocation list", "rights", "findings")
        assert "Changes of participants are not known" in html_of(report, changes)
        rows = [row for row in read_csv(csv_of(report, changes)) if row[0] == "change"]
        assert [row[1] for row in rows] == list(changes.unknown)


# The page


class Page(HTMLParser):
    """Tags with their attributes, and the text, as a browser reads them."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.text, self.raw = [], "", {"style": "", "script": ""}
        self._inside = ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._inside = tag if tag in self.raw else self._inside

    def handle_endtag(self, tag):
        self._inside = "" if tag == self._inside else self._inside

    def handle_data(self, data):
        if self._inside:
            self.raw[self._inside] += data
        else:
            self.text += data

    def named(self, tag):
        return [attrs for name, attrs in self.tags if name == tag]


def test_the_page_allows_only_its_own_style_and_script(report):
    page = Page(html_of(report))
    [policy] = [
        each["content"]
        for each in page.named("meta")
        if each.get("http-equiv") == "Content-Security-Policy"
    ]
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    for what, text in page.raw.items():
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert rules.pop(f"{what}-src") == f"'sha256-{digest}'"
    assert rules == {"default-src": "'none'", "base-uri": "'none'", "form-action": "'none'"}


def test_the_page_loads_nothing_and_has_no_inline_handlers(report):
    page = Page(html_of(report))
    for tag, attrs in page.tags:
        assert tag not in {"img", "link", "iframe", "object", "embed", "base", "form action"}
        assert not [name for name in attrs if name.startswith("on") or name in {"src", "style"}]
        assert attrs.get("href", "#").startswith("#")
    assert not re.search(r"url\(|@import", page.raw["style"])


def test_tables_have_captions_and_headers_with_a_scope(report):
    text = html_of(report)
    page = Page(text)
    assert text.count("<table") == text.count("<caption>")
    assert page.named("table")
    assert all(each.get("scope") in {"row", "col"} for each in page.named("th"))
    ids = [attrs["id"] for _, attrs in page.tags if "id" in attrs]
    assert len(ids) == len(set(ids))
    pointed = {each["href"][1:] for each in page.named("a")}
    assert pointed <= set(ids)


def test_headings_are_in_order_and_everything_has_a_name_that_is_read_aloud(report):
    page = Page(html_of(report))
    levels = [int(tag[1]) for tag, _ in page.tags if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))
    assert levels.count(1) == 1
    ids = {attrs["id"] for _, attrs in page.tags if "id" in attrs}
    for tag, attrs in page.tags:
        assert attrs.get("aria-labelledby", "rights") in ids
        assert attrs.get("for", "filter") in ids
        is_area = tag in {"section", "nav", "svg"} or "role" in attrs
        silent = attrs.get("role") in {"status", "search"} or attrs.get("aria-hidden") == "true"
        assert not is_area or silent or {"aria-label", "aria-labelledby"} & attrs.keys(), attrs
        assert tag != "button" or attrs["type"] == "button"


def test_the_picture_has_every_right_that_is_not_given_to_every_node(tmp_path):
    names, node = ("/a", "/b", "/boss"), ros.node_minimum
    keystore = Keystore.create(
        tmp_path / "k",
        profile_named("classical"),
        name="Test",
        domains=DomainSet.parse("0"),
        validity=900 * DAY,
        passphrase=None,
        now=NOW,
    )
    own = {"/boss": (["rt/all", "rq/boss_setRequest"], ["rr/boss_setReply"])}
    specs = [
        spec(name, [*node(name).publish, *publish], [*node(name).subscribe, *subscribe], "0")
        for name in names
        for publish, subscribe in [own.get(name, ([f"rt{name}/odom"], ["rt/all"]))]
    ]
    issue(keystore, keystore.unlock(None), specs, now=NOW)
    rights = report_of(keystore, now=NOW).rights
    picture, table = picture_of(rights), {each.label for each in rights.rows}
    flows = [(flow, row) for flow in picture.flows for each in flow.topics for row in each.rows]
    drawn = {row.label for _, row in flows}
    assert drawn == {row.label for row, _ in matrix_of(rights)}
    assert {"rt/all", "rt/{name}/odom", "rq/boss_setRequest", "rr/boss_setReply"} <= drawn
    assert {"rt/parameter_events", "rt/rosout"} & drawn == set()
    assert table - drawn >= {"ros_discovery_info", "rq/boss/set_parametersRequest"}
    by_label = {row.label: flow for flow, row in flows}
    to_all = by_label["rt/all"]
    assert [each.group.label for each in to_all.publishers] == ["/boss"]
    assert [each.group.label for each in to_all.subscribers] == ["/{name}"]
    assert not by_label["rt/{name}/odom"].subscribers
    assert picture.flows[0] is to_all


def test_the_picture_has_an_action_as_one_topic_in_each_direction(tmp_path):
    keystore = made(tmp_path / "k", "classical", names=())
    client, server = ros.action_client("/dock"), ros.action_server("/dock")
    specs = [
        spec("/boss", [*client.publish, "rt/all"], client.subscribe),
        spec("/arm", server.publish, [*server.subscribe, "rt/all"]),
    ]
    issue(keystore, keystore.unlock(None), specs, now=NOW)
    report = report_of(keystore, now=NOW)
    flows = {
        tuple(each.label for each in flow.topics): [each.group.label for each in flow.publishers]
        for flow in picture_of(report.rights).flows
    }
    assert flows == {
        ("requests of action /dock", "rt/all"): ["/boss"],
        ("replies, feedback and status of action /dock",): ["/arm"],
    }
    page = html_of(report)
    assert "requests of action /dock 3 topics" in " ".join(Page(page).text.split())
    words = [each.split() for each in re.findall(r'data-words="([^"]*)"', page)]
    assert sorted(words, key=len) == [
        [f"rq/dock/_action/{each}Request" for each in ("cancel_goal", "get_result", "send_goal")],
        [
            *("rr/dock/_action/cancel_goalReply", "rr/dock/_action/get_resultReply"),
            *("rr/dock/_action/send_goalReply", "rt/dock/_action/feedback"),
            "rt/dock/_action/status",
        ],
    ]


def test_groups_with_one_label_are_told_apart_by_a_member(tmp_path):
    keystore = made(tmp_path / "k", "classical", names=())
    specs = [spec(f"/r{n}", [f"rt/r{n}/x"], [], ("0", "0-1")[n % 2]) for n in range(4)]
    issue(keystore, keystore.unlock(None), specs, now=NOW)
    report = report_of(keystore, now=NOW)
    assert [each.label for each in report.rights.groups] == ["/{name}", "/{name}"]
    text = html_of(report)
    rows = {
        row[1]: row[-1] for row in read_csv(csv_of(report)) if row[:3:2] == ["right", "publish"]
    }
    assert {name: place.split("/")[1] for name, place in rows.items() if place} == {
        "/r0": "r0", "/r1": "r1", "/r2": "r2", "/r3": "r3",
    }  # fmt: skip
    assert rows["/r3"].startswith("enclaves/r3/permissions.p7s, as enclaves/r1/permissions.p7s:")
    for first in ("/r0", "/r1"):
        assert f'<bdi>/{{name}}</bdi> <span class="small">as <bdi>{first}</bdi></span>' in text


def test_parameters_that_another_participant_may_set_are_in_the_picture(tmp_path, report):
    row = replace(report.rights.rows[0], topics=("rq/r1/set_parametersRequest",))
    assert not is_routine(replace(row, publishers=row.publishers, subscribers=row.publishers))
    assert is_routine(replace(row, publishers=()))


def test_each_cell_of_the_matrix_leads_to_the_rule_that_decided(report):
    page = Page(html_of(report))
    cells = [each for each in page.named("a") if each["href"].startswith("#rule-")]
    rows = [
        holder.place
        for row in report.rights.rows
        if not is_routine(row)
        for holder in (*row.publishers, *row.subscribers)
    ]
    assert sorted(each["aria-label"].rpartition("by ")[2] for each in cells) == sorted(rows)


HOSTILE = (
    "/</script><script>alert(1)</script>",
    '/"><img src=x onerror=alert(1)>',
    "/<style>*{display:none}</style>",
    "/{{ 7*7 }}{% raw %}",
    "/\u202eevil\u2066\u200b",
    "/\x1b[31m\x00\ud800",
    "=HYPERLINK(1)",
    "/" + 300 * "x",
)


def hostile(value, names=HOSTILE):
    """The report with hostile texts in each place that is not our own."""
    rights, people = value.rights, value.participants[0]
    group = replace(rights.groups[0], label=names[0], members=names)
    holder = replace(
        rights.rows[0].publishers[0], group=group, members=names, reason=names[1], place=names[2]
    )
    row = replace(rights.rows[0], label=names[1], topics=names, domains=names[3])
    row = replace(row, publishers=(holder,), subscribers=(replace(holder, members=()),))
    every = tuple(replace(rights.every[0], participant=name, topic=name) for name in names)
    place = FindingPlace(path=names[0], line=1, message=names[1])
    finding = FindingGroup(
        rule="PQS000",
        severity=Severity.ERROR,
        title=names[0],
        why=names[1],
        fix=names[2],
        places=5 * (place,),
    )
    step = MigrationStep(
        title=names[0],
        before=names[1],
        after=names[2],
        commands=names,
        at_once=True,
        stacks=tuple(StackNeeds(stack=name, needs=name) for name in names),
        mixed=names[3],
        if_skipped=names,
        left_out=dict.fromkeys(names, names[0]),
        level=0,
    )
    return replace(
        value,
        migration=MigrationPlan(before=names[0], target=names[1], steps=(step,)),
        keystore=names[0],
        command=names[1],
        rights=replace(
            rights,
            groups=(group,),
            rows=(row,),
            every=every,
            refused=dict.fromkeys(names, names[0]),
        ),
        participants=tuple(replace(people, name=name, serial=name) for name in names),
        authorities=tuple(replace(value.authorities[0], name=name) for name in names),
        endings=(replace(value.endings[0], names=names),),
        exposures=(replace(value.exposures[0], use=names[0], algorithm=names[1], names=names),),
        findings=replace(
            value.findings, groups=(finding,), ignored=((names[0], names[1], names[2]),)
        ),
        events=(replace(value.events[0], names=names, operator=names[0], what=names[1]),),
        sizes=(replace(value.sizes[0], names=names),),
        evidence=replace(value.evidence, audit=names),
        gaps=tuple(Gap(name, name) for name in names),
    )


def test_hostile_names_are_text_and_nothing_in_them_is_invisible(report):
    plain, page = Page(html_of(report)), Page(html_of(hostile(report)))
    assert len(page.named("script")) == len(page.named("style")) == 1
    assert page.raw == plain.raw
    assert {tag for tag, _ in page.tags} <= {tag for tag, _ in plain.tags} | {"h3", "strong"}
    for name in HOSTILE[:4]:
        assert page.text.count(name) > 10, name
    assert "/\\u202eevil\\u2066\\u200b" in page.text
    assert "/\\u001b[31m\\u0000\\ud800" in page.text
    assert all(each.isprintable() or each in "\n\r\t " for each in page.text)
    assert HOSTILE[-1] in page.text
    html_of(hostile(report)).encode()


def test_hostile_changes_are_text_too(report, keystore, earlier):
    changes = changes_since(read_earlier(earlier), report, keystore)
    texts = dict.fromkeys(
        ("appeared", "disappeared", "changed", "new_findings", "resolved", "authorities"), HOSTILE
    )
    changes = replace(changes, since=HOSTILE[0], ledger=HOSTILE[1], unknown=HOSTILE, **texts)
    page = Page(html_of(report, changes))
    assert len(page.named("script")) == 1
    assert not page.named("img")
    assert all(each.isprintable() or each in "\n\r\t " for each in page.text)


def test_the_report_has_rights_that_are_only_in_partitions(keystore, earlier):
    """They had no row: as if nobody had them."""
    now = NOW + timedelta(seconds=1)
    criteria = (Criteria(topics=("rt/door",), partitions=("D",)),)
    rule = PermissionRule(allow=True, domains=DomainSet.of(0), publish=criteria)
    grant = Grant(
        name="/door",
        subject_name="CN=/door",
        not_before=now,
        not_after=now + 90 * DAY,
        rules=(rule,),
    )
    door = replace(spec("/door", [], [], "0"), grants=(grant,))
    issue(keystore, keystore.unlock(None), [door], now=now)
    report = report_of(keystore, now=now + timedelta(seconds=1))
    [row] = [each for each in report.rights.rows if each.label == "rt/door"]
    [holder] = row.publishers
    assert (row.where, holder.group.members) == ("0, partition D", ("/door",))
    assert "lets it publish 'rt/door' in partition 'D'" in holder.reason
    right = Right("/door", "publish", "rt/door", "0", "D")
    assert right in report.rights.every
    assert "0, partition D" in Page(html_of(report)).text
    [cells] = [each for each in read_csv(csv_of(report)) if each[3:4] == ["rt/door"]]
    assert cells[4] == "0, partition D"
    older = json.loads(earlier.read_text())
    older["rights"]["every"] = [each[:4] for each in older["rights"]["every"]]
    earlier.write_text(json.dumps(older))  # as of a pqsec that did not say partitions
    changes = changes_since(read_earlier(earlier), report, keystore)
    assert (changes.granted, changes.removed) == ((right,), ())


# CSV


def read_csv(text):
    return list(csv.reader(io.StringIO(text)))


def test_the_csv_has_every_right_with_its_rule(report):
    header, *rows = read_csv(csv_of(report))
    assert header == list(HEADER)
    rights = [row for row in rows if row[0] == "right"]
    assert [(row[1], row[2], row[3], row[4]) for row in rights] == [
        (each.participant, each.action, each.topic, each.domains) for each in report.rights.every
    ]
    assert all(re.fullmatch(r"enclaves/.*/permissions\.p7s:\d+", row[6]) for row in rights)
    assert all(row[6].startswith(f"enclaves{row[1]}/permissions.p7s") for row in rights)
    ends = {row[1]: row[5] for row in rows if row[0] == "participant"}
    assert {row[1]: row[5] for row in rights}.items() <= ends.items()
    assert {row[5][-1] for row in rows if row[0] in {"participant", "ledger"}} == {"Z"}
    assert {row[0] for row in rows} >= {"report", "participant", "authority", "ledger", "evidence"}


def test_no_cell_of_the_csv_is_a_formula(report):
    for row in read_csv(csv_of(hostile(report))):
        assert not [cell for cell in row if cell.startswith(("=", "+", "-", "@"))]


def test_no_cell_of_the_csv_has_what_a_terminal_obeys_or_utf8_lacks(report):
    text = csv_of(hostile(report))
    assert "\\u001b[31m" in text
    assert all(each.isprintable() or each in "\r\n" for each in text)
    text.encode()
