"""Beginning and ending an overlap, in which participants trust two identity CAs.

begin:   a new CA is made and trusted by all, behind the one that issues;
switch:  the new one issues, and everybody is issued again; the old one is still trusted;
finish:  the new one alone is trusted.

Each is one change. Between two of them every robot gets its new files, and those that have
them meet those that do not (docs/adr/0010-two-identity-cas-in-one-file.md).
"""

from dataclasses import dataclass
from datetime import datetime

from pqsec_pki.algorithms import private_key_pem
from pqsec_pki.certificates import Authority, Certificate
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import _journal, _layout
from pqsec_pki.keystore._entries import certificate_entry
from pqsec_pki.keystore._transaction import Transaction
from pqsec_pki.keystore.authorities import Authorities, check_pair, load_ca_key
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.overlap import Overlap, Phase, refuse_overlap, trust_entry, trust_file
from pqsec_pki.keystore.rollover import Rollover, Scope, check_scope, generation
from pqsec_pki.keystore.rotating import Rotated, new_authorities, rotate


@dataclass(frozen=True, slots=True, kw_only=True)
class BegunOverlap:
    """What an overlap began with."""

    overlap: Overlap
    generation: int
    """Of the CA that will issue."""
    dropped_list: bool
    """Whether there was a revocation list, which revoked nobody, and which is gone."""


def begin_overlap(
    keystore: Keystore,
    terms: Rollover,
    *,
    kept: Authorities,
    passphrase: bytes | None,
    now: datetime,
) -> BegunOverlap:
    """A new identity CA that all participants trust beside the old one, which still issues.

    Its key is encrypted under `passphrase`. Errors as of `check_begin`.
    """
    with _journal.change(keystore.root) as transaction:
        kept.refuse_outdated(keystore.root)
        check_begin(keystore, terms, now)
        number = generation(keystore) + 1
        new = _new_identity(keystore, terms, number, now)
        overlap = Overlap(Phase.BEGUN, kept.identity.certificate, new.certificate)
        private = transaction.folder(_layout.PRIVATE, private=True)
        private.private(_layout.NEXT_KEY, private_key_pem(new.key, passphrase))
        if new.alternative_key:
            private.private(_layout.NEXT_ALT_KEY, private_key_pem(new.alternative_key, passphrase))
        dropped = _drop_list(keystore, transaction)
        _link_all(keystore, transaction)
        transaction.record(
            certificate_entry("identity-ca", new.certificate.subject_name, new.certificate, now)
        )
        _trust(transaction, overlap.issuing, overlap.other)
        transaction.record(trust_entry(overlap, now))
    return BegunOverlap(overlap=overlap, generation=number, dropped_list=dropped)


def switch_overlap(
    keystore: Keystore,
    terms: Rollover,
    *,
    kept: Authorities,
    passphrase: bytes | None,
    now: datetime,
) -> Rotated:
    """The new identity CA issues from now on, also to all who are there; the old one stays trusted.

    KeystoreError if no overlap has begun, PassphraseError if `passphrase` is not the new
    CA's; else as `rotate`.
    """
    overlap = Overlap.that_is(keystore, Phase.BEGUN)
    successor = _next_authority(keystore, overlap.other, passphrase)
    return rotate(keystore, terms, kept=kept, passphrase=passphrase, now=now, successor=successor)


def finish_overlap(keystore: Keystore, *, now: datetime) -> Overlap:
    """The old identity CA is trusted no more; which it was.

    KeystoreError if the new one does not issue yet. No key is needed.
    """
    with _journal.change(keystore.root) as transaction:
        overlap = Overlap.that_is(keystore, Phase.SWITCHED)
        _trust(transaction, overlap.issuing)
        transaction.record(trust_entry(overlap, now, end="finished"))
    return overlap


def cancel_overlap(keystore: Keystore, *, now: datetime) -> Overlap:
    """The new identity CA, which has issued nothing, is not trusted after all; which it was.

    Its key is overwritten with zeros. KeystoreError if it issues already.
    """
    with _journal.change(keystore.root) as transaction:
        overlap = Overlap.that_is(keystore, Phase.BEGUN)
        _trust(transaction, overlap.issuing)
        transaction.record(trust_entry(overlap, now, end="cancelled"))
        for key in (_layout.NEXT_KEY, _layout.NEXT_ALT_KEY):
            transaction.shred(f"{_layout.PRIVATE}/{key}")
            transaction.remove(f"{_layout.PRIVATE}/{key}")
    return overlap


def check_begin(keystore: Keystore, terms: Rollover, now: datetime) -> None:
    """Refuse what `begin_overlap` would.

    KeystoreError if an overlap has begun already, or somebody is revoked: no list would
    say so to who trusts two CAs. UsageError if more than the identity CA shall follow.
    """
    if terms.scope is not Scope.IDENTITY:
        raise UsageError(
            "an overlap is of identity CAs: no stack trusts two permissions CAs",
            hint="leave --only out: the permissions CA stays as it is",
        )
    check_scope(keystore, terms)
    refuse_overlap(keystore, "an overlap has begun already")
    if count := len(_revoked(keystore, now)):
        raise KeystoreError(
            f"{count} revoked would be let in again: no revocation list can be given to who"
            " trusts two CAs",
            hint="without --overlap it is a switch; or wait until their certificates have ended",
        )


def _new_identity(keystore: Keystore, terms: Rollover, number: int, now: datetime) -> Authority:
    """UsageError if it would be called as the old one: who looks for an issuer goes by name."""
    new = new_authorities(keystore, terms, number, now).identity
    if new.certificate.subject_der == keystore.identity_ca.subject_der:
        raise UsageError(
            f"{new.certificate.subject_name} is what the old identity CA is called",
            hint="choose another --name",
        )
    return new


def _revoked(keystore: Keystore, now: datetime) -> set[int]:
    """Serial numbers of the identity CA that are revoked and have not ended."""
    issuer, found = keystore.identity_ca.fingerprint, keystore.revocation_list
    with keystore.open_ledger() as ledger:
        lines = [each for each in ledger.of_kind("revocation") if each.issuer == issuer]
    ended = {each.serial_number for each in lines if each.ends < now}
    listed = {each.serial_number for each in found.revoked} if found else set()
    return (listed | {each.serial_number for each in lines}) - ended


def _trust(transaction: Transaction, *authorities: Certificate) -> None:
    """These identity CAs, the first of which issues."""
    public = transaction.folder(_layout.PUBLIC, private=False)
    public.public(_layout.IDENTITY_CA, trust_file(authorities))


def _link_all(keystore: Keystore, transaction: Transaction) -> None:
    """Links to that file where enclaves have one of their own, as adopted ones may."""
    shared = {_layout.IDENTITY_CA: _layout.CA_TARGETS[_layout.IDENTITY_CA]}
    for name in keystore.names():
        folder = _layout.enclave_folder(name)
        [(link, target)] = _layout.shared_links(name, shared).items()
        there = keystore.root / folder / link
        if not (there.is_symlink() and str(there.readlink()) == target):
            transaction.folder(folder, private=False).link(link, target)


def _drop_list(keystore: Keystore, transaction: Transaction) -> bool:
    """An empty list too: stacks that are given one CA's refuse what the other one issued."""
    if not keystore.has_revocation_list:
        return False
    transaction.remove(f"{_layout.PUBLIC}/{_layout.CA_LIST}")
    for name in keystore.names():
        transaction.remove(f"{_layout.enclave_folder(name)}/{_layout.LIST}")
    return True


def _next_authority(
    keystore: Keystore, certificate: Certificate, passphrase: bytes | None
) -> Authority:
    private, second = keystore.root / _layout.PRIVATE, certificate.alternative_key
    authority = Authority(
        certificate,
        load_ca_key(private / _layout.NEXT_KEY, passphrase),
        load_ca_key(private / _layout.NEXT_ALT_KEY, passphrase) if second else None,
    )
    check_pair(authority)
    return authority
