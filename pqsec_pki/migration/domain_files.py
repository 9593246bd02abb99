"""A domain file for each step of a migration: `pqsec apply` makes the step on the keystore."""

import re
from collections.abc import Iterable, Iterator
from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import read
from pqsec_pki.domain import Desired, desired_in, import_domain
from pqsec_pki.errors import InvalidDocumentError, UsageError, shown
from pqsec_pki.keystore import Keystore
from pqsec_pki.migration.steps import MigrationPlan, MigrationStep

_OLD = re.compile(r"(?:profile|migrate_from)[ \t]*:")
_ITEM = re.compile(r"[ \t]*-[ \t]")
_FIRST = re.compile(r"[^#%\s-]")
"""The start of the first line that is not a comment, or a mark of a document."""


@dataclass(frozen=True, slots=True)
class StepFile:
    """The domain file of one step."""

    name: str
    """Its number and the profiles after it: `1-transition.yaml`, `1-classical+hybrid.yaml`."""
    document: bytes
    """YAML, UTF-8, with the step in words as comments."""


def step_files(
    plan: MigrationPlan, keystore: Keystore, file: Path | None, folder: Path, *, now: datetime
) -> tuple[StepFile, ...]:
    """A domain file for each step, in order: the same as `file` apart from the profile.

    Without `file`, it is made of the keystore. `folder` is where they are to be written: files
    that `file` names are found from there. UsageError if they are not found, or the profile
    cannot be written into `file`; errors as of `read_domain` and `import_domain`.
    """
    if file:
        base = read(file)
        wanted = desired_in(base, file)
    else:
        base = import_domain([keystore.root], now=now, domains=keystore.domains).document
        wanted = desired_in(base, folder / "domain.yaml")
    files = []
    for number, step in enumerate(plan.steps, 1):
        name = f"{number}-{'+'.join(_profiles(step.after))}.yaml"
        document = _written(base, number, step, name)
        _refuse_other(document, folder / name, step, wanted)
        files.append(StepFile(name, document))
    return tuple(files)


def _written(base: bytes, number: int, step: MigrationStep, name: str) -> bytes:
    lines = [*_without_old(base.decode("utf-8-sig").split("\n"))]
    place = next((at for at, each in enumerate(lines) if _FIRST.match(each)), len(lines))
    words = [f"# {shown(each, len(each))}\n" for each in _comments(number, step, name)]
    is_several = len(_profiles(step.after)) > 1
    settings = [f"profile: [{step.after}]" if is_several else f"profile: {step.after}"]
    if step.before != step.after and not is_several:
        settings.append(f"migrate_from: {step.before}")
    text = "\n".join([*lines[:place], *settings, *lines[place:]])
    return ("".join(words) + text).encode()


def _without_old(lines: Iterable[str]) -> Iterator[str]:
    """The lines without the keys that a step sets, and without the items of their lists."""
    in_old = False
    for each in lines:
        in_old = bool(_OLD.match(each)) or (in_old and bool(_ITEM.match(each)))
        if not in_old:
            yield each


def _profiles(names: str) -> tuple[str, ...]:
    """The profiles that a step names."""
    return tuple(names.split(", "))


def _comments(number: int, step: MigrationStep, name: str) -> Iterator[str]:
    yield from step.lines(number)
    if step.before == step.after:
        yield f"The keystore does not change: `pqsec apply {name}` shows whether it is ready."
    else:
        same = "ca add-set" if len(_profiles(step.after)) > 1 else "ca rotate"
        yield f"`pqsec apply {name}` does the same as `pqsec {same}`."


def _refuse_other(document: bytes, path: Path, step: MigrationStep, wanted: Desired) -> None:
    """UsageError if the document does not say the same apart from the profile."""
    hint = "write `profile` and `migrate_from` into a copy beside it, each on a line of its own"
    try:
        found = desired_in(document, path)
    except InvalidDocumentError as error:
        raise UsageError(f"{wanted.path} cannot be changed: {error}", hint=hint) from error
    same = _content(found) == _content(wanted)
    if not same or found.profiles != _profiles(step.after):
        raise UsageError(f"the profile cannot be written into {wanted.path}", hint=hint)


def _content(desired: Desired) -> tuple[object, ...]:
    """The content that must not change."""
    members = {
        name: (each.config_digest, each.validity, each.request, each.by_order)
        for name, each in desired.members.items()
    }
    own = (desired.name, desired.domains, desired.ca_validity, desired.renew_before)
    shared = (desired.governance, desired.groups, desired.stock, desired.approvals, desired.prune)
    return (*own, *shared, members)
