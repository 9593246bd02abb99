"""What an agent's memory does in a flood of forged Requests, and when hosts come and go.

Each number is a ratio to what the same agent had before. Run: python bench/agent_memory.py
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from itertools import combinations
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))  # tests/ has the shim's side of the socket

from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import DomainSet
from pqsec_pki.errors import PqsecError
from pqsec_pki.handshake import DataHolder, adjusted_guid, participant_data
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.plugin import AgentFolder, agent_status
from pqsec_pki.plugin.authentication import NO_TOKEN
from pqsec_pki.plugin.control import Client
from tests.unit.plugin_wire import IDENTITY, new_guid, properties

FORGED, SIZE, HOSTS, ROUNDS = 1100, 240_000, 16, 3
DAY = timedelta(days=1)

Side = tuple[Client, int, bytes]


def enclaves(root: Path) -> list[Path]:
    now, names = datetime.now(UTC), [f"/host{number}" for number in range(HOSTS)]
    domains = DomainSet.parse("0")
    store = Keystore.create(
        root,
        profile_named("pq"),
        name="Bench",
        domains=domains,
        validity=900 * DAY,
        passphrase=None,
        now=now,
    )
    specs = [
        ParticipantSpec(name=name, domains=domains, publish=("x",), validity=90 * DAY)
        for name in names
    ]
    issue(store, store.unlock(None), specs, now=now)
    return [root / f"enclaves{name}" for name in names]


@contextmanager
def agent(folder: Path) -> Iterator[AgentFolder]:
    folder.mkdir(mode=0o700)
    place = AgentFolder(folder / "agent.sock")
    command = [sys.executable, "-I", "-m", "pqsec_pki.plugin", str(place.socket)]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
    while not agent_status(place):
        time.sleep(0.02)
    try:
        yield place
    finally:
        process.terminate()
        process.wait()


def megabytes(place: AgentFolder) -> float:
    """Of the agent and its workers; what they share is counted once."""
    status = agent_status(place)
    return sum(map(proportional, (status.process, *status.workers))) if status else 0.0


def proportional(process: int) -> float:
    lines = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024


def joined(place: AgentFolder, enclave: Path) -> Side:
    client = Client(place, "authentication")
    pairs, where = properties(enclave)
    _, (own, guid, *_) = client.call("validate_local_identity", 0, where, pairs, new_guid())
    return client, own, guid


def shake_hands(*sides: Side) -> None:
    (one, own, guid), (other, theirs, peers) = sorted(sides, key=lambda side: side[2])
    _, (seen, asks) = other.call("validate_remote_identity", NO_TOKEN, theirs, IDENTITY, guid)
    _, (known, _) = one.call("validate_remote_identity", asks, own, IDENTITY, peers)
    data = [participant_data(each) for each in (guid, peers)]
    _, (begun, token) = one.call("begin_handshake_request", own, known, data[0])
    _, (waits, token) = other.call("begin_handshake_reply", token, seen, theirs, data[1])
    _, (token,) = one.call("process_handshake", token, begun)
    other.call("process_handshake", token, waits)


def flood(victim: Side, heard: DataHolder, subject: bytes) -> None:
    client, own, guid = victim
    for _ in range(FORGED):
        fake = adjusted_guid(subject, new_guid())
        _, (peer, _) = client.call("validate_remote_identity", NO_TOKEN, own, IDENTITY, fake)
        items = dict(heard.binary_properties)
        items |= {"c.perm": os.urandom(SIZE), "c.pdata": participant_data(fake)}
        del items["hash_c1"]
        token = DataHolder(heard.class_id, (), tuple(items.items()))
        try:
            client.call("begin_handshake_reply", token, peer, own, participant_data(guid))
        except PqsecError:
            continue


def flooded(place: AgentFolder, folders: list[Path]) -> None:
    victim, talker, eve = (joined(place, folder) for folder in folders[:3])
    shake_hands(victim, talker)
    _, (peer, _) = eve[0].call("validate_remote_identity", NO_TOKEN, eve[1], IDENTITY, victim[2])
    data = participant_data(eve[2])
    _, (_, heard) = eve[0].call("begin_handshake_request", eve[1], peer, data)
    before = megabytes(place)
    flood(victim, heard, Certificate.from_pem((folders[2] / "cert.pem").read_bytes()).subject_der)
    during = megabytes(place)
    shake_hands(victim, talker)
    for client, *_ in (victim, talker, eve):
        client.close()
    time.sleep(1)
    print(f"{FORGED} forged Requests of {SIZE // 1000} kB: {before:.0f} MB before")
    print(f"  in the flood {during / before:.2f} x, {during - before:+.0f} MB")
    print(f"  when all have gone {megabytes(place) / before:.2f} x")


def crowded(place: AgentFolder, folders: list[Path]) -> None:
    before = 0.0
    for number in range(ROUNDS):
        sides = [joined(place, folder) for folder in folders]
        for pair in combinations(sides, 2):
            shake_hands(*pair)
        full = megabytes(place)
        for client, *_ in sides:
            client.close()
        time.sleep(1)
        after = megabytes(place)
        before = before or after
        print(
            f"{HOSTS} hosts that all meet, time {number + 1}: {full / before:.2f} x,"
            f" and {after / before:.2f} x when they have gone"
        )


def main() -> None:
    with tempfile.TemporaryDirectory(prefix="pqsec-") as name:
        folders = enclaves(Path(name, "keystore"))
        for measure in (flooded, crowded):
            with agent(Path(name, measure.__name__)) as place:
                measure(place, folders)


if __name__ == "__main__":
    main()
