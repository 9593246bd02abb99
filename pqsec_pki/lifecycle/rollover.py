"""The values of a rollover: its options, and the plan that is shown and executed."""

from collections.abc import Collection, Iterator
from dataclasses import field
from datetime import timedelta
from enum import StrEnum
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import Profile
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import UsageError
from pqsec_pki.keystore import Keystore, Overlap, key_algorithms, layout

CA_VALIDITY = timedelta(days=3650)


class Scope(StrEnum):
    """Which CAs are replaced."""

    BOTH = "both"
    IDENTITY = "identity"
    PERMISSIONS = "permissions"


class OverlapStep(StrEnum):
    """A step of a rollover in which two identity CAs are trusted (ADR 10).

    Between two steps every robot gets its new files; robots with new files still accept robots
    with old ones.
    """

    BEGIN = "begin"
    """Create a new CA, which all trust beside the one that issues."""
    SWITCH = "switch"
    """Let the new CA issue, and reissue all participants; the old CA is still trusted."""
    FINISH = "finish"
    """Remove the trust in the old CA."""
    CANCEL = "cancel"
    """Remove the new CA, which has not issued anything."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rollover:
    """The options of a rollover."""

    profile: Profile
    scope: Scope = Scope.BOTH
    overlap: OverlapStep | None = None
    """The step to make; None for a rollover at once."""
    name: str | None = None
    """The start of the new CAs' names; None for the old name and the generation: Lab G2."""
    validity: timedelta = CA_VALIDITY
    """The validity of the new CAs; participants keep the validity that they were issued for."""
    rekey: bool = False
    """Whether participants get new keys even if their algorithms fit the profile."""
    destroy: bool = False
    """Whether the old CAs' keys are overwritten with zeros instead of archived."""

    @property
    def reissues(self) -> bool:
        """Whether participants are reissued: not in every step of an overlap."""
        return self.overlap in {None, OverlapStep.SWITCH}

    @property
    def new_keys(self) -> tuple[str, ...]:
        """The names of the files of the CA keys that it makes."""
        if self.overlap not in {None, OverlapStep.BEGIN}:
            return ()
        of_identity = {layout.IDENTITY_KEY, layout.IDENTITY_ALT_KEY}
        return tuple(
            name
            for name in key_algorithms(self.profile)
            if self.scope is Scope.BOTH or (name in of_identity) == (self.scope is Scope.IDENTITY)
        )

    @property
    def needs_old_cas(self) -> bool:
        """Whether the keys of the old CAs are needed, because one of them stays in use."""
        if self.overlap:
            return self.overlap in {OverlapStep.BEGIN, OverlapStep.SWITCH}
        return self.scope is not Scope.BOTH


@dataclass(frozen=True, slots=True, kw_only=True)
class RolloverPlan:
    """What a rollover does: `steps` shows it, `apply_rollover` executes it and decides nothing."""

    terms: Rollover
    before: Profile
    issuing: Certificate
    """The identity CA that issued when the plan was made."""
    overlap: Overlap | None
    """The overlap that continues or ends; None if there is none yet."""
    head: str = field(repr=False)
    """The ledger's head when the plan was made; another change makes the plan invalid."""
    generation: int
    """The generation of the new CAs."""
    archive: Path
    """The folder for the replaced CAs."""
    one_ca: bool
    """Whether both CAs have the same key now (CVE-2023-24010)."""
    set_name: str = layout.FIRST
    """The set of credentials whose CAs are replaced."""
    others: tuple[str, ...] = ()
    """The profiles of the other sets, which stay as they are."""
    keeping: tuple[str, ...] = ()
    """Participants that are reissued with their keys."""
    rekeyed: tuple[str, ...] = ()
    """Participants that get new keys."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Participants that are not reissued, and why."""
    new_list: bool = False
    """Whether a new, empty revocation list is issued: it replaces the old one, or comes back to a
    set whose overlap ends, if other sets have lists."""
    drop_list: bool = False
    """Whether the empty revocation list is removed: it would cover only one of two CAs."""

    @property
    def rotate(self) -> str:
        """The command that replaces CAs of this set."""
        return f"pqsec ca rotate --set {self.before.name}" if self.others else "pqsec ca rotate"

    @property
    def needs_old_cas(self) -> bool:
        """Whether the keys of this set's old CAs are needed."""
        return self.terms.needs_old_cas or bool(self.new_list and self.overlap)

    @property
    def needs_other_sets(self) -> bool:
        """Whether the keys of the other sets' CAs are needed: with the new permissions CA, they
        sign the next head of the ledger."""
        return bool(self.others) and (self.terms.scope is Scope.BOTH or self.needs_old_cas)

    def to_json(self) -> dict[str, object]:
        """The plan of a rollover without an overlap, for --json."""
        return {
            "generation": self.generation,
            "scope": self.terms.scope,
            "profile": {"before": self.before.name, "after": self.terms.profile.name},
            "one_ca": self.one_ca,
            "keeping": self.keeping,
            "rekeyed": self.rekeyed,
            "left_out": self.left_out,
            "new_list": self.new_list,
            "archive": self.archive,
            "destroy": self.terms.destroy,
            "steps": self.steps,
        }

    @property
    def steps(self) -> tuple[str, ...]:
        """What changes, in words; all of it is one change."""
        return tuple(self._steps())

    def _steps(self) -> Iterator[str]:
        match self.terms.overlap:
            case OverlapStep.BEGIN:
                yield f"create an identity CA ({self._identity_kinds}), which does not issue yet"
                yield (
                    "add it to the CAs that all participants trust,"
                    f" after {self._issuing_name}, which still issues"
                )
                if self.drop_list:
                    yield "remove the revocation list, which is empty: it would cover one CA only"
            case OverlapStep.FINISH:
                yield f"trust only {self._issuing_name}"
                yield f"refuse certificates that {self._other_name} issued"
                yield from self._returning_list()
            case OverlapStep.CANCEL:
                yield f"trust only {self._issuing_name}, as before"
                yield f"destroy the key of {self._other_name}, which has not issued anything"
                yield from self._returning_list()
            case _:
                yield from self._rollover_steps()

    def _returning_list(self) -> Iterator[str]:
        if self.new_list:
            yield "issue an empty revocation list: the other sets of credentials have lists too"

    def _rollover_steps(self) -> Iterator[str]:
        yield from self._ca_steps()
        if self.keeping:
            yield f"reissue {_counted(self.keeping, 'participant')} with the same keys"
        if self.rekeyed:
            yield f"reissue {_counted(self.rekeyed, 'participant')} with new keys"
        documents = _counted((*self.keeping, *self.rekeyed), "permissions document")
        yield f"sign the governance and {documents} again"
        if self.new_list:
            yield (
                "issue an empty revocation list: certificates of the old CA are no longer trusted"
            )
        for name, reason in self.left_out.items():
            yield f"do not reissue {name}: {reason}"
        if self.terms.destroy:
            yield f"destroy the old keys, and keep the old certificates in {self.archive}"
        else:
            yield f"keep the old CAs in {self.archive}"
        if self.overlap:
            yield f"keep trusting {self._issuing_name}"

    def _ca_steps(self) -> Iterator[str]:
        profile, scope = self.terms.profile, self.terms.scope
        if self.overlap:
            yield f"issue with {self._other_name} from now on"
        elif scope is not Scope.PERMISSIONS:
            yield f"create an identity CA ({self._identity_kinds})"
        if scope is not Scope.IDENTITY:
            yield f"create a permissions CA ({_kinds(profile, profile.permissions_key.name)})"

    @property
    def _identity_kinds(self) -> str:
        return _kinds(self.terms.profile, self.terms.profile.identity_key.name)

    @property
    def _issuing_name(self) -> str:
        return self.issuing.subject_name

    @property
    def _other_name(self) -> str:
        return self.overlap.other.subject_name if self.overlap else ""


def _kinds(profile: Profile, first: str) -> str:
    second = profile.alternative_key
    return f"{first} and {second.name}" if second else first


def _counted(items: Collection[str], what: str) -> str:
    return f"{len(items)} {what}" if len(items) == 1 else f"{len(items)} {what}s"


def refuse_keys_in_files(keystore: Keystore, terms: Rollover, placed: Collection[str] = ()) -> None:
    """UsageError if a key that is in a token now would be followed by one in a file.

    `placed` are the names of files of new keys for which somebody has said where they are.
    """
    names = [each for each in keystore.key_uris() if each in terms.new_keys and each not in placed]
    if names:
        raise UsageError(
            f"the new keys would be in files, and are in tokens now: {', '.join(names)}",
            hint="give a URI for each: `pqsec ca rotate --identity-key-uri URI`, and so on; write"
            " `file` instead of a URI for a key in a file",
        )
