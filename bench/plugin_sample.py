"""How long a first sample takes in three stacks with the plugin, against their own in the same run.

Real processes on the loopback, started together: each loads its credentials, finds the other,
shakes hands and matches, and then the reader gets a sample. Medians of rounds in turn. It takes
what `pqsec try` does; OpenDDS is among them if PQSEC_OPENDDS_ROOT names a build of it (ACE_ROOT and
TAO_ROOT as for the build).
"""

import os
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from datetime import UTC, datetime
from pathlib import Path

from pqsec_pki.keystore import Keystore
from pqsec_pki.plugin import AgentFolder, stop_agent
from pqsec_pki.stacks import Stack
from pqsec_pki.trial import MissingStackError, TopicRoute, Trial, find, plugin, run_trial
from pqsec_pki.vendors.fastdds_adapter import here
from pqsec_pki.vendors.opendds_adapter import install_opendds
from pqsec_pki.vendors.opendds_library import find_opendds
from tests.interop.plugin.test_opendds import SECONDS, VARIABLE, Build, met, words_of

TOPIC = "Square"
OWN = "its own"
"""The stack's own plugins, which know only classical keys."""
PROFILES = ("classical", "transition", "hybrid", "pq")
TIMEOUT = 60.0
CASES = (OWN, *PROFILES)
Meeting = Callable[[str], float]
"""Seconds that two participants take in one of CASES: in a profile with our plugin, or OWN."""


def profile_of(case: str) -> str:
    return "classical" if case == OWN else case


def pqsec(*words: object) -> None:
    command = [sys.executable, "-m", "pqsec_pki", *map(str, words)]
    subprocess.run(command, check=True, capture_output=True)


def keystore(folder: Path, profile: str) -> Path:
    """Two participants, in a domain that all three stacks can join."""
    root = folder / profile
    pqsec("-k", root, "ca", "init", "--profile", profile, "--no-passphrase")
    governance = root / "enclaves/governance.xml"
    text = governance.read_text()
    # OpenDDS cannot protect RTPS messages, and joins no domain where all is under access control.
    for kind, value in {
        "rtps_protection_kind": "NONE",
        "enable_join_access_control": "false",
    }.items():
        text = re.sub(f"<{kind}>.*</{kind}>", f"<{kind}>{value}</{kind}>", text)
    governance.write_text(text)
    pqsec("-k", root, "sign-governance", governance, "--force")
    pqsec("-k", root, "issue", "/alice", "--publish", TOPIC)
    pqsec("-k", root, "issue", "/bob", "--subscribe", TOPIC)
    return root


@contextmanager
def tried(stack: Stack, folder: Path) -> Iterator[Meeting]:
    """A stack that `pqsec try` runs."""
    installation = find(stack)
    route = TopicRoute(sender="/alice", receiver="/bob", domain=0, topic=TOPIC)
    with plugin(fastdds=installation if stack is Stack.FASTDDS else None) as ours:

        def meet(case: str) -> float:
            report = run_trial(
                Trial(
                    installation=installation,
                    keystore=Keystore.open(folder / profile_of(case)),
                    timeout=TIMEOUT,
                    plugin=None if case == OWN else ours,
                    now=datetime.now(UTC),
                ),
                route,
            )
            if not report.accepted:
                raise SystemExit(f"{stack}, {case}: {report.findings}")
            return report.trial_run.seconds

        yield meet


@contextmanager
def opendds(root: Path, folder: Path) -> Iterator[Meeting]:
    """A build of OpenDDS. Its participants share an agent, as on a robot."""
    place = folder / "opendds"
    place.mkdir()
    build = Build(find_opendds(root, os.environ), folder / "plugin", place)
    install_opendds(build.stack, build.plugin, here())
    program = build.program("peer")

    def meet(case: str) -> float:
        words = []
        for name, act in (("alice", "send"), ("bob", "receive")):
            there = folder / f"{case}-{name}"
            if not there.exists():
                ours = () if case == OWN else ("--plugin", "--plugins", build.plugin)
                export = ("export", "opendds", f"/{name}", *ours, "--anyway", "-o", there)
                pqsec("-k", folder / profile_of(case), *export)
            words.append(words_of(program, there, act, TOPIC, SECONDS))
        begin = time.monotonic()
        _, receiver = met(build, *words, ours=(case != OWN, case != OWN))
        if not receiver.heard:
            raise SystemExit(f"OpenDDS, {case}: {receiver.log}")
        return time.monotonic() - begin

    try:
        yield meet
    finally:
        stop_agent(AgentFolder.of(os.environ))


def measured(meet: Meeting, rounds: int) -> dict[str, list[float]]:
    """Seconds of each round: of the stack's own plugins, and of each profile with ours."""
    taken: dict[str, list[float]] = {case: [] for case in CASES}
    for case in CASES:  # once not counted: programs are compiled, files read
        meet(case)
    for _ in range(rounds):
        for case, found in taken.items():
            found.append(meet(case))
    return taken


def stacks(folder: Path) -> Iterator[tuple[str, Meeting]]:
    """Those that are on this machine."""
    for each in (Stack.CYCLONEDDS, Stack.FASTDDS):
        try:
            installation = find(each)
        except MissingStackError as error:
            print(f"{each}: {error}")
            continue
        with tried(each, folder) as meet:
            yield installation.title, meet
    root = os.environ.get(VARIABLE)
    with opendds(Path(root), folder) if root else nullcontext() as meet:
        if meet:
            yield "OpenDDS", meet
        else:
            print(f"OpenDDS: {VARIABLE} names no build of it")


def measure(rounds: int) -> None:
    with tempfile.TemporaryDirectory(prefix="pqsec-") as name:
        folder, os.environ["XDG_RUNTIME_DIR"] = Path(name), name
        for profile in PROFILES:
            keystore(folder, profile)
        print(("{:<22} " + "{:>16} " * 5).format("stack", *CASES))
        for title, meet in stacks(folder):
            medians = [statistics.median(each) for each in measured(meet, rounds).values()]
            cells = [f"{each:6.2f} s ({each / medians[0]:4.2f} x)" for each in medians]
            print(("{:<22} " + "{:>16} " * 5).format(title, *cells), flush=True)
    print("seconds from the start of both processes to the first sample; in brackets, against the")
    print("stack's own plugins with classical keys")
