"""All errors that a caller should catch.

PqsecError is the base class: a room raises no other error for outside input. The command
line prints the message and the hint, and exits with the error's exit_code: 1 if a check
failed, 2 if the request makes no sense, 3 if the work could not be done.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Self, TypeVar

from pqsec_pki import __version__
from pqsec_pki.problems import Code, Problem

MOST_MEANT = 3
"""The number of known names that are suggested for an unknown one."""
_ALIKE = 0.7
"""Similarity by difflib: /talkr and /talker are similar enough, /listener is not."""


def shown(text: str, limit: int = 80) -> str:
    """`text` from outside, fit for a message: without control characters, and shortened."""
    short = text if len(text) <= limit else f"{text[: limit - 3]}..."
    return "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in short)


def meant(word: str, known: Iterable[str]) -> str:
    """`did you mean '/talker'?`, with up to three of `known` that are spelled alike; or ''."""
    from difflib import get_close_matches  # noqa: PLC0415 -- few errors need it

    near = get_close_matches(word, known, MOST_MEANT, _ALIKE)
    return f"did you mean {' or '.join(repr(shown(each)) for each in near)}?" if near else ""


class ForeignAlgorithmWarning(UserWarning):
    """An algorithm of another installed package is in use."""


class PqsecError(Exception):
    """The work could not be done.

    `hint` says how to fix it, in one sentence. `where` names the file (or message) at fault;
    the layer that knows it sets it, or uses `located`. `words` is the message without `where`.
    """

    exit_code = 3
    code = Code.OTHER

    def __init__(
        self,
        message: str,
        *,
        code: Code | None = None,
        hint: str | None = None,
        where: object = None,
    ) -> None:
        super().__init__(message)
        self.hint = hint
        if code is not None:
            self.code = code
        self.where = None if where is None else str(where)

    def __str__(self) -> str:
        return self._placed(self.words)

    @property
    def words(self) -> str:
        """The message without `where`."""
        return super().__str__()

    def words_at(self, where: object) -> str:
        """The message for a text that names `where` already; another place stays in the message."""
        return self.words if self.where == str(where) else str(self)

    @property
    def lines(self) -> tuple[str, ...]:
        """The message, with one line for each problem."""
        return (str(self),)

    @property
    def codes(self) -> frozenset[Code]:
        """The codes of what is wrong."""
        return frozenset({self.code})

    def _placed(self, message: str) -> str:
        return f"{self.where}: {message}" if self.where else message


class UsageError(PqsecError):
    """The request makes no sense, or contradicts another option."""

    exit_code = 2


class UnknownAlgorithmError(UsageError):
    """No table has a row with that name, identifier or key type."""


class ForeignPackageError(PqsecError):
    """Another installed package offers an algorithm that cannot be used."""


class MalformedError(PqsecError):
    """Bytes that are not the certificate, key, document or message they should be."""

    code = Code.FILE_MALFORMED


class FileError(PqsecError):
    """A file cannot be read or written."""


class TooLargeError(PqsecError):
    """What would be written is larger than what pqsec reads, so it is not written."""

    @classmethod
    def check(cls, what: str, size: int, limit: int, *, hint: str, unit: str = "bytes") -> None:
        """TooLargeError if `size` is over the `limit` of what reads it; `hint` is the way out."""
        if size > limit:
            raise cls(f"{what} would have {size} {unit}; pqsec reads at most {limit}", hint=hint)


class MissingError(FileError):
    """The path does not exist; for other errors of reading this is not known."""

    code = Code.FILE_MISSING


class ExistsError(FileError):
    """The file exists already, and is not overwritten without force."""


class KeystoreError(PqsecError):
    """The keystore lacks something that is needed, or is not a keystore."""


class InterruptedChangeError(KeystoreError):
    """A change of the keystore was interrupted, so its files may be from before and after it."""


class PassphraseError(PqsecError):
    """A private key is encrypted and the passphrase is missing or wrong."""


class InvalidDocumentError(PqsecError):
    """A governance or permissions document violates its schema; `problems` lists everything."""

    exit_code = 1
    code = Code.DOCUMENT_INVALID

    def __init__(self, problems: Iterable[Problem], *, hint: str | None = None) -> None:
        self.problems = tuple(problems)
        super().__init__("; ".join(map(str, self.problems)), hint=hint)

    def __reduce__(self) -> tuple[type[Self], tuple[tuple[Problem, ...]], dict[str, object]]:
        """Pickle with all problems, to pass between processes."""
        return type(self), (self.problems,), self.__dict__

    @property
    def lines(self) -> tuple[str, ...]:
        """One for each problem."""
        return tuple(self._placed(str(problem)) for problem in self.problems)


class VerificationError(PqsecError):
    """A signature, chain, document or handshake message was checked and refused.

    `problems` lists everything that is wrong, not only the first thing; a text becomes
    a Problem of that `code`.
    """

    exit_code = 1

    def __init__(
        self, *problems: Problem | str, code: Code = Code.OTHER, hint: str | None = None
    ) -> None:
        self.problems = tuple(
            each if isinstance(each, Problem) else Problem(each, code) for each in problems
        )
        super().__init__("; ".join(map(str, self.problems)), hint=hint)

    def __reduce__(self) -> tuple[type[Self], tuple[Problem, ...], dict[str, object]]:
        """Pickle with all problems, to pass between processes."""
        return type(self), self.problems, self.__dict__

    @property
    def lines(self) -> tuple[str, ...]:
        """One for each problem."""
        return tuple(self._placed(str(problem)) for problem in self.problems)

    @property
    def codes(self) -> frozenset[Code]:
        """The codes of the problems."""
        return frozenset(each.code for each in self.problems)


Kind = TypeVar("Kind", bound=PqsecError)


def other_format(
    kind: type[Kind],
    found: object,
    known: Sequence[int],
    *,
    made_by: object = None,
    where: object = None,
) -> Kind:
    """The error for what has a format that is not among `known`; `made_by` is a version."""
    maker = f"pqsec {shown(str(made_by), 20)}" if made_by else "another version of pqsec"
    return kind(
        f"made by {maker}, in format {shown(str(found))}; this is pqsec {__version__}, which reads"
        f" format{'s' * (len(known) > 1)} {' and '.join(map(str, known))}",
        hint="use the version that made it, or a newer one; or restore what was backed up before"
        " the upgrade",
        where=where,
    )


def problems_of(error: PqsecError, code: Code = Code.OTHER) -> tuple[Problem, ...]:
    """The problems of `error`; `code` is for an error that has no codes of its own."""
    if isinstance(error, VerificationError):
        return error.problems
    return (Problem(str(error), code if error.code is Code.OTHER else error.code),)


class library_call:  # noqa: N801 -- read as a function, and quicker than a generator
    """Around one call of a library on bytes from outside: what it raises becomes our `refusal`.

    Libraries raise more than they document (KeyError, RecursionError, panics of Rust), so no types
    are listed. The library's error is the cause. Our own errors pass, and so do the ends of the
    process. PqsecError for too little memory, which says nothing about the bytes.
    """

    __slots__ = ("_refusal",)

    def __init__(self, refusal: Callable[[BaseException], PqsecError]) -> None:
        self._refusal = refusal

    def __enter__(self) -> None:
        pass

    def __exit__(self, _type: object, error: BaseException | None, _traceback: object) -> None:
        if error is None or isinstance(error, _PASSING):
            return
        if isinstance(error, MemoryError):
            hint = "run it again where more is free"
            raise PqsecError("there is not enough memory", hint=hint) from error
        raise self._refusal(error) from error


_PASSING = (PqsecError, KeyboardInterrupt, SystemExit, GeneratorExit)


def words_of(error: BaseException) -> str:
    """What a library's error says, fit for a message; its type if it says nothing."""
    return shown(str(error), limit=200) or type(error).__name__


@contextmanager
def located(where: object) -> Iterator[None]:
    """Set `where` in errors that pass through, unless it is set already."""
    try:
        yield
    except PqsecError as error:
        if error.where is None:
            error.where = str(where)
        raise
