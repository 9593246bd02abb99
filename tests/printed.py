"""What a command printed, compared with what a document or a script says."""

import doctest


def same(expected: list[str], printed: str) -> bool:
    """Whether `printed` is what is expected, up to `...` and blank lines at the end."""
    want, got = ("\n".join(expected).rstrip() + "\n", printed.rstrip() + "\n")
    return doctest.OutputChecker().check_output(want, got, doctest.ELLIPSIS)
