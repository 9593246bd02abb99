"""The access control of Fast DDS, asked about single endpoints.

It is the real plugin, called as a participant's stack and as its peers call it: the peer
is itself, met once more, since the plugin knows a peer by its certificate alone.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pqsec_pki.access import Action, Question
from tests.interop.cyclone import Meeting
from tests.interop.cyclone_access import KINDS, refusal
from tests.interop.fastdds import Participant, participant
from tests.interop.fastdds_shim import FastDdsShim

_MYSELF = Meeting(0, begins=False, auth_request=None)
_REMOTE_KINDS = KINDS | {Action.RELAY: "datareader"}
"""A participant's own stack is not asked about relaying."""


@contextmanager
def access_control(fastdds: FastDdsShim, enclave: Path, domain: int) -> Iterator["AccessControl"]:
    """The plugin with the six files in `enclave`, on that domain."""
    with participant(fastdds, enclave) as one:
        yield AccessControl(one, domain)


class AccessControl:
    """What Fast DDS answers to questions, by its own checks in their order."""

    def __init__(self, one: Participant, domain: int) -> None:
        self._one = one
        self.unfit = refusal(lambda: one.validate(domain, _MYSELF))

    def own(self, question: Question) -> str:
        """Why the participant's own stack refuses; empty if it does not."""
        return self.unfit or refusal(lambda: self._ask(question, "create", KINDS))

    def peer(self, question: Question) -> str:
        """Why a peer of the same domain refuses; empty if it does not."""
        return self.unfit or refusal(lambda: self._ask(question, "remote", _REMOTE_KINDS))

    def _ask(self, question: Question, side: str, kinds: dict[Action, str]) -> None:
        self._one.check(f"check_{side}_participant", question.domain)
        if question.action in kinds:
            names = question.topic, *question.partitions
            self._one.check(f"check_{side}_{kinds[question.action]}", question.domain, *names)
