"""A process that has a private key and signs with it: python signing_process.py KEY SOCKET.

Run it as a user of its own, and let only the group of pqsec's operators open the socket.
"""

import base64
import json
import os
import socketserver
import sys
from pathlib import Path

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    PublicFormat,
    load_pem_private_key,
)

KEY = load_pem_private_key(Path(sys.argv[1]).read_bytes(), None)
SPKI = KEY.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)


class Answer(socketserver.StreamRequestHandler):
    """Answers one request."""

    def handle(self) -> None:
        data = json.loads(self.rfile.readline(1 << 20))["sign"]
        signed = KEY.sign(base64.b64decode(data), ec.ECDSA(hashes.SHA256())) if data else SPKI
        self.wfile.write(json.dumps({"bytes": base64.b64encode(signed).decode()}).encode() + b"\n")


if __name__ == "__main__":
    os.umask(0o177)
    with socketserver.UnixStreamServer(sys.argv[2], Answer) as server:
        server.serve_forever()
