"""How the standard and the stacks interpret the documents: one row each.

Of a stack whose versions differ, each range of versions has a row. If a row has its own function,
the function says how it differs and how that is known: measured with the stack itself, or read in
its source.
"""

import re
from collections.abc import Collection
from dataclasses import replace
from itertools import groupby

from pqsec_pki.access import _characters, _criteria, _patterns, _stacks, _subjects, _values
from pqsec_pki.access._checks import (
    endpoint,
    governed,
    in_force,
    own_participant,
    remote_participant,
)
from pqsec_pki.access._patterns import Covers
from pqsec_pki.access.interpretation import Check, Interpretation, Viewpoint
from pqsec_pki.errors import UsageError
from pqsec_pki.stacks import Stack


def _both(*checks: Check) -> dict[Viewpoint, tuple[Check, ...]]:
    return dict.fromkeys(Viewpoint, checks)


def _in_locales(row: Interpretation, covers: Covers, governs: Covers) -> Interpretation:
    """The row, with one for C and, with these functions, one for C.UTF-8."""
    plain = replace(row, name=f"{row.name}/C", title=f"{row.title} in C")
    wide = replace(
        row,
        name=f"{row.name}/C.UTF-8",
        title=f"{row.title} in C.UTF-8",
        covers=covers,
        governs=governs,
    )
    return replace(row, locales=(plain, wide))


_SPEC = Interpretation(
    name="spec",
    title="DDS-Security 1.1",
    covers=_patterns.posix,
    governs=_patterns.posix,
    is_for=_subjects.standard,
    includes=_values.standard_includes,
    in_force=_values.standard_in_force,
    skips_grants_out_of_force=False,
    knows_relay=True,
    partitions_met=_criteria.standard_partitions,
    tags_met=_criteria.standard_tags,
    flaw=_values.no_flaw,
    join={
        Viewpoint.OWN: (governed, in_force, own_participant),
        Viewpoint.PEER: (governed, in_force, remote_participant),
    },
    use=_both(endpoint),
)

SPEC = _in_locales(_SPEC, _characters.posix, _characters.posix)

CYCLONEDDS = Interpretation(
    name=f"{Stack.CYCLONEDDS}@0.10",
    title=f"{Stack.CYCLONEDDS.product} 0.10.2",
    covers=_patterns.cyclonedds,
    governs=_patterns.cyclonedds,
    is_for=_subjects.cyclonedds,
    includes=_values.cyclonedds_includes,
    in_force=_values.cyclonedds_in_force,
    skips_grants_out_of_force=False,
    knows_relay=False,
    partitions_met=_criteria.cyclonedds_partitions,
    tags_met=_criteria.no_tags,
    flaw=_values.cyclonedds_flaw,
    builtin=_stacks.CYCLONEDDS_BUILTIN,
    join={
        Viewpoint.OWN: (governed, in_force, own_participant),
        Viewpoint.PEER: (governed, in_force, remote_participant),
    },
    use=_both(_stacks.cyclonedds_topic, _stacks.cyclonedds_endpoint),
)

CYCLONEDDS_11 = replace(
    CYCLONEDDS,
    name=f"{Stack.CYCLONEDDS}@11.0",
    title=f"{Stack.CYCLONEDDS.product} 11.0.1",
    is_for=_subjects.cyclonedds_11,
    use=_both(_stacks.cyclonedds_11_topic, _stacks.cyclonedds_endpoint),
)

_FASTDDS = Interpretation(
    name=Stack.FASTDDS.value,
    title=f"{Stack.FASTDDS.product} 2.9.1",
    covers=_patterns.fastdds,
    governs=_patterns.either_way,
    is_for=_subjects.fastdds,
    includes=_values.fastdds_includes,
    in_force=_values.fastdds_in_force,
    skips_grants_out_of_force=True,
    knows_relay=True,
    partitions_met=_criteria.cyclonedds_partitions,
    tags_met=_criteria.no_tags,
    flaw=_values.fastdds_flaw,
    # A domain that governance does not name is treated as one with join access control.
    join={
        Viewpoint.OWN: (in_force, _stacks.fastdds_own_participant),
        Viewpoint.PEER: (in_force, _stacks.fastdds_remote_participant),
    },
    use={
        Viewpoint.OWN: (_stacks.fastdds_own_endpoint,),
        Viewpoint.PEER: (_stacks.fastdds_remote_endpoint,),
    },
)

FASTDDS = _in_locales(_FASTDDS, _characters.posix_without_escapes, _characters.either_way)

OPENDDS = Interpretation(
    name=Stack.OPENDDS.value,
    title=f"{Stack.OPENDDS.product} 3.34",
    covers=_patterns.opendds,
    governs=_patterns.opendds,
    is_for=_subjects.opendds,
    includes=_values.standard_includes,
    in_force=_values.standard_in_force,
    skips_grants_out_of_force=False,
    knows_relay=False,
    partitions_met=_criteria.opendds_partitions,
    tags_met=_criteria.no_tags,
    flaw=_values.opendds_flaw,
    # The times of a grant are checked only for endpoints, within their checks.
    join={
        Viewpoint.OWN: (governed, _stacks.opendds_own_participant),
        Viewpoint.PEER: (governed, _stacks.opendds_remote_participant),
    },
    use=_both(_stacks.opendds_topic, _stacks.opendds_endpoint),
)

INTERPRETATIONS = (SPEC, CYCLONEDDS, CYCLONEDDS_11, FASTDDS, OPENDDS)
"""The rows of a stack are neighbours, the oldest version first."""

NAMES = (
    *dict.fromkeys(name for row in INTERPRETATIONS for name in (row.stack, row.name)),
    *(each.name for row in INTERPRETATIONS for each in row.locales),
)
"""All values of `--as`."""


_VERSION = re.compile(r"[0-9]+(\.[0-9]+)*")


def names_of(rows: Collection[Interpretation]) -> list[str]:
    """The values of `--as` that mean these rows: a stack's name if all of its rows are there."""
    names = list[str]()
    for stack, group in groupby(INTERPRETATIONS, key=lambda row: row.stack):
        every = list(group)
        some = [row.name for row in every if row in rows]
        names += [stack] if len(some) == len(every) else some
    return names


def interpretations_named(name: str) -> tuple[Interpretation, ...]:
    """The row of a stack and version, such as `cyclonedds@11.0`; all of its rows for `cyclonedds`.

    `fastdds/C.UTF-8` is the row for that locale. UsageError, with all names, if there is none.
    """
    known, slash, locale = name.partition("/")
    stack, at, version = known.partition("@")
    rows = tuple(row for row in INTERPRETATIONS if row.stack == stack)
    if at:
        rows = tuple(row for row in rows if _is_of(version, row.version))
    if slash:
        rows = tuple(each for row in rows for each in row.locales if each.locale == locale)
    if not rows:
        raise UsageError(
            f"'{name}' is not an interpretation", hint=f"choose from {', '.join(NAMES)}"
        )
    return rows


def _is_of(version: str, known: str) -> bool:
    """Whether one of the two is the beginning of the other: 11, 11.0 and 11.0.1."""
    pairs = zip(version.split("."), known.split("."), strict=False)
    return bool(_VERSION.fullmatch(version)) and all(part == other for part, other in pairs)
