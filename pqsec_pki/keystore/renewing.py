"""Renewing: the same participant, allowed the same, for another while.

Certificate and permissions are made together and end together. What it may do is taken
from the signed permissions in its folder, once the permissions CA's signature holds and
the ledger tells that they are the newest.
"""

import hashlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import Self

from pqsec_pki._files import read
from pqsec_pki.algorithms import Profile, PublicKey
from pqsec_pki.certificates import BACKDATE, Certificate, end_of
from pqsec_pki.documents import Grant, Permissions
from pqsec_pki.errors import KeystoreError, located
from pqsec_pki.keystore import _journal, _layout
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._journal import DraftedFolder
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore._making import Issued, Keys, Maker
from pqsec_pki.keystore.authorities import Authorities, required_signatures
from pqsec_pki.keystore.holdings import marks_in
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.participant import load_certificate, refuse_unknown
from pqsec_pki.keystore.revoking import LIST_VALIDITY, Publisher
from pqsec_pki.keystore.status import status
from pqsec_pki.smime import verify


@dataclass(frozen=True, slots=True)
class Renewal:
    """How to renew."""

    rekey: bool | None = None
    """Whether to make new keys, or keep the public keys of the certificate; None makes new
    ones where the private key lies here."""
    validity: timedelta | None = None
    """From now on; None for as long as the old certificate was issued for."""
    due: timedelta | None = None
    """A revocation list that ends within this time is made anew; None as in `status`."""


def renew(
    keystore: Keystore,
    authorities: Authorities,
    names: Sequence[str],
    terms: Renewal = Renewal(),
    *,
    now: datetime,
) -> list[Issued]:
    """Give every participant in `names` a new certificate and new permissions, or none.

    A revocation list that is due is made anew with them. KeystoreError for a participant
    that is not there, was revoked, or has files that are not the newest ones issued to
    it; VerificationError for permissions that the CA did not sign.
    """
    regular = list(dict.fromkeys(map(_layout.enclave_name, names)))
    maker = Maker(keystore, authorities, now)
    with _journal.change(keystore.root) as draft, keystore.open_ledger() as ledger:
        authorities.refuse_outdated(keystore.root)
        inspector = Inspector.of(keystore, ledger)
        inspector.refuse_revoked(regular)
        folders = [draft.folder(_layout.enclave_folder(name), private=False) for name in regular]
        renewer = Renewer(maker, inspector, terms)
        with ThreadPoolExecutor() as pool:
            # Signing does not hold the interpreter, so threads use every core.
            renewed = list(pool.map(renewer.make, regular, folders))
        for each in renewed:
            draft.record(*each.entries)
        if status(keystore, (), now=now, due=terms.due).list_is_due:
            publisher = Publisher(keystore, authorities.identity, ledger, now)
            publisher.publish(draft, [], LIST_VALIDITY)
    return renewed


@dataclass(frozen=True, slots=True)
class Inspector:
    """Knows what was issued last, and takes nothing else for a participant's own."""

    keystore: Keystore
    permissions_ca: Certificate
    permissions_alt_ca: Certificate | None
    certificates: dict[str, Entry]
    """Name -> the newest line."""
    revoked: frozenset[str]
    """SHA-256 of certificates."""
    newest: dict[str, int]
    """Name -> number of the newest line on its permissions."""
    known: dict[str, int]
    """SHA-256 of signed permissions -> number of their line."""
    marks: dict[str, str]
    """Name -> what the newest lines were marked with."""

    @classmethod
    def of(cls, keystore: Keystore, ledger: Ledger) -> Self:
        """What the ledger says now, while the keystore is locked."""
        return cls(
            keystore,
            keystore.permissions_ca,
            keystore.permissions_alt_ca,
            {each.name: each for each in ledger.newest("participant")},
            frozenset(each.sha256 for each in ledger.of_kind("revocation")),
            ledger.newest_numbers("permissions"),
            ledger.numbers("permissions"),
            marks_in(ledger),
        )

    def revoked_of(self, names: Sequence[str]) -> list[str]:
        """Those whose newest certificate was taken back."""
        known = filter(None, map(self.certificates.get, names))
        return [each.name for each in known if each.sha256 in self.revoked]

    def refuse_revoked(self, names: Sequence[str]) -> None:
        """KeystoreError if any of them was revoked."""
        revoked = self.revoked_of(names)
        if revoked:
            raise KeystoreError(
                f"revoked: {', '.join(revoked)}",
                hint="if it may come back, `pqsec issue` it with --force --after-revocation",
            )

    def certificate(self, name: str, folder: Path) -> Certificate:
        """The newest that was issued to `name`; KeystoreError if another lies there."""
        refuse_unknown(self.keystore.root, name)
        path = folder / _layout.CERTIFICATE
        found = load_certificate(path)
        known = self.certificates.get(name)
        if known is None or found.fingerprint != known.sha256:
            raise _stale(path, name, "certificate")
        return found

    def permissions(self, name: str, folder: Path) -> Permissions:
        """What `name` was allowed last; its signatures hold."""
        path = folder / _layout.PERMISSIONS
        signed = read(path)
        number = self.known.get(hashlib.sha256(signed).hexdigest(), 0)
        if number < self.newest.get(name, 1):
            raise _stale(path, name, "permissions")
        with located(path):
            document = self.verified(signed)
            _refuse_edited(folder / _layout.PERMISSIONS_XML, document)
            return Permissions.from_xml(document)

    def mark(self, name: str, folder: Path) -> str:
        """What `name` was marked with; nothing if its permissions were signed by hand since."""
        number = self.known.get(hashlib.sha256(read(folder / _layout.PERMISSIONS)).hexdigest())
        return self.marks.get(name, "") if number == self.newest.get(name) else ""

    def verified(self, signed: bytes) -> bytes:
        """The document in a signed file; VerificationError if the CA did not sign it."""
        return verify(
            signed,
            self.permissions_ca,
            alternative_ca=self.permissions_alt_ca,
            require=required_signatures(self.keystore.profile),
        ).document


def _refuse_edited(path: Path, signed: bytes) -> None:
    """What somebody wrote into permissions.xml and did not sign yet is not overwritten."""
    if path.exists() and read(path) not in (signed, signed.replace(b"\r\n", b"\n")):
        raise KeystoreError(
            f"{path} is not what permissions.p7s says",
            hint="`pqsec sign-permissions` signs it; or remove it, and it is made anew",
        )


def _stale(path: Path, name: str, what: str) -> KeystoreError:
    return KeystoreError(
        f"{path} is not the newest {what} that the ledger has for {name}",
        hint=f"put that back, or say what it may do: pqsec issue {name} --force ...",
    )


@dataclass(frozen=True, slots=True)
class Renewer:
    """Makes a participant anew, from what the inspector lets pass."""

    maker: Maker
    inspector: Inspector
    terms: Renewal

    def make(self, name: str, folder: DraftedFolder) -> Issued:
        """Draft certificate, permissions and, where they are new, keys into `folder`."""
        keystore, now = self.maker.keystore, self.maker.now
        there = keystore.root / _layout.enclave_folder(name)
        with _journal.disk_errors(there):
            old = self.inspector.certificate(name, there)
            allowed = self.inspector.permissions(name, there)
            rekey = self._rekey(name, (there / _layout.KEY).exists())
            keys = self._new_keys(folder) if rekey else self._kept_keys(old)
        validity = self.terms.validity or _length(old)
        certificate = self.maker.authorities.identity.issue(
            name, keys[0], alternative=keys[1], now=now, validity=validity
        )
        permissions = Permissions(
            grants=tuple(_moved(grant, old, certificate) for grant in allowed.grants)
        )
        asked = end_of(now, validity)
        mark = self.inspector.mark(name, there)
        return self.maker.draft(folder, name, certificate, permissions, asked=asked, mark=mark)

    def _rekey(self, name: str, has_key: bool) -> bool:  # noqa: FBT001 -- of this module only
        if self.terms.rekey and not has_key:
            raise KeystoreError(
                f"{name} has no key.pem here: its key was made elsewhere",
                hint="keep it (--keep-key), or have a new one made where the old one is",
            )
        return has_key if self.terms.rekey is None else self.terms.rekey

    def _new_keys(self, folder: DraftedFolder) -> tuple[PublicKey, PublicKey | None]:
        keys = Keys.generate(self.maker.keystore.profile)
        keys.draft(folder)
        second = keys.alternative
        return keys.key.public_key, second.public_key if second else None

    def _kept_keys(self, old: Certificate) -> tuple[PublicKey, PublicKey | None]:
        """Those in the certificate: the private ones may be elsewhere."""
        profile = self.maker.keystore.profile
        if not keys_fit(old, profile):
            raise KeystoreError(
                f"the keys of {old.subject_name} are not of profile {profile.name}",
                hint="renew it with --rekey",
            )
        return old.public_key, old.alternative_key


def keys_fit(certificate: Certificate, profile: Profile) -> bool:
    """Whether its keys are of the kinds that the profile wants of participants."""
    second = certificate.alternative_key
    kinds = (certificate.public_key.algorithm, second.algorithm if second else None)
    return kinds == (profile.participant_key, profile.alternative_key)


def _length(old: Certificate) -> timedelta:
    """How long it was issued for, to the second."""
    whole = old.not_after - old.not_before
    return whole - BACKDATE if whole > BACKDATE else whole


def _moved(grant: Grant, old: Certificate, new: Certificate) -> Grant:
    """The grant, while `new` lasts: but an end that a policy set before `old`'s stays.

    Grants of other subjects stay as they are. The names of `old` and `new` differ where the
    participant was adopted.
    """
    if grant.subject_name not in {old.subject_name, new.subject_name}:
        return grant
    begin = new.not_before if grant.not_before <= old.not_before else grant.not_before
    end = new.not_after if grant.not_after >= old.not_after else grant.not_after
    if not max(begin, new.not_before) < end:
        raise KeystoreError(
            f"what {grant.name} was allowed ended on {grant.not_after:%Y-%m-%d}",
            hint="say anew what it may do: pqsec issue --force, with topics or a --policy",
        )
    return replace(
        grant,
        subject_name=new.subject_name,
        not_before=begin,
        not_after=min(end, new.not_after),
    )
