"""Finds the known texts nearest to a text, by the words that they share; rare words count more."""

import re
from collections import Counter
from collections.abc import Collection

MAX_WORDS = 200
"""Most words of the text; a message has fewer."""
LEAST = 0.34
"""The share of a known text's weight that makes it near."""


def nearest_texts(text: str, known: Collection[str]) -> list[str]:
    """The texts of `known` that share at least a third of their words' weight, nearest first."""
    here = set(_words(text)[:MAX_WORDS])
    words = {each: set(_words(each)) for each in known}
    common = Counter(word for each in words.values() for word in each)

    def likeness(each: str) -> float:
        weights = {word: 1 / common[word] for word in words[each]}
        shared = sum(weights[word] for word in weights.keys() & here)
        return shared / sum(weights.values()) if weights else 0

    scores = {each: likeness(each) for each in known}
    near = [each for each in known if scores[each] >= LEAST]
    return sorted(near, key=lambda each: -scores[each])


def _words(text: str) -> list[str]:
    return [word.lower() for word in re.findall(r"[A-Za-z][A-Za-z0-9_]{2,}", text)]
