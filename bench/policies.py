"""How long answers take: explain on policies of up to 10,000 rules, diff, and the matrix.

The floor of an answer is plain fnmatch of the standard library of the topic with each
pattern of the policy, which it cannot do without where the last rule decides. The diff is
compared with reading one of its two documents from XML.
Run: python bench/policies.py
"""

import fnmatch
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from subprocess import run
from tempfile import TemporaryDirectory

from pqsec_pki.access import INTERPRETATIONS, Action, InterpretedPolicy, Question, decide
from pqsec_pki.access.diff import permissions_diff
from pqsec_pki.access.matrix import DocumentOwner, topics_named, who_may
from pqsec_pki.algorithms import profile_named
from pqsec_pki.documents import (
    Criteria,
    DomainSet,
    Governance,
    Grant,
    PermissionRule,
    Permissions,
    ros,
)
from pqsec_pki.keystore import Keystore
from pqsec_pki.lifecycle import ParticipantSpec, issue

SIZES = (1_250, 2_500, 5_000, 10_000)
MEMBERS = (125, 250, 500, 1_000)
ZERO = DomainSet.of(0)
GOVERNANCE = Governance.protected(ZERO)
NOW = datetime(2026, 6, 1, tzinfo=UTC)
ASKED = "rt/robot/last"


def main() -> None:
    print(
        f"{'rules':>6} {'decide ms':>10} {'x fnmatch':>10} {'4 readings':>11} {'diff ms':>8}"
        f" {'x reading':>10}"
    )
    for size in SIZES:
        rules(size)
    print(f"\n{'members':>7} {'topics':>7} {'who may ms':>11} {'us a right':>11}")
    for count in MEMBERS:
        members(count)
    with TemporaryDirectory() as folder:
        command(Path(folder), SIZES[-1])
        keystores(Path(folder))
    print("targets: linear (twice the size, twice the time); decide on 10,000 rules <= 50 ms;")
    print("who-may of 1000 participants in less than 10 s")


def policy(size: int) -> Permissions:
    """Rules with two topics each, every fifth with a wildcard; the last has what is asked."""
    topics = [
        (f"rt/robot{n}/odom", f"rt/robot{n}/{'*' if n % 5 == 0 else 'map'}") for n in range(size)
    ]
    topics[-1] = ("rt/robot/*", "rt/other")
    made = tuple(
        PermissionRule(allow=True, domains=ZERO, publish=(Criteria(topics=each),))
        for each in topics
    )
    return Permissions(grants=(grant("/robot", made),))


def grant(name: str, rules: tuple[PermissionRule, ...]) -> Grant:
    return Grant(
        name=name,
        subject_name=f"CN={name}",
        not_before=datetime(2026, 1, 1, tzinfo=UTC),
        not_after=datetime(2027, 1, 1, tzinfo=UTC),
        rules=rules,
    )


def rules(size: int) -> None:
    document = policy(size)
    question = Question(subject="CN=/robot", domain=0, action=Action.PUBLISH, topic=ASKED, now=NOW)
    patterns = [
        topic
        for rule in document.grants[0].rules
        for criteria in rule.publish
        for topic in criteria.topics
    ]
    assert decide(GOVERNANCE, document, question).allowed
    floor = milliseconds(lambda: [fnmatch.fnmatchcase(ASKED, each) for each in patterns])
    one = milliseconds(lambda: decide(GOVERNANCE, document, question))
    every = milliseconds(
        lambda: [
            InterpretedPolicy(GOVERNANCE, document, each).decide(question)
            for each in INTERPRETATIONS
        ]
    )
    first, *others = document.grants[0].rules
    changed = Permissions(grants=(replace(document.grants[0], rules=(*others, first)),))
    compared = milliseconds(lambda: permissions_diff(document, changed), rounds=2)
    xml = document.to_xml()
    interpretation = milliseconds(lambda: Permissions.from_xml(xml), rounds=2)
    print(
        f"{size:6} {one:10.2f} {one / floor:10.2f} {every:11.2f} {compared:8.0f}"
        f" {compared / interpretation:10.2f}"
    )


def members(count: int) -> None:
    """Each a ROS 2 node that also publishes a topic and reads its neighbour's."""
    found = []
    for number in range(count):
        name = f"/robot{number}"
        needs = ros.node_minimum(name)
        criteria = (Criteria(topics=(*needs.publish, f"rt{name}/odom")),)
        reads = (Criteria(topics=(*needs.subscribe, f"rt/robot{(number + 1) % count}/*")),)
        own = PermissionRule(allow=True, domains=ZERO, publish=criteria, subscribe=reads)
        document = Permissions(grants=(grant(name, (own,)),))
        found.append(DocumentOwner(name=name, subject=f"CN={name}", permissions=document))
    topics = topics_named(found)
    rows = who_may(GOVERNANCE, found, topics, domain=0, now=NOW)
    rights = sum(len(row.publishers) + len(row.subscribers) for row in rows)
    taken = milliseconds(lambda: who_may(GOVERNANCE, found, topics, domain=0, now=NOW), rounds=1)
    print(f"{count:7} {len(topics):7} {taken:11.0f} {taken * 1000 / rights:11.1f}")


def command(folder: Path, size: int) -> None:
    """The whole command, with reading and checking the XML, against checking it alone."""
    governance, permissions = folder / "g.xml", folder / "p.xml"
    governance.write_bytes(GOVERNANCE.to_xml())
    permissions.write_bytes(replace_times(policy(size)).to_xml())
    files = ["--governance", governance, "--permissions", permissions]
    explain = seconds("explain", *files, "--publish", ASKED)
    validate = seconds("validate", permissions)
    print(
        f"\npqsec explain, {size} rules: {explain:.2f} s,"
        f" {explain / validate:.2f} x pqsec validate of the same file"
    )


def keystores(folder: Path) -> None:
    """Whole keystores: every certificate and document of every participant is verified."""
    now, year, limit = datetime.now(UTC), timedelta(days=365), MEMBERS[-1]
    for count in (limit // 4, limit):
        root = folder / str(count)
        keystore = Keystore.create(
            root,
            profile_named("classical"),
            name="Bench",
            domains=ZERO,
            validity=year,
            passphrase=None,
            now=now,
        )
        specs = [
            ParticipantSpec(
                name=f"/r{each}", domains=ZERO, publish=(f"rt/r{each}/odom",), validity=year
            )
            for each in range(count)
        ]
        issue(keystore, keystore.unlock(None), specs, now=now)
        taken = seconds("who-may", "--json", root)
        print(f"pqsec who-may, {count} participants: {taken:.1f} s")


def seconds(*line: str | Path) -> float:
    """What pqsec takes as a process: the best of two."""
    whole = [sys.executable, "-m", "pqsec_pki", *map(str, line)]
    taken = []
    for _ in range(2):
        begin = time.perf_counter()
        run(whole, check=True, capture_output=True)
        taken.append(time.perf_counter() - begin)
    return min(taken)


def replace_times(document: Permissions) -> Permissions:
    always = {
        "not_before": datetime(2000, 1, 1, tzinfo=UTC),
        "not_after": datetime(2200, 1, 1, tzinfo=UTC),
    }
    return Permissions(grants=tuple(replace(each, **always) for each in document.grants))


def milliseconds(work: Callable[[], object], rounds: int = 5) -> float:
    """Time of the processor, the best: others that want it too do not count."""
    taken = []
    for _ in range(rounds):
        begin = time.process_time()
        work()
        taken.append(time.process_time() - begin)
    return min(taken) * 1000


if __name__ == "__main__":
    main()
