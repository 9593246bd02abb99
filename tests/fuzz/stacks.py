"""The access control of real stacks, each in a process of its own: stacks.py STACK PLACE FOLDER.

A hostile document may crash a stack. Only a fork of that process dies then, and the next question
goes to a new one. Questions and answers are lists as in libcrypto.py. A question is a signed
governance, signed permissions, a domain and what is asked: an action, a topic and partitions, with
a zero between two of them.

An answer is what the stack said when it refused both documents, if it did, and two letters for
each question, of the own stack and of a peer: `y`, `n`, or `-` where the stack is not asked.
"""

import locale
import mmap
import os
import resource
import signal
import struct
import subprocess
import sys
import traceback
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from pqsec_pki.access import (
    CYCLONEDDS,
    CYCLONEDDS_11,
    FASTDDS,
    Action,
    Interpretation,
    Question,
)
from tests.fuzz import libcrypto
from tests.fuzz.documents import SUBJECT
from tests.interop import cyclone_access, fastdds_access, fastdds_shim
from tests.interop.cyclone import find_plugins, plugins_of

MOST_SECONDS = 60
"""After that long with one document a stack counts as hanging."""
_ENVIRONMENT = {
    "LC_ALL": "C",  # in which patterns are compared, and in UTC times
    "PYTHONCOERCECLOCALE": "0",
    "TZ": "UTC",
    "MALLOC_PERTURB_": "165",  # new and freed memory has no zeros: reading it is mostly seen
    "PQSEC_FASTDDS_DEAF": "1",  # fastdds_shim.cpp
}


@dataclass(frozen=True)
class Stack:
    """A stack that can be asked."""

    name: str
    """With its version."""
    reading: Interpretation
    kind: str
    """`cyclonedds` or `fastdds`."""
    place: str = ""
    """The folder of Cyclone DDS's plugins."""


def stacks():
    """Those that are on this machine, and the remedies for others."""
    found, missing = [], []
    if plugins := find_plugins():
        found.append(Stack("Cyclone DDS 0.10.2", CYCLONEDDS, "cyclonedds", str(plugins)))
    else:
        missing.append("Cyclone DDS 0.10: apt-get install libddsc0debian")
    if prefix := os.environ.get("PQSEC_CYCLONEDDS_11"):
        place = str(plugins_of(Path(prefix), "11.0"))
        found.append(Stack("Cyclone DDS 11.0", CYCLONEDDS_11, "cyclonedds", place))
    else:
        missing.append("Cyclone DDS 11.0: PQSEC_CYCLONEDDS_11 names the prefix of a build")
    if fastdds_shim.find_compiler():
        fastdds_shim.build(fastdds_shim.find_compiler())  # so that no process waits for it
        found.append(Stack("Fast DDS 2.9", FASTDDS, "fastdds"))
    else:
        missing.append("Fast DDS 2.9: apt-get install g++ libfastrtps-dev")
    return found, missing


class Peer:
    """A stack that answers."""

    def __init__(self, stack, process):
        self.stack, self._process = stack, process

    @property
    def version(self):
        return self.stack.name.encode()

    def ask(self, questions):
        """Its answer to each; where it died, `crash` and the name of the signal."""
        self._process.stdin.write(libcrypto.pack(questions))
        self._process.stdin.flush()
        return [libcrypto.unpack(self._process.stdout.read) for _ in questions]


@contextmanager
def peers(found, enclave):
    """The stacks, with the identity in `enclave`, until the block ends."""
    with ExitStack() as block:
        yield [block.enter_context(_peer(each, enclave)) for each in found]


@contextmanager
def _peer(stack, enclave):
    with TemporaryDirectory() as folder:
        for each in enclave.glob("*.pem"):
            Path(folder, each.name).write_bytes(each.read_bytes())
        with subprocess.Popen(
            [sys.executable, "-m", "tests.fuzz.stacks", stack.kind, stack.place, folder],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=os.environ | _ENVIRONMENT,
            cwd=Path(__file__).parents[2],
        ) as process:
            yield Peer(stack, process)
            process.stdin.close()


# The process


@contextmanager
def _asked(kind, place):
    """What opens the access control with the files of a folder, on a domain."""
    if kind == "cyclonedds":
        yield lambda *where: cyclone_access.access_control(Path(place), *where)
    else:
        library = fastdds_shim.build(fastdds_shim.find_compiler())
        yield lambda *where: fastdds_access.access_control(library, *where)


def _answer(open_, folder, question):
    governance, permissions, domain, *asked = libcrypto.unpacked(question)
    (folder / "governance.p7s").write_bytes(governance)
    (folder / "permissions.p7s").write_bytes(permissions)
    now = datetime.now(UTC)
    with open_(folder, int(domain)) as stack:
        letters = "".join(_letters(stack, question_of(each, int(domain), now)) for each in asked)
        return [stack.unfit.encode(), letters.encode()]


def _letters(stack, question):
    if question.action is Action.RELAY and not isinstance(stack, fastdds_access.AccessControl):
        return "--"  # Cyclone DDS has no function for it
    return "".join("n" if ask(question) else "y" for ask in (stack.own, stack.peer))


def question_of(asked, domain, now):
    """The question in these octets, of our subject."""
    action, *names = asked.decode().split("\0")
    topic, partitions = (names[0], tuple(names[1:])) if names else (None, ())
    return Question(
        subject=SUBJECT,
        domain=domain,
        action=Action(action),
        topic=topic,
        partitions=partitions,
        now=now,
    )


class Answers:
    """Answers lists of questions in forks, so that a stack which dies is only one answer."""

    def __init__(self, kind, place, folder):
        self._open = partial(_asked, kind, place)
        self._folder, self._write = folder, os.fdopen(os.dup(1), "wb")
        self._done = mmap.mmap(-1, 4)
        self._stderr = os.dup(2)

    def give(self, questions):
        left = questions
        while left:
            self._done[:] = struct.pack("=I", 0)
            process = os.fork()
            if process == 0:
                self._fork(left)
            status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
            [done] = struct.unpack("=I", self._done)
            left = left[done:]
            assert status <= 0, "the harness failed"
            if left:
                self._send([b"crash", signal.Signals(-status).name.encode()])
                left = left[1:]

    def _fork(self, questions):
        code = 1
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for each in (1, 2):  # what stacks print
            os.dup2(nowhere, each)
        try:
            with self._open() as open_:
                for number, each in enumerate(questions, 1):
                    signal.alarm(MOST_SECONDS)  # which ends the process
                    self._send(_answer(open_, self._folder, each))
                    self._done[:] = struct.pack("=I", number)
            code = 0
        except BaseException:  # noqa: BLE001 -- the fork ends here
            os.write(self._stderr, traceback.format_exc().encode())
        finally:
            os._exit(code)

    def _send(self, answer):
        self._write.write(libcrypto.pack(answer))
        self._write.flush()


def main():
    kind, place, folder = sys.argv[1:]
    locale.setlocale(locale.LC_ALL, "C")
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    answers = Answers(kind, place, Path(folder))
    if kind == "fastdds":
        fastdds_shim.build(fastdds_shim.find_compiler())  # once for all forks
    while True:
        try:
            questions = libcrypto.unpack(sys.stdin.buffer.read)
        except EOFError:
            return
        answers.give(questions)


if __name__ == "__main__":
    main()
