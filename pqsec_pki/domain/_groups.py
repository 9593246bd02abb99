"""Groups of a domain file: names, for commands, of several of its participants."""

from collections.abc import Collection, Mapping
from functools import partial

from pqsec_pki.documents.parts_yaml import Item, all_of, fields, one_or_more, refused, table, text
from pqsec_pki.domain._listing import regular, without_braces
from pqsec_pki.errors import shown
from pqsec_pki.keystore import GROUP_NAME, matching, nearest

MAX_GROUPED = 1_000_000
"""Names in all groups: ten groups for each of the most participants. Patterns soon exceed it."""

Given = tuple[str, int]
"""A name or pattern of a group, and its line."""


def groups_in(item: Item) -> dict[str, tuple[Given, ...]]:
    """The names and patterns of each group in `groups`. InvalidDocumentError for a bad name."""
    found = table(item)
    all_of(partial(_check_name, key) for key, _ in found.entries.values())
    return fields(found, dict.fromkeys(found.entries, _given))


def _check_name(key: Item) -> None:
    name = text(key)
    if not GROUP_NAME.fullmatch(name):
        raise refused(
            key, f"'{shown(name)}' cannot be a group's name: write it without @, like hall1"
        )


def _given(item: Item) -> tuple[Given, ...]:
    found = one_or_more(item, lambda each: (text(each), each.line))
    if not found:
        raise refused(item, "the group is empty")
    return found


def members_of_groups(
    groups: Mapping[str, tuple[Given, ...]], participants: Collection[str]
) -> dict[str, tuple[str, ...]]:
    """The names of each group's members, sorted. InvalidDocumentError with all mistakes.

    Each name must be of a participant of the file, and each pattern must match one: a group with
    a typing error would leave a robot out of a revocation.
    """
    members = all_of(partial(_members, given, participants) for given in groups.values())
    found = dict(zip(groups, members, strict=True))
    if sum(map(len, found.values())) > MAX_GROUPED:
        line = next(iter(groups.values()))[0][1]
        raise refused(line, f"the groups have more than {MAX_GROUPED} names")
    return dict(sorted(found.items()))


def _members(given: tuple[Given, ...], participants: Collection[str]) -> tuple[str, ...]:
    found = all_of(partial(named, pattern, line, participants) for pattern, line in given)
    return tuple(sorted({name for names in found for name in names}))


def named(pattern: str, line: int, participants: Collection[str]) -> list[str]:
    """The participants of the file that a name or pattern stands for, in its order.

    InvalidDocumentError for a name that none of them has, and a pattern that matches none.
    """
    found: list[str] = []
    for each in without_braces(pattern, line):
        if "*" in each:
            names = matching(each, participants)
        else:
            names = [name for name in [regular(each, line)] if name in participants]
        if not names:
            hint = nearest(each, participants)
            message = f"no participant of the file is {shown(each)}"
            raise refused(line, f"{message}; {hint}" if hint else message)
        found += names
    return found
