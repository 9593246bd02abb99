"""Which files of an enclave the ledger has, and the proof that it has them."""

import hashlib
from collections.abc import Mapping
from typing import TYPE_CHECKING

from pqsec_pki.credentials._pem_files import only_certificate
from pqsec_pki.credentials.anchors import TrustAnchors
from pqsec_pki.credentials.names import CERTIFICATE, GOVERNANCE, PERMISSIONS
from pqsec_pki.errors import PqsecError, VerificationError, problems_of
from pqsec_pki.problems import Code, Problem

if TYPE_CHECKING:
    from pqsec_pki.transparency import LedgerProof

PROOF = "ledger.proof"
"""The proof beside an enclave's files; no stack reads it."""
_KINDS = {CERTIFICATE: "participant", PERMISSIONS: "permissions", GOVERNANCE: "governance"}


def logged_hashes(files: Mapping[str, bytes]) -> list[tuple[str, str]]:
    """The kind and the SHA-256 of each line that the ledger must have about these files."""
    certificate = only_certificate(files[CERTIFICATE], CERTIFICATE).fingerprint
    documents = (PERMISSIONS, GOVERNANCE)
    hashes = [(_KINDS[file], hashlib.sha256(files[file]).hexdigest()) for file in documents]
    return [(_KINDS[CERTIFICATE], certificate), *hashes]


def verify_logged(
    name: str,
    anchors: TrustAnchors,
    files: Mapping[str, bytes],
    proof: "LedgerProof | None",
    *,
    demanded: bool = False,
) -> "LedgerProof | None":
    """The part of `proof` about the certificate and documents in `files`: the ledger has them.

    The permissions CA and its countersigner must have signed the ledger's head.
    VerificationError if it does not prove that, or is None and `demanded`.
    """
    if proof is None:
        if demanded:
            raise VerificationError(missing_proof(name))
        return None
    try:
        wanted = logged_hashes(files)
        own = proof.about(wanted)
        own.verify([each.public_key for each in anchors.signers], wanted)
    except PqsecError as error:
        found = [Problem(each.message, Code.PROOF_BAD, PROOF) for each in problems_of(error)]
        raise VerificationError(*(each.of(name) for each in found)) from error
    return own


def missing_proof(name: str) -> Problem:
    """The problem of a participant without a proof where one is demanded."""
    words = "it is missing, and demanded here: install a new bundle, which has one"
    return Problem(words, Code.PROOF_MISSING, PROOF).of(name)
