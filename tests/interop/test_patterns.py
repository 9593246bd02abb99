"""Patterns cover what fnmatch of the C library says: it is what Fast DDS calls.

In the C locale, as a program runs in that never chose another, and in C.UTF-8, as Python chooses.
"""

import ctypes
import locale
import platform
import random

import pytest

from pqsec_pki.access import _characters, _patterns

pytestmark = pytest.mark.interop

FNM_NOESCAPE = 2
PIECES = (
    *("a", "b", "c", "-", "]", "[", "!", "^", "*", "*", "?", "\\", "ñ", "/", "."),
    *("[a-c]", "[!a]", "[^a]", "[]a]", "[ab]", "[:alpha:]", "[[:digit:]]", "[.a.]", "[[=b=]]"),
    *("[!ñ]", "[é-ü]", "[a-é]", "[ñ]", "[![:alpha:]]", "[[:upper:]É]", "[[:punct:]]", "日", "🦾"),
    *("[[.é.]a]", "[[=é=]b]"),
)
LETTERS = "ab-]^c\\[ñ/7éÉ日🦾«"


@pytest.fixture(scope="module", params=["C", "C.UTF-8"])
def fnmatch(request, requires):
    """The module that reads patterns as in that locale, and fnmatch there."""
    glibc = ctypes.CDLL(None) if platform.libc_ver()[0] == "glibc" else None
    found = requires(glibc, "the GNU C library", "run this on a system that has it").fnmatch
    found.argtypes = [ctypes.c_char_p, ctypes.c_char_p, ctypes.c_int]
    before = locale.setlocale(locale.LC_ALL)
    locale.setlocale(locale.LC_ALL, request.param)
    reading = _patterns if request.param == "C" else _characters
    yield reading, lambda pattern, name, flags: found(pattern.encode(), name.encode(), flags) == 0
    locale.setlocale(locale.LC_ALL, before)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("reading", "flags"),
    [("posix", 0), ("posix_without_escapes", FNM_NOESCAPE)],
    ids=["with escapes", "without escapes"],
)
def test_a_pattern_covers_what_fnmatch_says(fnmatch, reading, flags):
    module, asked = fnmatch
    covers = getattr(module, reading)
    chance = random.Random(flags)  # noqa: S311 -- the same patterns every time
    covered = 0
    for _ in range(20_000):
        pattern = "".join(chance.choices(PIECES, k=chance.randint(1, 6)))
        name = "".join(chance.choices(LETTERS, k=chance.randint(1, 5)))
        wanted = asked(pattern, name, flags)
        assert covers(pattern, name) is wanted, (pattern, name)
        covered += wanted
    assert covered > 400
