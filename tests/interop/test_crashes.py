"""The documents that `documents.crashes` names end the process of the stacks that it names.

The real plugins read each document in a process of its own, and are asked about some endpoints,
as a participant's own stack and as its peers.
"""

import faulthandler
import os
import shutil
import signal
from datetime import UTC, datetime
from itertools import product

import pytest

from pqsec_pki.access import CYCLONEDDS, CYCLONEDDS_11, FASTDDS, Action, Question, decide
from pqsec_pki.documents import Governance, Permissions
from tests.crashing import CRASHING, GOVERNANCE, PERMISSIONS, spoiled
from tests.interop import cyclone_access, fastdds_access

pytestmark = pytest.mark.interop

STACKS = {
    CYCLONEDDS: ("plugins", cyclone_access),
    CYCLONEDDS_11: ("plugins_11", cyclone_access),
    FASTDDS: ("fastdds", fastdds_access),
}
SECONDS = 120
"""After which a process that hangs ends by a signal too, which is not SIGSEGV."""
HARMLESS = {
    "nothing": (GOVERNANCE, PERMISSIONS),
    "a range without max": (GOVERNANCE, PERMISSIONS.replace(b"<max>9</max>", b"")),
    "governance of a range without min": (GOVERNANCE.replace(b"<min>0</min>", b""), PERMISSIONS),
    "an empty topic to relay": (GOVERNANCE, spoiled(PERMISSIONS, b">rt/r<", b"><")),
    "an empty partition": (
        GOVERNANCE,
        spoiled(
            PERMISSIONS,
            b"<topic>rt/s</topic></topics>",
            b"</topics>",
            b"</topics><partitions><partition/></partitions>",
        ),
    ),
    "an empty subject": (GOVERNANCE, spoiled(PERMISSIONS, b">CN=/lab/alice<", b"><")),
    "an empty name": (GOVERNANCE, spoiled(PERMISSIONS, b'"/lab/alice"', b'""')),
    "formats of printf": (GOVERNANCE, spoiled(PERMISSIONS, b">CN=/lab/alice<", b">%s%n%s=%n<")),
    "a rule without topics": (
        GOVERNANCE,
        PERMISSIONS.replace(b"<subscribe><topics><topic>rt/s</topic></topics></subscribe>", b""),
    ),
    "a domain above all": (GOVERNANCE, spoiled(PERMISSIONS, b"<max>9<", b"<max>2147483647<")),
    "a bracket that does not end": (GOVERNANCE, spoiled(PERMISSIONS, b">rt/p<", b">rt/[a-<")),
}


@pytest.fixture(params=STACKS, ids=lambda row: row.name)
def stack(request, labs, tmp_path):
    """ask(governance, permissions) is the signal that ended the stack's process, or 0."""
    installed, module = STACKS[request.param]
    library, lab = request.getfixturevalue(installed), labs("classical")
    folder = shutil.copytree(lab.alice, tmp_path / "alice")

    def ask(governance, permissions):
        (folder / "governance.p7s").write_bytes(lab.sign(governance))
        (folder / "permissions.p7s").write_bytes(lab.sign(permissions))
        child = os.fork()
        if not child:
            faulthandler.disable()  # the crash is wanted
            signal.alarm(SECONDS)
            try:
                ask_about_all(module, library, folder)
            finally:
                os._exit(0)
        return os.WTERMSIG(os.waitpid(child, 0)[1])

    ask.row = request.param
    return ask


def ask_about_all(module, library, folder):
    """Join, and publish and subscribe to a topic that the permissions have, and another."""
    now = datetime.now(UTC)
    for domain in (0, 5):
        with module.access_control(library, folder, domain) as stack:
            actions = (Action.PUBLISH, Action.SUBSCRIBE)
            for topic, action in product(("rt/chatter", "rt/other"), actions):
                question = Question(
                    subject="CN=/lab/alice", domain=domain, action=action, topic=topic, now=now
                )
                stack.own(question)
                stack.peer(question)


@pytest.mark.parametrize("case", CRASHING)
def test_what_is_said_to_crash_a_stack_ends_its_process(stack, case):
    found = CRASHING[case]
    documents = {Governance: GOVERNANCE, Permissions: PERMISSIONS} | {found.kind: found.xml}
    ended_by = stack(documents[Governance], documents[Permissions])
    assert (ended_by == signal.SIGSEGV) is (stack.row.name in found.stacks.split())
    assert ended_by in {0, signal.SIGSEGV}


@pytest.mark.parametrize("case", HARMLESS)
def test_what_is_not_said_to_crash_a_stack_does_not(stack, case):
    governance, permissions = HARMLESS[case]
    assert stack(governance, permissions) == 0
    question = Question(
        subject="CN=/lab/alice", domain=0, action=Action.JOIN, now=datetime.now(UTC)
    )
    decision = decide(
        Governance.from_xml(governance), Permissions.from_xml(permissions), question, stack.row
    )
    assert decision.verdict.is_known
