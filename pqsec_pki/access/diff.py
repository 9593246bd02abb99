"""The rights that a change of permissions grants and takes away; not the change of text.

Both documents answer the same questions, with at least one topic, partition, data tag and domain
for each set of patterns that can match together. So every reported change is real, with an
example, and if there is none, nothing changes, within the limits of `Difference.complete`.
Governance is taken to control everything. This is by the standard; the same questions are used
to find changes for single stacks.
"""

from collections.abc import Iterator
from functools import lru_cache
from itertools import product

from pqsec_pki._times import exact
from pqsec_pki.access._rights import Dimensions, Rights, Whole, wholes
from pqsec_pki.access._stack_diff import StackChange, stack_changes
from pqsec_pki.access._topics import SampleNames, Topics
from pqsec_pki.access.change import Change, Difference, Sense
from pqsec_pki.access.decision import Verdict
from pqsec_pki.access.question import Action
from pqsec_pki.documents import Grant, Permissions, parse_subject
from pqsec_pki.errors import MalformedError

STACKS = "stacks"
"""The `interpretation` of a change that the standard ignores and no stack was checked for."""
_SECOND = "a grant above it is used, but some stacks look further, or for another spelling"
_NAMELESS = "its subject is not a name, but some stacks compare pieces only"
_KEPT = 1_000
"""Pairs of grants whose comparison is kept: to plan, to propose and to check ask for the same."""
MOST_RESHAPED = 8
"""Most added or removed patterns of an action to compare in pairs: more would not help a reader."""


def permissions_diff(old: Permissions | None, new: Permissions | None) -> Difference:
    """For each subject, what `new` allows and `old` did not, and the reverse.

    None is a document that does not exist. Of several grants for a subject the first counts,
    in force or not.
    """
    before, after = _by_subject(old), _by_subject(new)
    found = [
        _grants_diff(before.get(key), after.get(key)) for key in dict.fromkeys([*before, *after])
    ]
    changes = [change for each in found for change in each.changes]
    changes += _passed_over(old, before, new, after)
    return Difference(
        tuple(changes),
        complete=all(each.complete for each in found),
        same_text=old == new,
    )


def _by_subject(permissions: Permissions | None) -> dict[object, Grant]:
    found: dict[object, Grant] = {}
    for grant in permissions.grants if permissions else ():
        if subject := _subject(grant):
            found.setdefault(subject, grant)
    return found


def _passed_over(
    old: Permissions | None,
    before: dict[object, Grant],
    new: Permissions | None,
    after: dict[object, Grant],
) -> Iterator[Change]:
    """Grants that apply to no participant by the standard, but may for a stack."""
    had, has = _others(old, before), _others(new, after)
    for verb, grants, others in (("added", has, had), ("removed", had, has)):
        for grant in (each for each in grants if each not in others):
            yield Change(
                sense=Sense.OTHER,
                subject=grant.subject_name,
                text=f"a grant is {verb} that the standard never uses: {grants[grant]}",
                interpretation=STACKS,
            )


def _others(permissions: Permissions | None, first: dict[object, Grant]) -> dict[Grant, str]:
    """Grants that are not the first of their subject, each with how stacks treat it."""
    counted = {id(grant) for grant in first.values()}
    grants = [each for each in permissions.grants if id(each) not in counted] if permissions else []
    return {each: _SECOND if _subject(each) else _NAMELESS for each in grants}


def _subject(grant: Grant) -> object:
    """The grant's subject name in both orders; None if its text is not a name."""
    try:
        subject = parse_subject(grant.subject_name)
    except MalformedError:
        return None
    return frozenset({subject, subject[::-1]})


@lru_cache(_KEPT)
def _grants_diff(old: Grant | None, new: Grant | None) -> Difference:
    grants = [grant for grant in (old, new) if grant]
    changes = [*_spelling_changes(old, new), *_validity_changes(old, new)] if old and new else []
    if old and new and (old.rules, old.default) == (new.rules, new.default):
        return Difference(tuple(changes), complete=True)
    dimensions = Dimensions.of(grants)
    before, after = dimensions.rights(old), dimensions.rights(new)
    subject = grants[-1].subject_name
    for sense, less, more in ((Sense.GRANTED, before, after), (Sense.TAKEN, after, before)):
        changes += (
            _change(subject, sense, dimensions, each) for each in wholes(_beyond(less, more))
        )
    if old and new:
        for action in dict.fromkeys(action for change in changes for action in change.actions):
            if action is not Action.JOIN and dimensions.topics.complete:
                changes += _reshaped(old, new, action, dimensions.topics)
        changes += map(_of_stack, stack_changes(old, new, dimensions))
    return Difference(tuple(changes), complete=dimensions.complete)


def _beyond(less: Rights, more: Rights) -> Rights:
    return {right: names - less.get(right, frozenset()) for right, names in more.items()}


def _change(subject: str, sense: Sense, dimensions: Dimensions, whole: Whole) -> Change:
    topics: tuple[Topics, ...] = ()
    what = " and ".join(whole.actions)
    if whole.actions != (Action.JOIN,):
        topics = dimensions.topics.described(whole.names)
        what += f" {'; '.join(map(str, topics))}"
    where = dimensions.where(whole)
    return Change(
        sense=sense,
        subject=subject,
        text=f"{what}{',' if any(each.such_as for each in topics) else ''} {where}",
        actions=whole.actions,
        topics=topics,
        domains=where,
    )


def _of_stack(found: StackChange) -> Change:
    question = found.question
    topic = f" '{question.topic}'" if question.topic else ""
    partitions = [f"partition '{name}'" for name in question.partitions if name]
    where = f"on domain {question.domain}"
    if partitions:
        where += f" in {' and '.join(partitions)}"
    what = f"{question.action}{topic} {where}"
    stacks = " and ".join(found.titles)
    text = f"in {stacks}, unlike the standard, for one: {what}"
    if Verdict.CRASHES in {found.before, found.after}:
        now = "now" if found.after is Verdict.CRASHES else "no longer"
        text = f"the document {now} crashes {stacks}, for one: {what}"
    senses = {found.before: Sense.TAKEN, found.after: Sense.GRANTED}
    return Change(
        sense=senses.get(Verdict.YES, Sense.OTHER),
        subject=question.subject,
        text=text,
        actions=(question.action,),
        domains=where,
        interpretation=found.name,
    )


def _spelling_changes(old: Grant, new: Grant) -> Iterator[Change]:
    if old.subject_name != new.subject_name:
        yield Change(
            sense=Sense.OTHER,
            subject=new.subject_name,
            text=f"written '{old.subject_name}' before, which some stacks take for another subject",
            interpretation=STACKS,
        )


def _validity_changes(old: Grant, new: Grant) -> Iterator[Change]:
    edges = (
        ("begins", old.not_before, new.not_before, new.not_before < old.not_before),
        ("ends", old.not_after, new.not_after, new.not_after > old.not_after),
    )
    for verb, before, after, longer in edges:
        if before != after:
            yield Change(
                sense=Sense.GRANTED if longer else Sense.TAKEN,
                subject=new.subject_name,
                text=f"validity {verb} {exact(after)} instead of {exact(before)}",
            )


def _reshaped(old: Grant, new: Grant, action: Action, topics: SampleNames) -> Iterator[Change]:
    """Patterns of allow_rules that replace wider or narrower ones."""
    before, after = _patterns(old, action), _patterns(new, action)
    removed, added = sorted(before - after), sorted(after - before)
    if max(len(removed), len(added)) > MOST_RESHAPED:
        return
    for was, now in product(removed, added):
        one, other = topics.covered[was], topics.covered[now]
        if one < other or other < one:
            word = "wider" if one < other else "narrower"
            text = f"{action}: '{now}' is {word} than '{was}' was"
            yield Change(sense=Sense.OTHER, subject=new.subject_name, text=text, actions=(action,))


def _patterns(grant: Grant, action: Action) -> set[str]:
    criteria = (each for rule in grant.rules if rule.allow for each in getattr(rule, action.value))
    return {topic for each in criteria for topic in each.topics}
