"""A signer for pqsec: asks a process behind a Unix socket, which has the key.

One line of JSON each way: {"sign": null} gives the public key, {"sign": DATA} a signature; all
bytes are in base64. A key management service is asked in the same place, in its own way.
"""

import base64
import json
import socket

TIMEOUT = 10
"""Seconds."""


class SocketSigner:
    """The key behind the socket of a URI such as socket:/run/keys/identity-ca."""

    def __init__(self, uri: str) -> None:
        self._path = uri.partition(":")[2]
        self.spki = self._ask(None)
        """DER SubjectPublicKeyInfo."""

    def sign(self, data: bytes) -> bytes:
        """A signature over `data` in the form of certificates: for ECDSA, DER of r and s."""
        return self._ask(base64.b64encode(data).decode())

    def _ask(self, data: str | None) -> bytes:
        with socket.socket(socket.AF_UNIX) as connection:
            connection.settimeout(TIMEOUT)
            connection.connect(self._path)
            connection.sendall(json.dumps({"sign": data}).encode() + b"\n")
            answer = connection.makefile("rb").readline()
        return base64.b64decode(json.loads(answer)["bytes"])
