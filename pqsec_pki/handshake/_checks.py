"""Which check of docs/wire.md, section 9, refuses: its number, as a code."""

from collections.abc import Iterator
from contextlib import contextmanager

from pqsec_pki.errors import PqsecError, VerificationError, problems_of
from pqsec_pki.problems import Code

_UNSAID = frozenset({Code.OTHER, Code.FILE_MALFORMED})
"""Codes that tell no check: what cannot be decoded here is a message, not a file."""


@contextmanager
def check(code: Code) -> Iterator[None]:
    """What is refused inside is refused by that check, unless the error has a code of its own.

    VerificationError for every PqsecError.
    """
    try:
        yield
    except PqsecError as error:
        refused = VerificationError(
            *(each.as_code(code) if each.code in _UNSAID else each for each in problems_of(error)),
            hint=error.hint,
        )
        if isinstance(error, VerificationError):  # the words of all others say where
            refused.where = error.where
        raise refused from error
