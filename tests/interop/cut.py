"""A network between a keystore and its database that is cut at a chosen message."""

import socket
import threading
from contextlib import suppress
from typing import Self

from pqsec_pki.keystore import Keystore
from tests.postgres import Cluster


class Cutter:
    """While it is open, the keystore's ledger is reached through it."""

    def __init__(self, cluster: Cluster, keystore: Keystore) -> None:
        self._cluster, self._settings = cluster, keystore.root / "pqsec.json"
        self._listener = socket.socket(socket.AF_UNIX)
        self._folder = keystore.root.parent / "s"
        self._folder.mkdir()
        self._listener.bind(str(self._folder / f".s.PGSQL.{cluster.port}"))
        self._listener.listen()
        self._word, self._deliver, self._stay, self._is_down = b"", False, False, False

    def cut_at(self, word: bytes, *, deliver: bool = False, stay: bool = False) -> None:
        """Cut when the keystore sends this, before or after it arrives; for good, if `stay`."""
        self._word, self._deliver, self._stay = word, deliver, stay

    def __enter__(self) -> Self:
        self._text = self._settings.read_text()
        self._settings.write_text(
            self._text.replace(f"host={self._cluster.folder}", f"host={self._folder}")
        )
        threading.Thread(target=self._accept, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        """The keystore's settings are as before, and so is the address of an open change."""
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._settings.write_text(self._text)
        for path in self._settings.parent.glob(".prepared/moves.json"):
            text = path.read_text().replace(f"host={self._folder}", f"host={self._cluster.folder}")
            path.write_text(text)

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                threading.Thread(target=self._serve, args=(client,), daemon=True).start()

    def _serve(self, client: socket.socket) -> None:
        server = socket.socket(socket.AF_UNIX)
        with client, server, suppress(OSError):
            if self._is_down:
                return
            server.connect(f"{self._cluster.folder}/.s.PGSQL.{self._cluster.port}")
            threading.Thread(target=_copy, args=(server, client), daemon=True).start()
            while data := client.recv(1 << 16):
                if self._word and self._word in data:
                    self._word, self._is_down = b"", self._stay
                    client.shutdown(socket.SHUT_RDWR)
                    if self._deliver:
                        server.sendall(data)
                        while server.recv(1 << 16):  # until the server has done it, and ends
                            server.shutdown(socket.SHUT_WR)
                    server.shutdown(socket.SHUT_RDWR)
                    return
                server.sendall(data)


def _copy(source: socket.socket, target: socket.socket) -> None:
    with suppress(OSError):
        while data := source.recv(1 << 16):
            target.sendall(data)
