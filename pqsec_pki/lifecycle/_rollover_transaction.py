"""The parts of a rollover, staged in one transaction."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from pqsec_pki._files import read
from pqsec_pki._processes import shared_out
from pqsec_pki.certificates import Authority
from pqsec_pki.errors import KeystoreError, located
from pqsec_pki.keystore import (
    Authorities,
    Keystore,
    Ledger,
    Overlap,
    Phase,
    StagedFolder,
    Transaction,
    document_entry,
    layout,
    settings_file,
    trust_entry,
)
from pqsec_pki.lifecycle._inspector import Inspector
from pqsec_pki.lifecycle._issuer import Issued, Issuer
from pqsec_pki.lifecycle.renewing import Renewal, Renewer
from pqsec_pki.lifecycle.revoking import LIST_VALIDITY, Publisher
from pqsec_pki.lifecycle.rollover import Rollover, Scope, gets_keys

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


@dataclass(frozen=True, slots=True)
class RolloverTransaction:
    """One rollover, while the keystore is locked."""

    old: Keystore
    new: Keystore
    terms: Rollover
    authorities: Authorities
    transaction: Transaction
    inspector: Inspector
    governances: dict[str, dict[str, str]]
    """SHA-256 of each signed governance -> the details of its ledger entry."""
    now: datetime
    successor: Authority | None
    """The next identity CA, if the old one stays trusted."""

    def archive(self, number: int) -> None:
        """Copy the replaced files to generation `number`; destroy private keys if wanted."""
        folder = self.transaction.folder(f"{layout.GENERATIONS}/{number}", private=True)
        for place in self._replaced_files():
            path = self.old.root / place
            if not place.startswith(layout.PRIVATE):
                folder.public(path.name, read(path))
            elif not self.terms.destroy:
                folder.private(path.name, read(path))
            elif path.resolve().parent != path.parent.resolve():
                raise KeystoreError(f"{path} is a link: pqsec does not destroy its target")
            else:
                self.transaction.shred(place)

    def write_authorities(self, passphrase: bytes | None) -> None:
        """Write the new CAs and the settings; remove files of the old CAs without a successor."""
        public = self.transaction.folder(layout.PUBLIC, private=False)
        private = self.transaction.folder(layout.PRIVATE, private=True)
        trusted = self.old.identity_ca if self.successor else None
        self.authorities.write(public, private, passphrase, trusted=trusted)
        for key in (layout.NEXT_KEY, layout.NEXT_ALT_KEY):  # now stored under its final name
            self.transaction.remove(f"{layout.PRIVATE}/{key}")
        written = {layout.CA_LIST, *public.names, *private.names}
        for place in self._replaced_files():
            if Path(place).name not in written:
                self.transaction.remove(place)
        settings = self.transaction.folder(".", private=False)
        settings.public(layout.SETTINGS, settings_file(self.new.profile, self.new.domains))
        self.transaction.record(*self.authorities.entries(self.now))
        if self.successor:
            overlap = Overlap(Phase.SWITCHED, self.successor.certificate, self.old.identity_ca)
            self.transaction.record(trust_entry(overlap, self.now))

    def sign_governance(self) -> None:
        """Sign the governance of the old permissions CA with the new one."""
        enclaves = self.transaction.folder(layout.ENCLAVES, private=False)
        self._sign(self.old.root / layout.ENCLAVES / layout.GOVERNANCE, enclaves, "")

    def reissue(self, names: Sequence[str]) -> list[Issued]:
        """Reissue every participant in `names`; add missing links, remove files it needs no more.

        VerificationError for documents that the old permissions CA did not sign.
        """
        folders = [
            self.transaction.folder(layout.enclave_folder(name), private=False) for name in names
        ]
        issued = shared_out(self._make, names, folders)
        for each, folder in zip(issued, folders, strict=True):
            self.transaction.record(*each.entries)
            governance = self._enclave(each.name) / layout.GOVERNANCE
            if governance.exists() and not governance.is_symlink():  # its own copy, when adopted
                self._sign(governance, folder, each.name)
            self._tidy(each.name, folder)
        return issued

    def publish_list(self, ledger: Ledger) -> bool:
        """Issue a list of the new identity CA, if the old one had a list; True if it did."""
        needed = self.terms.scope is not Scope.PERMISSIONS and self.old.has_revocation_list
        if needed:
            publisher = Publisher(self.new, self.authorities.identity, ledger, self.now)
            publisher.stage(self.transaction, [], LIST_VALIDITY)
        return needed

    def _replaced_files(self) -> list[str]:
        return [place for place in _PLACES[self.terms.scope] if (self.old.root / place).exists()]

    def _enclave(self, name: str) -> Path:
        return self.old.root / layout.enclave_folder(name)

    def _make(self, name: str, folder: StagedFolder) -> Issued:
        issuer = Issuer(self.new, self.authorities, self.now)
        renewal = Renewal(rekey=gets_keys(self.old, self.terms, self.inspector, name))
        return Renewer(issuer, self.inspector, renewal).make(name, folder)

    def _sign(self, path: Path, folder: StagedFolder, name: str) -> None:
        old = read(path)
        with located(path):
            document = self.inspector.verified(old)
        signed = self.authorities.sign(document, now=self.now)
        folder.public(layout.GOVERNANCE, signed)
        details = self.governances.get(hashlib.sha256(old).hexdigest(), {})
        self.transaction.record(
            replace(document_entry("governance", name, signed, self.now), details=details)
        )

    def _tidy(self, name: str, staged: StagedFolder) -> None:
        """Add missing links, and remove files of keys that the profile does not have."""
        folder = layout.enclave_folder(name)
        shared = layout.CA_TARGETS | (layout.LIST_TARGET if self.old.has_revocation_list else {})
        if self.authorities.countersigner:
            shared |= layout.ALT_TARGET
        else:
            self.transaction.remove(f"{folder}/{layout.PERMISSIONS_ALT_CA}")
        if not self.new.profile.alternative_key:
            self.transaction.remove(f"{folder}/{layout.ALT_KEY}")
        for link, target in layout.shared_links(name, shared).items():
            there = self.old.root / folder / link
            if not (there.is_symlink() and str(there.readlink()) == target):
                staged.link(link, target)  # replaces the file of an adopted enclave
