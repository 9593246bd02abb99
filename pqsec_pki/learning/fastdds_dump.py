"""Reads what Fast DDS Monitor and Fast DDS's statistics backend save (`dump_database`), as JSON.

    {"domains":      {ID: {"name": "0"}},             or the address of a discovery server
     "topics":       {ID: {"name": "rt/chatter"}},
     "processes":    {ID: {"name": "talker"}},
     "participants": {ID: {"name": ..., "domain": ID, "process": ID, "qos": {"user_data": HEX}}},
     "datawriters":  {ID: {"guid": ..., "participant": ID, "topic": ID,
                           "qos": {"partition": [...]}}},
     "datareaders":  likewise}

ID is a number as text. Other keys are not needed. The backend discovers participants of every
stack. What it calls metatraffic is needed too: with it are the services of every ROS 2 node.
"""

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias, TypeGuard

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import MalformedError, shown
from pqsec_pki.learning._discovered import (
    ACTIONS,
    DiscoveredParticipant,
    domain_in,
    enclave_in,
    endpoint,
)
from pqsec_pki.learning.seen import Endpoint, SeenParticipant

_Entity: TypeAlias = Mapping[str, Any]

_KINDS = ("domains", "topics", "processes", "participants", "datawriters", "datareaders")
_GUID = re.compile(r"[0-9a-f.]+\|(?:[0-9a-f]{1,2}\.){3}([0-9a-f]{1,2})", re.ASCII)
"""A GUID; its group is the kind of the entity, the last octet."""
_TEXT = re.compile(r"(?:[2-7][0-9a-f])*", re.ASCII)
"""The backend writes octets in hex without leading zeros, so what follows an octet below 0x10
cannot be read; what ROS 2 writes is text, before any such octet."""
_NAMELESS = frozenset({"", "/", "RTPSParticipant", "Unknown"})
"""Names of participants and processes that were given none."""


def participants_in(text: str, domain: int) -> list[SeenParticipant]:
    """The participants of a dump; `domain` is for those that a discovery server showed.

    MalformedError if it is not a dump, or is not complete.
    """
    dump = _Dump(_parsed(text), domain)
    found = {number: dump.participant(each) for number, each in dump.of["participants"].items()}
    if not found:
        raise MalformedError("the dump has no participant")
    for owner, seen in dump.endpoints():
        found[owner].endpoints[seen] = None
    return [each.seen() for each in found.values()]


def _parsed(text: str) -> Mapping[str, Mapping[str, _Entity]]:
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise MalformedError(f"begins like JSON, and is not: {error}") from error
    tables = {kind: found.get(kind) for kind in _KINDS}
    for table in tables.values():
        if not isinstance(table, dict) or not all(isinstance(x, dict) for x in table.values()):
            raise MalformedError("is JSON, but not a dump of Fast DDS's statistics backend")
    return tables


@dataclass(frozen=True, slots=True)
class _Dump:
    of: Mapping[str, Mapping[str, _Entity]]
    """The entities of each kind, by their ID."""
    domain: int
    """The domain of participants whose domain the dump does not have."""

    def participant(self, entity: _Entity) -> DiscoveredParticipant:
        process = self.of["processes"].get(str(entity.get("process")), {})
        names = (entity.get("name"), process.get("name"))
        return DiscoveredParticipant(
            enclave=_enclave(entity),
            label=next((each for each in names if _is_name(each)), ""),
        )

    def endpoints(self) -> Iterator[tuple[str, Endpoint]]:
        """Each with the ID of its participant; without those of Fast DDS's own."""
        for kind in ("datawriters", "datareaders"):
            for number, entity in self.of[kind].items():
                try:
                    if found := self._endpoint(entity):
                        yield str(entity["participant"]), found
                except MalformedError as error:
                    raise MalformedError(f"{kind}, {shown(number)}: {error}") from error

    def _endpoint(self, entity: _Entity) -> Endpoint | None:
        guid = _GUID.fullmatch(str(entity.get("guid")))
        if guid is None:
            raise MalformedError("it has no GUID")
        participant, topic = (
            self._known(entity, "participant"),
            self._known(entity, "topic")["name"],
        )
        domain, partitions = self._domain(participant), _partitions(entity)
        action = ACTIONS.get(int(guid[1], 16))
        return endpoint(domain, action, topic, partitions) if action else None

    def _known(self, entity: _Entity, key: str) -> _Entity:
        found = self.of[f"{key}s"].get(str(entity.get(key)))
        if found is None or not isinstance(found.get("name"), str):
            raise MalformedError(f"its {key} is not in the dump")
        return found

    def _domain(self, participant: _Entity) -> int:
        name = self._known(participant, "domain")["name"]
        return domain_in(name) if name.isdecimal() else self.domain


def _is_name(found: object) -> TypeGuard[str]:
    return isinstance(found, str) and found not in _NAMELESS


def _partitions(entity: _Entity) -> list[str]:
    found = _qos(entity).get("partition", [])
    if not isinstance(found, list) or not all(isinstance(each, str) for each in found):
        raise MalformedError("its partitions cannot be read")
    return found


def _enclave(entity: _Entity) -> str:
    data = _TEXT.match(str(_qos(entity).get("user_data", "")))
    return (enclave_in(bytes.fromhex(data[0]).decode()) or "") if data else ""


def _qos(entity: _Entity) -> _Entity:
    found = entity.get("qos")
    return found if isinstance(found, dict) else {}
