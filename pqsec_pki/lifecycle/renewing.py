"""Renews participants: a new certificate and new permissions with the same content.

Certificate and permissions are made together and end together. The content is read from the
signed permissions in the participant's folder, after the permissions CA's signature was
verified; they must be the newest in the ledger.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors
from pqsec_pki._processes import shared_out
from pqsec_pki._times import said
from pqsec_pki.algorithms import Profile
from pqsec_pki.approvals import Covered
from pqsec_pki.certificates import BACKDATE, Authority, Certificate, end_of
from pqsec_pki.documents import Grant, Permissions
from pqsec_pki.errors import KeystoreError, UnknownAlgorithmError
from pqsec_pki.keystore import (
    Authorities,
    Keystore,
    Overlap,
    StagedFolder,
    change,
    layout,
    list_status,
    load_certificate,
)
from pqsec_pki.lifecycle._alike import issued_alike
from pqsec_pki.lifecycle._inspector import Inspector
from pqsec_pki.lifecycle._issuer import Issued, Issuer, PublicKeys
from pqsec_pki.lifecycle._key_checks import refuse_compromised
from pqsec_pki.lifecycle._sets import SetWork, common_validity, each_set
from pqsec_pki.lifecycle.revoking import LIST_VALIDITY, publish


@dataclass(frozen=True, slots=True)
class Renewal:
    """How to renew."""

    rekey: bool | None = None
    """Whether to make new keys, or keep the public keys of the certificate; None makes new keys if
    the private key is here, and people need not approve rights that grow."""
    validity: timedelta | None = None
    """The validity from now on; None for the validity of the old certificate."""
    due: timedelta | None = None
    """A revocation list that ends within this time is issued again; None as in `status`."""
    compromised_keys: bool = False
    """Whether keys that were revoked as compromised may be kept."""
    sign_permissions: bool = True
    """Whether to sign permissions for the new certificate; the others stay until their end."""


def renew(
    keystore: Keystore,
    authorities: Authorities,
    names: Sequence[str],
    terms: Renewal = Renewal(),  # noqa: B008 -- a frozen value
    *,
    now: datetime,
) -> list[Issued]:
    """Issue a new certificate and new permissions to all participants in `names`, or to none.

    In each set of credentials that they have, with the same permissions. Revocation lists are
    issued again too if one is due. New keys that were asked for, and a longer
    validity, are rights that grow. KeystoreError for a participant that does
    not exist, was revoked, or has files that are not its newest; VerificationError for
    permissions that the CA did not sign.
    """
    regular = list(dict.fromkeys(map(layout.enclave_name, names)))
    if terms.rekey is None and _shows_new_keys(keystore):
        terms = replace(terms, rekey=False)
    with change(keystore.root, authorities) as transaction, keystore.open_ledger() as ledger:
        longer = terms.validity and lasts_longer(keystore, regular, terms.validity)
        keystore.refuse_unapproved(Covered.GROW if longer or terms.rekey else Covered.OTHER)
        sets = each_set(keystore, authorities, transaction, ledger)
        renewer = _renewer(sets, regular, terms, transaction.number, now)
        folders = [renewer.folders(sets, name) for name in regular]
        renewed = shared_out(renewer.make, regular, folders)
        parts = {each.keystore.profile.name: each.part for each in sets}
        for each in (made for participant in renewed for made in participant.sets):
            parts[each.profile].record(*each.entries)
        with_lists = [each for each in sets if not Overlap.of(each.keystore)]
        lists = [
            list_status(each.keystore, each.ledger, now=now, due=terms.due) for each in with_lists
        ]
        there = [each for each in lists if each]
        lost = there and len(there) < len(with_lists)
        if lost or any(each.state.calls_for_renewal for each in there):
            publish(with_lists, [], LIST_VALIDITY, now)
    return renewed


def _renewer(
    sets: Sequence[SetWork], names: Sequence[str], terms: Renewal, number: int, now: datetime
) -> "Renewer":
    """The renewer of the first set, with those of the others; refuses what cannot be renewed."""
    made: list[Renewer] = []
    for each in reversed(sets):
        inspector = Inspector.of(each.keystore, each.ledger, names, now=now)
        inspector.refuse_revoked(names)
        inspector.refuse_previous_ca(names)
        issuer = Issuer(each.keystore, each.authorities, number, now)
        made = [Renewer(issuer, inspector, terms, tuple(made)), *made]
    return made[0]


def _shows_new_keys(keystore: Keystore) -> bool:
    """Whether people approve rights that grow: then a new key is one that they were shown."""
    policy = keystore.approvals
    return policy is not None and Covered.GROW in policy.covers


@dataclass(frozen=True, slots=True)
class Renewer:
    """Reissues a participant from the files that the inspector verified."""

    issuer: Issuer
    inspector: Inspector
    terms: Renewal
    others: "tuple[Renewer, ...]" = ()
    """Those of the further sets."""

    def folders(self, sets: Sequence[SetWork], name: str) -> list[StagedFolder | None]:
        """Stage the participant's folder in each set; None where it has no certificate yet."""
        has = [True, *(name in each.inspector.participants for each in self.others)]
        staged = zip(sets, has, strict=True)
        return [each.folder(name, private=False) if there else None for each, there in staged]

    def make(self, name: str, folders: Sequence[StagedFolder | None]) -> Issued:
        """Stage certificate, permissions and, if new, the keys, into the folder of each set.

        The permissions of this set, for the new certificate's time, are those of all.
        """
        now, there = self.issuer.now, self._there(name)
        with disk_errors(there):
            old = self.inspector.certificate(name, there)
            signs = self.terms.sign_permissions
            allowed = self.inspector.permissions(name, there) if signs else None
        wanted = self.terms.validity or _length(old)
        validity = common_validity(self._cas, now, wanted)
        permissions, digest, made = None, "", list[Issued]()
        for each, folder in zip((self, *self.others), folders, strict=True):
            if folder is None:
                continue
            certificate = each.certificate(name, folder, validity)
            if allowed and permissions is None:
                grants = tuple(_moved(grant, old, certificate) for grant in allowed.grants)
                permissions = Permissions(grants=grants)
                digest = self.inspector.config_digest(name, there)
            made.append(
                each.issuer.stage(
                    folder,
                    name,
                    certificate,
                    permissions,
                    asked=end_of(now, wanted),
                    config_digest=digest,
                )
            )
        return replace(made[0], further=tuple(made[1:]))

    def make_alike(self, name: str, folder: StagedFolder) -> Issued:
        """Stage a certificate that ends as the old one, and the same permissions signed again.

        So this set says what the others say, of which nothing is made.
        """
        there = self._there(name)
        with disk_errors(there):
            old = self.inspector.certificate(name, there)
            self.inspector.permissions(name, there)
        return issued_alike(
            self.issuer, self.inspector, name, folder, self._next_keys(name, old, folder)
        )

    def certificate(self, name: str, folder: StagedFolder, validity: timedelta) -> Certificate:
        """The next certificate of this set; stages its keys, if they are new."""
        there = self._there(name)
        with disk_errors(there):
            old = self.inspector.certificate(name, there)
            keys = self._next_keys(name, old, folder)
        return self.issuer.authorities.identity.issue(
            name,
            keys.key,
            alternative=keys.alternative,
            number=self.issuer.number,
            now=self.issuer.now,
            validity=validity,
        )

    def _next_keys(self, name: str, old: Certificate, folder: StagedFolder) -> PublicKeys:
        """The keys of the next certificate; stages them, if they are new."""
        rekey = self._rekey(name, self.issuer.keystore.has_key(name))
        return self.issuer.new_keys(folder) if rekey else self._kept_keys(name, old)

    @property
    def _cas(self) -> list[Authority]:
        return [each.issuer.authorities.identity for each in (self, *self.others)]

    def _there(self, name: str) -> Path:
        return self.issuer.keystore.folder / layout.enclave_folder(name)

    def _rekey(self, name: str, has_key: bool) -> bool:  # noqa: FBT001 -- of this module only
        if self.terms.rekey and not has_key:
            raise KeystoreError(
                f"the key of {name} is not here, but on its robot or in a token",
                hint="keep it (--keep-key), or make a new one where the old one is",
            )
        return has_key if self.terms.rekey is None else self.terms.rekey

    def _kept_keys(self, name: str, old: Certificate) -> PublicKeys:
        """The public keys of the certificate; the private keys may be elsewhere."""
        profile = self.issuer.keystore.profile
        if not keys_fit(old, profile):
            raise KeystoreError(
                f"the keys of {old.subject_name} are not of profile {profile.name}",
                hint="renew it with --rekey",
            )
        keys = PublicKeys(old.public_key, old.alternative_key)
        if not self.terms.compromised_keys:
            refuse_compromised(self.inspector.compromised, name, keys[:2])
        return keys


def keys_fit(certificate: Certificate, profile: Profile) -> bool:
    """Whether its keys have the algorithms that the profile demands of participants."""
    try:
        first, second = certificate.public_key, certificate.alternative_key
    except UnknownAlgorithmError:  # possible in an adopted certificate
        return False
    kinds = (first.algorithm, second.algorithm if second else None)
    return kinds == (profile.participant_key, profile.alternative_key)


def lasts_longer(keystore: Keystore, names: Iterable[str], validity: timedelta) -> bool:
    """Whether a certificate for `validity` would last longer than that of one of `names` did.

    FileError or MalformedError for a certificate that cannot be read.
    """
    enclaves = (keystore.folder / layout.enclave_folder(name) for name in names)
    return any(validity > _length(load_certificate(each / layout.CERTIFICATE)) for each in enclaves)


def _length(old: Certificate) -> timedelta:
    """The validity that the certificate was issued for, to the second."""
    whole = old.not_after - old.not_before
    return whole - BACKDATE if whole > BACKDATE else whole


def _moved(grant: Grant, old: Certificate, new: Certificate) -> Grant:
    """The grant for the validity of `new`; an end that a policy set before `old`'s end is kept.

    Grants of other subjects are not changed. The subjects of `old` and `new` differ if the
    participant was adopted.
    """
    if grant.subject_name not in {old.subject_name, new.subject_name}:
        return grant
    begin = new.not_before if grant.not_before <= old.not_before else grant.not_before
    end = new.not_after if grant.not_after >= old.not_after else grant.not_after
    if not max(begin, new.not_before) < end:
        raise KeystoreError(
            f"the permissions of {grant.name} ended on {said(grant.not_after)}",
            hint="issue it again: pqsec issue --force, with its topics or a --policy",
        )
    return replace(
        grant,
        subject_name=new.subject_name,
        not_before=begin,
        not_after=min(end, new.not_after),
    )
