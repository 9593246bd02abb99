"""pqsec try ros2 --dry-run: check whether ROS 2 would run a secured node from this shell."""

import os
from collections.abc import Iterator

from pqsec_pki.cli import _printing, _settings
from pqsec_pki.cli._paragraph import paragraph
from pqsec_pki.errors import KeystoreError
from pqsec_pki.vendors import Check, preflight


def report(names: tuple[str, ...]) -> int:
    """Print the checks for these participants, or for all. Returns the exit code."""
    keystore, now = _settings.open_keystore(), _settings.now()
    names = names or tuple(keystore.names())
    if not names:
        raise KeystoreError(
            "there is no participant to check", hint="issue one: `pqsec issue NAME`"
        )
    checks = {name: list(preflight(keystore, name, os.environ, now=now)) for name in names}
    good = all(each.ok for found in checks.values() for each in found)
    _printing.emit({"ok": good, "participants": checks}, _lines(checks))
    return 0 if good else 1


def _lines(checks: dict[str, list[Check]]) -> Iterator[str]:
    for name, found in checks.items():
        width = max(len(each.what) for each in found)
        for each in found:
            front = f"{'ok  ' if each.ok else 'FAIL'}  {each.what:<{width}}  "
            yield from paragraph(front, each.problem) if each.problem else [front.rstrip()]
        bad = [each for each in found if not each.ok]
        yield ""
        if not bad:
            yield f"ROS 2 would run {name} secured from this shell: --ros-args --enclave {name}"
            continue
        yield f"ROS 2 would not run {name} secured from this shell. To fix it:"
        yield from (f"  {fix}" for fix in dict.fromkeys(each.fix for each in bad))
