"""Import of single sources: roles, patterns, labels, and what is left out."""

from dataclasses import replace
from pathlib import Path

import pytest

from pqsec_pki.documents import (
    Criteria,
    DefaultAction,
    DomainSet,
    Grant,
    PermissionRule,
    Permissions,
    governance_to_yaml,
    permissions_to_yaml,
    preset_named,
)
from pqsec_pki.domain import import_domain, plan, read_domain
from pqsec_pki.domain._name_patterns import patterns_of
from pqsec_pki.domain._shared_rules import FoundParticipant
from pqsec_pki.domain._sources import ImportSource
from pqsec_pki.domain.importing import imported
from pqsec_pki.errors import InvalidDocumentError, KeystoreError, UsageError, VerificationError
from pqsec_pki.lifecycle import Rollover, Scope, adopt
from tests.unit.domains import DAY, FILE, NOW, Scene, damage
from tests.unit.keystores import begin_overlap
from tests.unit.sros2_keystore import MADE, SROS2

ZERO = DomainSet.of(0)
POLICY = """<policy version="0.2.0"><enclaves><enclave path="{}"><profiles>
<profile ns="/" node="talker"><topics publish="ALLOW"><topic>chatter</topic></topics></profile>
</profiles></enclave></enclaves></policy>"""


def rule(*topics, **others):
    values = {"allow": True, "domains": ZERO, "publish": (Criteria(topics=topics),)}
    return PermissionRule(**(values | others))


def found(name, *topics, **others):
    values = {"name": name, "default": DefaultAction.DENY}
    if topics:
        values["rules"] = (rule(*topics),)
    return FoundParticipant(**(values | {"validity": 90 * DAY, "source": "k"} | others))


def document(*participants):
    return imported([ImportSource(Path("k"), list(participants))]).document.decode()


def imported_from(*paths, now=NOW, domains=ZERO):
    return import_domain(paths, now=now, domains=domains)


def left_out(result):
    return {each.name: each.why for each in result.left_out}


@pytest.mark.parametrize(
    ("names", "patterns"),
    [
        ([], []),
        (["/a"], ["/a"]),
        (["/r9", "/r10", "/r11"], ["/r{9..11}"]),
        (["/r08", "/r09", "/r10", "/r12"], ["/r12", "/r{08..10}"]),
        (["/r1", "/r01", "/r2"], ["/r01", "/r{1..2}"]),
        (["/r1/arm1", "/r1/arm2", "/r2/arm1", "/r2/arm2"], ["/r{1..2}/arm{1..2}"]),
        (["/r1/arm1", "/r1/arm2", "/r2/arm1"], ["/r1/arm{1..2}", "/r2/arm1"]),
        (["/r1/cam", "/r2/cam", "/r3/cam"], ["/r{1..3}/cam"]),
        (["/a999999999", "/a1000000000"], ["/a1000000000", "/a999999999"]),
    ],
)
def test_names_that_count_become_patterns(names, patterns):
    assert patterns_of(names) == patterns


@pytest.mark.parametrize(
    ("topics", "role"),
    [
        (("rt/cmd", "rt/cmd"), "rt/cmd"),
        (("rt/fleet/robot1/pose", "rt/fleet/robot2/pose"), "rt$name/pose"),
        (("fleet/robot1/pose", "fleet/robot2/pose"), "fleet/$base/pose"),
        (("rt/robot1_pose", "rt/robot2_pose"), "rt/${base}_pose"),
        (("rt/a$/robot1", "rt/a$/robot2"), "rt/a$$/$base"),
        (("$robot1", "$robot2"), "$$$base"),
        (("rt/*", "rt/*"), "rt/*"),
        (("rt/fleet/x", "rt/fleet/x"), "rt/fleet/x"),
    ],
)
def test_robots_that_speak_of_themselves_share_a_role(topics, role):
    members = [found(f"/fleet/robot{n}", topic) for n, topic in enumerate(topics, start=1)]
    text = document(*members)
    assert f"  robot:\n    publish:\n      - {role}\n\n" in text
    assert "  - name: /fleet/robot{1..2}\n    role: robot\n" in text


def test_the_parent_and_the_name_may_both_be_left_open():
    text = document(
        found("/north/cam1", "rt/north/cam1/image", "rt/north/map"),
        found("/south/cam2", "rt/south/cam2/image", "rt/south/map"),
    )
    assert "  cam:\n    publish:\n      - rt$name/image\n      - rt$parent/map\n" in text


@pytest.mark.parametrize(("one", "other"), [("x/robot12", "x/robot2"), ("alarm1", "alarm2")])
def test_a_part_of_a_longer_word_is_no_name(one, other):
    text = document(found("/robot1" if "b" in one else "/arm1", one), found("/robot9", other))
    assert "$" not in text
    assert text.count("- name: ") == 2


def test_roles_with_equal_labels_get_numbers():
    text = document(found("/a/arm", "x"), found("/b/arm", "y"), found("/arm-2", "z"))
    labels = [line.split()[-1] for line in text.splitlines() if "role: " in line]
    assert labels == ["arm", "arm-2", "arm-3"]


def test_labels_that_yaml_would_read_as_something_else_stay_names(tmp_path):
    (tmp_path / "domain.yaml").write_text(
        document(found("/no", "x"), found("/null", "y"), found("/1", "z"), found("/1.5", "~"))
    )
    desired = read_domain(tmp_path / "domain.yaml")
    assert {name: each.role.label for name, each in desired.members.items()} == {
        "/no": "no",
        "/null": "null",
        "/1": "1",
        "/1.5": "1.5",
    }


def test_domains_and_validity_are_written_where_they_differ():
    wide = (rule("x", domains=DomainSet.parse("2-5")),)
    apart = (*wide, rule("x"))
    text = document(
        found("/r1", "x"),
        found("/r2", "x"),
        found("/r3", rules=wide),
        found("/r4", "x", validity=DAY),
        found("/s", rules=apart),
    )
    assert "domains: 0\nvalidity: 90d\n" in text
    assert (
        "  - name: /r{1..2}\n    role: r\n"
        "  - name: /r3\n    role: r\n    domains: 2-5\n"
        "  - name: /r4\n    role: r\n    validity: 1d\n"
        "  - name: /s\n    role: s\n" in text
    )
    assert "          domains: 2-5\n" in text


def test_a_key_on_its_robot_is_told_and_no_path_writes_into_the_file():
    hostile = ImportSource(Path("k\nprune: true\x1b[2J"), [found("/r", "x", key_elsewhere=True)])
    text = imported([hostile]).document.decode()
    assert "  # The keys are on the robots.\n  - name: /r\n" in text
    assert "\nprune" not in text
    assert "\x1b" not in text


def test_one_participant_of_two_sources_must_have_the_same_rights():
    one, same, other = (found("/a", topic, source=topic) for topic in ("x", "x", "y"))
    sources = [ImportSource(Path("k"), [each]) for each in (one, same)]
    assert imported(sources).participants == ("/a",)
    with pytest.raises(UsageError, match="/a has different permissions in x and y"):
        imported([*sources, ImportSource(Path("o"), [other])])


# Keystores


@pytest.fixture(scope="module")
def applied(tmp_path_factory):
    scene = Scene(tmp_path_factory.mktemp("applied"), FILE.replace("transition", "classical"))
    scene.apply()
    return scene


@pytest.fixture
def scene(applied, tmp_path):
    return Scene.copy(applied, tmp_path / "copy")


def test_what_the_file_does_not_have_is_named_with_its_reason(scene):
    damage(scene.file_of("/r1", "permissions.p7s"))
    scene.file_of("/r2", "cert.pem").unlink()
    (scene.root / "enclaves/stranger").mkdir()
    (scene.root / "enclaves/stranger/cert.pem").write_bytes(
        scene.file_of("/r3", "cert.pem").read_bytes()
    )
    result = imported_from(scene.root)
    assert left_out(result) == {
        "/r1": "its permissions are not the ones signed last",
        "/r2": "its certificate is missing",
        "/stranger": "is not in the ledger",
    }
    assert [each.name for each in result.left_out if each.refused] == ["/r1", "/stranger"]
    assert result.participants == ("/monitor", "/r3")


def test_who_expired_is_left_out(scene):
    result = imported_from(scene.root, now=NOW + 91 * DAY)
    assert set(left_out(result).values()) == {"expired"}
    assert b"participants: []" in result.document


def test_in_an_overlap_those_of_the_first_ca_stay(scene):
    keystore = scene.keystore
    terms = Rollover(profile=keystore.profile, scope=Scope.IDENTITY)
    begin_overlap(keystore, terms, kept=keystore.unlock(None), passphrase=None, now=NOW)
    result = imported_from(scene.root)
    assert (len(result.participants), result.left_out) == (4, ())
    scene.write(result.document.decode())
    assert scene.plan().in_order


def test_a_governance_of_another_signer_is_refused(scene, tmp_path):
    (tmp_path / "other").mkdir()
    other = Scene(tmp_path / "other", FILE.replace("transition", "classical"))
    other.apply()
    data = (other.root / "enclaves/governance.p7s").read_bytes()
    (scene.root / "enclaves/governance.p7s").write_bytes(data)
    with pytest.raises(VerificationError, match=r"enclaves/governance\.p7s"):
        imported_from(scene.root)


def test_an_sros2_keystore_needs_no_change_once_it_is_adopted(tmp_path):
    ros = SROS2(tmp_path / "ros")
    for name in ("/talker", "/tb/one", "/tb/two"):
        ros.enclave(name)
    before = sorted(path for path in ros.root.rglob("*"))
    result = imported_from(ros.root, now=MADE)
    assert sorted(path for path in ros.root.rglob("*")) == before
    assert result.participants == ("/talker", "/tb/one", "/tb/two")
    assert (result.roles, result.left_out) == (("participant",), ())
    (tmp_path / "domain.yaml").write_bytes(result.document)
    keystore = adopt(ros.root, now=MADE).keystore
    assert plan(read_domain(tmp_path / "domain.yaml"), keystore, now=MADE).in_order
    assert imported_from(ros.root, now=MADE).participants == result.participants


def test_a_folder_that_is_no_keystore_is_refused(tmp_path):
    with pytest.raises(KeystoreError, match="lacks public"):
        imported_from(tmp_path)


# Policies


def test_policies_of_all_kinds_become_one_file(tmp_path):
    grant = Grant(
        name="/cam",
        subject_name="CN=/cam",
        not_before=NOW - DAY,
        not_after=NOW + 30 * DAY,
        rules=(rule("rt/image"),),
    )
    grants = (grant, replace(grant, subject_name="O=Lab, CN=no name!", name="no name!"))
    value = Permissions(grants=grants)
    (tmp_path / "cam.xml").write_bytes(value.to_xml())
    past = replace(grant, subject_name="CN=/past", not_after=NOW - DAY / 2)
    (tmp_path / "past.yaml").write_bytes(permissions_to_yaml(Permissions(grants=(past,))))
    (tmp_path / "ros.policy.xml").write_text(POLICY.format("/talker"))
    governance = preset_named("migration").governance(DomainSet.of(7))
    (tmp_path / "governance.yaml").write_bytes(governance_to_yaml(governance))
    files = [tmp_path / name for name in ("cam.xml", "past.yaml", "ros.policy.xml")]
    result = imported_from(*files, tmp_path / "governance.yaml", domains=DomainSet.of(7))
    assert result.participants == ("/cam", "/talker")
    assert left_out(result) == {
        "O=Lab, CN=no name!": "is not the name of a participant",
        "/past": "its permissions are not in force",
    }
    assert any("/talker lacks topics that a Jazzy node needs" in each for each in result.notes)
    (tmp_path / "domain.yaml").write_bytes(result.document)
    desired = read_domain(tmp_path / "domain.yaml")
    assert desired.governance == governance
    assert desired.members["/talker"].domains == DomainSet.of(7)
    [of_cam] = desired.members["/cam"].spec().grants
    assert of_cam.rules == grant.rules


def test_two_governance_documents_are_too_many(tmp_path):
    for name in ("strict", "migration"):
        value = preset_named(name).governance(ZERO)
        (tmp_path / f"{name}.yaml").write_bytes(governance_to_yaml(value))
    with pytest.raises(UsageError, match="different governance"):
        imported_from(tmp_path / "strict.yaml", tmp_path / "migration.yaml")


def test_a_grant_that_only_has_a_default_cannot_be_said(tmp_path):
    window = {"not_before": NOW - DAY, "not_after": NOW + DAY}
    open_to_all = Grant(name="x", subject_name="CN=/x", default=DefaultAction.ALLOW, **window)
    (tmp_path / "x.xml").write_bytes(Permissions(grants=(open_to_all,)).to_xml())
    result = imported_from(tmp_path / "x.xml")
    assert left_out(result) == {"/x": "its grant has no rule, only a default"}


def test_text_that_xml_cannot_have_is_refused():
    with pytest.raises(InvalidDocumentError, match="XML cannot contain the character"):
        document(found("/a", "x\x01"))
