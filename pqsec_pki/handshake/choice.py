"""Which of several sets of credentials is used with a peer: by our policy, not by the peer.

Sets are in the keystore's order: stock stacks see the first one, the last one is the strongest.
Peers are met with the strongest set, except those that `stock` names: these may be met with the
first one too. What a peer announces is not authenticated. Its name chooses the row of our policy,
and its certificate must then have that very name; that it has our strongest set only saves a
handshake that would fail.
"""

import re
from collections.abc import Sequence

from pqsec_pki._dataclass import dataclass
from pqsec_pki._name_patterns import covers, is_pattern, whole
from pqsec_pki.certificates import Certificate, common_name
from pqsec_pki.errors import UsageError, VerificationError, shown
from pqsec_pki.handshake.guid import belongs_to
from pqsec_pki.handshake.tokens import IdentityToken
from pqsec_pki.problems import Code, Problem

FIRST, STRONGEST = 0, -1
_LONE_NAME = re.compile(r"/?CN ?= ?(?P<name>.+)", re.DOTALL)
r"""A subject that is a CN alone, as stacks announce it: /CN=\/x, /CN=/x, CN=/x or CN = /x."""


@dataclass(frozen=True, slots=True)
class PolicyRow:
    """What our policy says about one peer."""

    subject: bytes | None
    """The subject (DER Name) that its certificate must have; None: any that fits its GUID."""
    is_stock: bool
    """Whether it may be met with the first set."""


def stock_name(text: str) -> str:
    """A name or pattern of participants, from the root; UsageError for what is neither."""
    found = whole(text)
    common_name("x" if is_pattern(found) else found)
    return found


@dataclass(frozen=True, slots=True)
class StockPeers:
    """The names, and patterns of names, of participants that may be met with the first set."""

    names: tuple[str, ...] = ()

    def row(self, said: IdentityToken, guid: bytes) -> PolicyRow:
        """The row for a peer that announced `said` and `guid` (16 bytes).

        A peer that announces no name is compared with our exact names, by the hash in its GUID.
        VerificationError (C29) for a name that does not belong to its GUID.
        """
        if said.subject is None:
            found = {each for each in map(common_name, self._exact) if belongs_to(guid, each)}
            only = found.pop() if len(found) == 1 else None
            return PolicyRow(only, is_stock=only is not None)
        name = _name_in(said.subject)
        subject = _subject_of(name)
        if subject is None or not belongs_to(guid, subject):
            words = f"the announced name '{shown(said.subject)}' does not belong to the peer's GUID"
            raise VerificationError(Problem(words, Code.C29))
        return PolicyRow(subject, is_stock=any(covers(each, name) for each in self.names))

    @property
    def _exact(self) -> list[str]:
        return [whole(each) for each in self.names if not is_pattern(each)]


def set_to_ask_with(
    row: PolicyRow, said: IdentityToken, profile: str, certificate: Certificate
) -> int:
    """FIRST or STRONGEST: the set of our Request to a peer of that row.

    `profile` and `certificate` are those of our strongest set.
    """
    return FIRST if row.is_stock and not said.has_set(profile, certificate) else STRONGEST


def set_of(certificate: Certificate, cas: Sequence[Sequence[Certificate]]) -> int:
    """The number of the set whose identity CA the certificate names as its issuer.

    `cas` are the identity CAs of each set. Of none: the last one, whose checks refuse it. The
    signature is not verified.
    """
    for number, each in enumerate(cas):
        if any(map(certificate.names_issuer, each)):
            return number
    return len(cas) - 1


def refuse_weak_set(row: PolicyRow, number: int, profiles: Sequence[str]) -> None:
    """VerificationError (C30) if a peer of that row may not be met with the set of that number."""
    if number == len(profiles) - 1 or (row.is_stock and number == FIRST):
        return
    words = f"the peer's certificate is of the set {profiles[number]}, and stock does not name it"
    raise VerificationError(
        Problem(words, Code.C30), hint='to meet it so, name it in pqsec.toml: stock = ["/name"]'
    )


def _name_in(text: str) -> str:
    found = _LONE_NAME.fullmatch(text)
    return found["name"].replace("\\/", "/") if found else ""


def _subject_of(name: str) -> bytes | None:
    try:
        return common_name(name)
    except UsageError:  # no participant of a keystore has such a name
        return None
