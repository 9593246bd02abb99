"""Creates the files of one participant, for issuing and for renewing."""

from collections.abc import Iterable, Mapping
from dataclasses import field, replace
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from pqsec_pki._dataclass import dataclass
from pqsec_pki._times import said
from pqsec_pki.algorithms import PrivateKey, PublicKey
from pqsec_pki.certificates import Certificate
from pqsec_pki.documents import Permissions
from pqsec_pki.keystore import (
    Authorities,
    Entry,
    Keystore,
    StagedFolder,
    certificate_entry,
    document_entry,
    layout,
)
from pqsec_pki.tokens import key_file


class PublicKeys(NamedTuple):
    """The public keys of a participant's certificate."""

    key: PublicKey
    alternative: PublicKey | None
    request: str | None = None
    """SHA-256, in hex, of the request, for the ledger."""
    csr: bytes | None = None
    """The certificate signing request, in PEM; the private keys are where it was made."""
    further: "tuple[PublicKeys, ...]" = ()
    """The keys of its certificates of the further sets."""

    @property
    def sets(self) -> "tuple[PublicKeys, ...]":
        """The keys of each set, those of the first one first."""
        return (self, *self.further)

    def answering(self, request: str) -> "PublicKeys":
        """These keys, requested in what has that SHA-256."""
        further = tuple(each._replace(request=request) for each in self.further)
        return self._replace(request=request, further=further)


@dataclass(frozen=True, slots=True, kw_only=True)
class Issued:
    """What was issued to one participant."""

    name: str
    folder: Path
    serial: str
    not_after: datetime
    shortened: bool
    """Whether the certificate ends earlier than asked, because the identity CA does."""
    certificate_size: int
    """Bytes of cert.pem, which is sent in every handshake."""
    permissions_size: int
    """Bytes of permissions.p7s, which is sent in every handshake; 0 if it is not signed yet."""
    entries: tuple[Entry, ...] = field(repr=False)
    profile: str
    """That of the set of credentials."""
    further: tuple["Issued", ...] = ()
    """What was issued to it in the further sets."""

    @property
    def sets(self) -> "tuple[Issued, ...]":
        """What was issued in each set, the first one first."""
        return (self, *self.further)

    @property
    def row(self) -> tuple[str, str, str]:
        """Name, end and place."""
        return self.name, f"until {said(self.not_after)}", str(self.folder)

    def to_json(self) -> dict[str, object]:
        """The participant for --json."""
        return {
            "name": self.name,
            "folder": self.folder,
            "serial": self.serial,
            "not_after": self.not_after,
            "certificate_bytes": self.certificate_size,
            "permissions_bytes": self.permissions_size,
            "further": [{"profile": each.profile, **each.to_json()} for each in self.further],
        }


@dataclass(frozen=True, slots=True)
class Issuer:
    """Creates keys, certificates and permissions with the CAs of a keystore, at `now`."""

    keystore: Keystore
    authorities: Authorities
    number: int
    """The sequence number of what is issued, `Transaction.number`."""
    now: datetime

    def new_keys(
        self, folder: StagedFolder, outside: Mapping[str, PrivateKey] | None = None
    ) -> PublicKeys:
        """Generate the profile's keys, but those `outside`; stage key.pem and alt.key.pem."""
        profile, given = self.keystore.profile, outside or {}
        first = given.get(layout.KEY) or profile.participant_key.generate()
        second = given.get(layout.ALT_KEY)
        if profile.alternative_key and second is None:
            second = profile.alternative_key.generate()
        for name, key in ((layout.KEY, first), (layout.ALT_KEY, second)):
            if key:
                folder.private(name, key_file(key))
        return PublicKeys(first.public_key, second.public_key if second else None)

    def stage(  # noqa: PLR0913 -- used within this room only
        self,
        folder: StagedFolder,
        name: str,
        certificate: Certificate,
        permissions: Permissions | None,
        *,
        asked: datetime,
        config_digest: str = "",
        request: str | None = None,
    ) -> Issued:
        """Stage the certificate and signed permissions; `asked` is the end that was asked for.

        Without permissions, only the certificate. `config_digest` and `request`, the hash of the
        request, are copied into the ledger.
        """
        extra = {"mark": config_digest, "request": request or ""}
        folder.public(layout.CERTIFICATE, certificate.pem)
        entries = [self._certificate_entry(name, certificate, permissions, extra)]
        signed = b""
        if permissions:
            signed, entry = stage_permissions(
                folder, self.authorities, name, permissions, number=self.number, now=self.now
            )
            entries.append(entry)
        return Issued(
            name=name,
            folder=self.keystore.folder / layout.enclave_folder(name),
            serial=f"{certificate.serial_number:x}",
            not_after=certificate.not_after,
            shortened=certificate.not_after < asked,
            certificate_size=len(certificate.pem),
            permissions_size=len(signed),
            entries=tuple(entries),
            profile=self.keystore.profile.name,
        )

    def _certificate_entry(
        self,
        name: str,
        certificate: Certificate,
        permissions: Permissions | None,
        extra: dict[str, str],
    ) -> Entry:
        domains = domains_of(permissions, certificate.subject_name) if permissions else ""
        return certificate_entry(
            "participant",
            name,
            certificate,
            self.now,
            issuer=self.authorities.identity.certificate,
            details={
                "profile": self.keystore.profile.name,
                "domains": domains,
            }
            | {key: text for key, text in extra.items() if text},
        )


def stage_permissions(  # noqa: PLR0913 -- used within this room only
    folder: StagedFolder,
    authorities: Authorities,
    name: str,
    permissions: Permissions,
    *,
    number: int,
    now: datetime,
    subject: str = "",
    config_digest: str = "",
) -> tuple[bytes, Entry]:
    """Sign the permissions of `name` and stage both files. Returns the S/MIME file and its entry.

    With the subject of its certificate, the entry has the domains that are allowed now.
    """
    document = permissions.to_xml()
    signed = authorities.sign(document, number=number, now=now)
    folder.public(layout.PERMISSIONS_XML, document)
    folder.public(layout.PERMISSIONS, signed)
    details = {"mark": config_digest} if config_digest else {}
    if subject:
        details["domains"] = domains_of(permissions, subject)
    return signed, replace(document_entry("permissions", name, signed, now), details=details)


def domains_of(permissions: Permissions, subject: str) -> str:
    """The domains where an allow rule of the subject applies, as 0,2-5; empty if there are none."""
    parts: Iterable[object] = (
        part
        for grant in permissions.grants
        if grant.subject_name == subject
        for rule in grant.rules
        if rule.allow
        for part in rule.domains.parts
    )
    return ",".join(dict.fromkeys(map(str, parts)))
