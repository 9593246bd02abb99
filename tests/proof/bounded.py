"""The second tool: Maude searches all runs of a few sessions, for the main queries."""

import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass

from pqsec_pki.handshake import Transcript
from tests.proof.model import CHECKS, FOLDER, kept
from tests.proof.protocol import SIX, in_signature

LIMIT = 1800
"""Seconds for all searches of a scenario."""
SESSIONS = {
    "alice and bob": "initiator(alice, 1) replier(bob, 2)",
    "alice in both roles": "initiator(alice, 1) replier(alice, 2)",
    "alice, bob in both roles": "initiator(alice, 1) replier(bob, 2) initiator(bob, 3)",
}
_INSTEAD = "P =/= eve and not"
QUERIES = {
    "reach": "< confirmedI(alice, N, bob, O, Z) confirmedR(bob, M, alice, O, Z) R | K >",
    "agreeI": f"< doneI(A, N, P, O, Z) R | K > such that {_INSTEAD} knows(R, P, A, O, Z)",
    "agreeR": f"< doneR(A, N, P, O, Z) R | K > such that {_INSTEAD} knows(R, P, A, O, Z)",
    "secretI": "< doneI(A, N, P, O, Z) R | K > such that P =/= eve and can(K, Z)",
    "secretR": "< doneR(A, N, P, O, Z) R | K > such that P =/= eve and can(K, Z)",
    "oneTranscript": "< doneI(A, N, P, O, Z) doneR(B, M, Q, O', Z) R | K > such that O =/= O'",
    "confirmedI": f"< confirmedI(A, N, P, O, Z) R | K > such that {_INSTEAD} told(R, P, A, Z)",
    "confirmedR": f"< confirmedR(A, N, P, O, Z) R | K > such that {_INSTEAD} told(R, P, A, Z)",
    "meantI": "< confirmedI(A, N, P, O, Z) sentR(B, M, Q, O', Z) R | K > "
    "such that P =/= B or Q =/= A",
}
"""State that breaks the query of that name; what `reach` looks for must be found."""


@dataclass(frozen=True, kw_only=True)
class Bounded:
    """What Maude searches, and which queries fail."""

    name: str
    words: str
    fails: str = ""
    without: str = ""
    sessions: tuple[str, ...] = ("alice and bob", "alice in both roles")


SCENARIOS = (
    Bounded(name="hybrid suite", words="HYBRID bound", sessions=("alice and bob",)),
    Bounded(name="ML-KEM", words="KEM bound"),
    Bounded(
        name="ML-KEM, three sessions", words="KEM bound", sessions=("alice, bob in both roles",)
    ),
    Bounded(name="ECDH or MODP", words="DH", fails="oneTranscript"),
    Bounded(
        name="hybrid suite, quantum computer",
        words="HYBRID bound dh_broken",
        sessions=("alice and bob",),
    ),
    Bounded(
        name="ECDH or MODP, quantum computer",
        words="DH dh_broken",
        fails="secretI secretR oneTranscript confirmedI confirmedR meantI",
    ),
    Bounded(
        name="ML-KEM, private key of the replier lost",
        words="KEM bound compromise",
        fails="agreeI secretI confirmedI",
        sessions=("alice and bob",),
    ),
    Bounded(name="ML-KEM, plain secret", words="KEM", fails="oneTranscript"),
    Bounded(
        name="without C21 and C24",
        words="KEM bound",
        without="C21",
        fails="agreeI agreeR secretI secretR confirmedI confirmedR",
    ),
    Bounded(
        name="without C26, destination and source",
        words="DH",
        without="C26.destination",
        fails="oneTranscript confirmedI confirmedR meantI",
    ),
)


def model(scenario: Bounded) -> str:
    """The text for Maude."""
    words = frozenset(scenario.words.split()) | (frozenset(CHECKS) - {*scenario.without.split()})
    text = kept((FOLDER / "7-bounded.maude").read_text(), words)
    return text.replace("@LISTS@", "\n".join(_lists()))


def found(scenario: Bounded) -> dict[str, bool]:
    """Query -> whether a run breaks it, in any of the sessions."""
    answers = [_answers(scenario, SESSIONS[each]) for each in scenario.sessions]
    return {query: any(each[query] for each in answers) for query in QUERIES}


def expected(scenario: Bounded) -> dict[str, bool]:
    """The same, as it should be."""
    return {query: query in {"reach", *scenario.fails.split()} for query in QUERIES}


def _answers(scenario: Bounded, sessions: str) -> dict[str, bool]:
    start = f"< {sessions} | known >"
    searches = [f"search [1] {start} =>* {pattern} ." for pattern in QUERIES.values()]
    text = "\n".join([model(scenario), *searches, "quit"])
    done = subprocess.run(
        ["maude", "-no-banner", "-no-wrap"],
        input=text,
        capture_output=True,
        text=True,
        timeout=LIMIT,
        check=True,
    )
    lines = re.findall(r"(?m)^(No solution|Solution 1)\b", done.stdout)
    if len(lines) != len(QUERIES):
        raise RuntimeError((done.stdout + done.stderr)[-1000:])
    return {query: line != "No solution" for query, line in zip(QUERIES, lines, strict=True)}


def _lists() -> Iterator[str]:
    probe = Transcript(**{name: b"<%s>" % name.encode() for name in SIX})
    yield f"  ops {' '.join(f'n_{name}' for name in SIX)} : -> Name [ctor] ."
    yield "  ops reply final : Term Term Term Term Term Term -> Octets ."
    variables = dict(zip(SIX, ("H1", "H2", "C1", "C2", "D", "E"), strict=True))
    for name, octets in ("reply", probe.reply_octets()), ("final", probe.final_octets()):
        values = [f"is(n_{each}, {variables[each]})" for each in in_signature(octets)]
        yield f"  eq {name}({', '.join(variables.values())}) = {', '.join(values)} ."
