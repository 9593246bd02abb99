"""What a robot trusts: as saved, or derived from what is installed."""

from collections.abc import Collection, Mapping

from pqsec_pki.credentials import KEYS, PROOF, Credentials, verify_logged
from pqsec_pki.enrolment.credential_store import CredentialStore, Installation
from pqsec_pki.enrolment.trust import Pins, TrustState, pins_in
from pqsec_pki.errors import PqsecError, located
from pqsec_pki.transparency import LedgerProof, TreeHead


def trust_state(
    store: CredentialStore, before: Installation | None, *, needed: bool
) -> TrustState | None:
    """The saved trust state, or, if there is none, one derived from what is installed.

    None if nothing is installed, or if it cannot be read and is not `needed`.
    """
    try:
        state = store.trust_state
        if state or before is None:
            return state
        installed = credentials_in(before)
        pins = pins_in(*(each.anchors for each in installed))
        return raised(None, installed, pins, heads_in(before, installed))
    except PqsecError as error:
        if not needed:
            return None
        error.hint = error.hint or (
            "--older, with --ca-fingerprint for each CA, ignores what was installed before"
        )
        raise


def raised(
    state: TrustState | None,
    credentials: Collection[Credentials],
    pins: Pins,
    heads: Mapping[str, TreeHead],
) -> TrustState:
    """The trust state after these credentials; `pins` are its CAs if there is none yet.

    `heads` are the heads of the ledger in their proofs, by participant.
    """
    return (state or TrustState.of_new_store(pins)).after(credentials, pins, heads)


def heads_in(found: Installation, credentials: Collection[Credentials]) -> dict[str, TreeHead]:
    """The head in each installed proof, by participant; errors as of `verify_logged`."""
    heads = {}
    for each in credentials:
        files = found.enclaves[each.name]
        if PROOF in files:
            proof = LedgerProof.from_bytes(files[PROOF])
            verify_logged(each.name, each.anchors, files, proof)
            heads[each.name] = proof.checkpoint.head
    return heads


def credentials_in(found: Installation) -> list[Credentials]:
    """The installed credentials, read but not verified."""
    with located(found.path):
        return [
            Credentials.of(name, {file: each for file, each in files.items() if file not in KEYS})
            for name, files in found.enclaves.items()
        ]
