"""The scenarios: what is in the model, and which queries hold."""

from collections.abc import Iterator

from tests.proof.model import Scenario

BOTH_SIDES = ("agree", "secret", "hybrid", "forward", "ephemeral", "guid", "discovered", "allowed")
BOTH_SIDES += ("shown", "confirmed", "ended", "meant", "token", "after", "apart")
"""Queries whose names, without I or R, stand for both."""
REDUNDANT = ("C3", "C6", "C17", "C18", "C22", "C28")
"""More checks without which all queries hold."""
LIGHT = "C12 C14 C15 C19 C20 C23"
"""Checks that most scenarios do not have: what is proved without them holds with them."""
ALL_REDUNDANT = " ".join([LIGHT, *REDUNDANT])
CONFIRMATION = "confirmed ended meant token"


def _expected(text: str) -> Iterator[tuple[str, bool]]:
    """`agree !secretI` as queries: both agree hold, and there is an attack on secretI."""
    for word in text.split():
        name, holds = word.lstrip("!"), not word.startswith("!")
        for side in ("I", "R") if name in BOTH_SIDES else ("",):
            yield name + side, holds


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


def _scenario(  # noqa: PLR0913 -- a row of a table
    name: str,
    expected: str,
    words: str = "",
    suites: str = "HYBRID",
    *,
    without: str = LIGHT,
    repliers: str = "",
    versions: tuple[int, ...] = (1,),
    settings: tuple[str, ...] = (),
) -> Scenario:
    if "C12" not in without.split():
        words += " discovery"
    return Scenario(
        name=name,
        expected=dict(_expected(expected)),
        words=_words(words),
        without=_words(without),
        initiators=tuple(suites.split()),
        repliers=tuple((repliers or suites).split()),
        versions=versions,
        settings=settings,
    )


CORE = "agree secret oneTranscript oneKey notSelf allowed shown"
ALL = f"{CORE} guid discovered"
PRECISE = ("preciseActions = true",)
PROTOCOL = (
    _scenario("hybrid suite, every check", ALL, without=""),
    _scenario("hybrid suite, every check, second version", ALL, without="", versions=(2,)),
    _scenario("hybrid suite, both versions", "agree secret oneTranscript", versions=(1, 2)),
    _scenario("hybrid suite, first messages", CONFIRMATION, "confirm"),
    _scenario("ML-KEM", CORE, suites="KEM"),
    _scenario(
        "ML-KEM, second version, first messages", CONFIRMATION, "confirm", "KEM", versions=(2,)
    ),
    _scenario("ML-KEM, tokens by their source", "attributed", "confirm attributed", "KEM"),
    _scenario("ECDH or MODP", "agree secret oneKey notSelf", suites="DH"),
    _scenario("ECDH or MODP, first messages", CONFIRMATION, "confirm", "DH", settings=PRECISE),
    _scenario("ECDH or MODP: an insider in the middle", "!oneTranscript", suites="DH"),
    _scenario("all suites at once", "agree", suites="DH KEM HYBRID"),
    _scenario("older permissions are valid too", "allowed shown", "older_permissions", "KEM"),
    _scenario("an announced challenge in many Replies", "agree secret", "reused_challenge"),
)
FALLEN = (
    _scenario("quantum computer, ECDH or MODP", "agree !secret", "dh_broken", "DH"),
    _scenario("quantum computer, hybrid suite", "agree secret", "dh_broken"),
    _scenario("ML-KEM falls, hybrid suite", "agree secret", "kem_broken"),
    _scenario("ML-KEM falls, ML-KEM", "agree !secret", "kem_broken", "KEM"),
    _scenario("ECDH and ML-KEM fall", "agree !secret oneTranscript", "dh_broken kem_broken"),
    _scenario(
        "quantum computer, initiators use ECDH for others",
        "secretR",
        "dh_broken",
        "HYBRID DH",
        repliers="HYBRID",
    ),
    _scenario(
        "quantum computer, both use ECDH for others", "hybrid !secret", "dh_broken", "HYBRID DH"
    ),
    _scenario("a KEM that binds nothing", "agree secret oneTranscript", "loose_kem", "KEM"),
    _scenario(
        "a KEM that binds nothing, plain secret",
        "agree secret !oneTranscript",
        "loose_kem plain",
        "KEM",
    ),
    _scenario("hybrid suite, plain secret", "agree secret !oneTranscript", "plain"),
    _scenario("signatures valid under other keys too", "agree secret", "shared_signatures"),
)
LOST = (
    _scenario("private keys lost", "agree secret", "compromise"),
    _scenario("private keys lost at some time", "forward", "compromise"),
    _scenario(
        "private keys lost at some time, quantum computer", "forward", "compromise dh_broken"
    ),
    _scenario("private keys lost at some time, ML-KEM falls", "forward", "compromise kem_broken"),
    _scenario(
        "private keys lost at some time, ECDH falls too", "!forward", "compromise dh_broken", "DH"
    ),
    _scenario("all private keys and CAs lost afterwards", "secret", "compromise_later", "KEM"),
    _scenario("ephemeral secrets lost", "agree ephemeral", "ephemeral", "KEM"),
    _scenario("ephemeral secrets lost, hybrid suite", "agree ephemeral", "ephemeral"),
    _scenario("keys stolen, then revoked", "after", "revocation", "KEM"),
    _scenario("identity CA lost", "!agree !secret", "identity_ca_lost"),
    _scenario("permissions CA lost", "agree secret !allowed", "permissions_ca_lost"),
    _scenario("a second identity CA, lost", "agree secret apart", "two_cas", "KEM"),
)
SIGNATURES = (
    _scenario("pair", "agree secret notSelf", "pair"),
    _scenario("pair, ECDSA falls", "agree secret", "pair ecdsa_broken", "KEM"),
    _scenario("pair, ML-DSA falls", "agree secret", "pair mldsa_broken", "KEM"),
    _scenario("pair, both fall", "!agree", "pair ecdsa_broken mldsa_broken", "KEM"),
    _scenario("pair, quantum computer", "agree secret", "pair ecdsa_broken dh_broken"),
    _scenario(
        "pair, second version, ECDSA falls",
        "agree secret",
        "pair ecdsa_broken",
        "KEM",
        versions=(2,),
    ),
    _scenario(
        "pair, signs plainly for stock stacks, ECDSA falls",
        "agree",
        "pair plain_too ecdsa_broken",
        "KEM",
    ),
    _scenario(
        "pair, less accepted, nothing falls",
        "agree",
        "pair plain_too",
        "KEM",
        without=LIGHT + " C16",
    ),
    _scenario("composite", "agree secret", "composite", "KEM"),
    _scenario("composite, ECDSA falls", "agree secret", "composite ecdsa_broken", "KEM"),
    _scenario("composite, ML-DSA falls", "agree secret", "composite mldsa_broken", "KEM"),
    _scenario("composite, both fall", "!agree", "composite ecdsa_broken mldsa_broken", "KEM"),
    _scenario("countersigned permissions", "allowed", "countersigned", "KEM"),
    _scenario(
        "countersigned permissions, ECDSA falls", "allowed", "countersigned ecdsa_broken", "KEM"
    ),
    _scenario(
        "countersigned permissions, ML-DSA falls",
        "allowed",
        "countersigned pair mldsa_broken",
        "KEM",
    ),
)
WITHOUT = (
    _scenario("without C5", "!shown", "older_permissions", "KEM", without=LIGHT + " C5"),
    _scenario("without C8", "!secretR", "dh_broken", "HYBRID DH", without=LIGHT + " C8"),
    _scenario("without C10", "!agree !secret", suites="KEM", without=LIGHT + " C10"),
    _scenario(
        "without C10, alternative signature",
        "!agree",
        "pair ecdsa_broken",
        "KEM",
        without=LIGHT + " C10.alternative",
    ),
    _scenario(
        "without C10, revocation", "!after", "revocation", "KEM", without=LIGHT + " C10.revocation"
    ),
    _scenario("without C11", "!guid", "discovery", "KEM", without="C11"),
    _scenario("without C12", "!discovered", "discovery", "KEM", without="C12"),
    _scenario("without C13", "!notSelf agree", suites="KEM", without=LIGHT + " C13"),
    _scenario(
        "without C16", "!agree", "pair plain_too ecdsa_broken", "KEM", without=LIGHT + " C16"
    ),
    _scenario("without C21", "!agreeI !secretI", suites="KEM", without=LIGHT + " C21"),
    _scenario("without C24", "!agreeR !secretR", suites="KEM", without=LIGHT + " C24"),
    _scenario("without C25", "!allowed", suites="KEM", without=LIGHT + " C25"),
    _scenario(
        "without C25, countersigner",
        "!allowed",
        "countersigned ecdsa_broken",
        "KEM",
        without=LIGHT + " C25.countersigner",
    ),
    _scenario("without C26", "!endedI", "confirm", "KEM", without=LIGHT + " C26"),
    _scenario(
        "without C26, destination",
        CONFIRMATION,
        "confirm",
        "KEM",
        without=LIGHT + " C26.destination",
    ),
    _scenario("without C26, source", CONFIRMATION, "confirm", "KEM", without=LIGHT + " C26.source"),
    _scenario(
        "without C26, source: tokens by their source",
        "!attributed",
        "confirm attributed",
        "KEM",
        without=LIGHT + " C26.source",
    ),
    _scenario(
        "without C26, destination and source",
        "!confirmed !ended",
        "confirm",
        "KEM",
        without=LIGHT + " C26.destination C26.source",
    ),
    _scenario(
        "without C26, destination and source, ECDH",
        "!confirmed !meant",
        "confirm",
        "DH",
        without=LIGHT + " C26.destination C26.source",
    ),
    _scenario(
        "without C26, destination, ECDH",
        CONFIRMATION,
        "confirm",
        "DH",
        without=LIGHT + " C26.destination",
        settings=PRECISE,
    ),
    _scenario(
        "without C26, source, ECDH",
        CONFIRMATION,
        "confirm",
        "DH",
        without=LIGHT + " C26.source",
        settings=PRECISE,
    ),
    _scenario(
        "without all redundant checks", CORE, suites="KEM", versions=(1, 2), without=ALL_REDUNDANT
    ),
    _scenario("without all redundant checks, hybrid suite", "agree secret", without=ALL_REDUNDANT),
    _scenario(
        "without all redundant checks, first messages",
        CONFIRMATION,
        "confirm",
        "KEM",
        without=ALL_REDUNDANT,
    ),
    _scenario(
        "without all redundant checks, ECDH too",
        "agree",
        suites="DH HYBRID",
        without=ALL_REDUNDANT,
    ),
)
PAPER = (
    _scenario("the paper's plugin, point 1", "!agree !secret", "flawed_signature"),
    _scenario(
        "the paper's plugin, points 1 and 5", "!agree !secret", "flawed_signature flawed_final"
    ),
    _scenario("the paper's plugin, point 4", "!agree", "unsigned_hashes"),
    _scenario("the paper's plugin, point 5", "agreeR", "flawed_final", settings=PRECISE),
    _scenario(
        "the paper's plugin, point 5, challenge reused", "!agreeR", "flawed_final reused_challenge"
    ),
)
GROUPS = {
    "The protocol": PROTOCOL,
    "Algorithms that fall": FALLEN,
    "Keys that are lost": LOST,
    "Two keys, composites and permissions": SIGNATURES,
    "Without a check": WITHOUT,
    "The paper's plugin": PAPER,
}
SCENARIOS = tuple(each for group in GROUPS.values() for each in group)
