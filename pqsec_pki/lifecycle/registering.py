"""Grants for registration authorities: signed and recorded, and ended."""

from collections.abc import Collection, Iterator
from datetime import datetime

from pqsec_pki.algorithms import PrivateKey
from pqsec_pki.approvals import Covered, RegistrationGrant, SignedGrant
from pqsec_pki.errors import ExistsError, VerificationError
from pqsec_pki.keystore import (
    Authorities,
    Keystore,
    Registration,
    change,
    grant_end_entry,
    grant_entry,
    registrations,
    registrations_of,
)


def add_registration(
    keystore: Keystore, authorities: Authorities, grant: RegistrationGrant, *, now: datetime
) -> SignedGrant:
    """Sign the grant with the identity CA and record it; the CAs sign a head with its line.

    ExistsError if one of that name is in force; VerificationError for the key of a CA;
    KeystoreError if approvals are needed for it.
    """
    _refuse_ca_key(authorities, grant)
    with change(keystore.root, authorities) as transaction:
        keystore.refuse_unapproved(Covered.GROW)
        for each in registrations(keystore):
            if each.grant.authority == grant.authority and not each.ended(now):
                raise ExistsError(
                    f"{grant.authority} has a grant: {each.grant}",
                    hint=f"`pqsec ra revoke {grant.authority}` ends it",
                )
            if each.grant.digest == grant.digest:  # the ledger has its line, and that of its end
                raise ExistsError(
                    "the same grant was ended before",
                    hint="run the command again: the new grant has another time",
                )
        signed = grant.signed_by([*_identity_keys(authorities)])
        transaction.record(grant_entry(signed, now))
    return signed


def end_registrations(
    keystore: Keystore, authorities: Authorities, names: Collection[str], *, now: datetime
) -> list[Registration]:
    """End all grants of these registration authorities; returns those that had not ended.

    The permissions CA signs a head with the lines, so a ledger without them is found out.
    KeystoreError for a name without a grant.
    """
    with change(keystore.root, authorities) as transaction:
        keystore.refuse_unapproved(Covered.OTHER)
        known = registrations(keystore)
        for name in names:
            registrations_of(known, name)  # refuses a name without a grant
        ended = [each for each in known if each.grant.authority in names and not each.revoked]
        transaction.record(*(grant_end_entry(each.grant, now) for each in ended))
    return ended


def _identity_keys(authorities: Authorities) -> Iterator[PrivateKey]:
    yield authorities.identity.key
    if authorities.identity.alternative_key:
        yield authorities.identity.alternative_key


def _refuse_ca_key(authorities: Authorities, grant: RegistrationGrant) -> None:
    cas = [authorities.identity, *authorities.signers]
    keys = [key.public_key.spki for ca in cas for key in (ca.key, ca.alternative_key) if key]
    if grant.key.spki in keys:
        raise VerificationError(
            "that key is a CA's", hint="a registration authority needs a key of its own"
        )
