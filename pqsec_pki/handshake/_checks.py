"""Set the number of the check in docs/reference/wire.md, section 9, as the code of an error."""

from collections.abc import Iterator
from contextlib import contextmanager

from pqsec_pki.errors import PqsecError, VerificationError, problems_of
from pqsec_pki.problems import Code

_UNSAID = frozenset({Code.OTHER, Code.FILE_MALFORMED})
"""Codes that name no check: what cannot be decoded here is a message, not a file."""


@contextmanager
def check(code: Code) -> Iterator[None]:
    """Give errors raised within the code of that check, unless they have their own code.

    VerificationError for every PqsecError.
    """
    try:
        yield
    except PqsecError as error:
        refused = VerificationError(
            *(each.as_code(code) if each.code in _UNSAID else each for each in problems_of(error)),
            hint=error.hint,
        )
        if isinstance(error, VerificationError):  # other messages name the place
            refused.where = error.where
        raise refused from error
