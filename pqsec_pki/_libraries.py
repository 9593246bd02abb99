"""The libraries that few commands need, and the error that names a missing one.

The hint names the library, never an extra of pqsec: `pip` would look for pqsec on the package
index, where anybody can register a name that nobody owns.
"""

from collections.abc import Iterator
from contextlib import contextmanager

from pqsec_pki._dataclass import dataclass
from pqsec_pki.errors import PqsecError


@dataclass(frozen=True, slots=True)
class ExtraLibrary:
    """A library of one of the package's extras."""

    name: str
    """As its project writes it."""
    requirement: str
    """As in pyproject.toml."""

    @property
    def hint(self) -> str:
        """The command that installs it."""
        return f"pip install '{self.requirement}'"


_TWISTED = ExtraLibrary("Twisted", "twisted>=26.4")
_PKCS11 = ExtraLibrary("python-pkcs11", "python-pkcs11>=0.10,<0.11")
LIBRARIES = {
    "OpenSSL": ExtraLibrary("pyOpenSSL", "pyopenssl>=26.4,<27"),
    "twisted": _TWISTED,
    "zope": _TWISTED,
    "pkcs11": _PKCS11,
    "asn1crypto": _PKCS11,
    "psycopg": ExtraLibrary("psycopg", "psycopg[binary]>=3.2,<4"),
    "cyclonedx": ExtraLibrary("cyclonedx-python-lib", "cyclonedx-python-lib>=11.6,<12"),
    "matplotlib": ExtraLibrary("matplotlib", "matplotlib>=3.8"),
}
"""Each by the module that it brings, or that it needs."""


@contextmanager
def needs_libraries(words: str) -> Iterator[None]:
    """PqsecError, with the command that installs it, if the block imports a missing library.

    `words` are those of the error, with `{library}` in place of its name.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        library = LIBRARIES.get((error.name or "").partition(".")[0])
        if library is None:
            raise
        raise PqsecError(words.format(library=library.name), hint=library.hint) from error
