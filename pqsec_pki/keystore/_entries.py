"""Ledger entries for certificates, signed documents and revocation lists."""

import hashlib
import os
from dataclasses import replace
from datetime import datetime

from pqsec_pki.certificates import Certificate, RevocationList
from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._ledger import PLACE
from pqsec_pki.keystore.compromised import keys_detail


def certificate_entry(  # noqa: PLR0913 -- the fields of the line, the rarer ones by name
    kind: str,
    name: str,
    certificate: Certificate,
    now: datetime,
    *,
    issuer: Certificate | None = None,
    details: dict[str, str] | None = None,
) -> Entry:
    """The ledger entry for a certificate."""
    return Entry.of(
        kind,
        name,
        certificate.fingerprint,
        now,
        serial=certificate.serial_number,
        not_after=certificate.not_after,
        issuer=issuer.fingerprint if issuer else None,
        details={**(details or {}), **keys_detail(certificate)},
    )


def document_entry(kind: str, name: str, signed: bytes, now: datetime) -> Entry:
    """The ledger entry for a signed document; `name` may be a path of any bytes."""
    text = os.fsencode(name).decode(errors="backslashreplace")
    return Entry.of(kind, text, hashlib.sha256(signed).hexdigest(), now)


def placed_entry(entry: Entry, place: str) -> Entry:
    """The entry of a document that was signed into the folder `place` of the keystore.

    Its name is the path that the user gave.
    """
    return replace(entry, details={**entry.details, PLACE: place})


def list_entry(made: RevocationList, pem: bytes, issuer: Certificate, now: datetime) -> Entry:
    """The ledger entry for a revocation list; `pem` is its file."""
    return Entry.of(
        "crl",
        "",
        hashlib.sha256(pem).hexdigest(),
        now,
        not_after=made.next_update,
        issuer=issuer.fingerprint,
        details={"number": str(made.number or 0), "revoked": str(len(made.revoked))},
    )
