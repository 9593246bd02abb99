"""Writes the model of a scenario: docs/proof/*.pv with its words, suites and versions."""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

from pqsec_pki.problems import Code
from tests.proof import protocol

FOLDER = Path(__file__).parents[2] / "docs/proof"
PARTS = ("C10.alternative", "C10.revocation", "C25.countersigner", "C26.destination", "C26.source")
"""Checks that are a part of another one."""
CHECKS = (*(each.value for each in Code if re.fullmatch("C[0-9]+", each)), "C10", *PARTS)
_CHECKED = re.compile(r"\(\* (C[0-9]+(?:\.[a-z]+)?) \*\)$")
_QUERY = re.compile(r"(?ms)^\(\* (\w+): (.*?) \*\)\n(.*?)(?=^\(\*|\Z)")


@dataclass(frozen=True, kw_only=True)
class Scenario:
    """What is in a model, and what is expected of its queries."""

    name: str
    expected: Mapping[str, bool]
    """Query -> whether it holds."""
    words: frozenset[str] = frozenset()
    """Conditions for lines of the model, beside the checks."""
    without: frozenset[str] = frozenset()
    """Checks that are missing."""
    initiators: tuple[str, ...] = ("HYBRID",)
    repliers: tuple[str, ...] = ("HYBRID",)
    versions: tuple[int, ...] = (1,)
    settings: tuple[str, ...] = ()
    """Settings of ProVerif."""
    note: str = ""
    """What a failed query means."""

    @property
    def conditions(self) -> frozenset[str]:
        """All words of the model."""
        kinds = {"single", "pair", "composite"}
        own = self.words if self.words & kinds else self.words | {"single"}
        return own | (frozenset(CHECKS) - self.without)


def model(scenario: Scenario, query: str) -> str:
    """The text for ProVerif, with one query: `reach` asks whether each end can be reached."""
    words = scenario.conditions
    parts = [
        f"(* {scenario.name}: {query} *)",
        *(f"set {setting}." for setting in scenario.settings),
        kept(_file("1-primitives"), words),
        kept(_file("2-credentials"), words),
        protocol.wire(words, scenario.versions),
        kept(_file("3-events"), words),
        *_query(scenario, query),
        *_roles(scenario),
        kept(_domain(scenario), words),
    ]
    return re.sub(r"\n\n+", "\n\n", "\n".join(parts)) + "\n"


def digest(scenario: Scenario) -> str:
    """That of all texts of a scenario, without comments but those that are made from the code."""
    texts = [model(scenario, query) for query in ("reach", *scenario.expected)]
    bare = [re.sub(r"(?s)\(\*.*?\*\)|\s", "", text) for text in texts]
    made = protocol.wire(scenario.conditions, scenario.versions)
    return sha256("\0".join([*bare, made]).encode()).hexdigest()[:32]


def questions() -> dict[str, str]:
    """What each query asks."""
    return {name: words for name, words, _ in _QUERY.findall(_file("6-queries"))}


def _file(name: str) -> str:
    text = (FOLDER / f"{name}.pv").read_text()
    for name_, value in re.findall(r"(?m)^#define (\w+) (.*)\n", text):
        text = text.replace(f"@{name_}@", value)
    return re.sub(r"(?m)^#define .*\n", "", text)


def kept(text: str, words: frozenset[str]) -> str:
    """The lines for a scenario with these words."""
    return "\n".join(_lines(text.splitlines(), words))


def _lines(lines: Iterable[str], words: frozenset[str]) -> Iterator[str]:
    inside: list[bool] = []
    for line in lines:
        if line.startswith("#if "):
            inside.append(_all_hold(line.split()[1:], words))
        elif line == "#end":
            inside.pop()
        elif all(inside) and not _missing(line, words):
            yield line
    if inside:
        raise ValueError("an #if has no #end")


def _all_hold(conditions: Iterable[str], words: frozenset[str]) -> bool:
    return all((each.lstrip("!") in words) != each.startswith("!") for each in conditions)


def _missing(line: str, words: frozenset[str]) -> bool:
    found = _CHECKED.search(line)
    return found is not None and found[1] not in words


def _roles(scenario: Scenario) -> Iterator[str]:
    """Each role for each suite and version."""
    text = _file("4-roles")
    head, replier = text.split("let replier_")
    initiator = head[head.index("let initiator_") :]
    for role, kinds in (
        (initiator, scenario.initiators),
        ("let replier_" + replier, scenario.repliers),
    ):
        for kind in kinds:
            for version in scenario.versions:
                words = scenario.conditions | {kind, f"V{version}"}
                yield kept(role, words).replace("@S@", kind).replace("@V@", str(version))


def _domain(scenario: Scenario) -> str:
    text = _file("5-domain")
    (given,) = re.findall(r"#define ARGUMENTS (.*)\n", (FOLDER / "4-roles.pv").read_text())
    names = ", ".join(re.findall(r"(\w+):", given))
    runs = [
        f"!{role}_{kind}_{version}({names})"
        for role, kinds in (("initiator", scenario.initiators), ("replier", scenario.repliers))
        for kind in kinds
        for version in scenario.versions
    ]
    return text.replace("@ARGUMENTS@", given).replace("@ROLES@", "  " + "\n  | ".join(runs) + ".")


def _query(scenario: Scenario, query: str) -> Iterator[str]:
    if query == "reach":
        yield from _reach(scenario)
        return
    texts = {name: text for name, _, text in _QUERY.findall(_file("6-queries"))}
    text = texts[query]
    for role, peer in ("a", "b"), ("b", "a"):
        text = text.replace(f"@{peer}@", _excuses(scenario, role, peer))
    yield text.replace("@last@", " phase 1" if "compromise_later" in scenario.words else "")


def _excuses(scenario: Scenario, own: str, peer: str) -> str:
    """When a participant cannot expect anything of its peer."""
    found = [f"event(Dishonest({peer}))"]
    if scenario.words & {"compromise", "revocation"}:
        found.append(f"event(Compromised({peer}))")
    if "two_cas" in scenario.words:
        found.append(f"event(Elsewhere({own}))")
    return " || ".join(found)


def _reach(scenario: Scenario) -> Iterator[str]:
    """Every end of a handshake, and what the queries ask about, must happen."""
    ends = ["End", *(["EndConfirmed"] if "confirm" in scenario.words else [])]
    for kind in scenario.initiators:
        if kind in scenario.repliers:
            for version in scenario.versions:
                for end in ends:
                    for role in "IR":
                        yield f"query event({end}{role}(suite_{kind}, version_{version}))."
    values = "a: bitstring, b: bitstring, s: bitstring, t: bitstring, k: bitstring"
    for role in "IR":
        if f"allowed{role}" in scenario.expected or f"shown{role}" in scenario.expected:
            yield f"query {values}; event(Admit{role}(a, b, t))."
        if "revocation" in scenario.words:
            era = f"event(Era{role}(e, a, b, s, t, k))"
            yield f"query e: bitstring, {values}; {era} ==> e = absent."
