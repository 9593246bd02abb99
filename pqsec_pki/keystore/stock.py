"""The ledger's line about who may be met with the first set of credentials, as stock stacks use it.

Everybody else is met with the strongest set only. It is in the ledger and in no other file, as the
rule of approvals is: so it cannot be widened by an edit.
"""

import hashlib
from collections.abc import Sequence
from datetime import datetime

from pqsec_pki.keystore._chain import Entry
from pqsec_pki.keystore._ledger import Ledger

STOCK = "stock"
"""The kind of line; it is about the whole keystore."""
_NAMES = "names"


def stock_of(ledger: Ledger) -> tuple[str, ...]:
    """Names and patterns of participants, as `matching` reads them; none without a line."""
    return next((tuple(each.details.get(_NAMES, "").split()) for each in ledger.newest(STOCK)), ())


def stock_entry(names: Sequence[str], head: str, now: datetime) -> Entry:
    """The line with these names and patterns; `head` makes it another line each time."""
    text = " ".join(names)
    sha256 = hashlib.sha256(f"{head} {text}".encode()).hexdigest()
    return Entry.of(STOCK, "", sha256, now, details={_NAMES: text})
