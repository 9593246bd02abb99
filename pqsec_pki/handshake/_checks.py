"""Set the number of the check in docs/reference/wire.md, section 9, as the code of an error."""

from pqsec_pki.errors import PqsecError, VerificationError, problems_of
from pqsec_pki.problems import Code

_UNSAID = frozenset({Code.OTHER, Code.FILE_MALFORMED})
"""Codes that name no check: what cannot be decoded here is a message, not a file."""


class check:  # noqa: N801 -- read as a statement; a generator would take four times as long
    """Give errors raised within the code of that check, unless they have their own code.

    VerificationError for every PqsecError.
    """

    __slots__ = ("_code",)

    def __init__(self, code: Code) -> None:
        self._code = code

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: object, traceback: object) -> None:
        if isinstance(error, PqsecError):
            raise _refused(error, self._code) from error


def _refused(error: PqsecError, code: Code) -> VerificationError:
    refused = VerificationError(
        *(each.as_code(code) if each.code in _UNSAID else each for each in problems_of(error)),
        hint=error.hint,
    )
    if isinstance(error, VerificationError):  # other messages name the place
        refused.where = error.where
    return refused
