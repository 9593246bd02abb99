"""Killing what changes a keystore, at any of its calls to the operating system.

A child process does the work and is killed at its Nth call, for every N until the work is
done; writes are cut in half. Then the parent looks. All changes go through one journal: of one of
them the gate kills at every N, of the others at one N in some. With PQSEC_LONG=1, as in .ci/long,
all do so for every N.
"""

import errno
import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

from pqsec_pki.algorithms import profile_named
from pqsec_pki.certificates import Certificate, verify_chain
from pqsec_pki.documents import DomainSet, Permissions
from pqsec_pki.errors import ExistsError, KeystoreError, PqsecError
from pqsec_pki.keystore import Keystore, audit, checked_head
from pqsec_pki.lifecycle import ParticipantSpec, issue, renew_list
from pqsec_pki.smime import Require, verify
from tests.longer import LONG

NOW = datetime(2026, 11, 21, 12, tzinfo=UTC)
YEAR = timedelta(days=365)
KILLED = 9
REASONS = (errno.ENOSPC, errno.EROFS, errno.EIO)
"""Why a disk refuses."""
CALLS = (
    *("open", "write", "mkdir", "chmod", "rename", "replace", "link", "symlink", "unlink", "rmdir"),
)


def create(root):
    return Keystore.create(
        root,
        profile_named("transition"),
        name="Lab",
        domains=DomainSet.of(0),
        validity=10 * YEAR,
        passphrase=None,
        now=NOW,
    )


def issue_to(root, *names, force=False):
    keystore = Keystore.open(root, to_change=True)
    specs = [ParticipantSpec(name=name, domains=DomainSet.of(0), validity=YEAR) for name in names]
    return issue(keystore, keystore.unlock(None), specs, now=NOW, force=force)


def empty_list(root):
    """Issue a revocation list."""
    keystore = Keystore.open(root, to_change=True)
    renew_list(keystore, keystore.unlock(None), now=NOW)


# Killing


class Countdown:
    """Counts the calls that change something, and ends the process at the last."""

    def __init__(self, calls: int) -> None:
        self.left = calls

    def watch(self, name: str) -> None:
        real = getattr(os, name)

        def watched(*arguments, **options):
            self.left -= 1
            if self.left <= 0:
                if name == "write":  # half of it arrives
                    handle, data = arguments
                    real(handle, bytes(data)[: len(data) // 2])
                os._exit(KILLED)
            return real(*arguments, **options)

        setattr(os, name, watched)


def threads() -> int:
    return len(list(Path("/proc/self/task").iterdir()))


residents = [threads()]
"""Of this process: one thread, or a few where tests run side by side or where libraries of
other tests keep some. They do not work in OpenSSL."""


def fork() -> int:
    """os.fork, once no thread is left that could hold one of OpenSSL's locks.

    A joined thread may still be on its way out of OpenSSL; who stays for two seconds is a
    resident, and is not waited for again.
    """
    patience = time.monotonic() + 2
    while threads() > residents[0] and time.monotonic() < patience:
        time.sleep(0.001)
    residents[0] = max(residents[0], threads())
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* is multi-threaded", DeprecationWarning)
        child = os.fork()
    if child == 0:
        signal.alarm(300)
    return child


def survives(calls: int, work: Callable[[], object]) -> bool:
    """Whether `work` is done before its process made so many calls."""
    child = fork()
    if child == 0:
        countdown = Countdown(calls)
        for name in CALLS:
            countdown.watch(name)
        try:
            work()
        except BaseException:  # noqa: BLE001 -- the parent wants to know of any
            traceback.print_exc()
            sys.stderr.flush()
            os._exit(1)
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in {0, KILLED}, f"the work failed by itself, with {code}"
    return code == 0


def disturbed_calls(every: int) -> range:
    """At which calls the work is disturbed: one in `every`, or each in the longer job."""
    return range(1, 2000, 1 if LONG else every)


Trial = Callable[[int, Callable[[], object]], bool]
"""Whether the work is done although it is disturbed at its Nth call."""


def copies(
    place: Path,
    original: Path,
    work: Callable[[Path], object],
    trial: Trial = survives,
    *,
    every: int = 1,
) -> Iterator[tuple[Path, bool]]:
    """Copies of `original` with `work` disturbed at one call each, and whether it is done.

    The last is done; each is there until the next is asked for.
    """
    for calls in disturbed_calls(every):
        root = place / str(calls)
        shutil.copytree(original, root, symlinks=True)
        done = trial(calls, lambda root=root: work(root))
        yield root, done
        shutil.rmtree(root)
        if done:
            return


def check_commitment(outcomes: list[bool], every: int = 1) -> None:
    """Not done, then from one call on done: the commitment is a single call."""
    assert len(outcomes) > 20 / every
    assert outcomes == sorted(outcomes)
    assert set(outcomes) == {False, True}


# Looking


def valid_at(certificate: Certificate) -> datetime:
    """NOW, or when the certificate begins: processes have the machine's clock."""
    return max(NOW, certificate.not_before)


def check_whole(keystore: Keystore, name: str) -> str:
    """The certificate's fingerprint, after everything was found to fit together."""
    one = keystore.participant(name)
    assert one.key.public_key.spki == one.certificate.spki
    assert one.alternative_key.public_key.spki == one.certificate.alternative_key.spki
    now = valid_at(one.certificate)
    verify_chain(one.certificate, one.identity_ca, now=now, require_alternative=True)
    verified = [
        verify(
            document,
            one.permissions_ca,
            alternative_ca=one.countersigner,
            require=Require.BOTH,
        )
        for document in (one.permissions, one.governance)
    ]
    [grant] = Permissions.from_xml(verified[0].document).grants
    assert grant.subject_name == one.certificate.subject_name == f"CN={name}"
    folder = keystore.root / "enclaves" / name[1:]
    plain = (folder / "permissions.xml").read_bytes()
    assert Permissions.from_xml(plain) == Permissions.from_xml(verified[0].document)
    key_files = [folder / "key.pem", folder / "alt.key.pem"]
    assert {file.stat().st_mode & 0o777 for file in key_files} == {0o600}
    assert folder.stat().st_mode & 0o777 == 0o700
    return one.certificate.fingerprint


WITHOUT_HEAD = {"revocation", "crl"}
"""What the identity CA does alone. Any other line and its head come together."""


def check_ledger(keystore: Keystore) -> None:
    """The last lines on each name are what lies in its folder, and there are no others."""
    audit(keystore)
    entries = keystore.ledger()
    without = entries[checked_head(keystore).head.size :]
    assert {entry.kind for entry in without} <= WITHOUT_HEAD
    assert [entry.kind for entry in entries[:4]] == [
        "identity-ca",
        "permissions-ca",
        "permissions-ca",
        "governance",
    ]
    assert entries[3].sha256 == hashlib.sha256(keystore.governance).hexdigest()
    issued = [entry for entry in entries[4:] if entry.kind in {"participant", "permissions"}]
    last = {(entry.kind, entry.name): entry.sha256 for entry in issued}
    names = keystore.names()
    assert {name for _, name in last} == set(names)
    for name in names:
        one = keystore.participant(name)
        assert last["participant", name] == one.certificate.fingerprint
        assert last["permissions", name] == hashlib.sha256(one.permissions).hexdigest()


def check_no_halves(root: Path) -> None:
    """Also for a stack that looks before any pqsec command: a certificate comes last."""
    for certificate in (root / "enclaves").rglob("cert.pem"):
        files = {path.name for path in certificate.parent.iterdir() if path.exists()}
        assert files >= {
            *("key.pem", "alt.key.pem", "permissions.xml", "permissions.p7s", "governance.p7s"),
            *("identity_ca.cert.pem", "permissions_ca.cert.pem", "permissions_ca.alt.cert.pem"),
        }


def is_keystore(root: Path) -> bool:
    try:
        Keystore.open(root, to_change=True)
    except KeystoreError:
        return False
    return True


def drafts(root: Path) -> list[Path]:
    return [
        path for path in root.glob(".*") if path.name.startswith((".draft-", ".journal", ".pqsec-"))
    ]


def fails_with(code: int, calls: int, work: Callable[[], object]) -> bool:
    """Whether `work` is done, if the disk refuses its Nth call; it may fail by our errors only."""
    child = fork()
    if child == 0:
        left = [calls]
        for name in ("open", "write", "fchmod", "mkdir", "chmod", "rename", "replace", "symlink"):
            _refusing(name, code, left)
        try:
            work()
        except BaseException as error:  # noqa: BLE001 -- the parent wants to know of any
            os._exit(KILLED if isinstance(error, PqsecError) else 1)
        os._exit(0 if left[0] > 0 else KILLED)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert status in {0, KILLED}, "another error than ours"
    return status == 0


def fails(calls: int, work: Callable[[], object]) -> bool:
    """As fails_with, for one reason after the other."""
    return fails_with(REASONS[calls % len(REASONS)], calls, work)


def _refusing(name: str, code: int, left: list[int]) -> None:
    real = getattr(os, name)

    def refusing(*arguments, **options):
        left[0] -= 1
        if left[0] == 0:
            raise OSError(code, os.strerror(code))
        return real(*arguments, **options)

    setattr(os, name, refusing)


def killed_processes(place: Path, original: Path, line: str, *, within: float) -> Iterator[Path]:
    """Copies of `original` whose process of the command `line` was killed as it worked.

    Once it has begun to draft, at a moment of the seconds `within`; the last ends by itself, as
    any may that is killed late.
    """
    chance = random.Random(line)  # noqa: S311 -- the same each time
    times = 5
    for number in range(times):
        root = place / str(number)
        shutil.copytree(original, root, symlinks=True)
        command = [sys.executable, "-m", "pqsec_pki", "-k", str(root), *line.split()]
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        while process.poll() is None and not drafts(root):
            time.sleep(0.002)
        if number < times - 1:
            time.sleep(chance.uniform(0, within))
            process.send_signal(signal.SIGKILL)
        assert b"Traceback" not in process.communicate(timeout=300)[1]
        yield root


# Several at once


def at_once(*works: Callable[[], object]) -> list[int]:
    """The exit codes of processes that each do one of `works`, all at the same time."""
    reader, writer = os.pipe()
    children = []
    for work in works:
        child = fork()
        if child == 0:
            os.close(writer)
            os.read(reader, 1)  # until the parent lets go
            os._exit(_code(work))
        children.append(child)
    os.close(reader)
    os.close(writer)
    return [os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) for child in children]


def _code(work: Callable[[], object]) -> int:
    try:
        work()
    except ExistsError:
        return 3
    except BaseException:  # noqa: BLE001 -- the parent wants to know of any
        return 1
    return 0
