"""What Fast DDS makes of the profiles that `pqsec check` reports: two participants with the same
one, and a third without credentials."""

import os
import re
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from pqsec_pki.lint import check
from pqsec_pki.trial import (
    Act,
    TrialSetup,
    built,
    credentialed,
    run_peers,
    unauthenticated,
    unique_text,
)
from tests.interop.conftest import TOPIC
from tests.interop.test_trials import AT_ONCE
from tests.interop.trials import RECEIVER, SENDER, Case, Laboratory
from tests.longer import LONG

pytestmark = pytest.mark.interop

LONGEST, REFUSAL = 60.0, 4.0
UNSECURED, IN_THE_CLEAR, SECURED = "all read it", "the two read it, unencrypted", "the two read it"
NOTHING, NO_PARTICIPANT = "nobody reads it", "no participant"
HIDDEN = "<property><name>dds.sec.auth.builtin.PKI-DH.{}</name><value>{}</value></property>"


def value(name: str, new: str) -> Callable[[str], str]:
    pattern = rf"(<name>dds\.sec\.{name}</name>\s*<value>)[^<]*"
    return lambda text: re.sub(pattern, rf"\g<1>{new}", text)


def name(old: str, new: str) -> Callable[[str], str]:
    return lambda text: text.replace(f"{old}</name>", f"{new}</name>")


def added(which: str, what: str) -> Callable[[str], str]:
    return lambda text: text.replace("</properties>", f"{HIDDEN.format(which, what)}</properties>")


VARIANTS = {
    "as exported": (lambda text: text, set(), SECURED),
    "auth unknown": (value("auth.plugin", "pqsec"), {"PQS801"}, UNSECURED),
    "auth spaced": (value("auth.plugin", " builtin.PKI-DH "), {"PQS801"}, UNSECURED),
    "auth misspelt": (name("sec.auth.plugin", "sec.auth.Plugin"), {"PQS802", "PQS804"}, UNSECURED),
    "access unknown": (value("access.plugin", "pqsec"), {"PQS801"}, IN_THE_CLEAR),
    "access misspelt": (
        name("sec.access.plugin", "sec.access"), {"PQS802", "PQS804"}, IN_THE_CLEAR
    ),
    "crypto unknown": (value("crypto.plugin", "pqsec"), {"PQS801"}, NOTHING),
    "governance misspelt": (
        name(".governance", ".Governance"), {"PQS803", "PQS804"}, NO_PARTICIPANT
    ),
    "list misspelt": (added("crl", "file:///nowhere.pem"), {"PQS804"}, SECURED),
    "blank": (added("password", " "), {"PQS805"}, UNSECURED),
}  # fmt: skip
"""How the profile is changed, the rules that say so, and what comes of it."""
PLACES = ["bookworm", "trixie"] if LONG else ["bookworm"]
CASES = [(where, variant) for where in PLACES for variant in VARIANTS]


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory, now) -> Laboratory:
    return Laboratory.create(tmp_path_factory.mktemp("profiles"), now)


@pytest.fixture(scope="module")
def outcome(
    stack_in, laboratory, now, selected
) -> Iterator[Callable[[str, str], tuple[set[str], str]]]:
    """outcome("bookworm", variant) is what is found in that profile, and what came of it."""

    def run(where, variant):
        change, _, expected = VARIANTS[variant]
        installation = stack_in("fastdds", where)
        seconds = REFUSAL if expected == NOTHING else LONGEST
        trial = laboratory.trial(installation, Case("", profile="classical"), timeout=seconds)
        folder = trial.keystore.root.parent
        two = [
            credentialed(trial, SENDER, Act.SEND, folder, unique_text()),
            credentialed(trial, RECEIVER, Act.RECEIVE, folder),
        ]
        paths = [Path(each.environment[installation.build.variable]) for each in two]
        for path in paths:
            path.write_text(change(path.read_text()))
        found = {each.rule.id for each in check(paths, now=now).findings}
        setup = TrialSetup(
            program=installation.peer(built(installation)), domain=0, topic=TOPIC, timeout=seconds
        )
        went = run_peers(setup, [*two, unauthenticated(installation, Act.RECEIVE, folder)])
        return found, said_of(went)

    for where in PLACES:
        built(stack_in("fastdds", where))
    with ThreadPoolExecutor(AT_ONCE) as pool:
        began = {each: pool.submit(run, *each) for each in CASES if each[1] in selected("variant")}
        yield lambda *case: began[case].result()


def said_of(went) -> str:
    sender, receiver, stranger = went.outcomes
    if sender.refused and receiver.refused:
        return NO_PARTICIPANT
    if receiver.received != sender.role.text:
        return NOTHING
    if stranger.received:
        return UNSECURED
    return IN_THE_CLEAR if went.wire.readable else SECURED


@pytest.mark.slow(but=1)
@pytest.mark.skipif(os.geteuid() != 0, reason="only root sees the wire")
@pytest.mark.parametrize(("where", "variant"), CASES)
def test_a_profile_that_is_not_secured_is_reported(outcome, where, variant):
    _, rules, expected = VARIANTS[variant]
    assert outcome(where, variant) == (rules, expected)
