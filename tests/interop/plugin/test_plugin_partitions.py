"""Partitions with wildcards on either side, in running Cyclone DDS: whose samples get where."""

import os
import re
import subprocess
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from itertools import product
from pathlib import Path

import pytest

import pqsec_pki.trial
from pqsec_pki.access import CYCLONEDDS, SPEC, Action, Question, Viewpoint, decide
from pqsec_pki.documents import Criteria, Governance, Grant, PermissionRule, Permissions
from pqsec_pki.trial import MissingStackError, find
from tests.interop.conftest import DOMAINS, TOPIC, YEAR, Lab
from tests.interop.plugin.processes import DOMAIN, PATIENCE, Stage
from tests.interop.plugin.test_plugin_robust import HERE, compiled

pytestmark = pytest.mark.interop

SOURCES = Path(pqsec_pki.trial.__file__).parent / "peers"
PARTITIONS = (
    *("floor1", "floor12", "floor?", "floor*", "flo*", "secret", "secre?", "s*", "sales", "sal*"),
    *("open", "o*", "*", "[os]ales", "o[pq]en"),
)
SOME = (
    (True, ("open",)),
    (False, ("secret",)),
    (True, ("floor?", "s*")),
)
"""An allow_rule comes first, so that Cyclone DDS does not deny the topic itself."""
EVERYTHING = ((True, ("*",)),)
GRACE = 2.0
"""Seconds in which what should not arrive may still do so."""


@pytest.fixture(scope="session")
def program(requires, tmp_path_factory):
    """A participant with endpoints in many partitions."""
    try:
        find("cyclonedds")
    except MissingStackError as error:
        requires(None, "Cyclone DDS to compile against", error.hint or str(error))
    folder = tmp_path_factory.mktemp("partitions")
    subprocess.run(["idlc", SOURCES / "Sample.idl"], cwd=folder, check=True)
    sources = HERE / "partitions.c", folder / "Sample.c", f"-I{folder}"
    return compiled(folder / "partitions", *sources, "-lddsc")


@pytest.fixture
def stage(shim, plugins, tmp_path):
    (tmp_path / "xml").mkdir()
    return Stage(None, shim, plugins, tmp_path / "xml")


@dataclass(frozen=True)
class Enclaves:
    """Alice's and Bob's, with permissions to be made up."""

    lab: Lab
    copy: Callable[..., Path]

    @property
    def now(self):
        return self.lab.now

    def enclave(self, name, permissions):
        """The folder of one of them with these permissions."""
        signed = self.lab.sign(permissions.to_xml())
        return self.copy(getattr(self.lab, name), {"permissions.p7s": signed})


@pytest.fixture
def lab(labs, enclave):
    return Enclaves(labs("classical"), enclave)


def granted(lab, name, rules):
    """Permissions with a rule for each, to publish and subscribe in these partitions."""
    criteria = {
        partitions: (Criteria(topics=(TOPIC,), partitions=partitions),) for _, partitions in rules
    }
    least = Grant.least(
        subject_name=f"CN=/lab/{name}",
        not_before=lab.now - YEAR,
        not_after=lab.now + YEAR,
        domains=DOMAINS,
    )
    made = (
        PermissionRule(
            allow=allow,
            domains=DOMAINS,
            publish=criteria[partitions],
            subscribe=criteria[partitions],
        )
        for allow, partitions in rules
    )
    return Permissions(grants=(replace(least, rules=tuple(made)),))


def meet(writer, reader):
    """As Cyclone DDS matches partitions: `*` and `?` on one side, and no brackets."""
    one, other = ("*" in each or "?" in each for each in (writer, reader))
    if one and other:
        return False
    pattern, name = (writer, reader) if one else (reader, writer)
    return fnmatchcase(name, re.sub(r"([\[\]])", r"[\1]", pattern))


def allowed(permissions, action, now, interpretation, **more):
    """The partitions in which they let an endpoint be."""
    governance = Governance.protected(DOMAINS)
    [grant] = permissions.grants
    asked = {"subject": grant.subject_name, "domain": DOMAIN, "now": now, "action": action}
    return {
        each
        for each in PARTITIONS
        if decide(
            governance,
            permissions,
            Question(topic=TOPIC, partitions=(each,), **asked),
            interpretation,
            **more,
        ).allowed
    }


def lines(path, word):
    found = (line.split(" ") for line in path.read_text().splitlines())
    return {tuple(rest) for first, *rest in found if first == word}


def run(program, folder, sender, receiver, wanted):
    """The pairs that got a sample, and whose endpoints were denied; ends once all wanted did."""
    logs = {act: folder / act for act in ("send", "receive")}
    with ExitStack() as stack:
        for act, environment in (("receive", receiver), ("send", sender)):
            process = subprocess.Popen(
                [program, act, str(DOMAIN), TOPIC, "90", *PARTITIONS],
                env=os.environ | environment,
                stdout=stack.enter_context(logs[act].open("wb")),
                stderr=subprocess.DEVNULL,
            )
            stack.callback(process.wait)
            stack.callback(process.kill)
        until = time.monotonic() + 2 * PATIENCE
        while not wanted <= lines(logs["receive"], "got") and time.monotonic() < until:
            time.sleep(0.1)
        time.sleep(GRACE)
    return lines(logs["receive"], "got"), {act: lines(logs[act], "denied") for act in logs}


OURS, CYCLONES = "ours ours", "ours cyclones"
INTERPRETATIONS = {OURS: SPEC, CYCLONES: CYCLONEDDS}
NAMES = {"alice": Action.PUBLISH, "bob": Action.SUBSCRIBE}


@pytest.mark.slow(but=1)
@pytest.mark.parametrize("plugins_of_both", [(OURS, OURS), (CYCLONES, OURS), (CYCLONES, CYCLONES)])
@pytest.mark.parametrize("restricted", NAMES)
def test_a_sample_passes_where_own_stack_and_peer_allow_it(
    stage, program, lab, restricted, plugins_of_both
):
    """Cyclone DDS's own access control goes by the name of a partition, ours by what it stands
    for. The first of `plugins_of_both` are those of the participant with few rights."""
    plugins = dict(zip(sorted(NAMES, key=restricted.__ne__), plugins_of_both, strict=True))
    made, heard, environments = {}, {}, {}
    for name, action in NAMES.items():
        (other,) = NAMES.keys() - {name}
        permissions = granted(lab, name, SOME if name == restricted else EVERYTHING)
        environments[name] = stage.environment(
            lab.enclave(name, permissions), plugins=plugins[name]
        )
        asked = permissions, action, lab.now
        made[name] = allowed(*asked, INTERPRETATIONS[plugins[name]], by=Viewpoint.OWN)
        heard[name] = made[name] & allowed(
            *asked, INTERPRETATIONS[plugins[other]], by=Viewpoint.PEER
        )
    wanted = {
        (reader, writer)
        for writer, reader in product(heard["alice"], heard["bob"])
        if meet(writer, reader)
    }
    got, denied = run(program, stage.folder, environments["alice"], environments["bob"], wanted)
    assert got == wanted != set()
    assert denied == {
        act: {(each,) for each in set(PARTITIONS) - made[name]}
        for act, name in (("send", "alice"), ("receive", "bob"))
    }
    through = [pair for pair in got if {"floor12", "secret"} & set(pair)]
    assert bool(through) is (OURS not in plugins_of_both), through
