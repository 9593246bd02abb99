"""What the robot of each participant runs, by its newest receipt, and what it should run."""

import hashlib
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from datetime import datetime
from enum import StrEnum
from pathlib import Path

from pqsec_pki._dataclass import dataclass
from pqsec_pki._files import disk_errors, exists, read
from pqsec_pki.credentials import (
    GOVERNANCE,
    NEEDED,
    PERMISSIONS,
    REVOCATION_LIST,
    TrustAnchors,
    certificates_in,
    only_list,
)
from pqsec_pki.errors import KeystoreError, PqsecError, VerificationError
from pqsec_pki.keystore import layout
from pqsec_pki.keystore._ledger import Ledger
from pqsec_pki.keystore.bundle_numbers import BundleNumbers
from pqsec_pki.keystore.current_files import CurrentFiles
from pqsec_pki.keystore.keystore import Keystore
from pqsec_pki.keystore.participant import enclave_files
from pqsec_pki.keystore.receipt import PUBLIC_FILES, RECEIPT, Receipt
from pqsec_pki.keystore.states import ParticipantState, State
from pqsec_pki.smime import is_canonical

_ENDED = frozenset({State.REVOKED, State.GONE, State.ELSEWHERE})


class InstallState(StrEnum):
    """How the files on a robot compare with those in the keystore."""

    CURRENT = "current"
    OUTDATED = "outdated"
    UNKNOWN = "unknown"
    """No receipt was imported."""
    NONE = "none"
    """It should run nothing: its certificate is revoked, or gone, in one of the sets."""

    @property
    def calls_for_bundle(self) -> bool:
        """Whether `pqsec bundle --outdated` would write a bundle."""
        return self in {InstallState.OUTDATED, InstallState.UNKNOWN}


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotState:
    """What the robot of one participant runs and should run."""

    name: str
    state: InstallState
    receipt: Receipt | None
    """The newest that was imported."""
    should_run: int | None
    """The number of the bundle that `pqsec bundle` would write now. None if it should run nothing,
    or if no receipt of any participant was imported: then no file is read."""
    changed: tuple[str, ...] = ()
    """The names of the files that differ, or that only the robot or only the keystore has; those of
    a further set of credentials as in `Receipt.files`."""

    @property
    def runs(self) -> int | None:
        """The number of the bundle that is installed; None if that is not known.

        If the files are those of the keystore, it is the keystore's number; else what the receipt
        says, which nothing signs but the robot.
        """
        if self.state is InstallState.CURRENT:
            return self.should_run
        return self.receipt.bundle if self.receipt else None

    @property
    def installed_at(self) -> datetime | None:
        """The time when the robot installed it; None without a receipt."""
        return self.receipt.installed_at if self.receipt else None

    def to_json(self) -> dict[str, object]:
        """The state for --json."""
        return {
            "robot": self.state,
            "runs": self.runs,
            "should_run": self.should_run,
            "changed": self.changed,
            "installed_at": self.installed_at,
        }


def robot_states(
    keystore: Keystore, participants: Iterable[ParticipantState]
) -> dict[str, RobotState]:
    """The state of the robot of each of these participants, by name, in their order.

    The files of the keystore are compared with the newest receipt; in place of older ones, those
    that another machine with its ledger made for all. KeystoreError for a damaged ledger or a
    missing file, FileError for one that cannot be read.
    """
    with keystore.open_ledger() as ledger:
        receipts = {entry.name: Receipt.of(entry) for entry in ledger.newest(RECEIPT)}
        numbers = BundleNumbers.among(keystore, ledger) if receipts else None
        sets = [(each, _certified(ledger.of(each.set_name))) for each in keystore.sets[1:]]
    shared = _newer(keystore)
    with disk_errors(keystore.root):
        return {
            each.name: _state(
                [keystore.sets[0], *(view for view, names in sets if each.name in names)],
                each,
                receipts.get(each.name),
                numbers,
                shared,
            )
            for each in participants
        }


def _certified(ledger: Ledger) -> frozenset[str]:
    """The participants that have a certificate in the set of that ledger."""
    return frozenset(each.name for each in ledger.newest("participant"))


def _newer(keystore: Keystore) -> dict[tuple[int, int], bytes]:
    """What to read in place of older files, by their device and inode."""
    if keystore.ledger_address is None:
        return {}
    with CurrentFiles.of(keystore) as current, suppress(KeystoreError, VerificationError):
        found = current.newer_elsewhere().items()
        there = ((path.stat(), data) for path, data in found if exists(path))
        return {(status.st_dev, status.st_ino): data for status, data in there}
    return {}


def _state(
    sets: Sequence[Keystore],
    participant: ParticipantState,
    receipt: Receipt | None,
    numbers: BundleNumbers | None,
    shared: dict[tuple[int, int], bytes],
) -> RobotState:
    name, state = participant.name, InstallState.UNKNOWN
    ended = {each.state for each in (participant, *participant.further)} & _ENDED
    if ended:
        return RobotState(name=name, state=InstallState.NONE, receipt=receipt, should_run=None)
    if numbers is None:
        return RobotState(name=name, state=state, receipt=None, should_run=None)
    found = {each.set_name: _files(each.folder, name, shared) for each in sets}
    changed: tuple[str, ...] = ()
    if receipt:
        changed = _changed(found, receipt.files, numbers)
        state = InstallState.OUTDATED if changed else InstallState.CURRENT
    return RobotState(
        name=name,
        state=state,
        receipt=receipt,
        should_run=numbers.number_of(found.values()),
        changed=changed,
    )


def _files(root: Path, name: str, shared: dict[tuple[int, int], bytes]) -> dict[str, bytes]:
    """The participant's files but its keys, by name.

    Thousands of enclaves link to the same files: those in `shared`, by device and inode, are not
    read again.
    """
    found = {}
    for file in PUBLIC_FILES:
        path = f"{root}/{layout.enclave_folder(name)}/{file}"
        with suppress(FileNotFoundError):
            status = os.stat(path)  # noqa: PTH116 -- faster, for thousands of files
            place = status.st_dev, status.st_ino
            data = shared.get(place) or read(Path(path))
            if os.path.islink(path):  # noqa: PTH114 -- see above
                shared[place] = data
            found[file] = data
    if not found.keys() >= set(NEEDED):
        enclave_files(root, name)  # says what is missing
    return found


def _changed(
    sets: Mapping[str, Mapping[str, bytes]], installed: Mapping[str, str], numbers: BundleNumbers
) -> tuple[str, ...]:
    """The names of files that are not installed as they are, or would be in a bundle."""
    known = {layout.in_set(name, file) for name, files in sets.items() for file in files}
    changed = [
        layout.in_set(name, file)
        for name, files in sets.items()
        for file in files
        if _differs(file, files, installed.get(layout.in_set(name, file)), numbers)
    ]
    return tuple(sorted({*changed, *(installed.keys() - known)}))


def _differs(
    file: str, files: Mapping[str, bytes], installed: str | None, numbers: BundleNumbers
) -> bool:
    if installed is None:
        return True
    here = _sha256(files[file])
    if here == installed:
        return False
    # Two files that the ledger knows differ. Else one may be in the form of another tool.
    known = bool(numbers.line_of(here) and numbers.line_of(installed))
    return known or _sha256(_in_bundle(file, files)) != installed


def _in_bundle(file: str, files: Mapping[str, bytes]) -> bytes:
    """The file as a bundle has it: other tools' files are written again in pqsec's own form."""
    data = files[file]
    with suppress(PqsecError):  # the file is not valid: no bundle has it
        if file in {PERMISSIONS, GOVERNANCE}:
            return data if is_canonical(data) else TrustAnchors.of(files).signed(data).message
        if file == REVOCATION_LIST:
            return only_list(data, file).pem
        return b"".join(each.pem for each in certificates_in(data, file))
    return data


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
