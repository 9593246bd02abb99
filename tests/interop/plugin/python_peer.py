"""A participant of Cyclone DDS in Python, as the peer of `pqsec try` is one in C.

usage: python_peer.py send|receive|visit|fall DOMAIN TOPIC TEXT SECONDS

`send` and `receive` say what that peer says. `visit` makes and deletes as many participants as
TEXT says, each after a little longer, the last after SECONDS; a listener is called in Python from
Cyclone's threads meanwhile. `fall` sends and ends by an exception after SECONDS.
"""

import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Listener
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic

PAUSE = 0.005
QOS = Qos(Policy.Reliability.Reliable(max_blocking_time=10**9), Policy.Durability.TransientLocal)


@dataclass
@final
class Sample(IdlStruct, typename="pqsec.Sample"):
    text: str


class Told(Listener):
    """Says once that the writer has a reader."""

    matched = False

    def on_publication_matched(self, writer, status):
        if not self.matched and status.current_count > 0:
            self.matched = True
            print("matched", flush=True)


def joined(domain: int, topic: str):
    """A participant and its topic."""
    participant = DomainParticipant(domain)
    print("joined", flush=True)
    return participant, Topic(participant, topic, Sample)


def write(writer: DataWriter, text: str, seconds: float) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        writer.write(Sample(text))
        time.sleep(PAUSE)


def send(domain: int, topic: str, text: str, seconds: float) -> None:
    participant, named = joined(domain, topic)
    write(DataWriter(participant, named, qos=QOS, listener=Told()), text, seconds)


def receive(domain: int, topic: str, _: str, seconds: float) -> None:
    participant, named = joined(domain, topic)
    reader = DataReader(participant, named, qos=QOS)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        for sample in reader.take():
            print(f"received {sample.text}", flush=True)
            return
        time.sleep(PAUSE)


def visit(domain: int, topic: str, count: str, seconds: float) -> None:
    for number in range(int(count)):
        send(domain, topic, "visit", seconds * number / int(count))
    print("home", flush=True)


def fall(domain: int, topic: str, text: str, seconds: float) -> None:
    """Without a listener: called in Python while the interpreter ends, one hangs without any
    plugin too."""
    participant, named = joined(domain, topic)
    writer = DataWriter(participant, named, qos=QOS)
    write(writer, text, seconds)
    raise RuntimeError("over", participant, named, writer)


act, domain, topic, text, seconds = sys.argv[1:]
{"send": send, "receive": receive, "visit": visit, "fall": fall}[act](
    int(domain), topic, text, float(seconds)
)
