"""What the shells offer at the cursor: commands, options, names in the keystore, rows of tables."""

import json
import os
import shlex
import shutil
import subprocess
import sys

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS, PROFILES, SIGNATURES
from pqsec_pki.cli import COMMANDS
from tests.cli.conftest import clean_environment, snapshot
from tests.cli.test_errors import HEAVY

TOPICS = ["rt/chatter", "rt/image"]


@pytest.fixture
def offered(run_in, tmp_path):
    """offered("-k k renew /t") is what is offered for the last word, and stderr is empty."""

    def ask(line: str, **environment: str) -> list[str]:
        words = ["pqsec", *line.split(" ")]
        done = run_in(
            tmp_path,
            "",
            _PQSEC_COMPLETE="bash_complete",
            COMP_WORDS="\n".join(words),
            COMP_CWORD=str(len(words) - 1),
            **environment,
        )
        assert done.err == ""
        return [each.partition(",")[2] for each in done.out.splitlines() if each]

    return ask


@pytest.fixture
def domain(pqsec, keystore):
    """A keystore `k` with /talker, /listener and /camera."""
    path = keystore()
    pqsec("-k k issue /camera --ros-publish /image --subscribe sensor/* --subscribe a$(b)").done()
    return path


def test_commands_and_options_are_offered(offered):
    assert offered("") == list(COMMANDS)
    assert offered("verify") == ["verify", "verify-handshake"]
    assert offered("ca r") == ["recover", "remove-set", "rotate"]
    assert offered("--ver") == ["--version"]
    assert offered("renew --re") == ["--rekey", "--reuse-compromised-key"]
    assert offered("no-such-command x") == []


@pytest.mark.parametrize(
    "line",
    [
        *("renew", "needs-renewal", "bundle", "revoke", "issue", "verify-handshake"),
        *("try cyclonedds", "try cyclonedds --stock", "export fastdds", "explain --participant"),
    ],
)
def test_participants_of_the_keystore_are_offered(offered, domain, line):
    assert offered(f"-k k {line} ") == ["/camera", "/listener", "/talker"]
    assert offered(f"{line} /t", PQSEC_KEYSTORE="k") == ["/talker"]


def test_groups_are_offered_after_an_at_sign(offered, domain):
    assert offered("-k k renew @") == []
    groups = {"hall1": ["/talker"], "a;b": ["/camera"], "arms": ["/camera"]}
    file = domain / "groups.json"
    file.write_text(json.dumps({"format": 1, "groups": groups | {"hall": ["/x"]}}))
    assert offered("-k k renew @h") == []  # one of them is no name of a group
    file.write_text(json.dumps({"format": 1, "groups": {**groups, "a;b": []}}).replace("a;b", "b"))
    assert offered("-k k renew @") == ["@hall1", "@b", "@arms"]
    assert offered("-k k who-may --participant @h") == ["@hall1"]


def test_a_participant_is_offered_once(offered, domain):
    assert offered("-k k verify-handshake /talker /") == ["/camera", "/listener"]
    assert offered("verify-handshake -k k /talker /") == ["/camera", "/listener"]


@pytest.mark.parametrize("line", ["who-may --topic", "explain --publish", "issue /a --subscribe"])
def test_topics_of_the_signed_documents_are_offered(offered, domain, line):
    """Without patterns, and without what a shell would run."""
    assert offered(f"-k k {line} ") == TOPICS
    assert offered(f"-k k {line} rt/i") == ["rt/image"]
    assert offered(f"-k k {line} x") == []


def test_ros_topics_are_offered_by_their_names(offered, domain):
    assert offered("-k k who-may --ros-topic ") == ["/chatter", "/image"]
    assert offered("-k k issue /a --ros-publish /i") == ["/image"]


def test_only_topics_of_the_participant_that_is_named_are_offered(offered, domain):
    assert offered("-k k explain --participant /camera --publish ") == ["rt/image"]
    assert offered("-k k explain --participant /nobody --publish ") == []
    assert offered("-k k explain --participant '/cam*' --publish ") == offered(
        "-k k explain --participant /camera --publish "
    )


def test_rows_of_tables_are_offered(offered):
    assert offered("ca init --profile ") == [profile.name for profile in PROFILES]
    assert offered("ca init --kem ") == [row.name for row in KEY_AGREEMENTS]
    assert offered("request /a --participant-key ") == [row.name for row in SIGNATURES]
    assert offered("check --explain PQS231") == ["PQS231"]
    assert "fastdds" in offered("check --target ")
    assert "cyclonedds" in offered("verify-handshake /a /b --as ")
    assert offered("verify-handshake /a /b --attack al") == ["all"]
    assert len(offered("verify-handshake /a /b --attack ")) > 20


def test_nothing_is_said_where_the_keystore_cannot_be_read(offered, domain):
    assert offered("renew ") == []
    assert offered("-k nowhere renew ") == []
    (domain / "pqsec.json").write_text("damaged")
    assert offered("-k k renew ") == []
    assert offered("-k k who-may --topic ") == []


def test_a_damaged_document_offers_nothing_and_hides_nothing(offered, domain):
    (domain / "enclaves/camera/permissions.p7s").write_bytes(b"damaged")
    assert offered("-k k who-may --topic ") == ["rt/chatter"]


def test_completing_reads_only(offered, domain, tmp_path):
    before, names = snapshot(domain), sorted(domain.rglob("*"))
    for line in ("renew ", "who-may --topic ", "explain --participant /camera --publish "):
        assert offered(f"-k k {line}")
    assert (snapshot(domain), sorted(domain.rglob("*"))) == (before, names)


def test_completing_a_command_imports_no_command(tmp_path):
    script = (
        "import sys\nfrom pqsec_pki.cli import main\n"
        f"try:\n    main()\nfinally:\n    print([n for n in {HEAVY} if n in sys.modules],"
        " [n for n in sys.modules if n.startswith('pqsec_pki.') and n.count('.') == 1],"
        " file=sys.stderr)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        cwd=tmp_path,
        env=clean_environment(
            PYTHONPATH=os.pathsep.join(sys.path),
            _PQSEC_COMPLETE="bash_complete",
            COMP_WORDS="pqsec i",
            COMP_CWORD="1",
        ),
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["plain,issue", "plain,install", "plain,inspect"]
    assert done.stderr.startswith("[] ")
    assert "keystore" not in done.stderr


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_the_other_shells_get_the_same(run_in, domain, tmp_path, shell):
    assert "pqsec" in run_in(tmp_path, "", _PQSEC_COMPLETE=f"{shell}_source").done().out
    cursor = {"zsh": "4", "fish": "/"}[shell]
    line = "pqsec -k k renew /"
    done = run_in(
        tmp_path, "", _PQSEC_COMPLETE=f"{shell}_complete", COMP_WORDS=line, COMP_CWORD=cursor
    ).done()
    for name in ("/camera", "/listener", "/talker"):
        assert name in done.out


def test_bash_completes(domain, tmp_path):
    """Real bash, with the function that its users load."""
    program = tmp_path / "bin/pqsec"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m pqsec_pki "$@"\n')
    program.chmod(0o755)
    script = """
        eval "$(_PQSEC_COMPLETE=bash_source pqsec)"
        function=$(complete -p pqsec | sed 's/.*-F \\([^ ]*\\).*/\\1/')
        COMP_WORDS=(pqsec -k k renew /) COMP_CWORD=4
        $function pqsec
        printf '%s\\n' "${COMPREPLY[@]}"
    """
    path = f"{program.parent}:{os.environ['PATH']}"
    done = subprocess.run(
        [shutil.which("bash"), "-c", script],
        cwd=tmp_path,
        env=clean_environment(PATH=path, PYTHONPATH=os.pathsep.join(filter(None, sys.path))),
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["/camera", "/listener", "/talker"]
    assert done.stderr == ""


def test_the_environment_of_a_shell_is_no_request(pqsec):
    assert shlex.split(pqsec("--version", _PQSEC_COMPLETE="").done().out)
