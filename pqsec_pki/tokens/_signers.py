"""Signers that installed packages offer, for URIs of other schemes: `pqsec.signers`.

An entry point has the name of its scheme, and is called with the URI. It returns an object with
`spki`, the DER SubjectPublicKeyInfo, and `sign(data)`, which gives a signature over `data` in the
form of certificates and CMS. What it gives is verified.
"""

from typing import Any

from pqsec_pki.algorithms import ExternalKey, load_public_key
from pqsec_pki.errors import PqsecError, UsageError

GROUP = "pqsec.signers"


def find(uri: str) -> ExternalKey:
    """The key with that URI; UsageError if no package handles its scheme."""
    from pqsec_pki._packages import offered  # noqa: PLC0415 -- slow, and few keys are here

    scheme = uri.partition(":")[0].lower()
    found = offered(GROUP, scheme)
    if len(found) != 1:
        raise UsageError(
            f"{len(found) or 'no'} installed packages handle keys with URIs that begin with"
            f" '{scheme}:'",
            hint="keys in tokens have URIs such as 'pkcs11:token=lab;object=identity-ca'",
        )
    try:
        signer: Any = found[0].load()(uri)
        public = load_public_key(bytes(signer.spki))
    except PqsecError:
        raise
    except Exception as error:
        raise PqsecError(
            f"the package of '{scheme}:' cannot give the key: {type(error).__name__}: {error}"
        ) from error
    return ExternalKey(public.algorithm, public, _Guarded(signer, uri), uri)


class _Guarded:
    """A signer whose errors become PqsecError."""

    def __init__(self, signer: Any, uri: str) -> None:
        self._signer, self._uri = signer, uri

    def sign(self, data: bytes) -> bytes:
        try:
            return bytes(self._signer.sign(data))
        except PqsecError:
            raise
        except Exception as error:
            raise PqsecError(
                f"the holder of the private key {self._uri} failed: {type(error).__name__}: {error}"
            ) from error
