"""Removes a set of credentials that nobody needs any more, beside sets that stay as they are.

A line ends the set. From then on its CAs, certificates and lists count nowhere, and settings that
still name it are refused. Its files go in the same change; its private keys are overwritten.
"""

from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import exists, walk
from pqsec_pki.approvals import Covered
from pqsec_pki.errors import KeystoreError, PqsecError, UsageError
from pqsec_pki.keystore import (
    SET_END,
    Authorities,
    Entry,
    Keystore,
    SetChange,
    change,
    layout,
    participant_states,
    settings_file,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class RemovedSet:
    """A set of credentials that was removed, or would be."""

    profile: str
    folder: Path
    """Where it was."""
    participants: tuple[str, ...]
    """Those that had a certificate of it that was valid."""
    key_uris: tuple[str, ...]
    """Its CA keys that are not in files: they stay where they are."""

    def to_json(self) -> dict[str, object]:
        """The set for --json."""
        return {
            "set": self.profile,
            "folder": self.folder,
            "participants": self.participants,
            "key_uris": self.key_uris,
        }


def removable_set(keystore: Keystore, profile: str, *, now: datetime) -> RemovedSet:
    """What `remove_set` removes. KeystoreError without such a set, and for the first one."""
    view = _further(keystore, profile)
    with view.open_ledger() as ledger:
        states = participant_states(view, ledger, now=now)
        valid = [each.name for each in states if not each.revoked and each.not_after > now]
    return RemovedSet(
        profile=profile,
        folder=view.folder,
        participants=tuple(valid),
        key_uris=tuple(_key_uris(view)),
    )


def remove_set(
    keystore: Keystore, authorities: Authorities, profile: str, *, now: datetime
) -> RemovedSet:
    """Remove the set of that profile, with its CAs, documents and all its certificates.

    The CAs of the others in `authorities` sign the next head of the ledger; the keys of its own
    are not needed. Errors as of `removable_set`; UsageError if a CA of the others cannot sign.
    """
    view = _further(keystore, profile)
    staying = tuple(each for each in authorities.others if each.set_name != view.set_name)
    left = replace(authorities, others=staying)
    if not left.can_sign:
        raise UsageError("the keys of the permissions CAs that stay are needed")
    with change(keystore.root, authorities) as transaction:
        keystore.refuse_unapproved(Covered.ROTATE)
        found = removable_set(keystore, profile, now=now)
        transaction.authorities = left
        part = transaction.of(view.set_name)
        ca = view.identity_ca
        part.record(Entry.of(SET_END, ca.subject_name, ca.fingerprint, now))
        profiles = [each for each in keystore.profiles if each.name != view.set_name]
        settings = settings_file(profiles, keystore.domains, keystore.ledger_address)
        transaction.folder(".", private=False).public(layout.SETTINGS, settings)
        _stage_removal(view, part)
    return found


def _further(keystore: Keystore, profile: str) -> Keystore:
    view = keystore.of_profile(profile)
    if view.set_name == layout.FIRST:
        raise KeystoreError(
            f"{profile} is the first set of credentials, whose files lie where stock stacks, ROS 2"
            " and exports look for them: it cannot be removed",
            hint="remove another one; or create a keystore of the other profile alone, and issue"
            " the participants there",
        )
    return view


def _key_uris(view: Keystore) -> Iterator[str]:
    """Without those of keys that are missing or damaged: they do not stop a removal."""
    try:
        yield from view.key_uris().values()
    except PqsecError:
        return


def _stage_removal(view: Keystore, part: SetChange) -> None:
    """Stage the end of all files of the set; what somebody else put beside them stays."""
    folders: list[str] = []
    for top in (layout.PUBLIC, layout.PRIVATE, layout.ENCLAVES):
        if not exists(view.folder / top):
            continue
        walked = list(walk(view.folder / top))
        inside = {path for path, _ in walked}
        for path, names in walked:
            place = path.relative_to(view.folder).as_posix()
            folders.append(place)
            for name in names:
                if path / name in inside:
                    continue
                if top == layout.PRIVATE or name in layout.KEYS:
                    part.shred(f"{place}/{name}")
                part.remove(f"{place}/{name}")
    for each in sorted(folders, key=len, reverse=True):
        part.remove_empty(each)
    part.remove_empty("")
    part.transaction.remove_empty(layout.SETS)
