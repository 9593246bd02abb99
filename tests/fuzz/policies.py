"""Do stacks decide as we say? Kinds of tests.fuzz.differential, with the stacks as peers.

A file is a list, as libcrypto.py writes one: the governance, the permissions, a domain, and what is
asked about them, as stacks.py takes it.
"""

import atexit
import re
from contextlib import contextmanager, suppress
from datetime import UTC, datetime, timedelta
from functools import cache, lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

from pqsec_pki.access import CYCLONEDDS, CYCLONEDDS_11, FASTDDS, Viewpoint
from pqsec_pki.access.deciding import InterpretedPolicy
from pqsec_pki.access.decision import Verdict
from pqsec_pki.algorithms import profile_named
from pqsec_pki.documents import (
    DomainSet,
    Governance,
    Permissions,
)
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue
from pqsec_pki.smime import document_in
from tests.fuzz import documents, libcrypto, spoiling, stacks

QUESTIONS = 50
YEAR = timedelta(days=365)


def valid(rng):
    """A file whose documents their schemas allow."""
    odd = documents.oddities(rng)
    maker, spelling = documents.Maker(rng, odd), documents.Spelling(rng, odd)
    return _file(rng, spelling.document(maker.governance()), spelling.document(maker.permissions()))


def spoilt(rng):
    """A file of which a document, or both, break their schemas in a few places."""
    odd = documents.oddities(rng)
    maker, spelling = documents.Maker(rng, odd), documents.Spelling(rng, odd)
    pair, whose = [maker.governance(), maker.permissions()], rng.choice([(0,), (1,), (1,), (0, 1)])
    by_text = rng.randrange(3) == 0
    for each in () if by_text else whose:
        spoiling.spoil(rng, pair[each])
    written = list(map(spelling.document, pair))
    for each in whose if by_text else ():
        written[each] = spoiling.spoil_text(rng, written[each])
    return _file(rng, *written)


def _file(rng, governance, permissions):
    asked = documents.questions(rng, QUESTIONS)
    domain = str(rng.choice(documents.DOMAINS)).encode()
    return libcrypto.pack([governance, permissions, domain, *asked])


class Lab:
    """A keystore with a participant, which signs documents."""

    def __init__(self):
        folder = TemporaryDirectory()
        atexit.register(folder.cleanup)
        now, domains = datetime.now(UTC), DomainSet.of(0)
        profile = profile_named("classical")
        options = {"domains": domains, "validity": YEAR, "now": now}
        root = Path(folder.name, "k")
        keystore = Keystore.create(root, profile, name="Lab", passphrase=None, **options)
        self._authorities, self._now = keystore.unlock(None), now
        name = documents.SUBJECT.removeprefix("CN=")
        spec = ParticipantSpec(name=name, publish=("x",), domains=domains, validity=YEAR)
        issue(keystore, self._authorities, [spec], now=now)
        self.enclave = keystore.root / f"enclaves{name}"

    def question(self, data):
        """The file as stacks are asked: its documents signed. PqsecError if they cannot be."""
        governance, permissions, *rest = libcrypto.unpacked(data)
        signed = [self._authorities.sign(each, now=self._now) for each in (governance, permissions)]
        return libcrypto.pack([*signed, *rest])


@cache
def lab():
    """One for all kinds."""
    return Lab()


class Decisions:
    """Files of one kind."""

    def __init__(self, make):
        self._make, self._lab = make, lab()
        self._signed = lru_cache(maxsize=1024)(self._lab.question)
        self._readings = (CYCLONEDDS, CYCLONEDDS_11, FASTDDS)

    @contextmanager
    def peers(self, _paths):
        """The stacks of this machine; the others are named."""
        found, missing = stacks.stacks()
        for each in missing:
            print("not here:", each)
        with stacks.peers(found, self._lab.enclave) as opened:
            yield opened

    def make(self, rng):
        """A file whose documents can be signed."""
        while True:
            data = self._make(rng)
            with suppress(PqsecError):
                self._signed(data)
                return data

    def ask(self, peer, files):
        return peer.ask([self._signed(each) for each in files])

    def read(self, data):
        """Each reading with its letters, as in stacks.py, and `c` where it says that it crashes.

        PqsecError if a document is refused.
        """
        governance, permissions, domain, *asked = libcrypto.unpacked(self._signed(data))
        pair = (
            Governance.from_xml(document_in(governance)),
            Permissions.from_xml(document_in(permissions)),
        )
        now = datetime.now(UTC)
        questions = [stacks.question_of(each, int(domain), now) for each in asked]
        return [(each, _letters(each, pair, questions)) for each in self._readings]

    def compared(self, ours, answers):
        """How many answers of stacks are compared."""
        given = [each[1] for each in answers if each[0] != b"crash"] if ours else []
        return sum(len(each) - each.count(b"-") for each in given)

    def disagreements(self, data, ours, peers, answers):
        """What each stack does otherwise than its reading says."""
        known = dict(ours)
        for peer, (said, theirs) in zip(peers, answers, strict=True):
            own = known.get(peer.stack.reading)
            if own is None:
                continue  # pqsec refuses it
            if said == b"crash":
                if CRASH not in own:
                    yield f"{peer.stack.name}: ends by {theirs.decode()}, and pqsec has answers"
                if _is_signed(data):
                    yield f"{peer.stack.name}: pqsec signs what ends it by {theirs.decode()}"
                continue
            pairs = {each for each in zip(own, theirs.decode(), strict=True) if each[1] != "-"}
            for mine, other in sorted(pairs):
                if mine not in {other, CRASH} and not (said and _explained(peer.stack.kind, data)):
                    reason = f": {said.decode()}" if said else ""
                    yield f"{peer.stack.name}: {WORDS[other]}, pqsec {WORDS[mine]}{reason}"


CRASH = "c"
WORDS = {"y": "yes", "n": "no"}
UNREADABLE = (
    ("cyclonedds", rb"\A(\xef\xbb\xbf|\xff\xfe|\xfe\xff)"),  # a byte order mark
    ("cyclonedds", rb"xsi:schemaLocation=|xmlns(?!:xsi)[:=]"),
    ("cyclonedds", rb"</\w+\s+>"),
    ("fastdds", rb"<\?(?!xml\s)"),  # a processing instruction
    ("fastdds", rb"-->\s*</dds\s*>"),
    ("fastdds", rb"<(enable|allow)_[^<>]*>(\s[^<]*|[^<]*\s)<"),  # spaces around a boolean
)
"""What a stack refuses in documents that match their schemas: "How a document is written" in
docs/reference/decisions.md."""


def _explained(kind, data):
    """Whether a stack of that kind refuses one of the documents for how it is written."""
    pair = libcrypto.unpacked(data)[:2]
    return any(
        re.search(pattern, each) for stack, pattern in UNREADABLE for each in pair if stack == kind
    )


def _is_signed(data):
    """Whether pqsec signs both documents."""
    governance, permissions = libcrypto.unpacked(data)[:2]
    try:
        Governance.from_xml(governance).to_xml()
        Permissions.from_xml(permissions).to_xml()
    except PqsecError:
        return False
    return True


LETTERS = {Verdict.YES: "y", Verdict.NO: "n", Verdict.CRASHES: CRASH}


def _letters(reading, pair, questions):
    policy = InterpretedPolicy(*pair, reading)
    return "".join(
        LETTERS[policy.decide(question, by=side).verdict]
        for question in questions
        for side in Viewpoint
    )


def kinds():
    """By name."""
    return {"policies": Decisions(valid), "documents": Decisions(spoilt)}
