"""The participants that a command line names, also by patterns and groups."""

import shlex
from collections.abc import Sequence

from pqsec_pki.cli import _printing, _settings
from pqsec_pki.errors import KeystoreError
from pqsec_pki.keystore import GROUP, Keystore, State, is_several, regular_name
from pqsec_pki.keystore import status as status_of


def named(
    keystore: Keystore,
    names: Sequence[str],
    known: Sequence[str] | None = None,
    *,
    where: str = "in the keystore",
) -> list[str]:
    """Like `Keystore.named`; a note names the members of groups that are not in `known`."""
    found = keystore.named(names, known)
    if groups := [name for name in names if name.startswith(GROUP)]:
        members = keystore.groups
        absent = {each for name in groups for each in members[name.removeprefix(GROUP)]}
        if absent := absent.difference(found):
            _printing.note(
                f"in {_printing.few(groups)} and not {where}: {_printing.few(sorted(absent))}"
            )
    return found


def admitted(
    keystore: Keystore,
    names: Sequence[str],
    known: Sequence[str] | None = None,
    *,
    revoked_too: bool = False,
) -> list[str]:
    """The names, each once; for a pattern or group the participants that it matches.

    Those are participants of the keystore, or of `known`. It leaves revoked participants out,
    unless `revoked_too`, and a note says so. KeystoreError if no other is left.
    """
    literal = [regular_name(name) for name in names if not is_several(name)]
    if len(literal) == len(names):
        return list(dict.fromkeys(literal))
    matching = [name for name in named(keystore, names, known) if name.startswith("/")]
    standing = status_of(keystore, matching, now=_settings.now())
    revoked = {each.name for each in standing.participants if each.state is State.REVOKED}
    left_out = set() if revoked_too else revoked - set(literal)
    if left_out:
        _printing.note(f"left out, because they are revoked: {_printing.few(sorted(left_out))}")
    found = [name for name in dict.fromkeys([*matching, *literal]) if name not in left_out]
    if not found:
        again = shlex.join(["pqsec", "-k", str(keystore.root), "issue", *names])
        raise KeystoreError(
            f"all that match {', '.join(names)} are revoked",
            hint=f"to admit them again, with new rights: `{again} --force --after-revocation`",
        )
    return found
