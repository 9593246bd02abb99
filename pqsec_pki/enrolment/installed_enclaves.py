"""Compares an enclave that is installed on a robot with what the robot saw before."""

from collections.abc import Iterator
from pathlib import Path

from pqsec_pki._files import exists
from pqsec_pki.credentials import CERTIFICATE, Credentials
from pqsec_pki.enrolment.credential_store import INSTALLED, CredentialStore, is_credential_store
from pqsec_pki.enrolment.pins import sets_in
from pqsec_pki.keystore import layout
from pqsec_pki.problems import Code, Problem
from pqsec_pki.transparency import TreeHead


def problems_where_installed(
    folder: Path, credentials: Credentials, head: TreeHead | None
) -> Iterator[Problem]:
    """What is wrong with an enclave's `folder` on a robot: a set of credentials that it lacks.

    And why `head`, of a verified proof there, is not the newest one seen. None outside of what is
    installed on a robot. KeystoreError for a damaged trust state.
    """
    place = folder.resolve()
    for installed in place.parents:
        root = installed.parent.parent
        if installed.parent.name == INSTALLED and is_credential_store(root):
            store = CredentialStore(root)
            current, state = store.current, store.trust_state
            if state and current and current.path.resolve() == installed:
                yield from _missing_sets(installed, credentials.name, sets_in(state.pins))
                if head:
                    yield from state.marks.head_problems(credentials, head)
            return


def _missing_sets(installed: Path, name: str, further: tuple[str, ...]) -> Iterator[Problem]:
    for each in (layout.FIRST, *further):
        folder = layout.in_set(each, layout.enclave_folder(name))
        if not exists(installed / folder / CERTIFICATE):
            words = f"{folder} is missing, and this robot has this set of credentials"
            yield Problem(words, Code.FILE_MISSING).of(name)
