"""Make current again what was installed before."""

from contextlib import suppress
from datetime import datetime
from pathlib import Path

from pqsec_pki._times import said
from pqsec_pki.credentials import PROOF, missing_proof
from pqsec_pki.enrolment._installed_trust import (
    credentials_in,
    pins_installed,
    raised,
    refuse_fewer_sets,
    trust_state,
)
from pqsec_pki.enrolment.credential_store import InstalledCredentials, changing
from pqsec_pki.enrolment.pins import pin_problems
from pqsec_pki.enrolment.receipt import receipt_of
from pqsec_pki.enrolment.trust import TrustState
from pqsec_pki.errors import KeystoreError, PqsecError, VerificationError
from pqsec_pki.tokens import Pin, stored_pin


def rollback(
    root: Path, *, now: datetime, older: bool = False, pin: Pin = stored_pin
) -> InstalledCredentials:
    """Make the installation before the current one current again.

    KeystoreError if there is none, or it cannot be read. VerificationError if its CAs are not
    those trusted here, or if anything in it is older than the newest that was installed,
    unless `older`; and always if it lacks a set of credentials. The marks stay, so no older bundle
    can be installed afterwards either.
    """
    with changing(root) as store:
        current = store.current
        if current is None:
            raise KeystoreError(f"nothing is installed in {root}")
        if current.previous is None or not (current.path.parent / current.previous).is_dir():
            raise KeystoreError(f"{root} has no installation from before {said(current.at)}")
        earlier = store.installation_numbered(current.previous)
        state = trust_state(store, current, needed=not older)
        if state:
            refuse_fewer_sets(earlier.further, state)
        if state and not older:
            _refuse_rollback(earlier, state)
        else:
            seen, pins = credentials_in(earlier), pins_installed(earlier)
            if state is None:
                with suppress(PqsecError):  # an unreadable one raises no marks
                    seen += credentials_in(current)
            state = raised(state, seen, pins, {})
        state = state.with_next_receipt()
        receipt = receipt_of(
            earlier.sets, earlier.numbers, state, installed_at=earlier.at, now=now, pin=pin
        )
        store.trust(state)
        store.point_to(current.previous, receipt)
        return earlier


def _refuse_rollback(earlier: InstalledCredentials, state: TrustState) -> None:
    credentials = credentials_in(earlier)
    enclaves = [each for of_set in earlier.sets.values() for each in of_set.items()]
    lacking = [name for name, files in enclaves if PROOF not in files]
    problems = [missing_proof(name) for name in lacking if state.proofs]
    problems += list(pin_problems(pins_installed(earlier), state.pins))
    problems += [problem for each in credentials for problem in state.marks.problems(each)]
    if problems:
        raise VerificationError(
            *dict.fromkeys(problems), hint="`pqsec rollback --older` restores it anyway"
        )
