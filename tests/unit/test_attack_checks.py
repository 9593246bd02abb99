"""Each attack is refused by the checks that its row names: without them it succeeds."""

import os
from collections import defaultdict
from contextlib import suppress
from functools import cache, partial

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS, KeyAgreement, KeyPair
from pqsec_pki.attacks._context import AttackContext
from pqsec_pki.attacks.attack import CERTIFICATE
from pqsec_pki.attacks.table import ATTACKS
from pqsec_pki.errors import PqsecError, problems_of
from pqsec_pki.handshake import (
    Introduction,
    PeerRequirements,
    RemotePeer,
    StockPeers,
    Terms,
    Transcript,
    _cdr,
    compact,
    messages,
    participant_data,
    states,
    wire,
)
from pqsec_pki.handshake.states import RequestSent
from pqsec_pki.handshake.wire import MAX_SAMPLE
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import HandshakeSetup, session
from pqsec_pki.selfcheck import run as selfcheck_run
from pqsec_pki.selfcheck.handshake_check import HandshakeCheck
from pqsec_pki.selfcheck.report import Steps, StoppedError
from tests.unit.test_attacks import GUESTS, NOW, SETS, made

pytestmark = [
    pytest.mark.filterwarnings("ignore::cryptography.utils.CryptographyDeprecationWarning"),
    pytest.mark.filterwarnings("ignore:Attribute's length:UserWarning"),
]
GENEROUS = 1 << 30
MOST_ROUNDS = 12
UNSAID = {Code.OTHER, Code.FILE_MALFORMED}


class Trusting(_cdr.CdrReader):
    """Reads on where nothing is left, and as much as there is where more is claimed."""

    left = 0

    def raw(self, size):
        start, self._at = self._at, min(self._at + size, len(self._data))
        return self._data[start : self._at]

    def u32(self):
        self._at += -self._at % 4
        return self._order.u32.unpack(self.raw(4).ljust(4, b"\0"))[0]

    def i64(self):
        self._at += -self._at % 8
        return self._order.i64.unpack(self.raw(8).ljust(8, b"\0"))[0]

    def octets(self):
        return self.raw(self.u32())

    def string(self):
        return self.octets().rstrip(b"\0").decode(errors="replace")

    def sequence(self, item, limit):
        del limit
        return tuple(item() for _ in range(self.u32()) if self._at < len(self._data))

    def pairs(self, limit):
        return self.sequence(lambda: (self.string(), self.octets()), limit)


def filled(found, due):
    """What is missing is there, and empty; but not what is only repeated."""
    repeated = {"challenge1"} if "dh1" not in due else set()
    repeated |= {"challenge2"} if "dh2" not in due else set()
    for name in due:
        if name not in repeated:
            found.setdefault(name, b"")
    return []


def any_agreement(policy, name):
    """What the peer asks for, if there is such a thing."""
    known = {row.wire_name: row for row in KEY_AGREEMENTS}
    return known.get(name, policy.agreements[0])


def to_a_new_key(agreement, _):
    """Where the public key is none, to another."""
    row = KEY_AGREEMENTS.on_wire(agreement.wire_name)
    return row.encapsulate(row.generate().public)


def initiators_credentials(context, _):
    """What the initiator has sent, where it cannot be inflated."""
    permissions = context.value("request", "c.perm")
    return context.value("request", "c.id"), compact.canonical(permissions)


class Checks:
    """The handshake's; those in `removed` find nothing wrong. One function for each check."""

    def __init__(self, patch, context):
        self.patch, self.removed = patch, set()
        self.known = [RemotePeer.read(introduction(context, each)) for each in ("request", "reply")]
        for place, name in (
            (messages, "_class_problems"),  # C3
            (messages, "_double_problems"),  # C5
            (messages, "_size_problems"),  # C6, and C8 and C16 of names that are too long
            (messages, "_unknown_problems"),  # C7
            (Terms, "_problems"),  # C10 to C13
            (states, "_request_problems"),  # C14, C15
            (Transcript, "differences"),  # C19, C23
            (RequestSent, "_problems"),  # C18 to C20
        ):
            self.listing(place, name)
        for code, place, name, instead in (
            (Code.C2, selfcheck_run, "_check_envelope", lambda *_: None),
            (Code.C4, messages, "_missing_problems", filled),
            (Code.C8, PeerRequirements, "agreement", any_agreement),
            (Code.C17, KeyAgreement, "encapsulate", to_a_new_key),
            (Code.C22, KeyPair, "decapsulate", lambda *_: os.urandom(32)),
            (Code.C25, selfcheck_run, "check_permissions", lambda *_: "not judged"),
            (Code.C26, selfcheck_run, "confirmed", lambda *_: None),
            (Code.C27, compact, "_inflated", partial(initiators_credentials, context)),
            (Code.C28, states, "check_version", lambda *_: None),
            (Code.C30, session, "refuse_weak_set", lambda *_: None),
            (Code.OTHER, states, "_check_signature", lambda *_: None),  # C21, C24
            (Code.OTHER, RemotePeer, "read", self.somebody),  # C9, and C11 without a GUID
        ):
            self.raising(code, place, name, instead)
        self.naming()
        self.reading()

    def listing(self, place, name):
        """A function that gives what is wrong."""
        genuine = getattr(place, name)

        def listed(*values):
            found = genuine(*values)
            return [each for each in found if each.code not in self.removed]

        self.patch.setattr(place, name, listed)

    def raising(self, code, place, name, instead):
        """A function that refuses, for what `code` stands if it does not say; or a value."""
        genuine = getattr(place, name)

        def raised(*values, **more):
            if name == "_missing_problems" and code in self.removed:
                return instead(*values)
            try:
                return genuine(*values, **more)
            except PqsecError as error:
                codes = {each.code for each in problems_of(error, code)}
                if not {code if each in UNSAID else each for each in codes} <= self.removed:
                    raise
                return instead(*values)

        self.patch.setattr(place, name, staticmethod(raised) if place is RemotePeer else raised)

    def somebody(self, introduction):
        """Either participant, if what it says of itself cannot be read."""
        return next(
            (
                each
                for each in self.known
                if each.certificate.pem == introduction.certificate.rstrip(b"\0")
                or participant_data(each.guid) == introduction.participant_data
            ),
            self.known[0],
        )

    def naming(self):
        """C16: whatever it is called, the best key that the peer has."""
        genuine = RemotePeer.key_for

        def found(peer, name, policy):
            key = genuine(peer, name, policy)
            if key is None and Code.C16 in self.removed:
                by_name = (each for each in peer.keys if each.algorithm.wire_name == name)
                return next(by_name, peer.keys[0])
            return key

        self.patch.setattr(RemotePeer, "key_for", found)

    def reading(self):
        """C1."""

        def reader(data, order):
            return (Trusting if Code.C1 in self.removed else _cdr.CdrReader)(data, order)

        self.patch.setattr(wire, "CdrReader", reader)

    def without(self, removed):
        """From now on `removed` are out."""
        self.removed = removed
        limit = GENEROUS if Code.C1 in removed else MAX_SAMPLE
        self.patch.setattr(wire, "MAX_SAMPLE", limit)


def introduction(context, message):
    return Introduction(*[context.value(message, name) for name in Introduction.NAMES])


def refusal(attempt):
    """The codes of the participant that refuses it; empty if none does."""
    run = selfcheck_run.HandshakeRun(attempt.session, Steps())
    with suppress(StoppedError):
        run.perform()
    step = run.steps.done[-1]
    # An attacker does not stop itself; nor is a step refused that did not run.
    return frozenset() if step.ok else step.codes


@pytest.fixture(scope="module")
def context(tmp_path_factory):
    """Two of that profile who met."""

    @cache
    def find(profile):
        keystore = made(tmp_path_factory.mktemp(profile) / "k", profile)
        stock = StockPeers() if len(keystore.profiles) > 1 else None
        meeting = HandshakeCheck(HandshakeSetup(keystore=keystore, domain=0, now=NOW, stock=stock))
        session = meeting.prepare(*GUESTS)
        meeting.perform(session)
        return AttackContext(session=session, recorded=meeting.report().sent)

    return find


def peeled(attack, context, checks):
    """For each attempt the checks that refused it, one after the other, until none did."""
    layers = defaultdict(list)
    for _ in range(MOST_ROUNDS):
        checks.without(set())
        attempts, again = attack.act(context), False
        for at, attempt in enumerate(attempts):
            checks.without(set().union(*layers[at]))
            codes = refusal(attempt)
            checks.without(set())
            if codes:
                assert codes - set().union(*layers[at]), f"{attempt.what}: still {codes}"
                layers[at].append(codes)
                again = True
        if not again:
            return list(layers.values())
    raise AssertionError(f"{attack.name} is refused for ever: {layers}")


@pytest.mark.slow(but=15)
@pytest.mark.parametrize("attack", ATTACKS, ids=lambda row: row.name)
def test_an_attack_succeeds_without_the_checks_that_its_row_names(context, monkeypatch, attack):
    """Each attempt is tried again without what refused it, until nothing does."""
    first, later = set(), set()
    for profile in ("transition", "classical", SETS):
        found = context(profile)
        if attack.not_applicable(found.session):
            continue
        with monkeypatch.context() as patch:
            layers = peeled(attack, found, Checks(patch, found))
        assert layers
        first |= {code for each in layers for code in each[0]}
        later |= {code for each in layers for codes in each[1:] for code in codes}
    assert first <= set(attack.checks), attack.name
    assert later <= {*attack.checks, *attack.also}, attack.name
    # A row names no check that refuses nothing. What one bit breaks is another thing each time.
    if not {*CERTIFICATE} <= {*attack.checks}:
        assert first == set(attack.checks), attack.name
    assert bool(attack.also) == bool(attack.because)
