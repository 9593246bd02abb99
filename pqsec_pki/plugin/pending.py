"""Handshakes that wait for a Final, and what they may cost an agent.

A Request proves nothing: anybody who has recorded a certificate can send as many in its
holder's name as it likes, each with a document of 256 kB that has to be kept until the Final.
So all that wait in an agent together hold MAX_HELD octets, and when that is not enough, one ends:
of the certificate in whose name most is held, the largest, and of equals the oldest. Who replays
one certificate thus pushes out handshakes in that name alone, and there the larger ones first: a
real participant's (28 kB) is in danger after some 600 forged Requests no larger than its own,
which take an agent more than two seconds, and its Final comes within a round trip.

Equal documents of one certificate are kept once: a hundred processes with one identity, as nodes of
ROS 2 have, are not a flood. A lower limit of a document's size would not do: a participant with two
thousand topics has one of 150 kB.

An answer costs a key agreement and a signature, 3 to 5 ms. So each local identity answers BURST
Requests in the name of one certificate, and then PER_SECOND more each second; those who come too
early ask again each second. Requests whose certificate is not good do not count: a forger must not
use up what is for others.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from itertools import count
from weakref import WeakKeyDictionary

from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import VerificationError

MAX_HELD = 16 << 20
"""Octets. With what Python needs beside them, less than 30 MB."""
COST = 4096
"""Octets of a handshake beside its document: keys, challenges, hashes, and objects around them."""
BURST = 256
"""Answers. As many processes with one identity may start at once."""
PER_SECOND = 32
"""Answers: a tenth of a core."""
MAX_RATES = 4096
"""Certificates whose Requests are counted."""


@dataclass(slots=True)
class _Group:
    """What waits in the name of one certificate."""

    held: int = 0
    ends: dict[int, tuple[bytes, Callable[[], None]]] = field(default_factory=dict)
    """By number, the oldest first: its document, and what ends it."""
    documents: dict[bytes, tuple[bytes, int]] = field(default_factory=dict)
    """Each document, and how many have it."""

    def add(self, number: int, document: bytes, end: Callable[[], None]) -> None:
        document, others = self.documents.get(document, (document, 0))
        self.documents[document] = document, others + 1
        self.ends[number] = document, end
        self.held += COST + (0 if others else len(document))

    def drop(self, number: int) -> None:
        document, _ = self.ends.pop(number)
        _, having = self.documents.pop(document)
        if having > 1:
            self.documents[document] = document, having - 1
        self.held -= COST + (len(document) if having == 1 else 0)

    @property
    def largest(self) -> int:
        """The number of the one to end first."""
        return max(self.ends, key=lambda number: len(self.ends[number][0]))


class PendingReplies:
    """Those of all connections of an agent."""

    def __init__(self) -> None:
        self._numbers = count(1)
        self._names: dict[int, Certificate] = {}
        self._groups: dict[Certificate, _Group] = {}
        self._proved: WeakKeyDictionary[Certificate, bytes] = WeakKeyDictionary()
        """The document of a participant that has authenticated, while it is there."""

    def __len__(self) -> int:
        return len(self._names)

    @property
    def held(self) -> int:
        """Octets."""
        return sum(each.held for each in self._groups.values())

    def one_copy(self, certificate: Certificate, document: bytes) -> bytes:
        """`document`, or the same octets that are kept already for its holder.

        Of what is to be kept, not of what came: OpenDDS's document comes with a NUL, and is kept
        without. The group's copy goes first, because `add` counts that one.
        """
        group = self._groups.get(certificate)
        if group and document in group.documents:
            return group.documents[document][0]
        proved = self._proved.get(certificate)
        return proved if proved == document else document

    def add(self, certificate: Certificate, document: bytes, end: Callable[[], None]) -> int:
        """The number of one more; `end` is called if it has to make room later.

        The certificate must be one that is good: then there are not many.
        """
        number = next(self._numbers)
        self._names[number] = certificate
        self._groups.setdefault(certificate, _Group()).add(number, document, end)
        return number

    def make_room(self) -> int:
        """How many had to end."""
        ended = 0
        while self.held > MAX_HELD and len(self._names) > 1:
            group = max(self._groups.values(), key=lambda each: each.held)
            number = group.largest
            _, end = group.ends[number]
            self.drop(number)
            end()
            ended += 1
        return ended

    def drop(self, number: int) -> None:
        """It is over, or ended."""
        certificate = self._names.pop(number, None)
        if certificate is None:
            return
        group = self._groups[certificate]
        group.drop(number)
        if not group.ends:
            del self._groups[certificate]

    def proved(self, certificate: Certificate, document: bytes) -> None:
        """The certificate's holder has authenticated, with that document."""
        self._proved[certificate] = document


class Rates:
    """How many Requests a participant has answered lately in whose name."""

    def __init__(self) -> None:
        self._left: dict[str, tuple[float, datetime]] = {}
        """By the SHA-256 of a good certificate: answers that are left, and when that was so."""

    def refuse_early(self, certificate: Certificate, now: datetime) -> None:
        """VerificationError if too many came in that name."""
        if certificate.fingerprint in self._left and self._now_left(certificate, now) < 1:
            raise VerificationError(
                f"more than {PER_SECOND} handshakes a second are begun in the name of"
                f" {certificate.subject_name}: this one has to come again"
            )

    def count(self, certificate: Certificate, now: datetime) -> None:
        """One was answered. The certificate is good."""
        left = self._now_left(certificate, now)
        self._left.pop(certificate.fingerprint, None)
        self._left[certificate.fingerprint] = left - 1, now
        if len(self._left) > MAX_RATES:
            del self._left[next(iter(self._left))]

    def _now_left(self, certificate: Certificate, now: datetime) -> float:
        left, since = self._left.get(certificate.fingerprint, (float(BURST), now))
        passed = max(0.0, (now - since).total_seconds())  # clocks are set back
        return min(float(BURST), left + passed * PER_SECOND)
