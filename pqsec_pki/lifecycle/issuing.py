"""Issuing participants: key, certificate and permissions for each, all or none."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace
from datetime import datetime, timedelta
from functools import partial

from pqsec_pki._dataclass import dataclass
from pqsec_pki._processes import shared_out
from pqsec_pki.algorithms import PrivateKey, PublicKey
from pqsec_pki.approvals import Covered
from pqsec_pki.certificates import Certificate, common_name, end_of
from pqsec_pki.documents import DomainSet, Grant, Permissions
from pqsec_pki.errors import ExistsError, KeystoreError, UsageError, VerificationError
from pqsec_pki.keystore import (
    Authorities,
    Entry,
    Keystore,
    StagedFolder,
    Transaction,
    change,
    compromised_keys_in,
    layout,
    participant_states,
)
from pqsec_pki.lifecycle._issuer import Issued, Issuer, PublicKeys
from pqsec_pki.lifecycle._key_checks import refuse_compromised, refuse_shared

_SHARED = layout.CA_TARGETS | {layout.GOVERNANCE: f"{layout.ENCLAVES}/{layout.GOVERNANCE}"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ParticipantSpec:
    """The name, permissions and keys of a participant to issue."""

    name: str
    """An enclave path, such as /fleet/robot1; also the CN of its certificate."""
    domains: DomainSet
    publish: tuple[str, ...] = ()
    """DDS topic expressions, with the topic names of the wire."""
    subscribe: tuple[str, ...] = ()
    validity: timedelta
    grants: tuple[Grant, ...] = ()
    """Grants of a policy: their rules replace the domains and topics above."""
    keys: PublicKeys | None = None
    """The keys of a verified request; None to make new keys here."""
    outside: Mapping[str, PrivateKey] = field(default_factory=dict, repr=False)
    """Keys in tokens that are to be used, by the names of their files, which will refer to them."""
    leaves_token: bool = False
    """Whether a key in a token may be followed by one in a file."""
    config_digest: str = ""
    """The caller's value, which the ledger keeps through renewals; see `ParticipantState`."""

    @property
    def has_rights(self) -> bool:
        """Whether it names a topic; without one, the permissions deny everything."""
        return bool(self.publish or self.subscribe or self.grants)

    @property
    def policy(self) -> bytes | None:
        """The permissions document with the grants of a policy; None without one."""
        return Permissions(grants=self.grants).to_xml() if self.grants else None


def issue(  # noqa: PLR0913 -- the choices are the user's, and by name
    keystore: Keystore,
    authorities: Authorities,
    specs: Sequence[ParticipantSpec],
    *,
    now: datetime,
    force: bool = False,
    after_revocation: bool = False,
    compromised_keys: bool = False,
    sign_permissions: bool = True,
    records: Sequence[Entry] = (),
) -> list[Issued]:
    """Issue all participants in `specs`, or none if one fails.

    Without `sign_permissions` they get certificates only, which needs no key of the permissions
    CA; `changed_permissions` and `sign_changed` give them rights. `records` are lines for the
    ledger, written with theirs.
    Names must differ. ExistsError for participants that exist already, unless `force`;
    KeystoreError for revoked participants, unless `after_revocation`; VerificationError for
    keys that were revoked as compromised, unless `compromised_keys`, and for keys of another
    participant or a CA; UsageError for an invalid name, topic or validity, and if a key in a token
    would be followed by one in a file, unless the spec `leaves_token`.
    """
    specs = _checked(keystore, specs, force=force)
    with change(keystore.root, authorities) as transaction:
        keystore.refuse_unapproved(Covered.GROW)
        _refuse_issued(keystore, specs, force=force)  # by another command, since
        if not after_revocation:
            _refuse_revoked(keystore, specs, now)
        _refuse_keys(keystore, specs, now, compromised=compromised_keys)
        _refuse_ca_keys(authorities, specs)
        _refuse_files(keystore, specs)
        shared = shared_files(keystore, authorities)
        folders = [
            transaction.folder(layout.enclave_folder(spec.name), private=True) for spec in specs
        ]
        for spec in specs:
            _clear(transaction, spec)
        issuer = Issuer(keystore, authorities, transaction.number, now)
        make = partial(_make, issuer, shared, sign_permissions=sign_permissions)
        issued = shared_out(make, specs, folders)
        transaction.record(*records)
        for each in issued:
            transaction.record(*each.entries)
    return issued


def _make(
    issuer: Issuer,
    shared: dict[str, str],
    spec: ParticipantSpec,
    folder: StagedFolder,
    *,
    sign_permissions: bool,
) -> Issued:
    keys = spec.keys or issuer.new_keys(folder, spec.outside)
    certificate = issuer.authorities.identity.issue(
        spec.name,
        keys.key,
        alternative=keys.alternative,
        number=issuer.number,
        now=issuer.now,
        validity=spec.validity,
    )
    if keys.csr:
        folder.public(layout.REQUEST, keys.csr)
    for link, target in layout.missing_links(issuer.keystore.folder, spec.name, shared).items():
        folder.link(link, target)
    permissions = permissions_for(spec, certificate) if sign_permissions else None
    asked = end_of(issuer.now, spec.validity)
    return issuer.stage(
        folder,
        spec.name,
        certificate,
        permissions,
        asked=asked,
        config_digest=spec.config_digest,
        request=keys.request,
    )


def _clear(transaction: Transaction, spec: ParticipantSpec) -> None:
    """Remove files of the participant's previous keys: they do not belong to the new ones."""
    folder = layout.enclave_folder(spec.name)
    if spec.keys is None:
        transaction.remove(f"{folder}/{layout.REQUEST}")
        return
    clear_keys(transaction, folder)


def clear_keys(transaction: Transaction, folder: str) -> None:
    """Remove the private keys in the folder of a participant whose keys are elsewhere now."""
    for key in layout.KEYS:
        transaction.shred(f"{folder}/{key}")
        transaction.remove(f"{folder}/{key}")


def shared_files(keystore: Keystore, authorities: Authorities) -> dict[str, str]:
    """The shared files that all enclaves link to."""
    shared = _SHARED | (layout.ALT_TARGET if authorities.countersigner else {})
    return shared | (layout.LIST_TARGET if keystore.has_revocation_list else {})


def permissions_for(spec: ParticipantSpec, certificate: Certificate) -> Permissions:
    """The permissions of `spec` for the certificate's subject, while the certificate is valid.

    UsageError for a policy's grant that ends before the certificate begins.
    """
    if spec.grants:
        return Permissions(grants=tuple(_fitted(grant, certificate) for grant in spec.grants))
    grant = Grant.least(
        name=spec.name,
        subject_name=certificate.subject_name,
        not_before=certificate.not_before,
        not_after=certificate.not_after,
        domains=spec.domains,
        publish=spec.publish,
        subscribe=spec.subscribe,
    )
    return Permissions(grants=(grant,))


def _fitted(grant: Grant, certificate: Certificate) -> Grant:
    """The grant for the certificate's subject, limited to the certificate's validity."""
    not_before = max(grant.not_before, certificate.not_before)
    not_after = min(grant.not_after, certificate.not_after)
    if not_before >= not_after:
        raise UsageError(
            f"the policy's grant for {grant.name} and its certificate are never valid together"
        )
    return replace(
        grant,
        subject_name=certificate.subject_name,
        not_before=not_before,
        not_after=not_after,
    )


def _checked(
    keystore: Keystore, specs: Iterable[ParticipantSpec], *, force: bool
) -> list[ParticipantSpec]:
    """The specs with normalized names; errors as of `issue`."""
    regular: dict[str, ParticipantSpec] = {}
    for spec in specs:
        name = layout.enclave_name(spec.name)
        common_name(name)  # refuses what no certificate can carry
        if name in regular:
            raise UsageError(f"{name} is given twice")
        regular[name] = replace(spec, name=name)
    _refuse_issued(keystore, regular.values(), force=force)
    return list(regular.values())


def _refuse_issued(keystore: Keystore, specs: Iterable[ParticipantSpec], *, force: bool) -> None:
    if force:
        return
    names = sorted(spec.name for spec in specs)
    if elsewhere := keystore.elsewhere(names):
        raise ExistsError(
            f"already issued on another machine with this ledger: {', '.join(elsewhere)}",
            hint="work there; --force issues it here, with new key, certificate and permissions",
        )
    if there := list(filter(keystore.has, names)):
        raise ExistsError(
            f"already issued: {', '.join(there)}",
            hint="`pqsec permit` changes rights and `pqsec renew` renews; --force replaces key,"
            " certificate and permissions",
        )


def _refuse_keys(
    keystore: Keystore, specs: Iterable[ParticipantSpec], now: datetime, *, compromised: bool
) -> None:
    """VerificationError for requested keys that are compromised or another participant's."""
    asked: dict[str, list[PublicKey | None]] = {
        spec.name: [*spec.keys[:2]] if spec.keys else [key.public_key for key in outside]
        for spec in specs
        if (outside := [*spec.outside.values()]) or spec.keys
    }
    if asked:
        with keystore.open_ledger() as ledger:
            known = {} if compromised else compromised_keys_in(keystore.folder, ledger)
            for name, keys in asked.items():
                refuse_compromised(known, name, keys)
            refuse_shared(ledger, asked, now)


def _refuse_ca_keys(authorities: Authorities, specs: Iterable[ParticipantSpec]) -> None:
    """VerificationError for a CA's key in a token: a participant could issue certificates."""
    cas = (authorities.identity, authorities.permissions, authorities.countersigner)
    known = {key.public_key.spki for ca in cas if ca for key in (ca.key, ca.alternative_key) if key}
    for spec in specs:
        if any(key.public_key.spki in known for key in spec.outside.values()):
            raise VerificationError(
                f"{spec.name}: that key is a CA's (CVE-2023-24010)",
                hint="name a key of its own for the participant",
            )


def _refuse_files(keystore: Keystore, specs: Iterable[ParticipantSpec]) -> None:
    """UsageError if a key in a token would be followed by one in a file."""
    for spec in specs:
        if spec.keys or spec.leaves_token:
            continue
        if outside := keystore.keys_outside(spec.name) - spec.outside.keys():
            raise UsageError(
                f"{min(outside)} of {spec.name} is in a token, and the new key would be in a file",
                hint="name the new key's place: --participant-key-uri (--alt-key-uri) URI, or"
                " `file` for a file",
            )


def _refuse_revoked(keystore: Keystore, specs: Iterable[ParticipantSpec], now: datetime) -> None:
    with keystore.open_ledger() as ledger:
        states = participant_states(keystore, ledger, [spec.name for spec in specs], now=now)
        names = [each.name for each in states if each.revoked]
    if names:
        raise KeystoreError(
            f"revoked: {', '.join(names)}",
            hint="to admit it again, issue it with --force --after-revocation",
        )
