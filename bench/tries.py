"""ML-DSA signs in a random number of tries; its time is noted apart, to be averaged."""

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from cryptography.hazmat.primitives.asymmetric import mldsa

from pqsec_pki.algorithms import PrivateKey

_RANDOM = mldsa.MLDSA44PrivateKey | mldsa.MLDSA65PrivateKey | mldsa.MLDSA87PrivateKey


class Spent(NamedTuple):
    """CPU seconds."""

    tries: float
    """In signatures by ML-DSA."""
    rest: float


class _Noted:
    """A private key whose time is noted."""

    seconds = 0.0
    """Of all of them."""

    def __init__(self, handle: Any) -> None:
        self._handle = handle

    def sign(self, *arguments: Any) -> bytes:
        start = time.thread_time()
        signature: bytes = self._handle.sign(*arguments)
        _Noted.seconds += time.thread_time() - start
        return signature


def noted(handle: Any) -> Any:
    """A private key's handle, or a tuple of such or of keys, that signs as before."""
    if isinstance(handle, tuple):
        return tuple(map(noted, handle))
    if isinstance(handle, PrivateKey):
        return replace(handle, handle=noted(handle.handle))
    return _Noted(handle) if isinstance(handle, _RANDOM) else handle


def spent(action: Callable[[], None]) -> Callable[[], Spent]:
    """`action`, giving the time that it took."""

    def run() -> Spent:
        _Noted.seconds, start = 0.0, time.thread_time()
        action()
        whole = time.thread_time() - start
        return Spent(_Noted.seconds, whole - _Noted.seconds)

    return run
