"""Executes the plan of a rollover, in one change.

All participants are reissued and all documents signed again. The keys of the old CAs are not
needed, unless one of the two stays: their signatures are verified with their certificates. The
old CAs are archived in private/generations/, or their keys destroyed.
"""

import hashlib
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki._processes import shared_out
from pqsec_pki.algorithms import Profile
from pqsec_pki.approvals import Covered
from pqsec_pki.errors import KeystoreError, UsageError, located
from pqsec_pki.keystore import (
    Authorities,
    Keystore,
    Ledger,
    Overlap,
    Phase,
    SetChange,
    StagedFolder,
    change,
    document_entry,
    layout,
    settings_file,
    trust_entry,
)
from pqsec_pki.lifecycle._ca_changes import (
    Keys,
    begin_overlap,
    cancel_overlap,
    finish_overlap,
    new_cas,
    next_identity_ca,
    refuse_known,
)
from pqsec_pki.lifecycle._inspector import Inspector
from pqsec_pki.lifecycle._issuer import Issued, Issuer
from pqsec_pki.lifecycle.renewing import Renewal, Renewer
from pqsec_pki.lifecycle.revoking import LIST_VALIDITY, Publisher
from pqsec_pki.lifecycle.rollover import OverlapStep, RolloverPlan, Scope
from pqsec_pki.tokens import Pin

_IDENTITY = (
    f"{layout.PUBLIC}/{layout.IDENTITY_CA}",
    f"{layout.PUBLIC}/{layout.CA_LIST}",
    f"{layout.PRIVATE}/{layout.IDENTITY_KEY}",
    f"{layout.PRIVATE}/{layout.IDENTITY_ALT_KEY}",
)
_PERMISSIONS = (
    f"{layout.PUBLIC}/{layout.PERMISSIONS_CA}",
    f"{layout.PUBLIC}/{layout.PERMISSIONS_ALT_CA}",
    f"{layout.PRIVATE}/{layout.PERMISSIONS_KEY}",
    f"{layout.PRIVATE}/{layout.PERMISSIONS_ALT_KEY}",
)
# SROS2's one CA, to which the names above are links.
_SROS2 = (f"{layout.PUBLIC}/ca.cert.pem", f"{layout.PRIVATE}/ca.key.pem")
_PLACES = {
    Scope.BOTH: (*_IDENTITY, *_PERMISSIONS, *_SROS2),
    Scope.IDENTITY: _IDENTITY,
    Scope.PERMISSIONS: _PERMISSIONS,
}
"""Scope -> the files of the CAs that are replaced."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RolloverResult:
    """The result of an executed plan."""

    plan: RolloverPlan
    keystore: Keystore
    """The keystore with the new profile."""
    issued: list[Issued]
    overlap: Overlap | None
    """The overlap that began, continued or ended."""

    def to_json(self) -> dict[str, object]:
        """The result for --json."""
        return {
            "generation": self.plan.generation,
            "profile": self.plan.terms.profile.name,
            "scope": self.plan.terms.scope,
            "issued": [each.name for each in self.issued],
            "left_out": self.plan.left_out,
            "new_list": self.plan.new_list,
            "archive": self.plan.archive,
        }


def apply_rollover(  # noqa: PLR0913 -- each is a choice of the user's, and all by name
    keystore: Keystore,
    plan: RolloverPlan,
    *,
    kept: Authorities | None = None,
    passphrase: bytes | None = None,
    pin: Pin | None = None,
    keys: Keys = None,
    compares_clock: bool = False,
    now: datetime,
) -> RolloverResult:
    """Execute the plan, or do nothing.

    `kept` are the keystore's CAs, if the plan needs them. New keys are encrypted under
    `passphrase`, which is also that of the key that an overlap has made; `pin` gives the PIN of a
    token that has it. `keys` are keys of new CAs that are there already. `compares_clock` is as
    in `Authorities`. KeystoreError if the
    keystore was changed after the plan was made; VerificationError for documents that the old
    permissions CA did not sign.
    """
    if kept is None and (plan.needs_old_cas or plan.needs_other_sets):
        raise UsageError("the keys of the CAs that stay are needed")
    with change(keystore.root, kept) as transaction, keystore.open_ledger() as ledger:
        keystore.refuse_unapproved(Covered.ROTATE)
        if ledger.head != plan.head:
            raise KeystoreError(
                "the keystore was changed after the plan was made", hint="run the command again"
            )
        made = _NewCas(plan, passphrase, pin, keys, now)
        part, old = transaction.of(keystore.set_name), kept and kept.of(keystore.set_name)
        if plan.terms.reissues:
            cas = made.following(keystore, old)
            if kept:
                refuse_known(kept, cas)
            everyone = kept.with_set(cas) if kept and plan.others else cas
            transaction.authorities = replace(everyone, compares_clock=compares_clock)
            inspector = Inspector.of(keystore, ledger, now=now)
            lines = {each.sha256: each.details for each in ledger.of_kind("governance")}
            new = _with_profile(keystore, plan.terms.profile)
            execution = _Execution(keystore, new, plan, cas, part, inspector, lines, now)
            issued, overlap = execution.run(passphrase, ledger), plan.overlap
        else:
            new, issued = keystore, []
            overlap = made.overlapping(keystore, part, kept)
            if plan.new_list and old:
                _return_list(keystore, old, ledger, part, now)
    return RolloverResult(plan=plan, keystore=new, issued=issued, overlap=overlap)


def _with_profile(keystore: Keystore, profile: Profile) -> Keystore:
    """The keystore with that profile for this set."""
    profiles = [profile if each == keystore.profile else each for each in keystore.profiles]
    return replace(keystore, profiles=tuple(profiles))


def _return_list(
    keystore: Keystore, authorities: Authorities, ledger: Ledger, part: SetChange, now: datetime
) -> None:
    """Stage an empty list, and links to it, for a set that trusts one identity CA again."""
    publisher = Publisher(keystore, authorities.identity, ledger, now)
    number = max(publisher.next_number, _last_number(keystore))
    publisher.stage(part, [], number, LIST_VALIDITY)
    for place, target in layout.missing_list_links(keystore.folder):
        part.link(place, target)


def _last_number(keystore: Keystore) -> int:
    """The largest number of a revocation list of the other sets; 0 if there is none."""
    lists = [each.revocation_list for each in keystore.sets if each != keystore]
    return max((each.number or 0 for each in lists if each), default=0)


@dataclass(frozen=True, slots=True)
class _NewCas:
    """The inputs for the new CAs of a keystore."""

    plan: RolloverPlan
    passphrase: bytes | None
    pin: Pin | None
    keys: Keys
    now: datetime

    def following(self, keystore: Keystore, kept: Authorities | None) -> Authorities:
        """The CAs that issue and sign from now on; `kept` are those of the keystore."""
        if kept and self.plan.overlap:
            other = self.plan.overlap.other
            following = next_identity_ca(keystore, other, self.passphrase, self.pin)
            return replace(kept, identity=following)
        return _replaced(self.plan, kept, new_cas(self.plan, self.now, self.keys))

    def overlapping(self, keystore: Keystore, part: SetChange, kept: Authorities | None) -> Overlap:
        """The overlap that the plan begins, finishes or cancels."""
        overlap = self.plan.overlap
        if overlap is None:
            return begin_overlap(
                keystore,
                self.plan,
                part,
                kept=kept,
                passphrase=self.passphrase,
                now=self.now,
                keys=self.keys,
            )
        if self.plan.terms.overlap is OverlapStep.FINISH:
            finish_overlap(overlap, part, self.now)
        else:
            cancel_overlap(overlap, part, self.now)
        return overlap


def _replaced(plan: RolloverPlan, kept: Authorities | None, new: Authorities) -> Authorities:
    """The CAs that issue and sign from now on: of `kept` those that the plan does not replace."""
    if kept and plan.terms.scope is Scope.IDENTITY:
        return replace(kept, identity=new.identity)
    if kept and plan.terms.scope is Scope.PERMISSIONS:
        return replace(new, identity=kept.identity)
    return new


@dataclass(frozen=True, slots=True)
class _Execution:
    """A rollover that reissues participants, while the keystore is locked."""

    old: Keystore
    new: Keystore
    plan: RolloverPlan
    authorities: Authorities
    """Those of the set."""
    part: SetChange
    inspector: Inspector
    governances: dict[str, dict[str, str]]
    """SHA-256 of each signed governance -> the details of its ledger line."""
    now: datetime

    def run(self, passphrase: bytes | None, ledger: Ledger) -> list[Issued]:
        self._archive()
        self._write_authorities(passphrase)
        enclaves = self.part.folder(layout.ENCLAVES, private=False)
        self._sign_governance(self.old.folder / layout.ENCLAVES, enclaves, "")
        issued = self._reissue()
        if self.plan.new_list:
            publisher = Publisher(self.new, self.authorities.identity, ledger, self.now)
            number = max(publisher.next_number, _last_number(self.old))
            publisher.stage(self.part, [], number, LIST_VALIDITY)
        return issued

    def _archive(self) -> None:
        """Copy the replaced files to the archive; destroy private keys if wanted."""
        archive = self.plan.archive.relative_to(self.old.folder)
        folder = self.part.folder(archive.as_posix(), private=True)
        for place in self._replaced_files():
            path = self.old.folder / place
            if not place.startswith(layout.PRIVATE):
                folder.public(path.name, read(path))
            elif not self.plan.terms.destroy:
                folder.private(path.name, read(path))
            elif path.resolve().parent != path.parent.resolve():
                raise KeystoreError(f"{path} is a link: pqsec does not destroy its target")
            else:
                self.part.shred(place)

    def _write_authorities(self, passphrase: bytes | None) -> None:
        """Write the new CAs and the settings; remove files of the old CAs without a successor."""
        public = self.part.folder(layout.PUBLIC, private=False)
        private = self.part.folder(layout.PRIVATE, private=True)
        overlap = self.plan.overlap
        trusted = overlap.issuing if overlap else None
        self.authorities.write(public, private, passphrase, trusted=trusted)
        for key in (layout.NEXT_KEY, layout.NEXT_ALT_KEY):  # now stored under its final name
            self.part.remove(f"{layout.PRIVATE}/{key}")
        written = {layout.CA_LIST, *public.names, *private.names}
        for place in self._replaced_files():
            if Path(place).name not in written:
                self.part.remove(place)
        settings = self.part.transaction.folder(".", private=False)
        settings.public(
            layout.SETTINGS,
            settings_file(self.new.profiles, self.new.domains, self.old.ledger_address),
        )
        self.part.record(*self.authorities.entries(self.now))
        if overlap:
            switched = Overlap(Phase.SWITCHED, overlap.other, overlap.issuing)
            self.part.record(trust_entry(switched, self.now))

    def _reissue(self) -> list[Issued]:
        """Reissue participants; add missing links, and remove files that they no longer need."""
        issuer = Issuer(self.new, self.authorities, self.part.number, self.now)
        names = sorted((*self.plan.keeping, *self.plan.rekeyed))
        rekeyed = frozenset(self.plan.rekeyed)

        def make(name: str, folder: StagedFolder) -> Issued:
            renewer = Renewer(issuer, self.inspector, Renewal(rekey=name in rekeyed))
            return (
                renewer.make_alike(name, folder)
                if self.plan.others
                else renewer.make(name, [folder])
            )

        folders = [self.part.folder(layout.enclave_folder(name), private=False) for name in names]
        issued = shared_out(make, names, folders)
        for each, folder in zip(issued, folders, strict=True):
            self.part.record(*each.entries)
            there = self.old.folder / layout.enclave_folder(each.name)
            governance = there / layout.GOVERNANCE
            if governance.exists() and not governance.is_symlink():  # its own copy, when adopted
                self._sign_governance(there, folder, each.name)
            self._tidy(each.name, folder)
        return issued

    def _replaced_files(self) -> list[str]:
        places = _PLACES[self.plan.terms.scope]
        return [place for place in places if (self.old.folder / place).exists()]

    def _sign_governance(self, there: Path, folder: StagedFolder, name: str) -> None:
        """Sign the governance in the folder `there` again, into `folder`."""
        old = read(there / layout.GOVERNANCE)
        with located(there / layout.GOVERNANCE):
            document = self.inspector.verified(old)
        number = self.part.number
        signed = self.authorities.sign(document, number=number, now=self.now)
        folder.public(layout.GOVERNANCE, signed)
        sha256 = hashlib.sha256(old).hexdigest()
        entry = document_entry("governance", name, signed, self.now)
        self.part.record(replace(entry, details=self.governances.get(sha256, {})))

    def _tidy(self, name: str, staged: StagedFolder) -> None:
        """Add missing links, and remove files of keys that the profile does not have."""
        folder = layout.enclave_folder(name)
        shared = layout.CA_TARGETS | (layout.LIST_TARGET if self.old.has_revocation_list else {})
        if self.authorities.countersigner:
            shared |= layout.ALT_TARGET
        else:
            self.part.remove(f"{folder}/{layout.PERMISSIONS_ALT_CA}")
        if not self.new.profile.alternative_key:
            self.part.remove(f"{folder}/{layout.ALT_KEY}")
        for link, target in layout.missing_links(self.old.folder, name, shared).items():
            staged.link(link, target)  # replaces the file of an adopted enclave
