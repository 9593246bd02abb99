"""Finds the entry points of other installed packages, whose code the installing user trusts."""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import Distribution, EntryPoint, distributions, entry_points

from pqsec_pki.errors import ForeignPackageError

_REMEDY = "update or uninstall that package"


def offered(group: str, name: str | None = None) -> list[EntryPoint]:
    """The entry points of `group`, by name; with `name`, in lower case, those of that name.

    ForeignPackageError, with the package, if they cannot be read.
    """
    try:
        found = entry_points(group=group)
    except Exception as error:
        broken = ", ".join(_named(each) for each in distributions() if not _is_readable(each))
        raise ForeignPackageError(
            f"the entry points of {broken or 'a package'} cannot be read:"
            f" {type(error).__name__}: {error}",
            hint=_REMEDY,
        ) from error
    chosen = [each for each in found if name is None or each.name.lower() == name]
    return sorted(chosen, key=lambda each: each.name)


def package_of(entry: EntryPoint) -> str:
    """Name and version of the package that declares `entry`; its value if it has no metadata."""
    return (_named(entry.dist) if entry.dist else "") or entry.value


def extensions() -> Iterator[tuple[str, str]]:
    """The packages with entry points for pqsec: name, and the folder where each is installed."""
    for package in filter(_is_readable, distributions()):
        if any(each.group.startswith("pqsec.") for each in package.entry_points):
            yield package.name, str(package.locate_file(""))


def the_only(entries: list[EntryPoint], what: str) -> EntryPoint:
    """The one entry point; ForeignPackageError, with `what`, if several packages have one."""
    if len(entries) > 1:
        packages = ", ".join(map(package_of, entries))
        raise ForeignPackageError(
            f"several packages offer the {what} {entries[0].name!r}: {packages}",
            hint="uninstall all but one of them",
        )
    return entries[0]


@contextmanager
def foreign_errors(words: str, *passing: type[Exception]) -> Iterator[None]:
    """Any error within, also the end of the process, is ForeignPackageError with `words`.

    Those of the classes `passing` pass.
    """
    try:
        yield
    except passing:
        raise
    except (Exception, SystemExit) as error:
        raise fault(words, f"{type(error).__name__}: {error}") from error


def fault(words: str, reason: str) -> ForeignPackageError:
    """The error `words`, which name the package, for `reason`."""
    return ForeignPackageError(f"{words}: {reason}", hint=_REMEDY)


def _is_readable(package: Distribution) -> bool:
    try:
        return package.entry_points is not None
    except Exception:  # noqa: BLE001 -- of any kind: it depends on Python's version
        return False


def _named(package: Distribution) -> str:
    try:
        return " ".join(each for each in (package.name, package.version) if each)
    except Exception:  # noqa: BLE001 -- metadata that is missing or not UTF-8
        return ""
