"""Reads a trace of Cyclone DDS with the category `discovery`, as versions 0.9 to 11 write it.

    TIME [DOMAIN]     THREAD: PARTICIPANT GUID QOS={...}     the process that writes the trace
    TIME [DOMAIN]     THREAD: WRITER GUID QOS={...}          or READER
    TIME [DOMAIN] dq.builtin: SPDP ST0 GUID ... QOS={...}    other participants, of any stack
    TIME [DOMAIN] dq.builtin: SEDP ST0 GUID ... QOS={...}    their endpoints

THREAD has ten characters, GUID is four numbers in hex. Other lines are not needed. Cyclone DDS
does not escape names; so a name with a quote cannot be read, and neither can a line that
Cyclone DDS cut, for want of space.
"""

import re
from collections.abc import Iterator
from dataclasses import field

from pqsec_pki._dataclass import dataclass
from pqsec_pki.access import Action
from pqsec_pki.errors import MalformedError
from pqsec_pki.learning._discovered import (
    ACTIONS,
    DiscoveredParticipant,
    domain_in,
    enclave_in,
    endpoint,
)
from pqsec_pki.learning.seen import Endpoint, SeenParticipant

IS_LINE = re.compile(r"\s*\d+\.\d{6} \[(\d*)\] .{10}: ?(.*)", re.ASCII)
"""Groups: the domain, which some lines do not have, and the message."""
_GUID = r"(?P<guid>[0-9a-f]+:[0-9a-f]+:[0-9a-f]+):(?P<entity>[0-9a-f]+)\b"
_QOS = r"(?>.*?QOS=\{)(?P<qos>.*)\}"
"""Atomic: in a crafted line, each further `QOS={` would else be another way to read all of it."""
_ABOUT_PARTICIPANT = re.compile(rf"(?:PARTICIPANT|SPDP ST0) {_GUID}{_QOS}")
_ABOUT_ENDPOINT = re.compile(rf"(?:WRITER|READER|SEDP ST0) {_GUID}{_QOS}")
_KINDS = (
    (re.compile(r"PARTICIPANT .*QOS=|SPDP ST0 .* NEW"), _ABOUT_PARTICIPANT),
    (re.compile(r"(?:WRITER|READER) \S+ QOS=|SEDP ST0 .*(?: NEW|QOS=)"), _ABOUT_ENDPOINT),
)
"""Which lines are needed, and what they must be in full."""

_OF_THE_PROCESS = ("__BUILT-IN PARTITION__",)
"""The partitions of readers of Cyclone DDS's own topics, which are not on the network."""
_USER_DATA = re.compile(r"user_data=\d+<")
_OCTETS = re.compile(r'"([^"]*)"|(\d{1,3})')
_ENTITY_NAME = re.compile(r'\bentity_name="([^"]*)"')
_PROCESS = re.compile(r'"__ProcessName":"([^"]*)"')
_TOPIC = re.compile(r'(?:\A|,)topic_name="([^"]+)",type_name="')
_PARTITIONS = re.compile(r'\bpartition=\{((?:"[^"]*"(?:,"[^"]*")*)?)\}')


@dataclass(slots=True)
class CycloneTrace:
    """The participants that the lines so far show."""

    _found: dict[str, DiscoveredParticipant] = field(default_factory=dict)
    """Participants by the prefix of their GUIDs."""
    needed: int = 0
    """Lines about participants and endpoints so far."""

    def add(self, line: str) -> None:
        """Read one line. MalformedError, with the reason, if it cannot be read."""
        whole = IS_LINE.fullmatch(line)
        if whole is None:
            raise MalformedError("not a line of a Cyclone DDS trace")
        for needed, form in _KINDS:
            if needed.match(whole[2]):
                self.needed += 1
                self._add(form, whole[1], whole[2])

    def _add(self, form: re.Pattern[str], domain: str, message: str) -> None:
        found = form.fullmatch(message)
        if found is None:
            raise MalformedError("the line is cut, or has a form that pqsec does not know")
        if form is _ABOUT_PARTICIPANT:
            participant = self._participant(found)
            participant.label = _label(found["qos"]) or participant.label
            participant.enclave = _enclave(found["qos"]) or participant.enclave
        elif action := ACTIONS.get(int(found["entity"][-2:], 16)):
            seen = _endpoint(domain_in(domain), action, found["qos"])
            if seen.partitions != _OF_THE_PROCESS:
                self._participant(found).endpoints[seen] = None

    def _participant(self, found: re.Match[str]) -> DiscoveredParticipant:
        return self._found.setdefault(found["guid"], DiscoveredParticipant())

    def participants(self) -> list[SeenParticipant]:
        """In the order of their first lines."""
        return [each.seen() for each in self._found.values()]


def _endpoint(domain: int, action: Action, qos: str) -> Endpoint:
    topic, partitions = _TOPIC.search(qos), _PARTITIONS.search(qos)
    if topic is None or (partitions is None and "partition={" in qos):
        raise MalformedError("its topic or its partitions cannot be read")
    names = re.findall(r'"([^"]*)"', partitions[1]) if partitions else []
    return endpoint(domain, action, topic[1], names)


def _enclave(qos: str) -> str:
    data = _USER_DATA.search(qos)
    octets, end, _ = qos[data.end() :].partition(">") if data else ("", "", "")
    found = enclave_in("".join(_characters(octets)) if end else "")
    if found is None:
        raise MalformedError("its enclave is cut: Cyclone DDS writes 100 bytes of user data")
    return found


def _characters(octets: str) -> Iterator[str]:
    """Cyclone DDS writes octets as numbers, or as text in quotes if all can be printed."""
    for text, number in _OCTETS.findall(octets):
        yield text or (chr(int(number)) if number else "")


def _label(qos: str) -> str:
    found = _ENTITY_NAME.search(qos) or _PROCESS.search(qos)
    return found[1] if found else ""
