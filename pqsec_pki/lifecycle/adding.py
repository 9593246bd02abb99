"""Adds a set of credentials of another profile to a keystore that runs, beside what it has.

No file of the sets before changes: new CAs sign the same governance and permissions, octet for
octet, and certify new keys of the same participants, all in one change.
"""

from dataclasses import field, replace
from datetime import datetime, timedelta
from functools import partial

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists
from pqsec_pki._processes import shared_out
from pqsec_pki.algorithms import Profile
from pqsec_pki.approvals import Covered
from pqsec_pki.errors import ExistsError, PassphraseError
from pqsec_pki.keystore import (
    GITIGNORE,
    WAIT,
    Authorities,
    CurrentFiles,
    Keystore,
    Ledger,
    SetChange,
    StagedFolder,
    Transaction,
    change,
    further,
    governance_digest,
    keystore_ignored,
    layout,
    refuse_overlap,
    settings_file,
    stage_cas,
    stage_governance,
    together,
)
from pqsec_pki.lifecycle._alike import issued_alike
from pqsec_pki.lifecycle._ca_changes import Keys, name_start, refuse_known
from pqsec_pki.lifecycle._inspector import Inspector
from pqsec_pki.lifecycle._issuer import Issued, Issuer
from pqsec_pki.lifecycle.additions import chosen, governance_to_copy
from pqsec_pki.lifecycle.revoking import LIST_VALIDITY, Publisher

_SHARED = layout.CA_TARGETS | {layout.GOVERNANCE: f"{layout.ENCLAVES}/{layout.GOVERNANCE}"}


@dataclass(frozen=True, slots=True, kw_only=True)
class AddedSet:
    """A set of credentials that was added."""

    keystore: Keystore
    """The new set."""
    authorities: Authorities = field(repr=False)
    """The CAs of all sets, the new ones among them."""
    issued: tuple[Issued, ...]
    left: tuple[str, ...]
    """Participants without credentials of the new set: their keys are not here, or their
    certificate has ended or was issued by a CA that has been replaced."""


def add_set(  # noqa: PLR0913 -- the choices are the user's, and by name
    keystore: Keystore,
    authorities: Authorities,
    profile: Profile,
    *,
    name: str | None = None,
    validity: timedelta,
    passphrase: bytes | None,
    keys: Keys = None,
    now: datetime,
) -> AddedSet:
    """Add a set of that profile, with new CAs and for all participants whose keys are here.

    The CAs are named `name` [default: as those of the first set], and the profile's name. Their
    keys are encrypted under `passphrase`, but for `keys` that are there already, by the names of
    their files; PassphraseError without one if those of the other CAs are
    encrypted. ExistsError if there is such a set; KeystoreError while two identity CAs are trusted,
    and for a document or a subject that pqsec would write otherwise; UsageError if a CA would have
    the name of another. Other machines with this ledger refuse to work until they have the new
    set's CAs.
    """
    if profile.name in {each.name for each in keystore.profiles}:
        raise ExistsError(f"the keystore has a set of profile {profile.name} already")
    if passphrase is None and keystore.is_locked():
        raise PassphraseError("the keys of the new CAs would not be encrypted, as the others are")
    there = keystore.root / layout.in_set(profile.name, "")
    if exists(there, follow=False):
        raise ExistsError(
            f"{there} exists, and is not a set of this keystore",
            hint="move it away: its files would be taken for those of the new set",
        )
    first = keystore.sets[0]
    start = name_start(first.identity_ca) if name is None else name
    with change(keystore.root, authorities) as transaction, keystore.open_ledger() as ledger:
        keystore.refuse_unapproved(Covered.ROTATE)
        for each in keystore.sets:
            refuse_overlap(each, WAIT)
        new = further(profile, start, now=now, validity=validity, keys=keys)
        refuse_known(authorities, new)
        view = replace(first, profiles=(*keystore.profiles, profile), set_name=profile.name)
        cas = together([*authorities.sets, new])
        transaction.authorities = cas
        addition = _Addition(first, view, cas, transaction, ledger, now)
        _stage_settings(view, transaction)
        addition.stage_shared(passphrase)
        issued, left = addition.issue()
    return AddedSet(keystore=view, authorities=cas, issued=tuple(issued), left=tuple(left))


def _stage_settings(keystore: Keystore, transaction: Transaction) -> None:
    beside = transaction.folder(".", private=False)
    settings = settings_file(keystore.profiles, keystore.domains, keystore.ledger_address)
    beside.public(layout.SETTINGS, settings)
    if exists(keystore.root / GITIGNORE, follow=False):
        beside.public(GITIGNORE, keystore_ignored(keystore.root))


@dataclass(frozen=True, slots=True)
class _Addition:
    first: Keystore
    new: Keystore
    cas: Authorities
    """Those of the first set, which know those of the others; the last are the new ones."""
    transaction: Transaction
    ledger: Ledger
    now: datetime

    @property
    def authorities(self) -> Authorities:
        """The CAs of the new set."""
        return self.cas.others[-1]

    @property
    def part(self) -> SetChange:
        return self.transaction.of(self.new.set_name)

    def stage_shared(self, passphrase: bytes | None) -> None:
        """Stage the CAs, the governance and, if the first set has one, a revocation list."""
        stage_cas(self.part, self.authorities, passphrase, self.now)
        document = governance_to_copy(self.first)
        digest = governance_digest(self.first) or ""
        stage_governance(self.part, self.authorities, document, now=self.now, config_digest=digest)
        with CurrentFiles.of(self.first) as current:
            has_list = layout.LIST in current.shared
        if has_list:
            before = Publisher(self.first, self.cas.identity, self.ledger, self.now)
            own = self.ledger.of(self.new.set_name)
            publisher = Publisher(self.new, self.authorities.identity, own, self.now)
            publisher.stage(self.part, [], before.last_number, LIST_VALIDITY)

    def issue(self) -> tuple[list[Issued], list[str]]:
        """Issue the participants whose keys are here; and the names of the others."""
        inspector = Inspector.of(self.first, self.ledger, now=self.now)
        found = chosen(inspector, self.now)
        folders = [
            self.part.folder(layout.enclave_folder(name), private=True) for name in found.issued
        ]
        issuer = Issuer(self.new, self.authorities, self.transaction.number, self.now)
        make = partial(_issued, issuer, inspector, self._shared())
        issued = shared_out(make, found.issued, folders)
        for each in issued:
            self.part.record(*each.entries)
        return issued, sorted(found.left)

    def _shared(self) -> dict[str, str]:
        """The shared files that the enclaves of the new set link to."""
        alternative = layout.ALT_TARGET if self.authorities.countersigner else {}
        has_list = self.transaction.stages(
            layout.in_set(self.new.set_name, layout.PUBLIC), layout.CA_LIST
        )
        return _SHARED | alternative | (layout.LIST_TARGET if has_list else {})


def _issued(
    issuer: Issuer,
    inspector: Inspector,
    shared: dict[str, str],
    name: str,
    folder: StagedFolder,
) -> Issued:
    """New keys and a certificate that ends with that of the first set, and its permissions."""
    for link, target in layout.shared_links(name, shared).items():
        folder.link(link, target)
    return issued_alike(issuer, inspector, name, folder)
