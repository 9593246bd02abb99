"""What a self-check found, step by step."""

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True)
class Step:
    """One thing that was checked. `detail` is what was found, or why it failed."""

    name: str
    ok: bool
    detail: str
    hint: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """A handshake between two participants. What was not reached is None."""

    steps: tuple[Step, ...]
    initiator: str | None
    replier: str | None
    why: str | None
    """Why that one sends the Request."""
    signature: str | None
    """The signature algorithms of initiator and replier, as c.dsign_algo names them."""
    key_agreement: str
    """As c.kagree_algo names it."""
    token_bytes: dict[str, int]
    """Size of the DataHolder of each message: request, reply, final."""
    milliseconds: float
    """The three messages and the key exchange, both sides; checks before not counted."""

    @property
    def ok(self) -> bool:
        """Whether every step was reached and held."""
        return all(step.ok for step in self.steps)

    def to_json(self) -> dict[str, Any]:
        """The report for --json."""
        return {
            "ok": self.ok,
            "initiator": self.initiator,
            "replier": self.replier,
            "why": self.why,
            "signature": self.signature,
            "key_agreement": self.key_agreement,
            "token_bytes": self.token_bytes,
            "steps": [
                {"name": step.name, "ok": step.ok, "detail": step.detail}
                | ({"hint": step.hint} if step.hint else {})
                for step in self.steps
            ],
            "milliseconds": self.milliseconds,
        }
