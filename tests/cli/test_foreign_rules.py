"""Rules of other packages that are broken; test_extension.py has one that works."""

import os
import subprocess
import sys

import pytest

RULE = """
from pqsec_pki.lint import File, Severity, lint_rule
@lint_rule("{id}", Severity.ERROR, "t", why="w", fix="f", bad="b", good="g")
def check(subject: {scope}): {body}
"""


@pytest.fixture
def run(tmp_path):
    """run(site, line, code): what pqsec says where that folder's packages are installed."""

    def run(site, line, code=0):
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([*sys.path, str(site)])}
        done = subprocess.run(
            [sys.executable, "-m", "pqsec_pki", *line.split()],
            cwd=tmp_path, env=environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == code, done.stdout + done.stderr
        assert "Traceback" not in done.stderr
        return done.stdout + done.stderr

    return run


@pytest.fixture
def package(tmp_path):
    """package(code, name) is a folder with an installed package with that module."""

    def make(code, name="lab"):
        site = tmp_path / "site"
        about = site / "lab-2.0.dist-info"
        about.mkdir(parents=True)
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: lab\nVersion: 2.0\n")
        (about / "entry_points.txt").write_text(f"[pqsec.lint_rules]\n{name} = lab_module\n")
        (site / "lab_module.py").write_text(code)
        return site

    return make


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("1 / 0", "ZeroDivisionError"),
        ("raise SystemExit(0)", "SystemExit"),
        ("pass", "defines no rule"),
        (RULE.format(id="PQS999", scope="File", body="return []"), "PQS999 is not LAB"),
        (RULE.format(id="PQS001", scope="File", body="return []"), "two rules are called PQS001"),
        (RULE.format(id="LAB1", scope="File", body="return []"), "LAB1 is not LAB"),
        (RULE.format(id="LAB001", scope="'File'", body="return []"), "no class"),
    ],
)
def test_a_package_that_cannot_add_rules_is_named(run, package, code, words):
    said = run(package(code), "check nowhere", code=3)
    assert "pqsec: error: the package lab 2.0 cannot add rules: " in said
    assert words in said
    assert "uninstall" in said


@pytest.mark.parametrize("name", ["pqs", "l", "LAB", "l4b"])
def test_a_name_that_begins_no_id_is_refused(run, package, name):
    code = RULE.format(id=f"{name.upper()}999", scope="File", body="return []")
    assert "is not 2 to 8 small letters" in run(package(code, name), "check nowhere", code=3)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("return 1 / 0", "ZeroDivisionError"),
        ("return 5", "TypeError"),
        ("return [5]", "a int is not a Violation"),
    ],
)
def test_a_rule_that_fails_does_not_look_like_no_finding(run, package, tmp_path, body, words):
    (tmp_path / "some.xml").write_text("<a/>")
    code = RULE.format(id="LAB001", scope="File", body=body)
    said = run(package(code), "check some.xml", code=3)
    assert "rule LAB001 of the package lab 2.0 failed" in said
    assert words in said


def test_a_package_whose_entry_points_cannot_be_read_is_named(run, package):
    site = package("")
    (site / "lab-2.0.dist-info/entry_points.txt").write_text("[x]\nno equals sign")
    assert "the entry points of lab 2.0 cannot be read" in run(site, "check nowhere", code=3)
