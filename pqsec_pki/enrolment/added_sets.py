"""Sets of credentials that a keystore added since the robot's last installation.

The CAs that the robot trusts vouch for those of a new set: all that sign in its sets signed a head
of the ledger, in which each CA of the new set has a line that names this set. Sets are only added
here, never removed.
"""

from collections.abc import Collection

from pqsec_pki.enrolment.bundle import Bundle, ca_kind
from pqsec_pki.enrolment.pins import Pins, of_sets, pin_problems, sets_in
from pqsec_pki.errors import PqsecError, VerificationError, problems_of
from pqsec_pki.keystore import layout
from pqsec_pki.problems import Code, Problem
from pqsec_pki.transparency import LedgerProof

_HINT = (
    "install it with --ca-fingerprint for each CA, as `pqsec ca show --pins` on the CA machine"
    " prints them; or write the bundle again, after `pqsec log --sign` there"
)


def with_added_sets(bundle: Bundle, pins: Pins) -> Pins:
    """`pins`, and the CAs of further sets in `bundle` for which the trusted CAs vouch.

    VerificationError for a set for which they do not. If the bundle has other CAs than `pins` in
    the sets that are known, only `pins`: its verification says what is wrong.
    """
    known = (layout.FIRST, *sets_in(pins))
    added = [each for each in bundle.further if each not in known]
    if not added or any(pin_problems(of_sets(bundle.roles, known), pins)):
        return pins
    proof = _verified(bundle, known, added)
    for each in added:
        _refuse_unproven(bundle, each, proof)
    return {**pins, **of_sets(bundle.roles, added)}


def _verified(bundle: Bundle, known: Collection[str], added: Collection[str]) -> LedgerProof:
    """The proof of the lines about the CAs; VerificationError unless all signers signed it."""
    wanted = [each.about for each in bundle.set_lines]
    signers = {
        signer.public_key.spki: signer.public_key
        for name in known
        for each in bundle.credentials_by_set[name]
        for signer in each.anchors.signers
    }
    if bundle.proof is None:
        missing = "nothing proves that the keystore has these CAs"
        raise VerificationError(*(_unproven(each, missing) for each in added), hint=_HINT)
    try:
        own = bundle.proof.about(wanted)
        own.verify([*signers.values()], wanted)
    except PqsecError as error:
        words = [each.message for each in problems_of(error)]
        problems = (_unproven(name, each) for name in added for each in words)
        raise VerificationError(*problems, hint=_HINT) from error
    return own


def _refuse_unproven(bundle: Bundle, name: str, proof: LedgerProof) -> None:
    """VerificationError for a CA of that set without a line of the ledger that names the set."""
    proven = {each.about for each in bundle.set_lines if each.proves(name, proof.lines)}
    lacking = [
        each
        for file, found in of_sets(bundle.roles, [name]).items()
        for each in sorted(found)
        if (ca_kind(file), each) not in proven
    ]
    if lacking:
        words = "no line of the ledger says that it is a CA of this set: SHA-256"
        raise VerificationError(
            *(_unproven(name, f"{words} {each}") for each in lacking), hint=_HINT
        )


def _unproven(name: str, words: str) -> Problem:
    return Problem(words, Code.CA_UNKNOWN, f"set {name}")
