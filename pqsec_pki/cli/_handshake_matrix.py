"""verify-handshake --matrix, as a table."""

from collections.abc import Iterator, Sequence

from pqsec_pki.cli import _printing, _settings
from pqsec_pki.selfcheck import Suite, suites
from pqsec_pki.stacks import FRAGMENT

_HEADERS = (
    *("", "profile", "signature", "key agreement", "request", "reply", "final"),
    *("fragments", "of 64 KB", "ms"),
)


def show_matrix(rounds: int) -> None:
    """Measure all suites and print a table."""
    # A list, not an iterator: a reader that closes the pipe must not leave a temporary folder.
    found = list(suites(_settings.now(), rounds))
    value = {"fragment_bytes": FRAGMENT, "rounds": rounds, "suites": found}
    _printing.emit(value, _lines(found, rounds))


def _lines(found: Sequence[Suite], rounds: int) -> Iterator[str]:
    yield from _printing.table(_HEADERS, map(_row, found))
    yield ""
    yield "request, reply, final: bytes of the token. *: the profile's own key agreement."
    yield f"fragments: of the three, by {FRAGMENT} bytes, Cyclone DDS's default."
    yield f"ms: the median of {rounds}, both sides and one protected message each way."
    for promise, who in _broken(found).items():
        yield f"!: breaks a promise of {', '.join(who)}: {promise}"


def _row(suite: Suite) -> tuple[str, ...]:
    own = suite.agreement is suite.profile.key_agreement
    sizes = suite.sizes.values()
    return (
        "*" if own else "!" if suite.breaks else "",
        suite.profile.name,
        suite.signature,
        suite.agreement.wire_name,
        *(f"{size.token:>7}" for size in sizes),
        "/".join(str(size.fragments) for size in sizes),
        f"{suite.share:>8.1%}",
        f"{suite.milliseconds:>5.1f}",
    )


def _broken(found: Sequence[Suite]) -> dict[str, list[str]]:
    """Promises that a combination breaks -> names of the profiles that promise it."""
    profiles: dict[str, list[str]] = {}
    for suite in found:
        for promise in suite.breaks:
            names = profiles.setdefault(promise, [])
            if suite.profile.name not in names:
                names.append(suite.profile.name)
    return profiles
