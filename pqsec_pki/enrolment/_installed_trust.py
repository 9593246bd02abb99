"""What a robot trusts: as saved, or derived from what is installed."""

from collections.abc import Collection, Mapping

from pqsec_pki.credentials import KEYS, PROOF, Credentials, verify_logged
from pqsec_pki.enrolment.credential_store import CredentialStore, InstalledCredentials
from pqsec_pki.enrolment.pins import Pins, pins_in, set_problems, sets_in
from pqsec_pki.enrolment.trust import TrustState
from pqsec_pki.errors import KeystoreError, PqsecError, VerificationError, located
from pqsec_pki.keystore import layout
from pqsec_pki.problems import Code
from pqsec_pki.transparency import LedgerProof, TreeHead


def trust_state(
    store: CredentialStore, before: InstalledCredentials | None, *, needed: bool
) -> TrustState | None:
    """The saved trust state, or, if there is none, one derived from what is installed.

    None if nothing is installed, or if it cannot be read and is not `needed`.
    """
    try:
        state = store.trust_state
        if state or before is None:
            return state
        installed, pins = credentials_in(before), pins_installed(before)
        return raised(None, installed, pins, heads_in(before))
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


def heads_in(found: InstalledCredentials) -> dict[str, TreeHead]:
    """The head in each installed proof, by participant; errors as of `verify_logged`."""
    heads = {}
    for place, credentials in _by_set(found).items():
        enclaves = found.sets[place]
        for each in credentials:
            files = enclaves[each.name]
            if PROOF in files:
                proof = LedgerProof.from_bytes(files[PROOF])
                verify_logged(each.name, each.anchors, files, proof)
                heads[each.name] = proof.checkpoint.head
    return heads


def credentials_in(found: InstalledCredentials) -> list[Credentials]:
    """The installed credentials of all sets, read but not verified.

    KeystoreError if a participant is missing in one of the sets that were installed.
    """
    return [each for credentials in _by_set(found).values() for each in credentials]


def pins_installed(found: InstalledCredentials) -> Pins:
    """The CAs of all sets that are installed; errors as of `credentials_in`."""
    return {
        file: pins
        for place, credentials in _by_set(found).items()
        for file, pins in pins_in(*(e.anchors for e in credentials), set_name=place).items()
    }


def _by_set(found: InstalledCredentials) -> dict[str, list[Credentials]]:
    with located(found.path):
        sets = found.sets
        for place, enclaves in sets.items():
            if lacking := sorted(sets[layout.FIRST].keys() - enclaves.keys()):
                raise KeystoreError(
                    f"the set of credentials {place} lacks {', '.join(lacking)}",
                    code=Code.FILE_MISSING,
                )
        return {
            place: [
                Credentials.of(name, {file: files[file] for file in files.keys() - {*KEYS}})
                for name, files in enclaves.items()
            ]
            for place, enclaves in sets.items()
        }


def refuse_fewer_sets(further: Collection[str], state: TrustState) -> None:
    """VerificationError if a further set of credentials that this robot has is not in `further`.

    Whoever leaves out the strongest set could be met with a weaker one, so no option allows it.
    """
    lacking = [each for each in sets_in(state.pins) if each not in further]
    if lacking:
        raise VerificationError(
            *set_problems((), lacking),
            hint="a set is not removed by leaving it out: for a domain without it, install into"
            " another --dir",
        )
