"""Issuing participants: key, certificate and permissions for each, all or none."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import field, replace
from datetime import datetime, timedelta
from functools import partial
from typing import Self, TypeAlias

from pqsec_pki._dataclass import dataclass
from pqsec_pki._processes import shared_out
from pqsec_pki.algorithms import PrivateKey, PublicKey
from pqsec_pki.approvals import Covered
from pqsec_pki.certificates import Authority, Certificate, common_name, end_of
from pqsec_pki.documents import DomainSet, Grant, Permissions
from pqsec_pki.errors import ExistsError, KeystoreError, UsageError, VerificationError
from pqsec_pki.keystore import (
    Authorities,
    Entry,
    Keystore,
    SetChange,
    StagedFolder,
    Transaction,
    change,
    compromised_keys_in,
    layout,
    participant_states,
    refuse_further_sets,
)
from pqsec_pki.lifecycle._issuer import Issued, Issuer, PublicKeys
from pqsec_pki.lifecycle._key_checks import refuse_compromised, refuse_repeated, refuse_shared
from pqsec_pki.lifecycle._sets import SetWork, common_validity, each_set

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
    """The keys of a verified request, for each set; None to make new keys here."""
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
    """Issue all participants in `specs`, or none if one fails, in all sets of credentials.

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
    if any(spec.outside for spec in specs):
        refuse_further_sets(keystore, "a key in a token is for")
    _refuse_other_sets(keystore, specs)
    with change(keystore.root, authorities) as transaction, keystore.open_ledger() as ledger:
        keystore.refuse_unapproved(Covered.GROW)
        _refuse_issued(keystore, specs, force=force)  # by another command, since
        sets = each_set(keystore, authorities, transaction, ledger)
        for number, each in enumerate(sets):
            if not after_revocation:
                _refuse_revoked(each, specs, now)
            asked = _asked(specs, number)
            _refuse_keys(each, asked, now, compromised=compromised_keys)
            _refuse_files(each.keystore, specs)
        _refuse_ca_keys(authorities, specs)
        folders = [[each.folder(spec.name, private=True) for each in sets] for spec in specs]
        for spec in specs:
            for each in sets:
                _clear(each.part, spec)
        makers = [_Maker.of(each, transaction.number, now, at) for at, each in enumerate(sets)]
        make = partial(_issued, makers, sign_permissions=sign_permissions)
        issued = shared_out(make, specs, folders)
        transaction.record(*records)
        for participant in issued:
            for each, made in zip(sets, participant.sets, strict=True):
                each.part.record(*made.entries)
    return issued


@dataclass(frozen=True, slots=True)
class _Maker:
    """Issues participants in one set."""

    issuer: Issuer
    shared: dict[str, str]
    """The shared files that its enclaves link to."""
    at: int
    """The place of the set among those of the keystore, from 0."""

    @classmethod
    def of(cls, work: SetWork, number: int, now: datetime, at: int) -> Self:
        issuer = Issuer(work.keystore, work.authorities, number, now)
        return cls(issuer, shared_files(work.keystore, work.authorities), at)

    def certificate(
        self, spec: ParticipantSpec, folder: StagedFolder, validity: timedelta
    ) -> tuple[Certificate, str | None]:
        """A certificate for new keys or for those of a request, and the hash of that."""
        issuer = self.issuer
        given = spec.keys.sets[self.at] if spec.keys else None
        keys = given or issuer.new_keys(folder, spec.outside)
        certificate = issuer.authorities.identity.issue(
            spec.name,
            keys.key,
            alternative=keys.alternative,
            number=issuer.number,
            now=issuer.now,
            validity=validity,
        )
        if keys.csr:
            folder.public(layout.REQUEST, keys.csr)
        there = issuer.keystore.folder
        for link, target in layout.missing_links(there, spec.name, self.shared).items():
            folder.link(link, target)
        return certificate, keys.request


def _identity(makers: Iterable[_Maker]) -> list[Authority]:
    return [each.issuer.authorities.identity for each in makers]


def _issued(
    makers: Sequence[_Maker],
    spec: ParticipantSpec,
    folders: Sequence[StagedFolder],
    *,
    sign_permissions: bool,
) -> Issued:
    """The participant in all sets: keys and certificates of each, and the same permissions."""
    now, permissions, made = makers[0].issuer.now, None, []
    validity = common_validity(_identity(makers), now, spec.validity)
    asked = end_of(now, spec.validity)
    for maker, folder in zip(makers, folders, strict=True):
        certificate, request = maker.certificate(spec, folder, validity)
        if sign_permissions and permissions is None:
            permissions = permissions_for(spec, certificate)
        issued = maker.issuer.stage(
            folder,
            spec.name,
            certificate,
            permissions,
            asked=asked,
            config_digest=spec.config_digest,
            request=request,
        )
        made.append(issued)
    return replace(made[0], further=tuple(made[1:]))


def _clear(part: SetChange, spec: ParticipantSpec) -> None:
    """Remove files of the participant's previous keys: they do not belong to the new ones."""
    folder = layout.enclave_folder(spec.name)
    if spec.keys is None:
        part.remove(f"{folder}/{layout.REQUEST}")
        return
    clear_keys(part, folder)


def clear_keys(transaction: Transaction | SetChange, folder: str) -> None:
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
    if there := [name for name in names if any(each.has(name) for each in keystore.sets)]:
        raise ExistsError(
            f"already issued: {', '.join(there)}",
            hint="`pqsec permit` changes rights and `pqsec renew` renews; --force replaces key,"
            " certificate and permissions",
        )


def _refuse_other_sets(keystore: Keystore, specs: Iterable[ParticipantSpec]) -> None:
    """VerificationError for keys that are not for all sets, or for two sets or participants."""
    count = len(keystore.profiles)
    asked = {spec.name: spec.keys.sets for spec in specs if spec.keys}
    for name, keys in asked.items():
        if len(keys) != count:
            raise VerificationError(
                f"{name}: there are keys for {len(keys)} of {count} sets of credentials",
                hint="a request is for all sets, or for none",
            )
    refuse_repeated(
        {name: [(each.key, each.alternative) for each in keys] for name, keys in asked.items()}
    )


_Asked: TypeAlias = dict[str, list[PublicKey | None]]


def _asked(specs: Iterable[ParticipantSpec], at: int) -> _Asked:
    """The keys from elsewhere that each participant is to have in the set at that place."""
    found: _Asked = {}
    for spec in specs:
        if spec.keys:
            own = spec.keys.sets[at]
            found[spec.name] = [own.key, own.alternative]
        elif spec.outside:
            found[spec.name] = [key.public_key for key in spec.outside.values()]
    return found


def _refuse_keys(work: SetWork, asked: _Asked, now: datetime, *, compromised: bool) -> None:
    """VerificationError for requested keys that are compromised or another participant's."""
    if asked:
        known = {} if compromised else compromised_keys_in(work.keystore.folder, work.ledger)
        for name, keys in asked.items():
            refuse_compromised(known, name, keys)
        refuse_shared(work.ledger, asked, now)


def _refuse_ca_keys(authorities: Authorities, specs: Iterable[ParticipantSpec]) -> None:
    """VerificationError for a CA's key in a token: a participant could issue certificates."""
    cas = [ca for each in authorities.sets for ca in each.all]
    known = {key.public_key.spki for ca in cas for key in (ca.key, ca.alternative_key) if key}
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


def _refuse_revoked(work: SetWork, specs: Iterable[ParticipantSpec], now: datetime) -> None:
    names = [spec.name for spec in specs]
    states = participant_states(work.keystore, work.ledger, names, now=now)
    names = [each.name for each in states if each.revoked]
    if names:
        raise KeystoreError(
            f"revoked: {', '.join(names)}",
            hint="to admit it again, issue it with --force --after-revocation",
        )
