"""Begins and ends an overlap, in which participants trust two identity CAs.

begin:   creates a new CA, which all trust beside the one that issues;
switch:  lets the new CA issue, and reissues all participants; the old CA is still trusted;
finish:  removes the trust in the old CA.

Each is one change. Between two of them every robot gets its new files; robots with new files
still accept robots with old ones (docs/explanation/adr/0010-two-identity-cas-in-one-file.md).
"""

from dataclasses import dataclass
from datetime import datetime

from pqsec_pki.algorithms import private_key_pem
from pqsec_pki.certificates import Authority, Certificate
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import (
    Authorities,
    Keystore,
    Overlap,
    Phase,
    Transaction,
    certificate_entry,
    change,
    check_pair,
    layout,
    load_ca_key,
    refuse_overlap,
    trust_entry,
    trust_file,
)
from pqsec_pki.lifecycle.rollover import Rollover, Scope, check_scope, generation
from pqsec_pki.lifecycle.rotating import Rotated, new_authorities, rotate


@dataclass(frozen=True, slots=True, kw_only=True)
class BegunOverlap:
    """The result of `begin_overlap`."""

    overlap: Overlap
    generation: int
    """Of the CA that will issue next."""
    dropped_list: bool
    """Whether an empty revocation list was removed."""


def begin_overlap(
    keystore: Keystore,
    terms: Rollover,
    *,
    kept: Authorities,
    passphrase: bytes | None,
    now: datetime,
) -> BegunOverlap:
    """Create an identity CA that all participants trust beside the old one, which still issues.

    Its key is encrypted under `passphrase`. Errors as of `check_begin`.
    """
    with change(keystore.root) as transaction:
        kept.refuse_outdated(keystore.root)
        check_begin(keystore, terms, now)
        number = generation(keystore) + 1
        new = _new_identity(keystore, terms, number, now)
        overlap = Overlap(Phase.BEGUN, kept.identity.certificate, new.certificate)
        private = transaction.folder(layout.PRIVATE, private=True)
        private.private(layout.NEXT_KEY, private_key_pem(new.key, passphrase))
        if new.alternative_key:
            private.private(layout.NEXT_ALT_KEY, private_key_pem(new.alternative_key, passphrase))
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
    """Let the new identity CA issue, and reissue all participants; the old CA stays trusted.

    KeystoreError if no overlap has begun, PassphraseError if `passphrase` is not that of the
    new CA's key; other errors as of `rotate`.
    """
    overlap = Overlap.that_is(keystore, Phase.BEGUN)
    successor = _next_authority(keystore, overlap.other, passphrase)
    return rotate(keystore, terms, kept=kept, passphrase=passphrase, now=now, successor=successor)


def finish_overlap(keystore: Keystore, *, now: datetime) -> Overlap:
    """Remove the old identity CA from the trusted ones; returns the ended overlap.

    KeystoreError if the new CA does not issue yet. No CA key is needed.
    """
    with change(keystore.root) as transaction:
        overlap = Overlap.that_is(keystore, Phase.SWITCHED)
        _trust(transaction, overlap.issuing)
        transaction.record(trust_entry(overlap, now, end="finished"))
    return overlap


def cancel_overlap(keystore: Keystore, *, now: datetime) -> Overlap:
    """Remove the new identity CA, which has issued nothing; returns the cancelled overlap.

    Its key is overwritten with zeros. KeystoreError if the new CA issues already.
    """
    with change(keystore.root) as transaction:
        overlap = Overlap.that_is(keystore, Phase.BEGUN)
        _trust(transaction, overlap.issuing)
        transaction.record(trust_entry(overlap, now, end="cancelled"))
        for key in (layout.NEXT_KEY, layout.NEXT_ALT_KEY):
            transaction.shred(f"{layout.PRIVATE}/{key}")
            transaction.remove(f"{layout.PRIVATE}/{key}")
    return overlap


def check_begin(keystore: Keystore, terms: Rollover, now: datetime) -> None:
    """Raise the errors that `begin_overlap` would raise.

    KeystoreError if an overlap has begun already, or a certificate is revoked: participants
    that trust two CAs cannot use a revocation list. UsageError if the permissions CA is to be
    replaced too.
    """
    if terms.scope is not Scope.IDENTITY:
        raise UsageError(
            "only the identity CA can overlap: no stack trusts two permissions CAs",
            hint="leave out --only: the permissions CA stays as it is",
        )
    check_scope(keystore, terms)
    refuse_overlap(keystore, "an overlap has begun already")
    if count := len(_revoked(keystore, now)):
        raise KeystoreError(
            f"{count} revoked would be accepted again: participants that trust two CAs cannot"
            " use a revocation list",
            hint="rotate without --overlap, or wait until their certificates have expired",
        )


def _new_identity(keystore: Keystore, terms: Rollover, number: int, now: datetime) -> Authority:
    """The new CA; UsageError if it has the old CA's name: issuers are found by name."""
    new = new_authorities(keystore, terms, number, now).identity
    if new.certificate.subject_der == keystore.identity_ca.subject_der:
        raise UsageError(
            f"{new.certificate.subject_name} is the name of the old identity CA",
            hint="choose another --name",
        )
    return new


def _revoked(keystore: Keystore, now: datetime) -> set[int]:
    """Serial numbers of the identity CA's certificates that are revoked and not expired."""
    issuer, found = keystore.identity_ca.fingerprint, keystore.revocation_list
    with keystore.open_ledger() as ledger:
        lines = [each for each in ledger.of_kind("revocation") if each.issuer == issuer]
    ended = {each.serial_number for each in lines if each.ends < now}
    listed = {each.serial_number for each in found.revoked} if found else set()
    return (listed | {each.serial_number for each in lines}) - ended


def _trust(transaction: Transaction, *authorities: Certificate) -> None:
    """Stage the file of trusted identity CAs; the first one issues."""
    public = transaction.folder(layout.PUBLIC, private=False)
    public.public(layout.IDENTITY_CA, trust_file(authorities))


def _link_all(keystore: Keystore, transaction: Transaction) -> None:
    """Link to that file in enclaves that have their own copy, as adopted ones may."""
    shared = {layout.IDENTITY_CA: layout.CA_TARGETS[layout.IDENTITY_CA]}
    for name in keystore.names():
        folder = layout.enclave_folder(name)
        [(link, target)] = layout.shared_links(name, shared).items()
        there = keystore.root / folder / link
        if not (there.is_symlink() and str(there.readlink()) == target):
            transaction.folder(folder, private=False).link(link, target)


def _drop_list(keystore: Keystore, transaction: Transaction) -> bool:
    """Remove the revocation list; True if there was one.

    Even an empty list has to go: stacks with one CA's list refuse certificates of the other CA.
    """
    if not keystore.has_revocation_list:
        return False
    transaction.remove(f"{layout.PUBLIC}/{layout.CA_LIST}")
    for name in keystore.names():
        transaction.remove(f"{layout.enclave_folder(name)}/{layout.LIST}")
    return True


def _next_authority(
    keystore: Keystore, certificate: Certificate, passphrase: bytes | None
) -> Authority:
    private, second = keystore.root / layout.PRIVATE, certificate.alternative_key
    authority = Authority(
        certificate,
        load_ca_key(private / layout.NEXT_KEY, passphrase),
        load_ca_key(private / layout.NEXT_ALT_KEY, passphrase) if second else None,
    )
    check_pair(authority)
    return authority
