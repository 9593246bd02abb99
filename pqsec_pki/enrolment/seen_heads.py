"""Compares an installed proof with the head of the ledger that the robot saw."""

from collections.abc import Iterator
from pathlib import Path

from pqsec_pki.credentials import Credentials
from pqsec_pki.enrolment.credential_store import INSTALLED, CredentialStore, is_credential_store
from pqsec_pki.problems import Problem
from pqsec_pki.transparency import TreeHead


def head_problems(folder: Path, credentials: Credentials, head: TreeHead) -> Iterator[Problem]:
    """Why `head`, of a verified proof in an enclave's `folder`, is not the newest one seen there.

    None outside of what is installed on a robot. KeystoreError for a damaged trust state.
    """
    place = folder.resolve()
    for installation in place.parents:
        if installation.parent.name == INSTALLED and is_credential_store(
            installation.parent.parent
        ):
            store = CredentialStore(installation.parent.parent)
            current, state = store.current, store.trust_state
            if state and current and current.path.resolve() == installation:
                yield from state.marks.head_problems(credentials, head)
            return
