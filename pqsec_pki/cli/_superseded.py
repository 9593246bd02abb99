"""Notes on certificates that were replaced and are still valid."""

import shlex
from collections.abc import Iterable
from datetime import datetime

from pqsec_pki._times import said
from pqsec_pki.cli import _printing
from pqsec_pki.keystore import MOST_SHOWN, Keystore, superseded_certificates


def note_superseded(keystore: Keystore, names: Iterable[str], now: datetime) -> None:
    """Note which certificates before the current ones of these stay valid, and how to end them."""
    found = superseded_certificates(keystore, now=now)
    valid = {name: found[name] for name in names if name in found}
    if valid:
        end = max(each.ends for those in valid.values() for each in those)
        few = [*map(shlex.quote, valid)] if len(valid) <= MOST_SHOWN else ["'/**'"]
        _printing.note(
            f"the certificates that {_printing.few(valid)} had before stay valid, the last until"
            f" {said(end)}; when the robots have the new ones, this ends them and no other: pqsec"
            f" -k {shlex.quote(str(keystore.root))} revoke {' '.join(few)} --superseded --yes"
        )
