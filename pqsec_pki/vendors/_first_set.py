"""Keystores with several sets of credentials: stock stacks see the first one only."""

from collections.abc import Iterator

from pqsec_pki.keystore import Keystore, faults_of_sets
from pqsec_pki.problems import Problem

_STOCK = "classical"
"""The profile of a first set for stock stacks."""


def unfit(keystore: Keystore) -> Problem | None:
    """That the first of several sets is not for stock stacks; None if it is, or the only one."""
    if len(keystore.profiles) == 1 or keystore.profile.runs_in_stock:
        return None
    return Problem(
        "stock stacks see only the first set of credentials, and that of this keystore has profile"
        f" {keystore.profile.name}, for pqsec peers only"
    )


def way_out(keystore: Keystore) -> str:
    """What to do about it."""
    others = [each.name for each in keystore.profiles if not each.runs_in_stock]
    stock = [each.name for each in keystore.profiles if each.runs_in_stock] or [_STOCK]
    order = ",".join((*stock, *others))
    return f"create another keystore, in this order: `pqsec -k DIR ca init --profile {order}`"


def lacking(keystore: Keystore, name: str) -> Iterator[str]:
    """A sentence if a set lacks something of that participant, or has it otherwise (PQS010)."""
    faults = [f"{path} {words}" for path, words in faults_of_sets(keystore, (name,))]
    if faults:
        more = f", and {len(faults) - 1} more" if len(faults) > 1 else ""
        yield (
            f"{name} does not have the same in all sets of credentials: {faults[0]}{more};"
            " `pqsec check` shows all (PQS010)"
        )
