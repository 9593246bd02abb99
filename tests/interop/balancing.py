"""A TCP balancer: each connection goes to the next server that listens, and is not looked into."""

import socket
import threading
from contextlib import contextmanager, suppress
from itertools import count

HOST = "127.0.0.1"
_PATIENCE = 120


@contextmanager
def balancer(*ports):
    """The port of a balancer before servers at these ports."""
    with socket.create_server((HOST, 0)) as listener:
        threading.Thread(target=_serve, args=(listener, ports), daemon=True).start()
        yield listener.getsockname()[1]
        listener.shutdown(socket.SHUT_RDWR)


def _serve(listener, ports):
    for number in count():
        try:
            client, _ = listener.accept()
        except OSError:
            return
        turn = [ports[(number + more) % len(ports)] for more in range(len(ports))]
        threading.Thread(target=_pass_on, args=(client, turn), daemon=True).start()


def _pass_on(client, ports):
    with client:
        for port in ports:
            with suppress(ConnectionError):
                server = socket.create_connection((HOST, port), _PATIENCE)
                break
        else:
            return
        with server:
            client.settimeout(_PATIENCE)
            back = threading.Thread(target=_copy, args=(server, client), daemon=True)
            back.start()
            _copy(client, server)
            back.join(_PATIENCE)


def _copy(source, goal):
    with suppress(OSError):
        while data := source.recv(1 << 16):
            goal.sendall(data)
    with suppress(OSError):
        goal.shutdown(socket.SHUT_WR)
