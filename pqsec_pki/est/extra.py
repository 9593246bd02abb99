"""What enrolment over a network needs beside the package."""

from collections.abc import Iterator
from contextlib import contextmanager

from pqsec_pki.errors import PqsecError

LIBRARIES = frozenset({"OpenSSL", "twisted", "zope"})
"""The modules that the extras bring."""


@contextmanager
def needs_extra(extra: str) -> Iterator[None]:
    """PqsecError with the way out if a library of that extra cannot be imported in the block."""
    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in LIBRARIES:
            raise
        raise PqsecError(
            f"enrolment over a network needs the library {error.name}, which is not installed",
            hint=f"install pqsec with its extra: pip install 'pqsec[{extra}]'",
        ) from error
