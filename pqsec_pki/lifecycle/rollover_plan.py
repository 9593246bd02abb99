"""Previews a rollover, without changing anything or unlocking a key."""

from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki._processes import shared_out
from pqsec_pki.algorithms import Profile
from pqsec_pki.errors import located
from pqsec_pki.keystore import WAIT, Keystore, layout, refuse_overlap
from pqsec_pki.lifecycle._inspector import Inspector
from pqsec_pki.lifecycle.rollover import (
    Rollover,
    Scope,
    check_scope,
    generation,
    gets_keys,
    not_reissued,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RolloverPlan:
    """What a rollover will do."""

    generation: int
    """Of the new CAs."""
    before: Profile
    after: Profile
    scope: Scope
    one_ca: bool
    """Whether both CAs have the same key now (CVE-2023-24010)."""
    keeping: tuple[str, ...]
    """Participants that are reissued with their keys."""
    rekeyed: tuple[str, ...]
    """Participants that get new keys."""
    left_out: dict[str, str]
    """Participants that are not reissued, and why."""
    new_list: bool
    """Whether a new, empty revocation list replaces the old one."""
    archive: Path
    destroy: bool
    """Whether the old keys are destroyed instead of archived."""

    @property
    def participants(self) -> int:
        """How many participants are reissued."""
        return len(self.keeping) + len(self.rekeyed)


def plan_rollover(
    keystore: Keystore, terms: Rollover, *, now: datetime, within_overlap: bool = False
) -> RolloverPlan:
    """What `rotate` would do with these terms; raises the errors of its checks."""
    check_scope(keystore, terms)
    if not within_overlap:
        refuse_overlap(keystore, WAIT)
    number = generation(keystore)
    with keystore.open_ledger() as ledger:
        inspector = Inspector.of(keystore, ledger, now=now)
        left_out = not_reissued(keystore, terms, inspector, now)
    names = [name for name in keystore.names() if name not in left_out]
    path = keystore.root / layout.ENCLAVES / layout.GOVERNANCE
    with located(path):
        inspector.verified(read(path))
    new_keys = shared_out(partial(gets_keys, keystore, terms, inspector), names)
    rekeyed = tuple(name for name, new in zip(names, new_keys, strict=True) if new)
    return RolloverPlan(
        generation=number + 1,
        before=keystore.profile,
        after=terms.profile,
        scope=terms.scope,
        one_ca=keystore.identity_ca.spki == keystore.permissions_ca.spki,
        keeping=tuple(name for name, new in zip(names, new_keys, strict=True) if not new),
        rekeyed=rekeyed,
        left_out=left_out,
        new_list=terms.scope is not Scope.PERMISSIONS and keystore.has_revocation_list,
        archive=keystore.root / layout.GENERATIONS / str(number),
        destroy=terms.destroy,
    )
