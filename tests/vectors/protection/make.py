"""Makes cyclone.json again, with Cyclone DDS's plugin: python -m tests.vectors.protection.make

From the root of the checkout. Every key is new each time.
"""

import ctypes
import json
import os
from itertools import product
from pathlib import Path

from tests.interop.cyclone import find_plugins
from tests.interop.cyclone_crypto import Crypto, Protection, crypto
from tests.interop.cyclone_types import SharedSecret, Token
from tests.interop.exchange import PAYLOAD, SUBMESSAGE


def capture(theirs: Crypto, protection: Protection) -> dict[str, object]:
    """A writer with two readers, and a reader: their keys and what they protect."""
    writer, reader = (theirs.endpoint(kind, protection) for kind in ("writer", "reader"))
    other = writer.another()
    return {
        "protection": str(protection),
        "submessage": SUBMESSAGE.hex(),
        "payload": PAYLOAD.hex(),
        "writer_keys": keys(writer.tokens()),
        "writer_keys_for_another": keys(other.tokens()),
        "writer_submessage": writer.protect(SUBMESSAGE, other).hex(),
        "writer_payload": writer.protect_payload(PAYLOAD).hex(),
        "reader_keys": keys(reader.tokens()),
        "reader_submessage": reader.protect(SUBMESSAGE).hex(),
    }


def keys(tokens: tuple[Token, ...]) -> list[str]:
    """dds.cryp.keymat of each."""
    return [token.binary[0][1].hex() for token in tokens]


if __name__ == "__main__":
    secret = SharedSecret.of(*(os.urandom(32) for _ in range(3)))
    with crypto(find_plugins(), ctypes.addressof(secret)) as theirs:
        each = product([True, False], [True, False], [256, 128])
        made = [capture(theirs, Protection(*values)) for values in each]
    Path(__file__).with_name("cyclone.json").write_text(json.dumps(made, indent=1) + "\n")
