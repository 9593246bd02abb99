"""Rules about topics that only one side may use, and about names that look like typing errors."""

import re
from collections.abc import Iterator

from pqsec_pki.access import Action, Alone
from pqsec_pki.lint.document import PermissionsFile
from pqsec_pki.lint.rule import Severity, Violation, lint_rule
from pqsec_pki.lint.subjects import Inventory

_NUMBER = re.compile(r"\d+")
_ONE_SIDE_FIX = (
    "Allow it to the other side with `pqsec permit`, or remove the right. If the other side is in"
    " another keystore, ignore the finding with that reason."
)


@lint_rule(
    "PQS345", Severity.INFO, "published, and nobody may subscribe",
    why="No participant of the keystore may subscribe to the topic in a domain and partition in"
    " which it may be published. So nobody receives it, or the right is not needed.",
    fix=_ONE_SIDE_FIX,
    bad="$ pqsec -k k permit /talker --publish image --yes",
    good="$ pqsec -k k permit /listener --subscribe image --yes",
)  # fmt: skip
def nobody_subscribes(inventory: Inventory) -> Iterator[Violation]:
    yield from _one_sided(inventory, Action.PUBLISH)


@lint_rule(
    "PQS346", Severity.INFO, "subscribed, and nobody may publish",
    why="No participant of the keystore may publish the topic in a domain and partition in which"
    " it may be subscribed to. So the subscriber waits in vain, or the right is not needed.",
    fix=_ONE_SIDE_FIX,
    bad="$ pqsec -k k permit /listener --subscribe image --yes",
    good="$ pqsec -k k permit /talker --publish image --yes",
)  # fmt: skip
def nobody_publishes(inventory: Inventory) -> Iterator[Violation]:
    yield from _one_sided(inventory, Action.SUBSCRIBE)


@lint_rule(
    "PQS347", Severity.WARNING, "a topic that differs by one letter from the other side's",
    why="Nobody may use the other side of this topic, and another participant may use that of a"
    " topic that is spelled alike. The two do not communicate, and no stack reports why.",
    fix="Correct the name: remove the right and add the other one with `pqsec permit`.",
    bad="$ pqsec -k k permit /talker --publish chater --yes",
    good="$ pqsec -k k permit /talker --remove --publish chater --yes",
)  # fmt: skip
def near_miss(inventory: Inventory) -> Iterator[Violation]:
    for document, found in inventory.one_sided:
        if found.meant:
            yield Violation(str(found), document.line(found.right.line), document.path)


def _one_sided(inventory: Inventory, action: Action) -> Iterator[Violation]:
    """One violation for all topics that differ by numbers only, such as those of robots."""
    alike: dict[str, list[tuple[PermissionsFile, Alone]]] = {}
    for document, found in inventory.one_sided:
        if found.right.action is action and not found.meant:
            alike.setdefault(_NUMBER.sub("0", found.right.topic), []).append((document, found))
    for (document, found), *others in alike.values():
        more = f" (and {len(others)} more like it)" if others else ""
        yield Violation(f"{found}{more}", document.line(found.right.line), document.path)
