"""`pqsec bench --stack`: hosts of real stacks, each in a network namespace of its own."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from io import StringIO

import pytest

from pqsec_pki.trial import STACKS, MissingStackError, SegmentError, find, refuse_without_hosts

pytestmark = pytest.mark.interop

BENCH = [sys.executable, "-m", "pqsec_pki", "bench"]
LOSSY = ["--profile", "pq", "--hosts", "3", "--loss", "5%", "--mtu", "576", "--rounds", "1"]


@pytest.fixture(params=STACKS)
def stack(request, requires) -> str:
    """A stack, on a machine that may have network namespaces."""
    found = None
    with suppress(MissingStackError, SegmentError):
        found = find(request.param)
        refuse_without_hosts()
    requires(found, f"{request.param} to compile against, and root", "see `pqsec bench --help`")
    return str(request.param)


def bench(*words, **environment):
    return subprocess.run(
        [*BENCH, *words],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
def test_three_hosts_meet_where_frames_get_lost(stack):
    done = bench("--stack", stack, *LOSSY, "--timeout", "240", "--samples", "5", "--json")
    assert done.returncode == 0, done.stderr
    value = json.loads(done.stdout)
    [run] = value["runs"]
    assert (value["complete"], value["stack"], run["complete"]) == (True, stack, 3), done.stderr
    assert [len(each) for each in run["met_s"]] == [2, 2, 2]
    assert all(0 < each <= run["full_s"] for host in run["met_s"] for each in host)
    assert 0 < run["lost"] < run["deliveries"] / 4
    assert run["fragments"] > 0  # a datagram of 1400 bytes does not fit into 576
    assert run["handshake_messages"] == 9
    assert run["agent_cpu_s"] > 0
    assert run["samples_lost"] is not None


@pytest.mark.slow
def test_hosts_send_the_version_of_messages_that_is_asked_for(stack):
    """Of the same participants, the second has fewer bytes; what knows one version has that."""
    words = ["--stack", stack, "--profile", "pq", "--rounds", "1", "--samples", "0", "--json"]
    sent = {1: [], 2: []}
    for _ in range(8):  # hosts on a busy machine repeat messages
        done = bench(*words, "--wire-version", "1", "--wire-version", "2")
        assert done.returncode == 0, done.stderr
        runs = json.loads(done.stdout)["runs"]
        assert [(each["wire_version"], each["complete"]) for each in runs] == [(1, 2), (2, 2)]
        for each in runs:
            sent[each["wire_version"]].append(each["frame_bytes"])
        if min(sent[1]) - min(sent[2]) > 8_000:  # 13 kB of messages
            return
    pytest.fail(f"the second version saves too little: {sent}")


@pytest.mark.slow
def test_without_security_and_without_loss_there_is_no_handshake(stack):
    done = bench("--stack", stack, "--plugins", "none", "--rounds", "2", "--format", "csv")
    rows = list(csv.DictReader(StringIO(done.stdout)))
    values = {row["measure"]: row["value"] for row in rows}
    assert done.returncode == 0, done.stderr
    assert {"environment.processor", "environment.cores", "environment.load"} <= values.keys()
    assert (values["complete"], values["handshake_messages"], values["lost"]) == ("2", "0", "0")
    assert len([row for row in rows if row["measure"] == "met_s"]) == 2 * 2
    assert {row["run"] for row in rows} == {"", "1", "2"}


@pytest.mark.slow(but=1)
def test_hosts_with_other_credentials_than_the_stack_takes_are_refused(stack):
    done = bench("--stack", stack, "--plugins", "stock", "--profile", "pq", "--rounds", "1")
    assert (done.returncode, "for pqsec peers only" in done.stderr) == (1, True), done


@pytest.mark.slow
def test_what_is_measured_before_ctrl_c_is_printed(stack):
    """The first run ends; 9,999 are interrupted."""
    words = ["--stack", stack, "--plugins", "none", "--samples", "0", "--rounds", "10000"]
    with subprocess.Popen(
        [*BENCH, *words, "--json"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        time.sleep(15)
        process.send_signal(signal.SIGINT)
        out, err = process.communicate()
    value = json.loads(out)
    assert (process.returncode, value["complete"]) == (130, False), err
    assert "interrupted" in err
    assert all(run["complete"] == 2 for run in value["runs"])


RIGHTS = {
    "no namespaces": ["setpriv", "--bounding-set=-sys_admin"],
    "no interfaces": ["setpriv", "--bounding-set=-net_admin"],
    "no device": ["unshare", "-m", "sh", "-c", 'mount -B /dev/null /dev/net/tun; exec "$@"', "sh"],
}


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("lack", RIGHTS)
def test_without_its_rights_it_is_refused_before_anything_is_compiled(stack, lack, tmp_path):
    """As in a container, where root may do less."""
    done = subprocess.run(
        [*RIGHTS[lack], *BENCH, "--stack", stack],
        env=os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")},
        capture_output=True,
        text=True,
        check=False,
    )
    words = "/dev/net/tun: " if lack == "no device" else "may not create network namespaces"
    assert (done.returncode, words in done.stderr) == (3, True), done
    assert "unshare --user --map-root-user" in done.stderr
    assert not (tmp_path / "cache").exists()


@pytest.mark.slow(but=1)
def test_without_a_compiler_the_package_is_named(stack, tmp_path):
    done = bench("--stack", stack, PATH=str(tmp_path))
    assert done.returncode == 3
    assert "which the peer is compiled with, is not" in done.stderr
    assert "apt-get install g" in done.stderr
