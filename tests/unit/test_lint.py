"""The frame of the check: what it looks at, and what it leaves out for a reason."""

import compileall
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

import pqsec_pki
from pqsec_pki.errors import FileError, UsageError
from pqsec_pki.lint import (
    RULES,
    Severity,
    _search,
    check,
    from_option,
    rule_named,
    to_sarif,
)
from pqsec_pki.stacks import Stack
from tests.unit.test_lint_documents import GOVERNANCE, NOW, PERMISSIONS, governance, topic

OPEN = governance(">*<", ">rt/*<")  # PQS229, a warning
BROKEN = governance(">SIGN<", ">SIGNED<")  # PQS202, an error


def checked(folder, files=None, **options):
    for path, text in (files or {}).items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(text)
    return check([folder], now=NOW, **options)


def told(report):
    return [(each.rule.id, each.path.name, each.line) for each in report.findings]


def test_a_folder_is_looked_through_and_what_is_not_ours_is_left_alone(tmp_path):
    report = checked(
        tmp_path,
        {"a/b/governance.xml": OPEN, "pom.xml": "<project/>", "notes.txt": BROKEN, "c.p7s": "x"},
    )
    assert [(id_, name) for id_, name, _ in told(report)] == [
        ("PQS229", "governance.xml"),
        ("PQS201", "c.p7s"),
    ]


def test_a_file_that_is_named_is_taken_to_be_a_document(tmp_path):
    (tmp_path / "notes.txt").write_text("hello")
    [finding] = check([tmp_path / "notes.txt"], now=NOW).findings
    assert finding.rule.id == "PQS201"


def test_what_is_not_there_and_a_folder_with_nothing_in_it_are_errors(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        check([tmp_path / "nowhere"], now=NOW)
    with pytest.raises(FileError, match="nothing to check"):
        check([tmp_path], now=NOW)


def test_settings_of_a_keystore_that_cannot_be_read_are_told(tmp_path):
    report = checked(tmp_path, {"pqsec.json": "{", "governance.xml": GOVERNANCE})
    assert told(report) == [("PQS001", "pqsec.json", None)]


def test_a_change_of_a_keystore_that_was_cut_off_is_told_and_not_finished(tmp_path):
    files = {"pqsec.json": "{}", ".journal/moves.json": '{"targets": ["x"], "entries": []}'}
    assert told(checked(tmp_path, files | {".journal/0/governance.xml": GOVERNANCE})) == [
        ("PQS006", ".journal", None)
    ]
    assert (tmp_path / ".journal/0/governance.xml").exists()


def test_what_a_killed_command_drafted_is_no_complaint(tmp_path):
    """The next command that writes there sweeps it away; what others call a draft is theirs."""
    files = {
        ".draft-0123456789abcdef/0/governance.xml": BROKEN,
        ".draft-mine/governance.xml": BROKEN,
    }
    found = checked(tmp_path, files).findings
    assert {each.path.parent.name for each in found} == {".draft-mine"}


def test_a_file_that_is_too_large_is_told_and_not_checked(tmp_path):
    with (tmp_path / "governance.xml").open("wb") as file:
        file.truncate(100 << 20)
    assert told(checked(tmp_path)) == [("PQS001", "governance.xml", None)]


@pytest.mark.parametrize(
    ("limit", "value", "words"), [("MAX_FILES", 2, "2 files"), ("MAX_BYTES", 99, "99 bytes")]
)
def test_a_folder_with_too_much_in_it_is_refused(tmp_path, monkeypatch, limit, value, words):
    files = {f"{name}.xml": "<dds>" + " " * 44 for name in "ab"}
    checked(tmp_path, files)
    monkeypatch.setattr(_search, limit, value)
    checked(tmp_path)
    with pytest.raises(FileError, match=f"more than {words} to check"):
        checked(tmp_path, {"c.xml": "<dds/>"})


def test_pipes_and_circles_of_links_do_not_hold_it_up(tmp_path):
    os.mkfifo(tmp_path / "governance.p7s")
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "up").symlink_to("..")
    (tmp_path / "round.xml").symlink_to("round.xml")
    assert told(checked(tmp_path, {"permissions.xml": PERMISSIONS})) == []


def test_a_file_with_many_links_is_told_once_and_by_its_own_name(tmp_path):
    checked(tmp_path, {"shared/governance.xml": OPEN})
    for place in ("a", "z"):
        (tmp_path / place).mkdir()
        (tmp_path / place / "governance.xml").symlink_to("../shared/governance.xml")
    [finding] = checked(tmp_path).findings
    assert finding.path == tmp_path / "shared/governance.xml"


SIGNED = 'Content-Type: multipart/signed; boundary="xx"\n\n--xx\nContent-Type: text/plain\n\n{}'
SIGNED += "\n--xx\nContent-Type: application/x-pkcs7-signature\n\nAAAA\n--xx--\n"


def test_in_a_signed_file_lines_are_those_of_the_file(tmp_path):
    text = SIGNED.format(OPEN)
    found = told(checked(tmp_path, {"governance.p7s": text}))
    line = text[: text.index("<domain_rule>")].count("\n") + 1
    assert ("PQS229", "governance.p7s", line) in found


def test_of_a_signed_file_and_its_source_only_the_source_is_told(tmp_path):
    files = {"governance.p7s": SIGNED.format(OPEN), "governance.xml": OPEN}
    names = [name for id_, name, _ in told(checked(tmp_path, files)) if id_ == "PQS229"]
    assert names == ["governance.xml"]
    files["governance.xml"] = BROKEN
    names = [name for id_, name, _ in told(checked(tmp_path, files)) if id_ == "PQS229"]
    assert names == ["governance.p7s"]


def test_rules_for_stacks_that_are_not_meant_are_not_asked(tmp_path):
    files = {"permissions.xml": topic("rt/[^a]")}
    of_cyclone, of_fast = "PQS236", "PQS244"
    assert [id_ for id_, *_ in told(checked(tmp_path, files))] == [of_cyclone, of_fast]
    assert [id_ for id_, *_ in told(checked(tmp_path, targets=[Stack.FASTDDS]))] == [of_fast]
    both = [Stack.FASTDDS, Stack.CYCLONEDDS]
    assert {of_cyclone, of_fast} <= {id_ for id_, *_ in told(checked(tmp_path, targets=both))}


def test_a_rule_that_contradicts_another_stack_is_asked_only_when_that_is_meant():
    rule = RULES["PQS416"]
    assert not rule.matters_to(frozenset())
    assert rule.matters_to(frozenset({Stack.OPENDDS}))
    assert not rule.matters_to(frozenset({Stack.CYCLONEDDS}))
    assert RULES["PQS202"].matters_to(frozenset({Stack.CYCLONEDDS}))


# Suppressions


def with_suppressions(folder, text, files=None):
    (folder / ".pqsec-check.yaml").write_text(text)
    return checked(folder, files or {"a/governance.xml": OPEN})


ENTRY = "ignore:\n  - rule: PQS229\n    reason: a test bench\n"


@pytest.mark.parametrize(
    "more", ["", "    path: a/*\n", "    path: '*.xml'\n", "    until: 2026-06-01\n"]
)
def test_a_finding_with_a_reason_is_left_out_and_told_as_such(tmp_path, more):
    report = with_suppressions(tmp_path, ENTRY + more)
    assert report.findings == ()
    [(finding, reason)] = report.ignored
    assert (finding.rule.id, reason) == ("PQS229", "a test bench")


BOMB = "[&a [x, x], " + ", ".join(
    f"&{name} [{', '.join([f'*{before}'] * 9)}]" for before, name in pairwise("abcdefghijkl")
) + "]"  # fmt: skip


@pytest.mark.parametrize(
    ("text", "more", "message"),
    [
        ("ignore:\n  - rule: PQS229\n", ["PQS002"], "gives no reason"),
        ("ignore:\n  - rule: PQS229\n    reason: ' '\n", ["PQS002"], "gives no reason"),
        (ENTRY + "    until: 2026-05-31\n", ["PQS003"], "expired on 2026-05-31"),
        (ENTRY + "    path: b/*\n", ["PQS004"], "matches no finding"),
        (ENTRY.replace("229", "204"), ["PQS004"], "matches no finding"),
        (ENTRY.replace("PQS229", "PQS9"), ["PQS005"], "no rule PQS9"),
        (ENTRY + "    until: soon\n", ["PQS005"], "'soon' is not a date"),
        (ENTRY + "    who: me\n", ["PQS005"], "who: no such key here"),
        ("ignore:\n  - reason: x\n", ["PQS005"], "'rule' is missing"),
        ("ignore: x\n", ["PQS005"], "expected a list"),
        ("ignore: [x]\n", ["PQS005"], "expected `key: value`"),
        ("ignored: []\n", ["PQS005"], "did you mean ignore"),
        (ENTRY + ENTRY, ["PQS005"], "comes twice"),
        (ENTRY + "    reason: z\n", ["PQS005"], "'reason' comes twice"),
        (ENTRY + "    path: [x]\n", ["PQS005"], "path: must be plain text"),
        ("- x\n", ["PQS005"], "expected `key: value`"),
        ("a: [\n", ["PQS005"], "not well-formed YAML"),
        ("\x00", ["PQS005"], "not well-formed YAML"),
        ("[" * 5000, ["PQS005"], "nested lists and mappings"),
        (ENTRY.replace("a test bench", BOMB), ["PQS005"], "the anchor &a is not allowed"),
        (f"{BOMB}: x\n", ["PQS005"], "a key must be a word"),
        ("x: " + "y" * (300 << 10), ["PQS005"], "larger than"),
        ("", [], ""),
        ("# nothing\n\n  # is ignored\n", [], ""),
    ],
)
def test_a_suppression_that_cannot_hold_is_itself_a_finding(tmp_path, text, more, message):
    report = with_suppressions(tmp_path, text)
    found = {each.rule.id: each for each in report.findings}
    assert set(found) == {"PQS229", *more}
    assert all(message in found[id_].message for id_ in more)
    assert all(found[id_].path.name == ".pqsec-check.yaml" for id_ in more)


def test_an_entry_holds_beside_those_that_cannot_be_read(tmp_path):
    report = with_suppressions(tmp_path, f"other: x\n{ENTRY}  - reason: x\n  - y\n")
    assert [(each.rule.id, each.line) for each in report.findings] == [
        ("PQS005", 1),
        ("PQS005", 5),
        ("PQS005", 6),
    ]
    assert [reason for _, reason in report.ignored] == ["a test bench"]


def test_a_suppression_for_other_stacks_is_not_called_superfluous(tmp_path):
    files = {"permissions.xml": topic("rt/*x*y")}
    with_suppressions(tmp_path, ENTRY.replace("229", "242"), files)
    assert told(checked(tmp_path, targets=[Stack.FASTDDS])) == []


def test_one_file_of_a_folder_is_checked_with_the_folders_suppressions(tmp_path):
    two = ENTRY + ENTRY.partition("\n")[2].replace("229", "202")
    (tmp_path / ".pqsec-check.yaml").write_text(two)
    (tmp_path / "governance.xml").write_text(OPEN)
    report = check([tmp_path / "governance.xml"], now=NOW)
    assert report.findings == ()  # nor is the other called superfluous
    assert len(report.ignored) == 1


def test_a_folder_suppresses_nothing_of_another_folder(tmp_path):
    for name in ("mine", "theirs"):
        checked(tmp_path / name, {"governance.xml": OPEN})
    (tmp_path / "theirs/.pqsec-check.yaml").write_text(ENTRY)
    for theirs in ("theirs", "mine/../theirs"):
        report = check([tmp_path / "mine", tmp_path / theirs], now=NOW)
        assert told(report) == [("PQS229", "governance.xml", report.findings[0].line)]
        assert report.findings[0].path == tmp_path / "mine/governance.xml"


def test_what_a_link_leads_to_is_suppressed_by_the_name_of_the_link(tmp_path):
    checked(tmp_path, {"outside.xml": OPEN})
    (tmp_path / "k").mkdir()
    (tmp_path / "k/governance.xml").symlink_to("../outside.xml")
    (tmp_path / "k/.pqsec-check.yaml").write_text(ENTRY + "    path: governance.xml\n")
    assert check([tmp_path / "k"], now=NOW).findings == ()


def test_a_suppression_file_of_a_few_bytes_cannot_say_millions(tmp_path):
    many = ", ".join(["{rule: x}"] * 8_000)
    report = with_suppressions(tmp_path, f"ignore: &a [{many}]\n" + "ignore: *a\n" * 14_000)
    assert [each.rule.id for each in report.findings] == ["PQS005", "PQS229"]


def test_a_suppression_of_the_command_line_holds_for_all(tmp_path):
    report = checked(tmp_path, {"governance.xml": OPEN}, ignore=[from_option("PQS229=a = b")])
    assert report.findings == ()
    assert [reason for _, reason in report.ignored] == ["a = b"]


@pytest.mark.parametrize("text", ["PQS229", "PQS229=", "=why", "PQS229= "])
def test_a_suppression_of_the_command_line_needs_a_reason(text):
    with pytest.raises(UsageError, match="no reason given"):
        from_option(text)


# Results


def test_a_report_is_clean_without_errors_and_strictly_without_warnings(tmp_path):
    report = checked(tmp_path, {"governance.xml": OPEN})
    assert report.count(Severity.WARNING) == 1
    assert report.is_clean()
    assert not report.is_clean(strict=True)
    assert not checked(tmp_path, {"governance.xml": BROKEN}).is_clean()
    assert checked(tmp_path, {"governance.xml": GOVERNANCE}).is_clean(strict=True)


def test_the_log_has_the_shape_of_sarif(tmp_path):
    """The parts of SARIF 2.1.0 that its schema requires (3.13, 3.14, 3.18, 3.19, 3.27)."""
    report = checked(
        tmp_path, {"a é#/governance.xml": OPEN, "b/governance.xml": BROKEN},
        ignore=[from_option("PQS202=why"), from_option("PQS220=so")],
    )  # fmt: skip
    log = to_sarif(report)
    assert set(log) == {"$schema", "version", "runs"}
    assert log["version"] == "2.1.0"
    [run] = log["runs"]
    driver = run["tool"]["driver"]
    assert driver["name"]
    ids = [rule["id"] for rule in driver["rules"]]
    assert len(set(ids)) == len(ids) == len(RULES)
    assert all(rule["shortDescription"]["text"] for rule in driver["rules"])
    assert len(run["results"]) == 3
    for result in run["results"]:
        assert ids[result["ruleIndex"]] == result["ruleId"]
        assert result["level"] in {"none", "note", "warning", "error"}
        assert result["message"]["text"]
        place = result["locations"][0]["physicalLocation"]
        assert place["region"]["startLine"] >= 1
        assert place["artifactLocation"]["uri"].startswith("file:///")
    first, second, third = run["results"]
    assert "a%20%C3%A9%23/governance.xml" in first["locations"][0]["physicalLocation"][
        "artifactLocation"]["uri"]  # fmt: skip
    reasons = {each["suppressions"][0]["justification"] for each in (second, third)}
    assert reasons == {"why", "so"}
    assert "suppressions" not in first


def test_a_relative_path_stays_relative_in_the_log(tmp_path):
    report = checked(tmp_path, {"governance.xml": OPEN})
    [finding] = report.findings
    moved = replace(report, findings=(replace(finding, path=Path("k/governance.xml")),))
    [result] = to_sarif(moved)["runs"][0]["results"]
    location = result["locations"][0]["physicalLocation"]["artifactLocation"]
    assert location == {"uri": "k/governance.xml"}


def test_rules_are_found_by_their_id_and_say_what_they_must():
    assert rule_named("pqs202") is RULES["PQS202"]
    with pytest.raises(UsageError, match="no rule PQS000"):
        rule_named("PQS000")
    for id_, rule in RULES.items():
        assert rule.id == id_
        assert rule.title[0].islower() or not rule.title[0].isalpha() or rule.title.isascii()
        assert rule.why.endswith(".")
        assert rule.fix.endswith((".", ">", "?"))
        assert rule.stacks or not rule.only_when_asked


def test_all_rules_are_found_where_only_compiled_modules_are_installed(tmp_path):
    """Without its rules a check would find nothing, and say so."""
    package = Path(pqsec_pki.__file__).parent
    copy = shutil.copytree(package, tmp_path / package.name, ignore=shutil.ignore_patterns("*.pyc"))
    assert compileall.compile_dir(copy / "lint", legacy=True, quiet=1)
    for path in (copy / "lint").rglob("*.py"):
        path.unlink()
    script = "from pqsec_pki import lint; print(lint.__file__, *lint.RULES)"
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.split() == [str(copy / "lint/__init__.pyc"), *RULES]
