"""Issuing participants: key, certificate and permissions for each, all or none."""

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path

from pqsec_pki.algorithms import private_key_pem
from pqsec_pki.certificates import Certificate, common_name, end_of
from pqsec_pki.documents import DomainSet, Grant, Permissions
from pqsec_pki.errors import ExistsError, UsageError
from pqsec_pki.keystore import _journal, _layout
from pqsec_pki.keystore._journal import DraftedFolder
from pqsec_pki.keystore._ledger import Entry
from pqsec_pki.keystore.authorities import Authorities, certificate_entry, document_entry
from pqsec_pki.keystore.keystore import Keystore

_SHARED = {
    _layout.GOVERNANCE: f"{_layout.ENCLAVES}/{_layout.GOVERNANCE}",
    _layout.IDENTITY_CA: f"{_layout.PUBLIC}/{_layout.IDENTITY_CA}",
    _layout.PERMISSIONS_CA: f"{_layout.PUBLIC}/{_layout.PERMISSIONS_CA}",
}
_SHARED_ALT = {_layout.PERMISSIONS_ALT_CA: f"{_layout.PUBLIC}/{_layout.PERMISSIONS_ALT_CA}"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Wish:
    """What a participant shall be called and may do."""

    name: str
    """An enclave path, such as /fleet/robot1; also the CN of its certificate."""
    domains: DomainSet
    publish: tuple[str, ...] = ()
    """DDS topic expressions, as they stand on the wire."""
    subscribe: tuple[str, ...] = ()
    validity: timedelta
    grants: tuple[Grant, ...] = ()
    """Of a policy: their rules hold in place of the domains and topics above."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Issued:
    """What was made for one participant."""

    name: str
    folder: Path
    serial: str
    not_after: datetime
    shortened: bool
    """Whether it ends earlier than asked, because the identity CA does."""
    certificate_size: int
    """Bytes of cert.pem; it travels in every handshake."""
    permissions_size: int
    """Bytes of permissions.p7s; it travels in every handshake."""
    entries: tuple[Entry, Entry]


def issue(
    keystore: Keystore,
    authorities: Authorities,
    wishes: Sequence[Wish],
    *,
    now: datetime,
    force: bool = False,
) -> list[Issued]:
    """Make every participant wished for; on any failure, none.

    Names are taken as `Wish.name` says and must differ. ExistsError for participants
    that are there already, unless `force`; UsageError for a name, topic or validity
    that cannot be used.
    """
    wishes = _checked(keystore, wishes, force=force)
    maker = _Maker(keystore, authorities, now)
    with _journal.change(keystore.root) as draft, ThreadPoolExecutor() as pool:
        _refuse_issued(keystore, wishes, force=force)  # by another command, since
        folders = [draft.folder(_layout.enclave_folder(wish.name), private=True) for wish in wishes]
        # Signing does not hold the interpreter, so threads use every core.
        issued = list(pool.map(maker.make, wishes, folders))
        for each in issued:
            draft.record(*each.entries)
    return issued


@dataclass(frozen=True, slots=True)
class _Maker:
    keystore: Keystore
    authorities: Authorities
    now: datetime

    def make(self, wish: Wish, folder: DraftedFolder) -> Issued:
        profile, now = self.keystore.profile, self.now
        key = profile.participant_key.generate()
        second = profile.alternative_key.generate() if profile.alternative_key else None
        certificate = self.authorities.identity.issue(
            wish.name,
            key.public_key,
            alternative=second.public_key if second else None,
            now=now,
            validity=wish.validity,
        )
        permissions = permissions_for(wish, certificate).to_xml()
        signed = self.authorities.sign(permissions, now=now)
        folder.private(_layout.KEY, private_key_pem(key))
        if second:
            folder.private(_layout.ALT_KEY, private_key_pem(second))
        folder.public(_layout.CERTIFICATE, certificate.pem)
        folder.public(_layout.PERMISSIONS_XML, permissions)
        folder.public(_layout.PERMISSIONS, signed)
        self._link(wish.name, folder)
        return Issued(
            name=wish.name,
            folder=self.keystore.root / _layout.enclave_folder(wish.name),
            serial=f"{certificate.serial_number:x}",
            not_after=certificate.not_after,
            shortened=certificate.not_after < end_of(now, wish.validity),
            certificate_size=len(certificate.pem),
            permissions_size=len(signed),
            entries=(
                certificate_entry("participant", wish.name, certificate, now),
                document_entry("permissions", wish.name, signed, now),
            ),
        )

    def _link(self, name: str, folder: DraftedFolder) -> None:
        shared = _SHARED | (_SHARED_ALT if self.authorities.countersigner else {})
        for link, target in _layout.shared_links(name, shared).items():
            folder.link(link, target)


def permissions_for(wish: Wish, certificate: Certificate) -> Permissions:
    """What `wish` asks for, granted to the certificate's subject as long as it is valid.

    UsageError for a grant of a policy that is over before the certificate begins.
    """
    if wish.grants:
        return Permissions(grants=tuple(_fitted(grant, certificate) for grant in wish.grants))
    grant = Grant.least(
        name=wish.name,
        subject_name=certificate.subject_name,
        not_before=certificate.not_before,
        not_after=certificate.not_after,
        domains=wish.domains,
        publish=wish.publish,
        subscribe=wish.subscribe,
    )
    return Permissions(grants=(grant,))


def _fitted(grant: Grant, certificate: Certificate) -> Grant:
    """The grant, for the certificate's subject and while both are valid."""
    not_before = max(grant.not_before, certificate.not_before)
    not_after = min(grant.not_after, certificate.not_after)
    if not_before >= not_after:
        raise UsageError(f"the policy's grant for {grant.name} and its certificate never hold both")
    return replace(
        grant,
        subject_name=certificate.subject_name,
        not_before=not_before,
        not_after=not_after,
    )


def _checked(keystore: Keystore, wishes: Iterable[Wish], *, force: bool) -> list[Wish]:
    """The wishes with their names made regular, and nothing in the way of any."""
    regular: dict[str, Wish] = {}
    for wish in wishes:
        name = _layout.enclave_name(wish.name)
        common_name(name)  # refuses what no certificate can carry
        if name in regular:
            raise UsageError(f"{name} is asked for twice")
        regular[name] = replace(wish, name=name)
    _refuse_issued(keystore, regular.values(), force=force)
    return list(regular.values())


def _refuse_issued(keystore: Keystore, wishes: Iterable[Wish], *, force: bool) -> None:
    there = [] if force else sorted({wish.name for wish in wishes} & set(keystore.names()))
    if there:
        raise ExistsError(
            f"already issued: {', '.join(there)}",
            hint="choose another name, or --force to replace key, certificate and permissions",
        )
