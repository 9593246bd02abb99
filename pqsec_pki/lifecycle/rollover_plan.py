"""Plans a rollover: what is replaced, and which participants are reissued with which keys.

It changes nothing and unlocks no key. The signatures of documents in enclaves are not verified:
that takes long for thousands.
"""

from collections.abc import Sequence
from dataclasses import replace
from datetime import datetime

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, exists, read
from pqsec_pki._processes import shared_out
from pqsec_pki._times import said
from pqsec_pki.algorithms import Profile
from pqsec_pki.certificates import BACKDATE, Certificate
from pqsec_pki.documents import Permissions
from pqsec_pki.errors import KeystoreError, UsageError, located
from pqsec_pki.keystore import (
    WAIT,
    Keystore,
    Overlap,
    Phase,
    State,
    all_hashes,
    layout,
    refuse_overlap,
)
from pqsec_pki.lifecycle._inspector import Inspector
from pqsec_pki.lifecycle.renewing import keys_fit
from pqsec_pki.lifecycle.rollover import OverlapStep, Rollover, RolloverPlan, Scope
from pqsec_pki.smime import document_in

_PHASES = {
    OverlapStep.SWITCH: Phase.BEGUN,
    OverlapStep.FINISH: Phase.SWITCHED,
    OverlapStep.CANCEL: Phase.BEGUN,
}
"""The phase that a step of an overlap needs."""


def plan_rollover(keystore: Keystore, terms: Rollover, *, now: datetime) -> RolloverPlan:
    """What the rollover does with these terms.

    UsageError for terms that exclude each other. KeystoreError for a participant whose files
    are not the ledger's newest, and if an overlap is not in the phase for it, or would admit
    revoked participants again. VerificationError for a governance that the permissions CA did
    not sign.
    """
    head = keystore.head  # before all else: what changes later makes the plan invalid
    _refuse_scope(keystore, terms)
    overlap = _overlap(keystore, terms, now)
    number = _generation(keystore)
    has_list = keystore.has_revocation_list
    others = [each for each in keystore.sets if each != keystore]
    ends = terms.overlap in {OverlapStep.FINISH, OverlapStep.CANCEL}
    plan = RolloverPlan(
        terms=terms,
        before=keystore.profile,
        issuing=keystore.identity_ca,
        overlap=overlap,
        head=head,
        generation=number + 1,
        archive=keystore.folder / layout.GENERATIONS / str(number),
        one_ca=keystore.identity_ca.spki == keystore.permissions_ca.spki,
        set_name=keystore.set_name,
        others=tuple(each.profile.name for each in others),
        new_list=(terms.reissues and terms.scope is not Scope.PERMISSIONS and has_list)
        or (ends and any(each.has_revocation_list for each in others)),
        drop_list=terms.overlap is OverlapStep.BEGIN and has_list,
    )
    return _with_participants(plan, keystore, now) if terms.reissues else plan


def _refuse_scope(keystore: Keystore, terms: Rollover) -> None:
    """UsageError for one CA with another profile, or an overlap of permissions CAs.

    Also for another profile of one of several sets: its name is that of the set.
    """
    changes = terms.profile.to_names() != keystore.profile.to_names()
    if changes and len(keystore.profiles) > 1:
        new, old = terms.profile.name, keystore.profile.name
        raise UsageError(
            f"the set of credentials {old} keeps its profile",
            hint=f"add a set beside it: `pqsec ca add-set {new}`",
        )
    if terms.overlap and terms.scope is not Scope.IDENTITY:
        raise UsageError(
            "only the identity CA can overlap: no stack trusts two permissions CAs",
            hint="leave out --only: the permissions CA stays as it is",
        )
    if terms.scope is not Scope.BOTH and changes:
        raise UsageError(
            "a new profile applies to both CAs",
            hint="leave out --profile; or leave out --only and --overlap",
        )


def _overlap(keystore: Keystore, terms: Rollover, now: datetime) -> Overlap | None:
    """The overlap that the step continues; KeystoreError if it is not in the phase for it."""
    if terms.overlap in _PHASES:
        return Overlap.that_is(keystore, _PHASES[terms.overlap])
    refuse_overlap(keystore, "an overlap has begun already" if terms.overlap else WAIT)
    if terms.overlap and (revoked := _revoked(keystore, now)):
        names = ", ".join(sorted(set(revoked.values())))
        raise KeystoreError(
            f"{len(revoked)} revoked would be accepted again ({names}): participants that trust"
            " two CAs cannot use a revocation list",
            hint="rotate without --overlap, or wait until their certificates have expired:"
            " `pqsec status --state revoked`",
        )
    return None


def _revoked(keystore: Keystore, now: datetime) -> dict[int, str]:
    """The identity CA's certificates that are revoked and not expired: serial number, name."""
    issuer, found = keystore.identity_ca.fingerprint, keystore.revocation_list
    with keystore.open_ledger() as ledger:
        lines = [each for each in ledger.of_kind("revocation") if each.issuer == issuer]
    ended = {each.serial_number for each in lines if each.ends < now}
    listed = [each.serial_number for each in found.revoked] if found else []
    names = {number: f"serial {number:x}" for number in listed}
    names |= {each.serial_number: each.name or f"serial {each.serial}" for each in lines}
    return {number: name for number, name in names.items() if number not in ended}


def _generation(keystore: Keystore) -> int:
    """The generation of the keystore's CAs, counted from 1."""
    folder = keystore.folder / layout.GENERATIONS
    with disk_errors(folder):
        found = list(folder.iterdir()) if exists(folder) else []
    return 1 + max((int(path.name) for path in found if path.name.isdecimal()), default=0)


def _with_participants(plan: RolloverPlan, keystore: Keystore, now: datetime) -> RolloverPlan:
    """The plan with what happens to each participant."""
    with keystore.open_ledger() as ledger:
        inspector = Inspector.of(keystore, ledger, now=now)
    names = keystore.names()
    revoked = dict.fromkeys(inspector.revoked_of(names), str(State.REVOKED))
    others = [name for name in names if name not in revoked]
    found = _Decider(inspector, plan.terms, now).all(others)
    path = keystore.folder / layout.ENCLAVES / layout.GOVERNANCE
    with located(path):
        inspector.verified(read(path))
    return replace(
        plan,
        keeping=tuple(name for name, each in found.items() if each == _Decision()),
        rekeyed=tuple(name for name, each in found.items() if each.new_keys),
        left_out=revoked | {name: each.why_not for name, each in found.items() if each.why_not},
    )


@dataclass(frozen=True, slots=True)
class _Decision:
    """What happens to a participant: it is reissued with its keys, unless a field is set."""

    why_not: str = ""
    """Why it is not reissued."""
    new_keys: bool = False


@dataclass(frozen=True, slots=True)
class _Decider:
    inspector: Inspector
    terms: Rollover
    now: datetime

    def all(self, names: Sequence[str]) -> dict[str, _Decision]:
        return dict(zip(names, shared_out(self.decide, names), strict=True))

    def decide(self, name: str) -> _Decision:
        """KeystoreError for a participant whose files are not the ledger's newest."""
        folder = self.inspector.keystore.folder / layout.enclave_folder(name)
        certificate = self.inspector.certificate(name, folder)
        has_key = self.inspector.keystore.has_key(name)
        if self.inspector.participants[name].issued_by_previous_ca:
            return _Decision("it was not reissued before: its CA has been replaced")
        why = self._why_new_keys(certificate, self.terms.profile)
        if why and not has_key:
            return _Decision(f"its key is not here and {why}: it needs a new request")
        if len(self.inspector.keystore.profiles) > 1 and certificate.not_after <= self.now:
            return _Decision(f"its certificate ended on {said(certificate.not_after)}")
        ended = _ended(self.inspector.signed_permissions(name, folder), certificate, self.now)
        if ended:
            return _Decision(f"its permissions ended on {said(ended)}")
        return _Decision(new_keys=has_key and (self.terms.rekey or bool(why)))

    def _why_new_keys(self, certificate: Certificate, profile: Profile) -> str:
        """Why its keys cannot be certified again; empty if they can."""
        if not keys_fit(certificate, profile):
            return "does not fit the profile"
        hashes = all_hashes(certificate.public_key, certificate.alternative_key)
        return "" if self.inspector.compromised.keys().isdisjoint(hashes) else "is compromised"


def _ended(signed: bytes, certificate: Certificate, now: datetime) -> datetime | None:
    """The past end of its own grant, if a policy set it before the certificate's end."""
    own = certificate.subject_name
    ends = [
        grant.not_after
        for grant in Permissions.from_xml(document_in(signed)).grants
        if grant.subject_name == own and grant.not_after < certificate.not_after
    ]
    return min((end for end in ends if end <= now - BACKDATE), default=None)
