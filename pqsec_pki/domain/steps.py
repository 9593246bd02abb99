"""The steps from a keystore to what is desired, and what stands in their way: values alone."""

from dataclasses import dataclass, field
from enum import StrEnum


class Action(StrEnum):
    """What a step does, in the order in which steps are taken."""

    CREATE_CAS = "create-cas"
    SIGN_GOVERNANCE = "sign-governance"
    ISSUE = "issue"
    REPLACE = "replace"
    SIGN_PERMISSIONS = "sign-permissions"
    RENEW = "renew"
    REVOKE = "revoke"
    RENEW_CRL = "renew-crl"

    @property
    def words(self) -> str:
        """It, for a person."""
        return _WORDS[self]


_WORDS = {
    Action.CREATE_CAS: "create the CAs",
    Action.SIGN_GOVERNANCE: "sign the governance",
    Action.ISSUE: "issue",
    Action.REPLACE: "issue again",
    Action.SIGN_PERMISSIONS: "sign permissions for",
    Action.RENEW: "renew",
    Action.REVOKE: "revoke",
    Action.RENEW_CRL: "renew the revocation list",
}


@dataclass(frozen=True, slots=True)
class Step:
    """One thing to be done."""

    action: Action
    name: str
    """Of the participant; empty where all share the thing."""
    why: str
    keys: str = field(default="", compare=False)
    """Hashes of those that its request asks for, as the ledger will have them."""


@dataclass(frozen=True, slots=True)
class Blocked:
    """A participant that no step can make, bring back or revoke, and should be."""

    name: str
    why: str
    way_out: str = "take it out of the file, or issue it by hand"


@dataclass(frozen=True, slots=True)
class Plan:
    """What is to be done, and what is not."""

    steps: tuple[Step, ...]
    blocked: tuple[Blocked, ...]
    unlisted: tuple[str, ...]
    """In the keystore and not in the file, and valid: they stay, as nothing says `prune`."""
    unchanged: int
    """Participants that are as they should be."""
    head: str | None = field(default=None, compare=False)
    """Of the ledger that it was made from; None if there was none."""

    @property
    def revoked(self) -> int:
        """How many participants it revokes."""
        return sum(step.action is Action.REVOKE for step in self.steps)

    @property
    def in_order(self) -> bool:
        """Whether the keystore is as the file wants it."""
        return not self.steps and not self.blocked
