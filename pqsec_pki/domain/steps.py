"""The values of a plan: its steps, and the participants that are blocked or were revoked."""

from dataclasses import field
from enum import StrEnum

from pqsec_pki._dataclass import dataclass
from pqsec_pki.keystore import SigningCa


class StepAction(StrEnum):
    """What a step does, in the order of execution."""

    CHANGE_PROFILE = "change-profile"
    CREATE_CAS = "create-cas"
    ADD_SET = "add-set"
    """Add a set of credentials of another profile; all steps after it are about all sets."""
    SIGN_GOVERNANCE = "sign-governance"
    STORE_GROUPS = "store-groups"
    STORE_STOCK = "store-stock"
    ENROL = "enrol"
    """Enrol by an order of a registration authority, within its grant; an order is one change."""
    ISSUE = "issue"
    REPLACE = "replace"
    SIGN_PERMISSIONS = "sign-permissions"
    RENEW = "renew"
    REVOKE = "revoke"
    RENEW_CRL = "renew-crl"
    STORE_APPROVALS = "store-approvals"
    """The last step: until then, the approvals of before are demanded."""

    @property
    def words(self) -> str:
        """The action in words, for messages."""
        return _WORDS[self]


_WORDS = {
    StepAction.CHANGE_PROFILE: "change the profile",
    StepAction.CREATE_CAS: "create the CAs",
    StepAction.ADD_SET: "add the set",
    StepAction.SIGN_GOVERNANCE: "sign the governance",
    StepAction.STORE_GROUPS: "store the groups",
    StepAction.STORE_STOCK: "store the stock names",
    StepAction.ENROL: "enrol",
    StepAction.ISSUE: "issue",
    StepAction.REPLACE: "issue again",
    StepAction.SIGN_PERMISSIONS: "sign permissions for",
    StepAction.RENEW: "renew",
    StepAction.REVOKE: "revoke",
    StepAction.RENEW_CRL: "renew the revocation list",
    StepAction.STORE_APPROVALS: "change the approvals",
}


@dataclass(frozen=True, slots=True)
class Step:
    """One step of a plan."""

    action: StepAction
    name: str
    """The participant's name, or the profile of the set that is added; empty if the step is for
    neither."""
    why: str
    keys: str = field(default="", compare=False)
    """Hashes of the keys in its request, as in the ledger."""
    approved: bool = field(default=False, compare=False)
    """Whether the grant that it is within was approved, or needed no approvals."""

    @property
    def participant(self) -> str:
        """The name of the participant that it changes; empty if it is not for one."""
        return "" if self.action is StepAction.ADD_SET else self.name

    def to_json(self) -> dict[str, object]:
        """The step for --json."""
        return {"action": self.action, "name": self.name or None, "why": self.why}


@dataclass(frozen=True, slots=True)
class Blocked:
    """A participant that should be changed, but no step can do it."""

    name: str
    why: str
    way_out: str = "remove it from the file, or issue it by hand"


@dataclass(frozen=True, slots=True)
class Ended:
    """A participant of the file that was revoked: somebody decided it, so it is left as it is."""

    name: str
    way_back: str


@dataclass(frozen=True, slots=True)
class Plan:
    """The steps, and the participants that they do not change."""

    steps: tuple[Step, ...]
    blocked: tuple[Blocked, ...]
    unlisted: tuple[str, ...]
    """Valid participants that are not in the file; they are kept, because `prune` is not set."""
    unchanged: int
    """How many participants are in the wanted state."""
    head: str | None = field(default=None, compare=False)
    """The ledger's head when the plan was made; None if there was no ledger."""
    only: SigningCa | None = None
    """The CA whose keys it needs, if it has the steps of one CA only: certificates, or rights."""
    ended: tuple[Ended, ...] = ()
    """Participants of the file that were revoked; the plan is complete without them."""
    left: tuple[Step, ...] = ()
    """Then the other steps: they are made where the keys of the other CA, or of both, are."""

    def to_json(self) -> dict[str, object]:
        """The plan for --json."""
        return {
            "in_order": self.in_order,
            "steps": self.steps,
            "blocked": self.blocked,
            "revoked": self.ended,
            "unlisted": self.unlisted,
            "unchanged": self.unchanged,
            **({"only": self.only.label, "left": self.left} if self.only else {}),
        }

    @property
    def revoked(self) -> int:
        """How many participants the plan revokes."""
        return sum(step.action is StepAction.REVOKE for step in self.steps)

    @property
    def changes_profile(self) -> bool:
        """Whether the plan replaces everything, by `change_profile`; then it has no other step."""
        return any(step.action is StepAction.CHANGE_PROFILE for step in self.steps)

    @property
    def in_order(self) -> bool:
        """Whether the keystore is in the wanted state."""
        return not self.steps and not self.blocked
