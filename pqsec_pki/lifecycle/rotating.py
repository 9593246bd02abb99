"""Replaces the CAs: all participants are reissued and all documents signed again, in one change.

The keys of the old CAs are not needed, unless one of the two stays: their signatures are
verified with their certificates. They are archived in private/generations/, or destroyed.
"""

import re
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from pqsec_pki.certificates import Authority, Certificate
from pqsec_pki.errors import KeystoreError, UsageError
from pqsec_pki.keystore import (
    WAIT,
    Authorities,
    Keystore,
    Overlap,
    Phase,
    change,
    layout,
    refuse_overlap,
)
from pqsec_pki.lifecycle._inspector import Inspector
from pqsec_pki.lifecycle._issuer import Issued
from pqsec_pki.lifecycle._rollover_transaction import RolloverTransaction
from pqsec_pki.lifecycle.rollover import (
    Rollover,
    Scope,
    check_scope,
    generation,
    not_reissued,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Rotated:
    """The result of `rotate`."""

    keystore: Keystore
    """With the new profile."""
    generation: int
    archive: Path
    """The folder of the replaced CAs."""
    issued: list[Issued]
    left_out: dict[str, str]
    """Participants that were not reissued, and why."""
    new_list: bool
    """Whether there is a new, empty revocation list."""


def rotate(  # noqa: PLR0913 -- the choices are the user's, and by name
    keystore: Keystore,
    terms: Rollover,
    *,
    kept: Authorities | None = None,
    passphrase: bytes | None,
    now: datetime,
    successor: Authority | None = None,
) -> Rotated:
    """Create new CAs, and reissue all participants and documents with them, or do nothing.

    `kept` are the keystore's CAs, needed if one of them stays. The new keys are encrypted
    under `passphrase`. `successor` is the new identity CA of an overlap (`overlapping.py`): it
    issues from now on, and the old one stays trusted. KeystoreError for a participant whose
    files are not the ledger's newest, and during an overlap without its successor;
    VerificationError for documents that the old permissions CA did not sign; UsageError for
    another profile while one CA stays.
    """
    check_scope(keystore, terms)
    new = replace(keystore, profile=terms.profile)
    with change(keystore.root) as transaction, keystore.open_ledger() as ledger:
        _check_overlap(keystore, successor)
        number = generation(keystore)
        authorities = _authorities(
            keystore, terms, number + 1, kept=kept, successor=successor, now=now
        )
        inspector = Inspector.of(keystore, ledger, now=now)
        left_out = not_reissued(keystore, terms, inspector, now)
        governances = {each.sha256: each.details for each in ledger.of_kind("governance")}
        rollover = RolloverTransaction(
            keystore, new, terms, authorities, transaction, inspector, governances, now, successor
        )
        rollover.archive(number)
        rollover.write_authorities(passphrase)
        rollover.sign_governance()
        issued = rollover.reissue([name for name in keystore.names() if name not in left_out])
        new_list = rollover.publish_list(ledger)
    return Rotated(
        keystore=new,
        generation=number + 1,
        archive=keystore.root / layout.GENERATIONS / str(number),
        issued=issued,
        left_out=left_out,
        new_list=new_list,
    )


def _check_overlap(keystore: Keystore, successor: Authority | None) -> None:
    """KeystoreError during an overlap, unless its new CA is the successor."""
    if successor is None:
        refuse_overlap(keystore, WAIT)
        return
    overlap = Overlap.of(keystore)
    trusted = overlap.other if overlap and overlap.phase is Phase.BEGUN else None
    if trusted is None or trusted.der != successor.certificate.der:
        raise KeystoreError(
            f"{successor.certificate.subject_name} is not the CA that will issue next",
            hint="run the command again",
        )


def _authorities(  # noqa: PLR0913 -- of this module only
    keystore: Keystore,
    terms: Rollover,
    number: int,
    *,
    kept: Authorities | None,
    successor: Authority | None,
    now: datetime,
) -> Authorities:
    if terms.scope is Scope.BOTH:
        return new_authorities(keystore, terms, number, now)
    if kept is None:
        raise UsageError("the key of the CA that stays is needed")
    kept.refuse_outdated(keystore.root)
    if successor:
        return replace(kept, identity=successor)
    new = new_authorities(keystore, terms, number, now)
    if terms.scope is Scope.IDENTITY:
        return replace(kept, identity=new.identity)
    return replace(new, identity=kept.identity)


def new_authorities(keystore: Keystore, terms: Rollover, number: int, now: datetime) -> Authorities:
    """Create the CAs of generation `number`, named by `terms` or after the old CA."""
    name = terms.name if terms.name is not None else _name(keystore.identity_ca, number)
    try:
        return Authorities.create(terms.profile, name, now=now, validity=terms.validity)
    except UsageError as error:
        if terms.name is None and error.hint is None:
            error.hint = "name the new CAs with --name"
        raise


def _name(old: Certificate, number: int) -> str:
    """The start of the new CAs' names: Lab Identity CA -> Lab G2."""
    found = re.search(r"(?:^|,)CN=([A-Za-z0-9_./ -]+)", old.subject_name)
    base = (found[1] if found else "").removesuffix("Identity CA").strip()
    base = re.sub(r"(^| )G[0-9]+$", "", base)
    return f"{base} G{number}".strip()
