"""The participants that a command line names, also by patterns."""

from collections.abc import Sequence

from pqsec_pki.cli import _printing, _settings
from pqsec_pki.cli.plan import few
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import Keystore, State, is_pattern, regular_name
from pqsec_pki.keystore import status as status_of


def admitted(keystore: Keystore, names: Sequence[str]) -> list[str]:
    """The names, each once; instead of a pattern the participants that match it.

    A pattern leaves revoked participants out, and a note says so. KeystoreError for a pattern
    that matches no other.
    """
    literal = [regular_name(name) for name in names if not is_pattern(name)]
    if len(literal) == len(names):
        return list(dict.fromkeys(literal))
    matching = [name for name in keystore.named(names) if name.startswith("/")]
    standing = status_of(keystore, matching, now=_settings.now())
    revoked = {each.name for each in standing.participants if each.state is State.REVOKED}
    left_out = revoked - set(literal)
    if left_out:
        _printing.note(f"left out, because they are revoked: {few(sorted(left_out))}")
    found = [name for name in dict.fromkeys([*matching, *literal]) if name not in left_out]
    if not found:
        raise KeystoreError(f"all that match {', '.join(names)} are revoked")
    return found
