"""How often a question opens the files of a keystore: counted by an audit hook, in one process."""

import os
import subprocess
import sys
from collections import Counter

import pytest

NAMES = ("/talker", "/listener", "/r1", "/r2")
COUNTING = """
import os, sys
opened, root = [], os.path.realpath("k/enclaves") + "/"
def note(event, arguments):
    path = arguments[0] if event == "open" else None
    if isinstance(path, (str, bytes)) and arguments[1] is None:  # once: by os.open alone
        found = os.path.abspath(os.fsdecode(path))
        if found.startswith(root):
            opened.append(found[len(root):])
sys.addaudithook(note)
from pqsec_pki.cli import main
sys.argv = ["pqsec", *sys.argv[1:]]
try:
    main()
finally:
    sys.stderr.write("".join(f"opened {each}\\n" for each in opened))
"""
QUESTIONS = ["who-may", "who-may --matrix", "explain /* --publish rt/chatter"]


@pytest.fixture
def opened(pqsec, keystore, tmp_path):
    """opened(command) counts the files below k/enclaves that the command opens."""
    keystore()
    pqsec("-k k issue /r1 /r2 --publish rt/chatter").done()

    def run(command):
        done = subprocess.run(
            [sys.executable, "-c", COUNTING, "-k", "k", *command.split()],
            cwd=tmp_path,
            env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode in {0, 1}, done.stderr
        lines = (line.removeprefix("opened ") for line in done.stderr.splitlines())
        return Counter(line for line in lines if line.endswith((".pem", ".p7s", ".xml")))

    return run


@pytest.mark.parametrize("question", QUESTIONS)
def test_a_question_opens_the_files_of_each_participant_once_and_no_key(opened, question):
    found = opened(question)
    for name in NAMES:
        own = {file: count for file, count in found.items() if file.startswith(f"{name[1:]}/")}
        parts = {file.partition("/")[2]: count for file, count in own.items()}
        assert parts.pop("cert.pem") == parts.pop("permissions.p7s") == 1
        assert not [file for file in parts if "key" in file], parts


def test_the_opens_of_who_may_grow_by_two_for_each_participant(pqsec, opened):
    """Shared files are opened once, whatever the number of participants."""
    few = opened("who-may").total()
    pqsec("-k k issue /s1 /s2 /s3 --publish rt/chatter").done()
    assert opened("who-may").total() - few == 2 * 3
