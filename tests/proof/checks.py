"""What each check of wire.md, section 9, is for: the attack without it, or why there is none."""

from dataclasses import dataclass

WITHOUT_ALL = "without all redundant checks"
HYBRID = f"{WITHOUT_ALL}, hybrid suite"
MESSAGES = f"{WITHOUT_ALL}, first messages"
SUITES = f"{WITHOUT_ALL}, ECDH too"
EVERYWHERE = "in no scenario"


@dataclass(frozen=True)
class Needed:
    """There is an attack without it: the scenario, and what the attacker then does."""

    scenario: str
    attack: str


@dataclass(frozen=True)
class Redundant:
    """The queries hold without it, in that scenario: why."""

    why: str
    scenario: str = WITHOUT_ALL


@dataclass(frozen=True)
class Outside:
    """A symbolic model cannot be without it: what it assumes instead."""

    assumption: str


REPEATED = "both signatures cover the value, and a verifier has its own"
ONE_SET = "each participant has one set of credentials"
FORM = "every value has one encoding, and one reading"
CHECKS: dict[str, Needed | Redundant | Outside] = {
    "C1": Outside(FORM),
    "C2": Redundant(
        "the model has no addresses: both signatures name the two by their certificates", EVERYWHERE
    ),
    "C3": Redundant(
        "the two signed lists begin with different names, so neither signature fits the other"
    ),
    "C4": Redundant("the attacker can send an absent value for any other", EVERYWHERE),
    "C5": Needed(
        "without C5",
        "replaces a peer's permissions by older ones, in a second `c.perm` that no hash covers",
    ),
    "C6": Redundant(
        "the queries hold even if the key of the key exchange does not contain the challenges",
        MESSAGES,
    ),
    "C7": Outside("all implementations hash the same five properties"),
    "C8": Needed(
        "without C8",
        "a quantum computer reads what a replier protects that should accept hybrid suites only",
    ),
    "C9": Outside(FORM),
    "C10": Needed("without C10", "issues itself a certificate"),
    "C10.alternative": Needed(
        "without C10, alternative signature",
        "issues certificates with the CA's classical key, once ECDSA has fallen",
    ),
    "C10.revocation": Needed(
        "without C10, revocation", "uses stolen keys whose certificate was revoked"
    ),
    "C11": Needed("without C11", "claims the GUID of another participant"),
    "C12": Needed(
        "without C12",
        "answers in the place of the participant that was discovered, with its own certificate",
    ),
    "C13": Needed("without C13", "has a participant authenticate itself"),
    "C14": Redundant(REPEATED),
    "C15": Redundant(REPEATED),
    "C16": Needed("without C16", "signs with the classical key alone, once ECDSA has fallen"),
    "C17": Redundant(
        "an invalid `dh1` reveals at most the exponent of that handshake, which is used once",
        HYBRID,
    ),
    "C18": Redundant("the initiator uses its own suite, and the name is in `hash_c2`", SUITES),
    "C19": Redundant(REPEATED),
    "C20": Redundant(REPEATED),
    "C21": Needed("without C21", "answers with another's certificate, and its own `dh2`"),
    "C22": Redundant(
        "an invalid `dh2` reveals at most the exponent of that handshake, which is used once",
        HYBRID,
    ),
    "C23": Redundant(REPEATED),
    "C24": Needed("without C24", "asks with another's certificate, and its own `dh1`"),
    "C25": Needed("without C25", "shows permissions that nobody signed"),
    "C25.countersigner": Needed(
        "without C25, countersigner",
        "signs permissions with the classical key of the permissions CA, once ECDSA has fallen",
    ),
    "C26": Needed(
        "without C26",
        "drops the Final: the initiator takes a peer for confirmed that has not ended",
    ),
    "C26.destination": Redundant("the source is enough", "without C26, destination, ECDH"),
    "C26.source": Needed(
        "without C26, source: tokens by their source",
        "sends its own crypto tokens in another's name, if they are taken for the source's",
    ),
    "C26.destination or C26.source": Needed(
        "without C26, destination and source, ECDH",
        "sends a participant its own first message, or, as an insider between two, the other's",
    ),
    "C27": Outside(FORM),
    "C28": Redundant("the hashes cover the version"),
    "C29": Outside(ONE_SET),
    "C30": Outside(ONE_SET),
}
"""By number; a part of a check has a word behind it."""
