"""What a shell offers for the word at the cursor: names in the keystore, and rows of tables.

Each function is the `shell_complete` of an option or argument. It reads only, asks nothing, and
offers nothing where the keystore cannot be read: a shell would print the error into the prompt.
"""

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, TypeAlias

import click

from pqsec_pki.cli import _settings
from pqsec_pki.errors import PqsecError
from pqsec_pki.stacks import Stack

if TYPE_CHECKING:
    from pqsec_pki.keystore import Keystore

Completer: TypeAlias = Callable[[click.Context, click.Parameter, str], list[str]]

VARIABLE = "_PQSEC_COMPLETE"
"""The variable by which a shell asks, as click names it."""
MAX_DOCUMENTS = 200
"""Permissions that are read for topic names: a few milliseconds each, while the user waits."""
_SAFE = re.compile(r"@?[A-Za-z0-9_/.+:-]+")
"""Shells insert an offer as it is, and run it: other characters could be commands or patterns."""


def participants(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """The participants of the keystore that are not on the command line yet; after `@` groups."""
    value = context.params.get(parameter.name or "")
    given = value if isinstance(value, tuple) else ()
    with suppress(PqsecError):
        keystore = _keystore(context)
        if incomplete.startswith("@"):  # else a shell would list groups between participants
            return _offers(incomplete, (f"@{each}" for each in keystore.groups))
        names = keystore.names()
        return _offers(incomplete, (name for name in names if name not in given))
    return []


def topics(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """The DDS topics that the keystore's documents name, without patterns.

    With --participant, those that its permissions name.
    """
    del parameter
    with suppress(PqsecError):
        return _offers(incomplete, sorted(set(_topics(context))))
    return []


def ros_topics(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """Like `topics`, as names of ROS 2 topics: /chatter for rt/chatter."""
    found = topics(context, parameter, "rt/")
    return _offers(incomplete, (each.removeprefix("rt") for each in found))


def stacks(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """The stacks that a configuration can be written for, also by other packages."""
    from pqsec_pki.vendors import foreign_stacks  # noqa: PLC0415 -- it looks for packages

    del context, parameter
    with suppress(PqsecError):
        return _offers(incomplete, (*Stack, *foreign_stacks()))
    return []


def signatures(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """The signature algorithms."""
    from pqsec_pki.algorithms import SIGNATURES  # noqa: PLC0415 -- it loads cryptography

    del context, parameter
    return _offers(incomplete, (each.name for each in SIGNATURES))


def key_agreements(
    context: click.Context, parameter: click.Parameter, incomplete: str
) -> list[str]:
    """The key agreements."""
    from pqsec_pki.algorithms import KEY_AGREEMENTS  # noqa: PLC0415 -- it loads cryptography

    del context, parameter
    return _offers(incomplete, (each.name for each in KEY_AGREEMENTS))


def attacks(context: click.Context, parameter: click.Parameter, incomplete: str) -> list[str]:
    """The attacks of verify-handshake, and `all`."""
    from pqsec_pki.attacks import ATTACKS  # noqa: PLC0415 -- only for this option

    del context, parameter
    return _offers(incomplete, ("all", *(each.name for each in ATTACKS)))


def among(names: Iterable[str]) -> Completer:
    """Offers of these names."""
    known = tuple(names)
    return lambda _context, _parameter, incomplete: _offers(incomplete, known)


def _offers(incomplete: str, names: Iterable[str]) -> list[str]:
    return [name for name in names if name.startswith(incomplete) and _SAFE.fullmatch(name)]


def _keystore(context: click.Context) -> "Keystore":
    from pqsec_pki.keystore import Keystore  # noqa: PLC0415 -- it imports lxml and more

    return Keystore.open(_settings.keystore_path(context))


def _topics(context: click.Context) -> Iterator[str]:
    from pqsec_pki.access import DocumentOwner, topics_named  # noqa: PLC0415 -- lxml, too
    from pqsec_pki.policy import own_permissions, shared_governance  # noqa: PLC0415

    keystore, now = _keystore(context), _settings.now()
    one = context.params.get("participant")
    for name in (keystore.named([one]) if one else keystore.names())[:MAX_DOCUMENTS]:
        with suppress(PqsecError):
            permissions = own_permissions(keystore, name, now, None).value
            yield from topics_named([DocumentOwner(name=name, subject="", permissions=permissions)])
    if not one:
        with suppress(PqsecError):
            for domain in shared_governance(keystore, None).value.domain_rules:
                yield from (rule.topic_expression for rule in domain.topic_rules)
