"""pre-commit's hooks and the GitHub action, as a user's repository runs them."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from pqsec_pki.documents import PRESETS, DomainSet
from tests.json_schemas import validator

ROOT = Path(__file__).parents[2]
HOOKS = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text())
ACTION = yaml.safe_load((ROOT / "action.yml").read_text())
GOOD = PRESETS[0].governance(DomainSet.of(0)).to_xml()
BAD = GOOD.replace(b"<id>0</id>", b"<id>999</id>")
BROKEN = GOOD.replace(b"<domains>", b"<domain>", 1)


def run(*words, cwd, code=0, **environment):
    done = subprocess.run(
        words, cwd=cwd, env=os.environ | environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == code, done.stdout + done.stderr
    return done.stdout + done.stderr


def git(*words, cwd):
    who = {f"GIT_{role}_{what}": "a@b.example" for role in ("AUTHOR", "COMMITTER")
           for what in ("NAME", "EMAIL")}  # fmt: skip
    return run("git", "-c", "init.defaultBranch=main", *words, cwd=cwd, **who).strip()


def repository(folder):
    git("init", "-q", cwd=folder)
    git("add", "-A", cwd=folder)
    git("commit", "-qm", "all", cwd=folder)
    return git("rev-parse", "HEAD", cwd=folder)


@pytest.fixture(scope="module")
def published(tmp_path_factory, requires):
    """(a repository with what a clone of this one has, its only commit)."""
    cloned = shutil.which("git") and (ROOT / ".git").exists()
    requires(cloned or None, "a clone with git", "apt-get install git, and clone the repository")
    folder = tmp_path_factory.mktemp("pqsec")
    listed = ("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard")
    for name in filter(None, run(*listed, cwd=ROOT).split("\0")):
        if (ROOT / name).is_file() and not name.startswith("tests/"):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder, repository(folder)


@pytest.fixture
def commit_check(published, tmp_path, requires):
    """commit_check(files) is what pre-commit says of a repository with these."""
    program = Path(sys.executable).with_name("pre-commit")
    requires(program.exists() or None, "pre-commit", "pip install pre-commit")

    def check(files, code):
        folder, commit = published
        chosen = [{"id": each["id"]} for each in HOOKS]
        configuration = {"repos": [{"repo": f"file://{folder}", "rev": commit, "hooks": chosen}]}
        project = tmp_path / "project"
        project.mkdir(exist_ok=True)
        (project / ".pre-commit-config.yaml").write_text(yaml.safe_dump(configuration))
        for name, data in files.items():
            (project / name).write_bytes(data)
        git("init", "-q", cwd=project)
        git("add", "-A", cwd=project)
        home = str(tmp_path / "home")
        return run(program, "run", "--all-files", cwd=project, code=code, PRE_COMMIT_HOME=home)

    return check


@pytest.mark.slow
def test_pre_commit_runs_both_hooks(commit_check):
    said = commit_check({"governance.xml": GOOD, "other.xml": b"<a/>"}, 0)
    assert said.count("Passed") == 2
    assert "PQS233" in commit_check({"governance.xml": BAD}, 1)
    said = commit_check({"governance.xml": BROKEN}, 1)
    assert said.count("Failed") == 2
    assert commit_check({"governance.xml": GOOD, "permissions-a.yaml": b"grants: 1"}, 1)
    said = commit_check(
        {"permissions-a.yaml": b"grants: []", "domain.yaml": b"nam: x\nprune: 1"}, 1
    )
    assert "domain.yaml: line 1: nam: no such key here; did you mean name?" in said


def test_each_hook_is_a_command_with_options_that_exist():
    for hook in HOOKS:
        program, command = hook["entry"].split()
        assert program == "pqsec"
        run(sys.executable, "-m", "pqsec_pki", command, "--help", cwd=ROOT)


# The GitHub action: the scripts of its steps, as the runner starts them


@pytest.fixture
def act(tmp_path):
    """act(paths, options, code) runs the step that checks; its SARIF, and what it said."""
    script = next(step["run"] for step in ACTION["runs"]["steps"] if step.get("id") == "check")
    program = tmp_path / "temp/pqsec/bin/pqsec"
    program.parent.mkdir(parents=True)
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m pqsec_pki "$@"\n')
    program.chmod(0o755)
    outputs = tmp_path / "outputs"

    def act(paths, options="", code=0):
        said = run(
            "bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", script, cwd=tmp_path,
            code=code, PATHS=paths, OPTIONS=options, GITHUB_OUTPUT=str(outputs),
            RUNNER_TEMP=str(tmp_path / "temp"), PYTHONPATH=str(ROOT),
        )  # fmt: skip
        sarif = outputs.read_text().splitlines()[-1].removeprefix("sarif=")
        return Path(sarif).read_text(), said

    return act


@pytest.mark.slow
def test_the_action_leaves_a_log_whether_or_not_the_check_fails(act, tmp_path):
    (tmp_path / "good.xml").write_bytes(GOOD)
    (tmp_path / "bad.xml").write_bytes(BAD)
    log, said = act("good.xml\n")
    assert json.loads(log)["runs"][0]["results"] == []
    assert "1 file checked: no findings" in said
    log, said = act("good.xml\nbad.xml\n", "--target\ncyclonedds\n", code=1)
    assert [each["ruleId"] for each in json.loads(log)["runs"][0]["results"]] == ["PQS233"]
    assert "bad.xml:" in said
    act("nowhere", code=3)
    act("good.xml", "--no-such", code=2)


@pytest.mark.slow
def test_what_the_action_is_given_is_no_command(act, tmp_path):
    hostile = "$(touch ran) `touch ran`; touch ran"
    act(hostile, code=3)
    act("--explain", code=3)
    (tmp_path / "good.xml").write_bytes(GOOD)
    act("good.xml", f"--target={hostile}", code=2)
    assert not (tmp_path / "ran").exists()
    for step in ACTION["runs"]["steps"]:
        assert "${{" not in step.get("run", "")


def test_the_report_for_gitlab_has_what_gitlab_requires(tmp_path):
    """GitLab's documentation of the format: these keys, and these severities."""
    (tmp_path / "bad.xml").write_bytes(BAD)
    words = ("check", "--format", "gitlab", "bad.xml")
    issues = run(sys.executable, "-m", "pqsec_pki", *words, cwd=tmp_path, code=1)
    text = {"type": "string", "minLength": 1}
    place = {"path": text, "lines": {"properties": {"begin": {"type": "integer", "minimum": 1}}}}
    keys = {
        "description": text,
        "check_name": text,
        "fingerprint": text,
        "severity": {"enum": ["info", "minor", "major", "critical", "blocker"]},
        "location": {"properties": place, "required": list(place)},
    }
    item = {"type": "object", "properties": keys, "required": list(keys)}
    validator({"type": "array", "items": item, "minItems": 1}).validate(json.loads(issues))
