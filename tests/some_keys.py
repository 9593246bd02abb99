"""Keys of every kind. RSA keys are slow to generate: one of each size and owner serves all rows."""

from functools import cache

from cryptography.hazmat.primitives.asymmetric import rsa

from pqsec_pki.algorithms import SIGNATURES


def some_key(name, owner="alice"):
    """`owner`'s key of that kind, the same at each call in a process."""
    return _key(name, owner)


@cache
def _key(name, owner):
    row = SIGNATURES.named(name)
    *first, last = row.parts or (row,)
    if not hasattr(last, "bits"):
        return row.generate()
    handles = (*(part.generate_handle() for part in first), _rsa(last.bits, owner))
    return row.private_key(handles if first else handles[0])


@cache
def _rsa(bits, _owner):
    return rsa.generate_private_key(65537, bits)
