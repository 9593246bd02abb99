"""The security plugins of a Fast DDS, called from Python.

Plugins in C++ cannot be: fastdds_shim.cpp is compiled to stand between, in this process or, for a
Fast DDS that this process cannot load, in another.
"""

import ctypes
import os
import re
import shutil
import struct
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from ctypes import POINTER, byref, c_char_p, c_int32, c_size_t, c_void_p
from pathlib import Path
from typing import IO, NamedTuple, Protocol

from pqsec_pki.handshake import ByteOrder, DataHolder
from pqsec_pki.trial import Installation, find
from pqsec_pki.vendors.fastdds_adapter import FASTDDS_SOURCES
from tests.interop.cyclone import Token
from tests.interop.kept import contents, kept

__all__ = ["Answer", "FastDdsShim", "build", "find_compiler", "process", "program"]

_SHIM, _PROCESS = (Path(__file__).with_name(f"fastdds_{name}.cpp") for name in ("shim", "process"))
_HEADER = Path("/usr/include/fastdds/rtps/security/authentication/Authentication.h")
_SOURCE_LINE = re.compile(r" \(\S+\.cpp:\d+\)")
"""Where in its source Fast DDS says something: not what a test should depend on."""
_NO_PLUGINS = "this Fast DDS has no security plugins"


class Answer(NamedTuple):
    """Of the shim, to a call."""

    code: int
    handle: int
    words: str
    octets: bytes

    @property
    def token(self) -> Token:
        holder = DataHolder.decode(self.octets, ByteOrder.LITTLE)
        return Token(holder.class_id, holder.properties, holder.binary_properties)


class FastDdsShim(Protocol):
    """The shim before a Fast DDS; a participant is a number."""

    def new(self, properties: Mapping[str, str]) -> int: ...

    def delete(self, participant: int) -> None: ...

    def call(
        self, participant: int, function: str, number: int, first: bytes, second: bytes
    ) -> Answer: ...


class _Answer(ctypes.Structure):
    _fields_ = (
        ("code", c_int32),
        ("handle", c_size_t),
        ("words", c_void_p),
        ("words_size", c_size_t),
        ("data", c_void_p),
        ("size", c_size_t),
    )


class _Library(FastDdsShim):
    """The shim in this process."""

    def __init__(self, path: Path) -> None:
        self._shim = shim = ctypes.CDLL(str(path))
        shim.fastdds_new.argtypes = [POINTER(c_char_p), c_size_t]
        shim.fastdds_new.restype = c_void_p
        shim.fastdds_delete.argtypes = [c_void_p]
        octets = (c_char_p, c_size_t)
        values = (c_char_p, c_size_t, *octets, *octets)
        shim.fastdds_call.argtypes = [c_void_p, POINTER(_Answer), *values]

    def new(self, properties: Mapping[str, str]) -> int:
        strings = [text.encode() for pair in properties.items() for text in pair]
        made = self._shim.fastdds_new((c_char_p * len(strings))(*strings), len(strings))
        assert made, _NO_PLUGINS
        return made

    def delete(self, participant: int) -> None:
        self._shim.fastdds_delete(participant)

    def call(
        self, participant: int, function: str, number: int, first: bytes, second: bytes
    ) -> Answer:
        answer = _Answer()
        inputs = first, len(first), second, len(second)
        self._shim.fastdds_call(participant, byref(answer), function.encode(), number, *inputs)
        words = ctypes.string_at(answer.words, answer.words_size)
        octets = ctypes.string_at(answer.data, answer.size)
        return Answer(answer.code, answer.handle, _plain(words), octets)


class _Process(FastDdsShim):
    """The shim in a process, which has these pipes."""

    def __init__(self, questions: IO[bytes], answers: IO[bytes]) -> None:
        self._questions, self._answers = questions, answers

    def new(self, properties: Mapping[str, str]) -> int:
        made = self._ask("new", *(text for pair in properties.items() for text in pair))
        assert made, _NO_PLUGINS
        return int(made[0])

    def delete(self, participant: int) -> None:
        self._ask("delete", participant)

    def call(
        self, participant: int, function: str, number: int, first: bytes, second: bytes
    ) -> Answer:
        answer = self._ask("call", participant, function, number, first, second)
        code, handle, words, octets = answer
        return Answer(int(code), int(handle), _plain(words), octets)

    def _ask(self, *question: str | int | bytes) -> list[bytes]:
        strings = [each if isinstance(each, bytes) else str(each).encode() for each in question]
        parts = [struct.pack("=I", len(each)) + each for each in strings]
        self._questions.write(struct.pack("=I", len(parts)) + b"".join(parts))
        self._questions.flush()
        return [self._answers.read(self._number()) for _ in range(self._number())]

    def _number(self) -> int:
        data = self._answers.read(4)
        assert data, "the process of Fast DDS has ended"
        return struct.unpack("=I", data)[0]


def _plain(words: bytes) -> str:
    return _SOURCE_LINE.sub("", words.decode(errors="replace"))


def find_compiler() -> str | None:
    """The compiler, if the headers of Fast DDS are there too."""
    return shutil.which("g++") if _HEADER.exists() else None


def build(compiler: str) -> FastDdsShim:
    """The shim before the Fast DDS of this machine, compiled and loaded."""
    name = "libfastdds_shim.so"
    options = ("-std=c++17", "-DPQSEC_FASTDDS=2", f"-I{FASTDDS_SOURCES}", "-shared", "-fPIC")
    command = [compiler, *options, "-o", name, str(_SHIM), "-lfastrtps"]

    def make(folder: Path) -> None:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr

    sources = contents(_SHIM, *FASTDDS_SOURCES.glob("*.hpp"))
    return _Library(kept("shim", (command, find("fastdds").library.build, sources), make) / name)


def program(installation: Installation) -> tuple[dict[str, bytes], tuple[str, ...]]:
    """The sources of the process before that Fast DDS, and options to compile them with.

    It has the build ID of Fast DDS: our preload library takes it for the caller.
    """
    headers = [FASTDDS_SOURCES / name for name in ("stack.hpp", "interface3.hpp")]
    sources = {each.name: each.read_bytes() for each in (_PROCESS, *headers)}
    generation = installation.version.partition(".")[0]
    options = ("-std=c++17", "-I.", f"-DPQSEC_FASTDDS={generation}", _PROCESS.name)
    identity = f"-Wl,--build-id=0x{installation.library.build_id}"
    return sources | {"fastdds.cpp": _SHIM.read_bytes()}, (*options, identity)


@contextmanager
def process(command: Sequence[str], environment: Mapping[str, str]) -> Iterator[FastDdsShim]:
    """The shim in a process, until the block ends."""
    with subprocess.Popen(
        command,
        env=os.environ | dict(environment),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    ) as running:
        assert running.stdin
        assert running.stdout
        yield _Process(running.stdin, running.stdout)
