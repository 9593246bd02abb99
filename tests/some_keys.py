"""Keys of every kind. RSA keys are slow to generate: one of each size and owner serves all rows,
and the first owners get those that the composite keys of vectors/composite hold."""

import json
from base64 import b64decode
from collections import defaultdict
from functools import cache
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import load_der_private_key

from pqsec_pki.algorithms import SIGNATURES

VECTORS = Path(__file__).parent / "vectors/composite/composite_ml_dsa_draft19.json"
SEED = 32


def some_key(name, owner="alice"):
    """`owner`'s key of that kind, the same at each call in a process."""
    return _key(name, owner)


@cache
def _key(name, owner):
    row = SIGNATURES.named(name)
    *first, last = row.parts or (row,)
    if not hasattr(last, "bits"):
        return row.generate()
    handles = (*(part.generate_handle() for part in first), rsa_key(last.bits, owner))
    return row.private_key(handles if first else handles[0])


@cache
def rsa_key(bits, owner="alice"):
    """`owner`'s RSA key of that size, the same at each call in a process."""
    _ = owner
    ready = _ready()[bits]
    return ready.pop() if ready else rsa.generate_private_key(65537, bits)


@cache
def _ready():
    """Keys by their size."""
    found = defaultdict(list)
    for case in json.loads(VECTORS.read_bytes())["tests"]:
        if "RSA" in case["tcId"]:
            der = b64decode(case["sk"])[SEED:]  # after the seed of the ML-DSA key
            key = load_der_private_key(der, None, unsafe_skip_rsa_key_validation=True)
            found[key.key_size].append(key)
    return found
