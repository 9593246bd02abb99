"""The attacker on the way substitutes its own challenges, keys and algorithm names."""

from collections.abc import Iterator
from dataclasses import replace

from pqsec_pki._dataclass import dataclass
from pqsec_pki.algorithms import KEY_AGREEMENTS, SIGNATURES, KeyAgreement
from pqsec_pki.attacks._context import AttackContext, Attempt, value_in
from pqsec_pki.attacks._relays import putting
from pqsec_pki.attacks.attack import COVERED, DOCUMENT, TRANSCRIPT, Attack, Attacker
from pqsec_pki.handshake import CHALLENGE_SIZE
from pqsec_pki.problems import Code
from pqsec_pki.selfcheck import AUTH_REQUEST, HANDSHAKE, Relay

_HASHES = {"request": "hash_c1", "reply": "hash_c2"}
"""The hashes that show a changed introduction; they are optional, so they can be removed."""
_FORGED = bytes(CHALLENGE_SIZE)


def swap_challenges(context: AttackContext) -> Iterator[Attempt]:
    """Replace a challenge: who chooses the challenge can prepare the answer."""
    for occurrence, whose, message, name in (
        (1, "initiator's", "request", "challenge1"),
        (2, "replier's", "reply", "challenge2"),
    ):
        yield context.between(f"the {whose}, as announced", _announcing(occurrence))
        sent = putting(message, {name: _FORGED})
        yield context.between(f"the {whose}, announced and sent", _announcing(occurrence), sent)
    yield context.between("the initiator's, restored in the reply", _announcing(1), _SwapBothWays())


def _announcing(occurrence: int) -> Relay:
    return putting(AUTH_REQUEST, {"future_challenge": _FORGED}, occurrence)


@dataclass(slots=True)
class _SwapBothWays:
    """Sends the replier another challenge1, and the initiator its own in the reply."""

    challenge1: bytes = b""

    def __call__(self, name: str, data: bytes) -> bytes:
        shown = {"request": _FORGED, "reply": self.challenge1}.get(name)
        if name == "request":
            self.challenge1 = value_in(data, "challenge1")
        return putting(name, {"challenge1": shown})(name, data) if shown else data


def strip_hashes(context: AttackContext) -> Iterator[Attempt]:
    """Put other permissions in an introduction, and remove its hash."""
    for message, other in (("request", "reply"), ("reply", "request")):
        name = _HASHES[message]
        relays = [putting(each, {name: None}) for each in HANDSHAKE]
        relays += [putting(message, {"c.perm": context.value(other, "c.perm")})]
        yield context.between(f"c.perm of the {message}, without {name}", *relays)


def sit_in_the_middle(context: AttackContext) -> Iterator[Attempt]:
    """Use keys of its own with both sides, to read what they send."""
    agreement = context.session.agreement
    yield context.between("dh1 and dh2", _Middle(agreement))
    yield context.between("dh1 and dh2, with dh1 not repeated", _Middle(agreement, hides=True))


@dataclass(slots=True)
class _Middle:
    """Agrees on a key with each side in the name of the other."""

    agreement: KeyAgreement
    hides: bool = False
    """Whether it removes dh1 from the reply, where it would differ from what is signed."""
    dh1: bytes = b""
    """The initiator's dh1."""

    def __call__(self, name: str, data: bytes) -> bytes:
        match name:
            case "request":
                self.dh1 = value_in(data, "dh1")
                return putting(name, {"dh1": self.agreement.generate().public})(name, data)
            case "reply":
                dh2, _ = self.agreement.encapsulate(self.dh1)
                dh1 = None if self.hides else self.dh1
                return putting(name, {"dh1": dh1, "dh2": dh2})(name, data)
        return data


# Names of algorithms


def downgrade(context: AttackContext) -> Iterator[Attempt]:
    """Ask for every key agreement except the domain's own."""
    own = context.session.agreement.wire_name
    for row in KEY_AGREEMENTS:
        if row.wire_name != own:
            asked = replace(context.session, agreement=row)
            yield Attempt(f"{row.name} in the request", asked, context.session.initiator.name)
            relay = _naming("reply", "c.kagree_algo", row.wire_name.encode() + b"\0")
            yield context.between(f"{row.name} in the reply", relay)


def name_other_signatures(context: AttackContext) -> Iterator[Attempt]:
    """Name every signature algorithm except the sender's."""
    for message, side in zip(_HASHES, context.session.sides, strict=True):
        own = side.terms.own.key.algorithm.wire_name
        for name in dict.fromkeys(row.wire_name for row in SIGNATURES):
            if name != own:
                relay = _naming(message, "c.dsign_algo", name.encode() + b"\0")
                yield context.between(f"{name} in the {message}", relay)


def name_unknown_algorithms(context: AttackContext) -> Iterator[Attempt]:
    """Use names of no algorithm, and values that are not names."""
    names = {"none": b"none\0", "empty": b"", "not text": b"\xff\xfe\0", "1000 bytes": b"A" * 1000}
    for message in _HASHES:
        for field in ("c.dsign_algo", "c.kagree_algo"):
            for what, name in names.items():
                relay = _naming(message, field, name)
                yield context.between(f"{field} of the {message}: {what}", relay)


def _naming(message: str, field: str, value: bytes) -> Relay:
    return putting(message, {field: value, _HASHES[message]: None})


ATTACKS = (
    Attack(
        name="swap-challenge",
        attacker=Attacker.ON_THE_WAY,
        title="replaces a fresh challenge by its own, for which it has an answer",
        refused_at=("reply", "final"),
        checks=(Code.C14, Code.C19, Code.C20, Code.C21),
        also=TRANSCRIPT,
        because=COVERED,
        act=swap_challenges,
    ),
    Attack(
        name="strip-hash",
        attacker=Attacker.ON_THE_WAY,
        title="changes the permissions in a message and removes the hash that would show it",
        refused_at=("final",),
        checks=(Code.C21,),
        also=(*TRANSCRIPT, *DOCUMENT),
        because=COVERED,
        act=strip_hashes,
    ),
    Attack(
        name="key-in-the-middle",
        attacker=Attacker.ON_THE_WAY,
        title="agrees on a key with each side in the other's name, to read what they send",
        refused_at=("final",),
        checks=(Code.C21,),
        also=TRANSCRIPT,
        because=COVERED,
        act=sit_in_the_middle,
    ),
    Attack(
        name="downgrade",
        attacker=Attacker.ON_THE_WAY,
        title="asks for another key agreement than the profile's, such as a weaker one",
        refused_at=("reply", "final"),
        checks=(Code.C8, Code.C18),
        also=TRANSCRIPT,
        because=COVERED,
        act=downgrade,
    ),
    Attack(
        name="name-other-signature",
        attacker=Attacker.ON_THE_WAY,
        title="names another signature algorithm than the certificate's",
        refused_at=("reply", "final"),
        checks=(Code.C16,),
        also=TRANSCRIPT,
        because=COVERED,
        act=name_other_signatures,
    ),
    Attack(
        name="name-unknown-algorithm",
        attacker=Attacker.ON_THE_WAY,
        title="names an algorithm that does not exist",
        refused_at=("reply", "final"),
        checks=(Code.C8, Code.C16, Code.C18),
        also=TRANSCRIPT,
        because=COVERED,
        act=name_unknown_algorithms,
    ),
)
