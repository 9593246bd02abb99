"""Refuses keys that were revoked as compromised, and keys of other participants."""

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime

from pqsec_pki.algorithms import PublicKey
from pqsec_pki.errors import VerificationError
from pqsec_pki.keystore import Entry, Ledger, all_hashes

_OWN_KEY = "make a key of its own for each set"


def refuse_compromised(
    compromised: Mapping[str, Entry], name: str, keys: Iterable[PublicKey | None]
) -> None:
    """VerificationError if any of the keys for `name` is compromised."""
    for each in all_hashes(*keys):
        if line := compromised.get(each):
            raise VerificationError(
                f"{name}: its key was revoked as compromised, with serial {line.serial} of"
                f" {line.name}",
                hint="others may have this key and could impersonate it: make a new key, with"
                " --rekey here or `pqsec request` on the robot",
            )


def refuse_shared(
    ledger: Ledger, asked: Mapping[str, Iterable[PublicKey | None]], now: datetime
) -> None:
    """VerificationError if a key in `asked` is in a valid certificate of another participant, or
    of another set than that of `ledger`.

    This happens after a robot's disk was copied: then each robot can impersonate the other.
    Earlier certificates count too: they are valid until they are revoked or expire.
    """
    holders: dict[str, str] = {}
    for name, keys in asked.items():
        for each in all_hashes(*keys):
            _refuse_second(name, holders.setdefault(each, name))
    for key, other, set_name, sha256 in ledger.certified(holders, now.isoformat()):
        if not ledger.line_of(("revocation",), sha256):
            _refuse_second(holders[key], other)
            if set_name != ledger.set_name:
                raise VerificationError(
                    f"{other}: its key is in another set of credentials too", hint=_OWN_KEY
                )


def refuse_repeated(asked: Mapping[str, Sequence[Iterable[PublicKey | None]]]) -> None:
    """VerificationError if a key, or a part of one, is for two participants or for two sets.

    `asked` has the keys for each set of each participant.
    """
    holders: dict[str, tuple[str, int]] = {}
    for name, sets in asked.items():
        for number, keys in enumerate(sets):
            for each in all_hashes(*keys):
                holder, place = holders.setdefault(each, (name, number))
                _refuse_second(name, holder)
                if place != number:
                    words = f"{name}: one key is for two sets of credentials"
                    raise VerificationError(words, hint=_OWN_KEY)


def _refuse_second(name: str, holder: str) -> None:
    if name != holder:
        raise VerificationError(
            f"{name}: its key is that of {holder}",
            hint="make a key of its own with `pqsec request`; if it is the same robot under"
            " another name, revoke the old name first",
        )
