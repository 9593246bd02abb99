"""verify-handshake --all, --matrix and --trace: many pairs, all suites, every byte."""

import json
import os
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS
from pqsec_pki.handshake import compact
from tests.cli.conftest import AT_ONCE, NAMES, clean_environment, snapshot, visible

TWO = "-k k verify-handshake /talker /listener"
RESTORE = "restore it from a backup, or reissue it: `pqsec renew /third` keeps its permissions"
ALL = "-k k verify-handshake --all"
LAST = re.compile(
    r"([0-9]+) participants; pairs: ([0-9]+), ([0-9]+) ok, ([0-9]+) failed,"
    r" ([0-9]+) without a common domain, ([0-9]+) without a common topic;"
    r" [0-9]+\.[0-9] s, [0-9]+ handshakes/s"
)


# What goes together


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("", "a handshake needs two participants, but 0 are named"),
        ("/talker", "a handshake needs two participants, but 1 is named"),
        ("/a /b /c", "a handshake needs two participants, but 3 are named"),
        ("--trace -", "a handshake needs two participants, but 0 are named"),
        ("--attack all /a", "a handshake needs two participants, but 1 is named"),
        ("/talker --all", "a handshake needs two participants, but 1 is named"),
        ("/talker /listener --matrix", "--matrix takes no participants, but 2 are named"),
        ("--all --matrix", "--all and --matrix exclude each other"),
        ("/a /b --trace t --attack all", "--trace and --attack exclude each other"),
        ("--matrix --domain 0", "--domain is for "),
        ("--matrix --kem mlkem768", "--kem is for "),
        ("--matrix --as fastdds", "--as is for "),
        ("--matrix --wire-version 2", "--wire-version is for "),
        ("/a /b --wire-version 3", "--wire-version"),
        ("/talker /listener --wire-version 2", "ECDH+prime256v1-CEUM have only version 1"),
        ("--all --wire-version 2", "ECDH+prime256v1-CEUM have only version 1"),
        ("/talker /listener --attack all --wire-version 2", "have only version 1"),
        ("/a /b --attack all --as fastdds", "--as is for "),
        ("/a /b --jobs 2", "--jobs is for --all, not for two participants"),
        ("--all --rounds 2", "--rounds is for --matrix, not for --all"),
        ("--all --force", "--force is for --trace, not for --all"),
        ("/a /b --insecure-show-secrets", "--insecure-show-secrets is for --trace, not for two"),
        ("--all --jobs 0", "--jobs"),
        ("--matrix --rounds 0", "--rounds"),
        ("/a /b --trace ''", "--trace"),
    ],
)
def test_what_does_not_go_together_is_a_usage_error(pqsec, keystore, options, words):
    keystore()
    pqsec(f"-k k verify-handshake {options}").refused(2, words)


def test_help_shows_each_mode_with_an_example(pqsec):
    told = pqsec("verify-handshake --help").done().out
    assert told.startswith("Usage: pqsec verify-handshake [OPTIONS] [A B|NAME...]\n")
    examples = [line.split(maxsplit=1)[1] for line in told.splitlines() if "  pqsec ver" in line]
    assert len(examples) == 8
    for option in ("--as", "--trace", "--attack", "--all", "--matrix"):
        assert [line for line in examples if option in line]
        assert f"\n  {option} " in told


# --all


@pytest.mark.parametrize("profile", NAMES)
def test_all_pairs_of_a_keystore_meet(pqsec, keystore, profile):
    keystore(profile)
    said = pqsec(ALL).done()
    assert said.err == ""
    *matrix, blank, last = said.out.splitlines()
    assert matrix == ["              1   2", "1  /listener      ok", "2  /talker    ok"]
    assert blank == ""
    assert LAST.fullmatch(last).groups() == ("2", "1", "1", "0", "0", "0")


def test_all_pairs_are_told_as_json(pqsec, keystore):
    keystore("transition")
    pqsec("-k k issue /third --publish x").done()
    said = pqsec(f"{ALL} --json").done()
    assert said.err == ""
    told = said.json
    assert told["ok"] is True
    names = ["/listener", "/talker", "/third"]
    assert told["participants"] == [{"name": name, "domains": [0], "faults": []} for name in names]
    assert [each["pair"] for each in told["pairs"]] == [
        ["/listener", "/talker"],
        ["/listener", "/third"],
        ["/talker", "/third"],
    ]
    for each in told["pairs"]:
        assert (each["as"], each["domain"], each["ok"]) == (["pqsec", "pqsec"], 0, True)
        assert {each["initiator"], each["replier"]} == set(each["pair"])
        assert each["milliseconds"] > 0
    totals = told["totals"]
    assert totals["seconds"] > 0
    assert totals["handshakes_per_second"] > 0
    assert {key: totals[key] for key in ("participants", "pairs", "ok", "handshakes")} == {
        "participants": 3,
        "pairs": 3,
        "ok": 3,
        "handshakes": 3,
    }


@pytest.fixture
def broken(pqsec, keystore):
    """A keystore with a third participant whose key is lost."""
    k = keystore()
    pqsec("-k k issue /third --publish x").done()
    (k / "enclaves/third/key.pem").write_text("gone")
    return k


def test_a_broken_participant_fails_its_pairs_and_is_told_once(pqsec, broken):
    said = pqsec(ALL)
    assert (said.code, said.err) == (1, "")
    matrix, faults, (last,) = (part.splitlines() for part in said.out.split("\n\n"))
    assert [line.split()[1:] for line in matrix[1:]] == [
        ["/listener", "ok", "FAIL"],
        ["/talker", "ok", "FAIL"],
        ["/third", "FAIL", "FAIL"],
    ]
    assert faults[0].startswith("FAIL  files of /third  k/enclaves/third/key.pem: ")
    assert faults[1:] == [
        f"  hint: {RESTORE}",
        "  so no handshake of /third can succeed",
    ]
    assert LAST.fullmatch(last).groups() == ("3", "3", "1", "2", "0", "0")


def test_a_broken_participant_is_told_as_json(pqsec, broken):
    said = pqsec(f"{ALL} --json")
    assert said.code == 1
    told = said.json
    assert told["ok"] is False
    [fault] = told["participants"][2]["faults"]
    assert (fault["as"], fault["step"]) == ("pqsec", "files of /third")
    assert (
        fault["hint"]
        == "restore it from a backup, or reissue it: `pqsec renew /third` keeps its permissions"
    )
    for each in told["pairs"]:
        assert each["ok"] == ("/third" not in each["pair"])
        if not each["ok"]:
            assert (each["step"], each["cause"]) == (fault["step"], fault["cause"])
            assert each["initiator"] is each["milliseconds"] is None


def test_pairs_that_fail_are_told_under_their_cause(pqsec, keystore):
    """One way round Fast DDS initiates, which Cyclone DDS refuses."""
    keystore()
    pqsec("-k k issue /third --publish x").done()
    said = pqsec(f"{ALL} --as cyclonedds --as fastdds")
    assert said.code == 1
    matrix, fault, (last,) = (part.splitlines() for part in said.out.split("\n\n"))
    assert matrix[-1] == "a row behaves as Cyclone DDS, a column as Fast DDS"
    cells = [cell for line in matrix[1:4] for cell in line.split()[2:]]
    assert sorted(cells) == ["FAIL"] * 3 + ["met"] * 2 + ["ok"]
    assert fault[0].startswith("FAIL  reply  Cyclone DDS (the replier) refuses: ")
    assert fault[1].startswith("  hint: Fast DDS and Cyclone DDS understand each other only where")
    pairs = [(one, each) for line in fault[2:] for one, each in told_pairs(line)]
    assert len(set(pairs)) == 3
    assert all(one != other for one, other in pairs)
    assert LAST.fullmatch(last).groups() == ("3", "6", "3", "3", "0", "2")


def told_pairs(line):
    initiator, others = line.strip().split(" to ")
    return [(initiator, other) for other in others.split(", ")]


def test_one_pair_that_fails_is_told_in_its_own_words(pqsec, keystore):
    keystore("transition")
    said = pqsec(f"{ALL} --as fastdds-3.1 --as fastdds-3.1")
    assert said.code == 1
    assert "\nFAIL  request  Fast DDS 3.1 (/talker) refuses: a message of 1" in said.out
    assert "\n  /talker to /listener\n" in said.out


def test_a_stack_that_takes_no_such_keys_is_told_once(pqsec, keystore):
    keystore("pq")
    said = pqsec(f"{ALL} --as opendds")
    assert said.code == 1
    _, fault, (last,) = (part.splitlines() for part in said.out.split("\n\n"))
    assert fault[0].startswith("FAIL  identity of NAME  OpenDDS accepts no ml-dsa-65 key of a part")
    assert fault[-1] == "  so no handshake of /listener, /talker as OpenDDS can succeed"
    assert LAST.fullmatch(last).groups() == ("2", "2", "0", "2", "0", "0")


def test_pairs_without_a_common_domain_are_counted_and_not_failed(pqsec, tmp_path):
    pqsec("-k k ca init --no-passphrase --profile classical --domain 0-3").done()
    pqsec("-k k issue /a /b --publish x --domain 1").done()
    pqsec("-k k issue /c --publish x --domain 3").done()
    said = pqsec(ALL).done()
    cells = [line.split()[2:] for line in said.out.splitlines()[1:4]]
    assert cells == [["met", "-"], ["met", "-"], ["-", "-"]]
    assert LAST.fullmatch(said.out.splitlines()[-1]).groups() == ("3", "3", "1", "0", "2", "1")
    said = pqsec(f"{ALL} --json").done().json
    assert [(each["pair"], each["domain"]) for each in said["pairs"]] == [(["/a", "/b"], 1)]
    assert [each["domains"] for each in said["participants"]] == [[1], [1], [3]]


@pytest.mark.parametrize(("options", "what"), [("", "a domain"), ("--domain 1", "domain 1")])
def test_where_no_two_share_a_domain_the_answer_is_no(pqsec, options, what):
    pqsec("-k k ca init --no-passphrase --profile classical --domain 0-3").done()
    pqsec("-k k issue /a --publish x --domain 1").done()
    pqsec("-k k issue /b --publish x --domain 3").done()
    said = pqsec(f"{ALL} {options}")
    assert said.code == 1
    assert f"\nNo two participants share {what}.\n" in said.out
    assert pqsec(f"{ALL} {options} --json").code == 1


@pytest.mark.parametrize(("names", "count"), [("", "0"), ("/a", "1")])
def test_less_than_two_participants_are_no_pair(pqsec, names, count):
    pqsec("-k k ca init --no-passphrase --profile classical").done()
    if names:
        pqsec(f"-k k issue {names} --publish x").done()
    said = pqsec(ALL)
    said.refused(3, f"k has {count} participants", hint="pqsec issue NAME NAME")


def test_messages_of_the_second_version_are_a_third_shorter(pqsec, keystore):
    keystore("pq")
    first, second = (
        sum(pqsec(f"{TWO} --json {more}").done().json["token_bytes"].values())
        for more in ("", "--wire-version 2")
    )
    assert second < 0.72 * first
    assert "\nver: 1 bytes" in pqsec(f"{TWO} --wire-version 2 --trace -").done().out


def test_all_pairs_can_have_messages_of_the_second_version(pqsec, keystore):
    keystore("pq")
    said = pqsec(f"{ALL} --wire-version 2 --json").done().json
    assert (said["ok"], len(said["pairs"])) == (True, 1)


def test_the_second_version_is_not_for_stacks_own_plugins(pqsec, keystore):
    keystore("transition")
    for options in ("/talker /listener --as cyclonedds", "--all --as fastdds"):
        pqsec(f"-k k verify-handshake {options} --wire-version 2").refused(2, "version 1 only")


def test_documents_that_the_second_version_cannot_carry_fail_a_step(pqsec, keystore, monkeypatch):
    keystore("pq")
    monkeypatch.setattr(compact, "MAX_CREDENTIALS", 1000)
    compact.check_carried.cache_clear()
    pqsec(TWO).done()
    failed = pqsec(f"{TWO} --wire-version 2")
    assert failed.code == 1
    assert "documents of /talker" in failed.out
    assert "version 2 of the messages cannot carry our own documents" in failed.out


def test_another_key_agreement_can_be_tried_by_all(pqsec, keystore):
    keystore("transition")
    said = pqsec(f"{ALL} --kem ecdh-p256").done()
    assert "breaks what profile transition promises" in said.err
    pqsec(f"{ALL} --kem no").refused(2, "no key agreement named 'no'")


def test_a_matrix_is_for_twenty(pqsec, keystore):
    keystore()
    pqsec("-k k issue --publish x", *(f"/n{number}" for number in range(18))).done()
    assert len(pqsec(ALL).done().out.splitlines()) == 21 + 1 + 2
    pqsec("-k k issue --publish x /n18").done()
    [last] = pqsec(ALL).done().out.splitlines()
    assert LAST.fullmatch(last).groups() == ("21", "210", "210", "0", "0", "209")


def test_processes_change_nothing_in_the_result(pqsec, keystore):
    keystore()
    pqsec("-k k issue --publish x", *(f"/n{number}" for number in range(12))).done()
    one, two = (pqsec(f"{ALL} --json --jobs {jobs}").done().json for jobs in (1, 2))
    for told in (one, two):
        del told["totals"]["seconds"], told["totals"]["handshakes_per_second"]
        for each in told["pairs"]:
            del each["milliseconds"]
    assert one == two
    assert len(one["pairs"]) == 91


def test_a_full_disk_below_all_pairs_is_an_error(tmp_path, keystore):
    keystore()
    command = [sys.executable, "-m", "pqsec_pki", *f"{ALL} --json".split()]
    with Path("/dev/full").open("wb") as full:
        done = subprocess.run(
            command, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, check=False, timeout=60
        )
    assert done.returncode == 3
    [error] = json.loads(done.stderr)["errors"]
    assert error["message"] == "the result cannot be printed: no space left on device"


# --all at a terminal


class Terminal:
    """pqsec at a terminal of its own."""

    def __init__(self, folder, line):
        self._handle, end = pty.openpty()
        command = [sys.executable, *AT_ONCE, *line.split()]
        streams = dict.fromkeys(("stdin", "stdout", "stderr"), end)
        self.process = subprocess.Popen(
            command, cwd=folder, env=clean_environment(), start_new_session=True, **streams
        )
        os.close(end)
        self.said = b""

    def until(self, words):
        """Read until these words came, or the end."""
        give_up = time.monotonic() + 300
        while words not in self.said and time.monotonic() < give_up:
            select.select([self._handle], [], [], 1)
            try:
                self.said += os.read(self._handle, 65536)
            except OSError:  # so Linux ends a terminal
                break

    def press_interrupt(self):
        """As a terminal does it: to all processes of the command."""
        os.killpg(self.process.pid, signal.SIGINT)

    def end(self):
        """The exit code, and all that was said."""
        self.until(b"there is no such word")
        os.close(self._handle)
        return self.process.wait(), self.said.decode()


@pytest.fixture
def terminal():
    """terminal(folder, line) runs that command at a terminal of its own."""
    started = []

    def start(folder, line):
        started.append(Terminal(folder, line))
        return started[-1]

    yield start
    for each in started:
        if each.process.poll() is None:
            os.killpg(each.process.pid, signal.SIGKILL)
            each.process.wait()


def test_at_a_terminal_it_counts_participants_and_pairs(terminal, pqsec, keystore, tmp_path):
    """So many that each count is drawn: a single pair may be done before."""
    keystore()
    pqsec("-k k issue --publish x", *(f"/n{number}" for number in range(10))).done()
    code, said = terminal(tmp_path, ALL).end()
    assert code == 0
    assert " of 12 participants, " in said
    assert " of 66 pairs, " in said


def test_json_at_a_terminal_stays_json(terminal, keystore, tmp_path):
    keystore()
    code, said = terminal(tmp_path, f"{ALL} --json").end()
    assert code == 0
    assert json.loads(visible(said))["ok"] is True


@pytest.fixture(scope="module")
def crowd(run_in, tmp_path_factory):
    """A keystore `k` whose pairs take a while."""
    folder = tmp_path_factory.mktemp("crowd")
    run_in(folder, "-k k ca init --no-passphrase --profile pq").done()
    run_in(folder, "-k k issue --publish x", *(f"/n{number}" for number in range(80))).done()
    return folder


@pytest.mark.parametrize("moment", [b" participants, ", b" pairs, "])
def test_an_interrupt_ends_all_processes_quietly(terminal, crowd, moment):
    before = snapshot(crowd)
    running = terminal(crowd, f"{ALL} --jobs 2")
    running.until(moment)
    workers = two_workers(running.process.pid)
    running.press_interrupt()
    code, said = running.end()
    assert code == 130
    assert said.rstrip().endswith("pqsec: error: interrupted")
    assert "Traceback" not in said
    assert [pid for pid in workers if alive(pid)] == []
    assert snapshot(crowd) == before


@pytest.mark.parametrize("kind", [signal.SIGTERM, signal.SIGKILL])
def test_a_kill_leaves_no_process_behind(terminal, crowd, kind):
    running = terminal(crowd, f"{ALL} --jobs 2")
    running.until(b" pairs, ")
    workers = two_workers(running.process.pid)
    running.process.send_signal(kind)
    code, said = running.end()
    assert code == (143 if kind == signal.SIGTERM else -kind)
    assert "Traceback" not in said
    give_up = time.monotonic() + 120
    while any(map(alive, workers)) and time.monotonic() < give_up:
        time.sleep(0.05)
    assert [pid for pid in workers if alive(pid)] == []


def two_workers(parent):
    """The two processes that a process has for its work."""
    lists = [*Path(f"/proc/{parent}/task").glob("*/children")]
    give_up = time.monotonic() + 120
    found = []
    while len(found) != 2 and time.monotonic() < give_up:
        pids = [int(pid) for path in lists for pid in path.read_text().split()]
        found = [pid for pid in pids if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    assert len(found) == 2
    return found


def alive(pid):
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


# --matrix


@pytest.fixture(scope="module")
def matrix(run_in, tmp_path_factory):
    """matrix(options) in a folder where there is no keystore, nor one after it."""

    def run(options=""):
        folder = tmp_path_factory.mktemp("matrix")
        said = run_in(folder, f"verify-handshake --matrix --rounds 1 {options}").done()
        assert list(folder.iterdir()) == []
        assert said.err == ""
        return said

    return run


def test_the_matrix_has_a_line_for_each_suite(matrix):
    heads, *lines = matrix().out.split("\n\n")[0].splitlines()
    assert heads.split() == [
        *("profile", "signature", "key", "agreement", "request", "reply", "final"),
        *("fragments", "of", "64", "KB", "ms"),
    ]
    assert len(lines) == len(NAMES) * len(KEY_AGREEMENTS)
    starts = [line[:3].strip() for line in lines]
    assert starts.count("*") == len(NAMES)
    assert "!" in starts
    numbers = re.compile(r" +[0-9]+ +[0-9]+ +[0-9]+  ([0-9]+/){2}[0-9]+ +[0-9.]+% +[0-9.]+$")
    assert [line for line in lines if not numbers.search(line)] == []
    assert len({line.index("%") for line in lines}) == 1  # columns stand in line


def test_the_matrix_says_what_promises_are_broken(matrix):
    notes = matrix().out.split("\n\n")[1]
    assert notes.count("\n!: breaks a promise of ") == len(NAMES)
    assert "breaks a promise of cnsa2: CNSA 2.0: ML-DSA-87 and ML-KEM-1024 only" in notes


def test_the_matrix_is_told_as_json(matrix):
    told = matrix("--json").json
    assert (told["fragment_bytes"], told["rounds"]) == (1344, 1)
    assert len(told["suites"]) == len(NAMES) * len(KEY_AGREEMENTS)
    for suite in told["suites"]:
        largest = max(message["bytes"] for message in suite["messages"].values())
        assert suite["share_of_datagram"] == round(largest / 65507, 4)
        for message in suite["messages"].values():
            assert (message["fragments"] - 1) * 1344 < message["bytes"]
            assert message["bytes"] <= message["fragments"] * 1344


# --trace


def test_a_trace_is_written_beside_the_report(pqsec, keystore, tmp_path):
    keystore("transition")
    said = pqsec(f"{TWO} --trace trace.txt").done()
    assert said.err == ""
    told = (tmp_path / "trace.txt").read_text()
    assert told.startswith(said.out)
    heads = [line for line in told.splitlines() if line.startswith("== ")]
    assert [head.split(", ")[0] for head in heads] == [
        *("== 1. auth request", "== 2. auth request", "== 3. request", "== 4. reply"),
        *("== 5. final", "== 6. message", "== 7. message", "== derived by both sides"),
    ]
    for words in (
        "  | Participant certificate: CN=/talker",
        "  |   alternative key        ml-dsa-65 (post-quantum, NIST level 3)",
        "  | Permissions document, signed",
        "  | ECDSA-SHA256+ML-DSA-65, and a NUL",
        "    mlkem768 ciphertext: 1088 bytes",
        "    ml-dsa-65: 3309 bytes",
        "    (withheld: --insecure-show-secrets shows it)",
    ):
        assert f"\n{words}\n" in told
    assert max(map(len, told.splitlines())) < 300


def test_a_trace_in_json_has_every_byte(pqsec, keystore, tmp_path):
    keystore("pq")
    report = pqsec(f"{TWO} --trace t --json").done().json
    told = json.loads((tmp_path / "t").read_text())
    assert told["version"] == 1
    assert told["report"] == report
    names = [message["name"] for message in told["messages"]]
    assert names == ["auth request"] * 2 + ["request", "reply", "final"] + ["message"] * 2
    for message in told["messages"]:
        assert len(bytes.fromhex(message["sample"])) == message["bytes"]
        for piece in message["pieces"]:
            assert len(bytes.fromhex(piece["hex"])) == piece["bytes"]
            assert piece["hex"] in message["sample"]
    hidden = [each["name"] for each in told["derived"] if each["hex"] is None]
    assert hidden[:3] == ["SharedSecret", "key exchange salt", "key exchange key"]
    assert hidden == [each["name"] for each in told["derived"] if each.get("secret")]


def test_a_dash_is_stdout(pqsec, keystore, tmp_path):
    keystore()
    said = pqsec(f"{TWO} --trace -").done()
    assert "\n== 1. auth request, /talker to /listener, 232 bytes\n" in said.out
    told = pqsec(f"{TWO} --trace - --json").done().json
    assert told["report"]["ok"] is True
    assert not (tmp_path / "-").exists()


@pytest.mark.parametrize("options", ["", "--json"])
@pytest.mark.parametrize("secrets", [False, True])
def test_a_trace_with_secrets_is_for_its_owner_only(pqsec, keystore, tmp_path, options, secrets):
    keystore()
    option = f"{options} --insecure-show-secrets" if secrets else options
    old = os.umask(0)
    try:
        pqsec(f"{TWO} --trace t {option}").done()
    finally:
        os.umask(old)
    path = tmp_path / "t"
    assert path.stat().st_mode & 0o777 == (0o600 if secrets else 0o644)
    assert ("withheld" in path.read_text() or '"hex": null' in path.read_text()) != secrets


def test_a_trace_that_is_there_stays_unless_forced(pqsec, keystore, tmp_path):
    keystore()
    path = tmp_path / "t"
    path.write_text("precious")
    pqsec(f"{TWO} --trace t").refused(3, "t exists", hint="--force")
    assert path.read_text() == "precious"
    pqsec(f"{TWO} --trace t --force --insecure-show-secrets").done()
    assert path.stat().st_mode & 0o777 == 0o600
    assert "== 3. request" in path.read_text()


def test_a_trace_that_is_there_is_seen_before_any_work_is_done(pqsec, keystore, tmp_path):
    shutil.rmtree(keystore() / "enclaves")
    (tmp_path / "t").touch()
    pqsec(f"{TWO} --trace t").refused(3, "t exists")
    pqsec(f"{TWO} --trace t --force").refused(3, "there is no participant /talker")


def test_a_trace_into_no_folder_is_refused_and_leaves_nothing(pqsec, keystore, tmp_path):
    before = snapshot(keystore())
    pqsec(f"{TWO} --trace no/t").refused(3, "no/t: no such file or directory")
    assert [path.name for path in tmp_path.iterdir()] == ["k"]
    assert snapshot(tmp_path / "k") == before


def test_a_handshake_that_fails_is_traced_up_to_there(pqsec, keystore, tmp_path):
    keystore()
    said = pqsec(f"{TWO} --as fastdds --as cyclonedds --trace t")
    assert said.code == 1
    assert "They would not meet: reply failed." in said.out
    told = (tmp_path / "t").read_text()
    assert told.startswith(said.out)
    assert [line for line in told.splitlines() if line.startswith("== ")][-1].startswith(
        "== 2. request, /talker to /listener, "
    )
    assert "derived" not in told


def test_a_handshake_that_never_began_is_traced_as_its_report(pqsec, keystore, tmp_path):
    keystore()
    said = pqsec(f"{TWO} --domain 7 --trace t --json")
    assert said.code == 1
    told = json.loads((tmp_path / "t").read_text())
    assert told == {"version": 1, "report": said.json, "messages": [], "derived": []}
