"""Scans a keystore of another tool: the files that its CAs issued, as ledger entries."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import field, replace
from datetime import datetime
from pathlib import Path
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists, read, walk
from pqsec_pki.algorithms import load_private_key
from pqsec_pki.certificates import Certificate, Reason, RevocationList
from pqsec_pki.credentials import TrustAnchors
from pqsec_pki.documents import DomainSet, Governance, Permissions
from pqsec_pki.errors import KeystoreError, PassphraseError, PqsecError, VerificationError
from pqsec_pki.keystore import (
    ABOVE,
    Entry,
    Keystore,
    certificate_entry,
    document_entry,
    layout,
    list_entry,
    load_certificate,
    load_revocation_list,
)
from pqsec_pki.lifecycle._issuer import domains_of
from pqsec_pki.tokens import is_reference, uri_in


@dataclass(slots=True, kw_only=True)
class KeystoreScan:
    """The content of a keystore's folder, filled by `run`."""

    keystore: Keystore
    now: datetime
    anchors: TrustAnchors
    domains: DomainSet
    """The domains of the governance, after it was read."""
    list_file: Path | None = None
    """The revocation list in the enclaves; the newest, if they differ."""
    entries: list[Entry] = field(default_factory=list)
    """New lines for the ledger."""
    highest: int = 0
    """The largest sequence number of the certificates and documents that are entered."""
    participants: dict[int, str] = field(default_factory=dict)
    """Serial number -> name."""
    refused: dict[str, str] = field(default_factory=dict)
    """Files, relative to the keystore, that are not entered in the ledger, and why."""

    @classmethod
    def of(cls, keystore: Keystore, now: datetime) -> Self:
        """A scan that has read the CAs only."""
        return cls(
            keystore=keystore,
            now=now,
            anchors=keystore.issuing_cas,
            domains=keystore.domains,
        )

    @property
    def identity_ca(self) -> Certificate:
        """The identity CA that issues."""
        return self.anchors.identity_ca

    @property
    def permissions_ca(self) -> Certificate:
        """The permissions CA, which signs documents."""
        return self.anchors.permissions_ca

    def run(self) -> None:
        """Read the CAs, the governance, every enclave, and the enclaves' revocation list."""
        self._check_ca_files()
        self._authority("identity-ca", self.identity_ca)
        self._authority("permissions-ca", self.permissions_ca)
        if self.anchors.countersigner:
            self._authority("permissions-ca", self.anchors.countersigner)
        with self._reported(f"{layout.ENCLAVES}/{layout.GOVERNANCE}") as path:
            governance = Governance.from_xml(self._document("governance", "", path))
            domains = governance.domain_rules[0].domains
            if domains.is_read_alike:  # else the default stays: PQS231 is about this governance
                self.domains = domains
        names = self.keystore.names()
        for name in names:
            self._participant(name)
        for folder, here in walk(self.keystore.folder / layout.ENCLAVES):
            path = folder / layout.CERTIFICATE
            if path.name in here and not exists(path):
                place = str(path.relative_to(self.keystore.folder))
                self.refused[place] = f"a link to {path.readlink()}, which is not there"
        self._find_list(names)
        if self.highest:  # what robots have is of a ledger that was lost: later ones are larger
            first = self.entries[0]
            details = {**first.details, ABOVE: str(self.highest)}
            self.entries[0] = replace(first, details=details)

    def _check_ca_files(self) -> None:
        """Report further certificates in a CA's file, and CA keys that are missing or wrong."""
        for role, ca in (("identity", self.identity_ca), ("permissions", self.permissions_ca)):
            with self._reported(f"{layout.PUBLIC}/{role}_ca.cert.pem") as path:
                count = len(Certificate.all_from_pem(read(path)))
                if count > 1:
                    raise KeystoreError(f"{count} certificates: the first one is the CA")
            with self._reported(f"{layout.PRIVATE}/{role}_ca.key.pem") as path:
                _check_key(path, ca)

    def _authority(self, kind: str, ca: Certificate) -> None:
        self.entries.append(certificate_entry(kind, ca.subject_name, ca, self.now))

    def _participant(self, name: str) -> None:
        folder, details = layout.enclave_folder(name), {"profile": self.keystore.profile.name}
        with self._reported(f"{folder}/{layout.CERTIFICATE}") as path:
            certificate = self._certificate(name, path)
            self.participants[certificate.serial_number] = name
            self.highest = max(self.highest, certificate.number or 0)
            with self._reported(f"{folder}/{layout.PERMISSIONS}") as signed:
                permissions = Permissions.from_xml(self._document("permissions", name, signed))
                details["domains"] = domains_of(permissions, certificate.subject_name)
            what = ("participant", name, certificate, self.now)
            self.entries.append(certificate_entry(*what, issuer=self.identity_ca, details=details))

    def _certificate(self, name: str, path: Path) -> Certificate:
        """The certificate at `path`, issued by the identity CA with a unique serial number."""
        layout.enclave_name(name)
        certificate, ca = load_certificate(path), self.identity_ca
        begin = max(certificate.not_before, ca.not_before)  # it may have expired
        problems = list(self.anchors.identity_problems(certificate, begin))
        if problems:
            raise VerificationError(*problems)
        other = self.participants.get(certificate.serial_number)
        if other:
            raise KeystoreError(f"its serial number is also that of {other}")
        return certificate

    def _document(self, kind: str, name: str, path: Path) -> bytes:
        """The document in a signed file, verified with the permissions CA."""
        signed = read(path)
        verified = self.anchors.signed(signed)
        self.highest = max(self.highest, verified.signatures[0].number or 0)
        self.entries.append(document_entry(kind, name, signed, self.now))
        return verified.document

    def _find_list(self, names: list[str]) -> None:
        """Find the newest list. It stays valid: the CA's next list includes its revocations."""
        lists: dict[Path, RevocationList] = {}
        for place in (f"{layout.enclave_folder(name)}/{layout.LIST}" for name in names):
            if os.path.lexists(self.keystore.folder / place):
                with self._reported(place) as path:
                    found = load_revocation_list(path)
                    twice = self.anchors.signed_twice
                    found.verify(self.identity_ca, require_alternative=twice)
                    lists[path] = found
        self.list_file = max(lists, key=lambda path: lists[path].number or 0, default=None)
        if self.list_file:
            self._enter_list(lists[self.list_file], read(self.list_file))

    def _enter_list(self, found: RevocationList, pem: bytes) -> None:
        reasons = {each.serial_number: each.reason for each in found.revoked}
        issued = [each for each in self.entries if each.kind == "participant"]
        for each in issued:
            if each.serial_number in reasons:
                reason = reasons[each.serial_number] or Reason.UNSPECIFIED.value
                self.entries.append(replace(each, kind="revocation", details={"reason": reason}))
        self.entries.append(list_entry(found, pem, self.identity_ca, self.now))

    @contextmanager
    def _reported(self, place: str) -> Iterator[Path]:
        """The file at `place`; an error in the block is recorded in `refused`."""
        path = self.keystore.folder / place
        try:
            yield path
        except PqsecError as error:
            self.refused[place] = error.words_at(path)


def _check_key(path: Path, ca: Certificate) -> None:
    """KeystoreError, FileError or MalformedError if the key at `path` is not usable for `ca`.

    An encrypted key, and one in a token, is only checked when it is used.
    """
    data = read(path)
    if is_reference(data):
        uri_in(data)
        return
    with suppress(PassphraseError):
        if load_private_key(data).public_key.spki != ca.spki:
            raise KeystoreError("the key does not match the CA's certificate: it cannot issue")
