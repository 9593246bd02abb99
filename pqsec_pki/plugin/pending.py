"""Handshakes that wait for a Final, and what they may cost an agent.

A Request proves nothing: an attacker who has recorded a certificate can send any number of Requests
in its holder's name, each with a document of 256 kB that must be kept until the Final. So all
waiting handshakes of a worker together take at most MAX_HELD octets. Beyond that, the worker drops
the largest handshake of the certificate that uses most; of equal ones the oldest. An attacker who
replays one certificate thus displaces only handshakes with that certificate, the larger ones first.
A real participant's (28 kB) can be displaced after some 300 forged Requests of its size. A worker
needs more than a second to answer these, and the real Final comes within a round trip.

Equal documents of one certificate are kept once: a hundred processes with one identity, as nodes of
ROS 2 have, are not a flood. A lower limit for the size of a document is not possible: a participant
with two thousand topics has one of 150 kB.

An answer costs a key agreement and a signature, 3 to 5 ms. So each local identity answers BURST
Requests for one certificate, and then PER_SECOND more each second; a peer that is refused repeats
its Request each second. Requests with an invalid certificate are not counted: a forger must not use
up the answers for others.
"""

from collections.abc import Callable
from dataclasses import field
from datetime import datetime
from itertools import count
from weakref import WeakKeyDictionary

from pqsec_pki._dataclass import dataclass
from pqsec_pki.certificates import Certificate
from pqsec_pki.errors import VerificationError

MAX_HELD = 8 << 20
"""Octets, for each worker: more than BURST answers hold. With the overhead of Python, 15 MB."""
COST = 4096
"""Octets of a handshake besides its document: keys, challenges, hashes and Python objects."""
BURST = 256
"""Answers at once: so many processes with one identity may start together."""
PER_SECOND = 32
"""Answers a second: a tenth of a core."""
MAX_RATES = 4096
"""Certificates whose Requests are counted."""


@dataclass(slots=True)
class _Group:
    """The waiting handshakes of one certificate."""

    held: int = 0
    ends: dict[int, tuple[bytes, Callable[[], None]]] = field(default_factory=dict)
    """Number, the oldest first -> its document, and the function that drops it."""
    documents: dict[bytes, tuple[bytes, int]] = field(default_factory=dict)
    """Document -> the kept copy, and the number of handshakes that have it."""

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
        """The number of the handshake to drop first."""
        return max(self.ends, key=lambda number: len(self.ends[number][0]))


class PendingReplies:
    """The waiting handshakes of all connections of a worker."""

    def __init__(self) -> None:
        self._numbers = count(1)
        self._names: dict[int, Certificate] = {}
        self._groups: dict[Certificate, _Group] = {}
        self._proved: WeakKeyDictionary[Certificate, bytes] = WeakKeyDictionary()
        """Certificate of an authenticated participant -> its document, as long as both exist."""

    def __len__(self) -> int:
        return len(self._names)

    @property
    def held(self) -> int:
        """The octets that all hold."""
        return sum(each.held for each in self._groups.values())

    def one_copy(self, certificate: Certificate, document: bytes) -> bytes:
        """`document`, or an equal copy that is already kept for its holder.

        Call it with the document as it is kept: OpenDDS's comes with a NUL, and is kept without.
        The group's copy is preferred, because `add` counts that one.
        """
        group = self._groups.get(certificate)
        if group and document in group.documents:
            return group.documents[document][0]
        proved = self._proved.get(certificate)
        return proved if proved == document else document

    def add(self, certificate: Certificate, document: bytes, end: Callable[[], None]) -> int:
        """Add a handshake: its number. `end` is called if it is dropped to make room.

        The certificate must be verified, so that there are not many.
        """
        number = next(self._numbers)
        self._names[number] = certificate
        self._groups.setdefault(certificate, _Group()).add(number, document, end)
        return number

    def make_room(self) -> int:
        """Drop handshakes until they hold at most MAX_HELD: how many were dropped."""
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
        """Forget the handshake: it is finished, or was dropped."""
        certificate = self._names.pop(number, None)
        if certificate is None:
            return
        group = self._groups[certificate]
        group.drop(number)
        if not group.ends:
            del self._groups[certificate]

    def proved(self, certificate: Certificate, document: bytes) -> None:
        """Record that the certificate's holder has authenticated, with that document."""
        self._proved[certificate] = document


class Rates:
    """The number of Requests that a participant has answered lately, for each certificate."""

    def __init__(self) -> None:
        self._left: dict[str, tuple[float, datetime]] = {}
        """SHA-256 of a valid certificate -> the answers that were left, and when."""

    def refuse_early(self, certificate: Certificate, now: datetime) -> None:
        """VerificationError if too many were answered for that certificate."""
        if certificate.fingerprint in self._left and self._now_left(certificate, now) < 1:
            raise VerificationError(
                f"more than {PER_SECOND} handshakes a second begin in the name of"
                f" {certificate.subject_name}: this one must be repeated"
            )

    def count(self, certificate: Certificate, now: datetime) -> None:
        """Count an answer; the certificate is valid."""
        left = self._now_left(certificate, now)
        self._left.pop(certificate.fingerprint, None)
        self._left[certificate.fingerprint] = left - 1, now
        if len(self._left) > MAX_RATES:
            del self._left[next(iter(self._left))]

    def _now_left(self, certificate: Certificate, now: datetime) -> float:
        left, since = self._left.get(certificate.fingerprint, (float(BURST), now))
        passed = max(0.0, (now - since).total_seconds())  # clocks are set back
        return min(float(BURST), left + passed * PER_SECOND)
