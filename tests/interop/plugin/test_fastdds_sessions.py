"""A peer in Fast DDS that is revoked, or expires, while samples flow."""

import os
import re
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from datetime import UTC, datetime, timedelta
from functools import cache
from threading import Thread

import pytest

from pqsec_pki.certificates import Reason
from pqsec_pki.lifecycle import ParticipantSpec, issue, renew_list, revoke
from pqsec_pki.plugin import AgentFolder, agent_status
from pqsec_pki.trial import (
    Act,
    Trial,
    credentialed,
    unique_text,
)
from pqsec_pki.trial.building import source
from pqsec_pki.trial.network import alone
from tests.interop.conftest import DOMAINS, LAB_PROFILES, TOPIC, Lab
from tests.interop.plugin.test_plugin_try import AT_ONCE
from tests.interop.roots import ROOTS, compiled
from tests.interop.trials import RECEIVER, SENDER

pytestmark = pytest.mark.interop

PATIENCE = 90.0
LIFETIME = timedelta(seconds=20)
QUIET = 4.0
"""Seconds without a sample; there are twenty a second, and a peer announces itself every three."""
LEASE = 25.0
"""Seconds after which Fast DDS drops a peer that it no longer hears of."""


def revoke_it(lab: Lab) -> None:
    revoke(lab.keystore, lab.authorities, [SENDER], reason=Reason.KEY_COMPROMISE, now=lab.now)


def let_it_expire(lab: Lab) -> None:
    """It was issued for a short time only."""


HOW = {"revoked": (revoke_it, "it was revoked"), "expired": (let_it_expire, "permissions expired")}
CASES = [(where, how) for where in ROOTS for how in HOW]
MIXED = ("bookworm", "trixie")


class Heard:
    """What a process says, as it says it."""

    def __init__(self, process: subprocess.Popen) -> None:
        self.lines: list[str] = []
        self.last = time.monotonic()
        self._process = process
        self._thread = Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        for line in iter(self._process.stdout.readline, ""):
            self.lines.append(line)
            if line.startswith("received"):
                self.last = time.monotonic()

    def wait(self) -> None:
        """Until it has ended."""
        self._thread.join()

    def says(self, words: str) -> bool:
        return any(words in line for line in [*self.lines])

    @property
    def is_quiet(self) -> bool:
        return time.monotonic() - self.last > QUIET


def wait(condition: Callable[[], bool], seconds: float = PATIENCE) -> bool:
    end = time.monotonic() + seconds
    while not (met := condition()) and time.monotonic() < end:
        time.sleep(0.05)
    return met


@pytest.fixture(scope="module")
def lasting(stack_in) -> Iterator[Callable[[str], list[str]]]:
    """lasting("trixie") is the command of a peer that receives until its time is over."""
    text = source("fastdds.cpp")
    line = b'      say("received " + text);\n'
    once = line + b"      return;\n"
    assert once in text
    sources = {"fastdds.cpp": text.replace(once, line)}
    with ExitStack() as stack:
        yield cache(
            lambda where: stack.enter_context(compiled(stack_in("fastdds", where), sources))
        )


@pytest.fixture(scope="module")
def session(stack_in, plugin_for, lasting, tmp_path_factory):
    """session(where, sending, change, until) is what a receiver heard of a sender until then."""

    def run(where, sending, how, during):
        now = datetime.now(UTC)
        folder = tmp_path_factory.mktemp("session")
        lab = Lab.create(folder / "lab", LAB_PROFILES["pq"], now)
        renew_list(lab.keystore, lab.authorities, now=now)
        if how == "expired":
            spec = ParticipantSpec(
                name=SENDER, publish=(TOPIC,), domains=DOMAINS, validity=LIFETIME
            )
            issue(lab.keystore, lab.authorities, [spec], now=now, force=True)
        (lab.keystore.root / f"enclaves{SENDER}" / "crl.pem").unlink()  # it knows nothing
        commands = []
        for name, act, place in ((SENDER, Act.SEND, sending), (RECEIVER, Act.RECEIVE, where)):
            trial = Trial(
                installation=stack_in("fastdds", place),
                keystore=lab.keystore,
                timeout=PATIENCE,
                plugin=plugin_for(place),
                anyway=True,  # the sender lacks the list, which an export refuses
                now=now,
            )
            text = unique_text() if act is Act.SEND else ""
            role = credentialed(trial, name, act, folder, text)
            words = [*lasting(place), act.value, "5", TOPIC, text, str(2 * PATIENCE)]
            commands.append((words, role.environment))
        return alone(lambda network: _watch(commands, lambda heard: during(lab, heard)))

    for each in ROOTS:
        plugin_for(each)
        lasting(each)
    return run


def _watch(commands, during):
    with ExitStack() as stack:
        processes = []
        for words, environment in commands:
            process = subprocess.Popen(
                words, env=os.environ | dict(environment), text=True,
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            )  # fmt: skip
            stack.enter_context(process)
            stack.callback(process.kill)
            processes.append(process)
        heard = [Heard(process) for process in processes]
        stack.callback(lambda: [each.wait() for each in heard])
        stack.callback(lambda: [each.kill() for each in processes])
        with suppress(AssertionError):
            assert wait(lambda: heard[1].says("received"))
            during(heard[1])
        assert [process.poll() for process in processes] == [None, None]
        return heard[1]


@pytest.fixture(scope="module")
def parted(session) -> Iterator[Callable[[str, str], Heard]]:
    def until_parted(lab: Lab, heard: Heard, how: str) -> None:
        HOW[how][0](lab)
        assert wait(lambda: heard.says("a peer is disconnected") and heard.is_quiet)

    with ThreadPoolExecutor(AT_ONCE) as pool:
        began = {
            (where, how): pool.submit(
                session,
                where,
                where,
                how,
                lambda lab, heard, how=how: until_parted(lab, heard, how),
            )
            for where, how in CASES
        }
        yield lambda *case: began[case].result()


@pytest.mark.slow
@pytest.mark.parametrize(("where", "how"), CASES)
def test_a_peer_that_may_no_longer_take_part_is_disconnected(parted, where, how):
    """Both processes live on, and what the peer sends is not received."""
    heard = parted(where, how)
    log = "".join(heard.lines)
    assert heard.says("received"), log
    assert heard.says(f"a peer is disconnected: {'its identity or ' if how == 'expired' else ''}"
                      f"{HOW[how][1]}"), log  # fmt: skip
    assert heard.is_quiet, log
    after = log.partition("a peer is disconnected")[2]
    assert len(re.findall("received", after)) < 5


@pytest.mark.slow
@pytest.mark.parametrize("receiving", MIXED)
def test_peers_of_two_versions_stay_connected(session, receiving):
    """Also where one never announces itself on the protected topic."""
    sending = next(each for each in MIXED if each != receiving)
    ends = []

    def during(lab, heard):
        ends.append(wait(lambda: heard.is_quiet, LEASE))

    heard = session(receiving, sending, "", during)
    assert ends == [False], "".join(heard.lines)


@pytest.mark.slow
@pytest.mark.parametrize("where", ROOTS)
def test_a_participant_announces_itself_also_while_the_agent_does_not_answer(
    session, plugin_for, monkeypatch, where
):
    """Who waits for the list of the revoked is not the thread that announces."""
    monkeypatch.setenv("PQSEC_AGENT_TIMEOUT", "120000")
    ends = []

    def during(lab, heard):
        workers = agent_status(AgentFolder.of(plugin_for(where).environment)).workers
        assert workers
        for each in workers:
            os.kill(each, signal.SIGSTOP)
        try:
            ends.append(wait(lambda: heard.is_quiet, 2 * LEASE))
        finally:
            for each in workers:
                os.kill(each, signal.SIGCONT)

    heard = session(where, where, "", during)
    assert ends == [False], "".join(heard.lines)
