"""Enrolment tokens in the ledger: a line when one is made, for each use, and at its end.

The ledger has the SHA-256 of the secret, which is random and cannot be guessed.
"""

import hashlib
from collections.abc import Iterable
from dataclasses import replace
from datetime import datetime
from typing import Self

from pqsec_pki._dataclass import dataclass
from pqsec_pki.certificates import Certificate, CertificateRequest
from pqsec_pki.errors import KeystoreError, UsageError, shown
from pqsec_pki.est import EnrolmentToken, is_secret
from pqsec_pki.keystore import (
    ADMISSION,
    Entry,
    Keystore,
    Ledger,
    change,
    is_several,
    matching,
    participant_states,
    policy_of,
    regular_name,
)
from pqsec_pki.server.deciding import demanded

TOKEN, TOKEN_END = "enrolment-token", "enrolment-token-end"
"""Kinds of lines; the name of an admission says by what."""
_REQUEST, _READMITS = "request", "after_revocation"


@dataclass(frozen=True, slots=True)
class TokenState:
    """A token, by the ledger."""

    id: str
    names: str
    secret_hash: str
    uses: int
    """How many requests it admits."""
    used: int
    replaces: bool
    """Whether it admits participants that have a valid certificate for another key."""
    readmits: int
    """The number of its ledger line if it was made to admit a participant that had been revoked
    before; else 0."""
    made_at: datetime
    not_after: datetime
    revoked: bool

    @classmethod
    def of(cls, ledger: Ledger, entry: Entry) -> Self:
        """KeystoreError for a damaged line."""
        details = entry.details
        if not details.get("uses", "").isdecimal():
            raise entry.damaged()
        return cls(
            id=entry.name,
            names=details.get("names", ""),
            secret_hash=entry.sha256,
            uses=int(details["uses"]),
            used=ledger.count(ADMISSION, by_token(entry.name)),
            replaces=details.get("replaces") == "yes",
            readmits=ledger.line_of([TOKEN], entry.sha256)
            if details.get(_READMITS) == "yes"
            else 0,
            made_at=entry.made_at,
            not_after=entry.ends,
            revoked=ledger.count(TOKEN_END, entry.name) > 0,
        )

    def admits(self, name: str) -> bool:
        """Whether it is for the participant called `name`."""
        return any(matching(each, [name]) for each in self.names.split())

    def end(self, now: datetime) -> str:
        """Why it admits no more requests; empty if it does."""
        if self.revoked:
            return "revoked"
        if now > self.not_after:
            return "expired"
        return "used up" if self.used >= self.uses else ""

    def to_json(self, now: datetime) -> dict[str, object]:
        """The token for --json."""
        return {
            "id": self.id,
            "names": self.names,
            "uses": self.uses,
            "used": self.used,
            "replaces": self.replaces,
            "after_revocation": self.readmits > 0,
            "made_at": self.made_at,
            "not_after": self.not_after,
            "end": self.end(now),
        }


def by_token(token: str) -> str:
    """The name of an admission by that token."""
    return f"token {token}"


def presented(ledger: Ledger, token: str, secret: str) -> TokenState | None:
    """The token with that identifier and secret; None if there is none."""
    lines = ledger.of_name(TOKEN, token)
    if len(lines) != 1 or not is_secret(secret, lines[0].sha256):
        return None
    return TokenState.of(ledger, lines[0])


def token_states(keystore: Keystore) -> list[TokenState]:
    """All tokens, oldest first."""
    with keystore.open_ledger() as ledger:
        return [TokenState.of(ledger, each) for each in ledger.of_kind(TOKEN)]


def record_token(  # noqa: PLR0913 -- the choices are the user's, and by name
    keystore: Keystore,
    token: EnrolmentToken,
    *,
    uses: int,
    replaces: bool,
    after_revocation: bool = False,
    now: datetime,
) -> None:
    """Enter a new token; UsageError for a name that no participant can have, or a past end.

    KeystoreError for one participant that was revoked, unless `after_revocation`: no request for
    it would be admitted; and for `after_revocation` where several people approve what is issued.
    """
    for name in token.names.split():
        if not (is_several(name) or regular_name(name) == name):
            raise UsageError(f"'{shown(name)}' is not a participant's name")
    if replaces and (uses != 1 or is_several(token.names)):
        raise UsageError(
            "a token that replaces a participant's certificate is for one name and one use"
        )
    if after_revocation and not replaces:
        raise UsageError("a token for what was revoked replaces its certificate")
    if token.not_after <= now:
        raise UsageError("the end of the token is in the past")
    details = {
        "names": token.names,
        "uses": str(uses),
        **({"replaces": "yes"} if replaces else {}),
        **({_READMITS: "yes"} if after_revocation else {}),
    }
    with change(keystore.root) as transaction:
        _refuse_revoked(keystore, token.names, after_revocation=after_revocation, now=now)
        transaction.record(
            Entry.of(
                TOKEN, token.id, token.secret_hash, now, not_after=token.not_after, details=details
            )
        )


def _refuse_revoked(
    keystore: Keystore, names: str, *, after_revocation: bool, now: datetime
) -> None:
    with keystore.open_ledger() as ledger:
        if after_revocation and demanded(policy_of(ledger)):
            raise KeystoreError(
                "what is issued here needs approvals, and no token replaces those",
                hint="`pqsec propose issue --csr FILE --force --after-revocation` proposes it",
            )
        single = [each for each in names.split() if not is_several(each)]
        revoked = [
            each.name
            for each in participant_states(keystore, ledger, single, now=now)
            if each.revoked
        ]
    if revoked and not after_revocation:
        raise KeystoreError(
            f"revoked: {', '.join(revoked)}: no request for it is admitted",
            hint="if it came back, --replace --after-revocation makes a token that admits it, with"
            " a new key",
        )


def revoke_tokens(keystore: Keystore, ids: Iterable[str], *, now: datetime) -> list[TokenState]:
    """End these tokens, all or none; KeystoreError for one that is not in the ledger."""
    with change(keystore.root) as transaction, keystore.open_ledger() as ledger:
        found = [_token(ledger, each) for each in dict.fromkeys(ids)]
        transaction.record(*(Entry.of(TOKEN_END, each.name, each.sha256, now) for each in found))
        return [replace(TokenState.of(ledger, each), revoked=True) for each in found]


def _token(ledger: Ledger, token: str) -> Entry:
    match ledger.of_name(TOKEN, token):
        case [entry]:
            return entry
    raise KeystoreError(
        f"the ledger has no enrolment token {shown(token)}",
        hint="`pqsec enrolment-token list --config serve.yaml` lists them",
    )


def admission_entry(
    by: str,
    name: str,
    request: CertificateRequest,
    now: datetime,
    *,
    certificate: Certificate | None = None,
) -> Entry:
    """The line that says by what the request of the participant `name` was admitted.

    `certificate` is that of the device, by its factory.
    """
    device = {"certificate": certificate.fingerprint} if certificate else {}
    asked = request.fingerprint
    # The ledger has one line of a kind and SHA-256, and each use must have its own.
    sha256 = hashlib.sha256(f"{by} {asked}".encode()).hexdigest()
    return Entry.of(
        ADMISSION, by, sha256, now, details={"participant": name, _REQUEST: asked, **device}
    )


def request_of(admission: Entry) -> str:
    """The SHA-256 of the request that was admitted."""
    return admission.details.get(_REQUEST, "")
