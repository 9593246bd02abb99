"""Whatever the file says and whatever was done before: apply, and nothing is left to do."""

import json
import tempfile
from contextlib import suppress
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pqsec_pki.domain import StepAction, apply_plan, create_keystore, plan, read_domain
from pqsec_pki.errors import PqsecError
from pqsec_pki.keystore import Keystore, audit
from tests.longer import examples
from tests.unit.domains import DAY, NOW

NAMES = [f"/r{number}" for number in range(4)]
ROLES = st.sampled_from(
    [{"publish": "rt/a"}, {"publish": "rt$name"}, {"subscribe": ["x", "y"], "domains": 2}]
)
FILES = st.fixed_dictionaries(
    {
        "name": st.just("Lab"),
        "profile": st.just("classical"),
        "governance": st.sampled_from(["strict", "migration", {"domains": "0-3", "topics": "*"}]),
        "validity": st.sampled_from(["30d", "90d"]),
        "renew_before": st.sampled_from(["7d", "20d"]),
        "roles": st.fixed_dictionaries({"r": ROLES, "s": ROLES}),
        "participants": st.lists(
            st.fixed_dictionaries(
                {"name": st.sampled_from(NAMES), "role": st.sampled_from(["r", "s"])}
            ),
            unique_by=lambda each: each["name"],
            max_size=len(NAMES),
        ),
    }
)
MEDDLING = st.sampled_from(["cert.pem", "permissions.p7s", ""])
ROUND = st.tuples(
    FILES,
    st.integers(0, 8),  # batches that are done before it is interrupted
    st.permutations(list(StepAction)),  # and in which order of actions
    st.sampled_from([timedelta(0), 15 * DAY, 40 * DAY]),  # what passes until the next round
    st.sampled_from(NAMES),
    MEDDLING,
)


def opened(desired, root, now):
    if not root.exists():
        create_keystore(desired, root, passphrase=None, now=now)
    return Keystore.open(root)


def interrupted(desired, keystore, now, count, order):
    """Only some batches, in another order than the plan's where that can be."""
    found = plan(desired, keystore, now=now)
    # A renewal carries on what was permitted, so it never comes first.
    place = {action: n for n, action in enumerate([*order, StepAction.RENEW])}
    steps = tuple(sorted(found.steps, key=lambda step: place[step.action]))
    batches = apply_plan(
        desired, keystore, keystore.unlock(None), replace(found, steps=steps), now=now
    )
    for _, _ in zip(range(count), batches, strict=False):
        pass


def meddle(root, name, file):
    path = root / f"enclaves{name}" / file
    if file and path.exists():
        path.write_bytes(path.read_bytes()[:-40])


@settings(max_examples=12, suppress_health_check=[HealthCheck.too_slow])
@given(st.lists(ROUND, min_size=1, max_size=4))
def test_apply_converges_from_anywhere(rounds):
    with tempfile.TemporaryDirectory() as folder:
        root, file, now = Path(folder, "k"), Path(folder, "domain.yaml"), NOW
        for content, count, order, passed, name, meddled in rounds:
            file.write_text(json.dumps(content))
            desired = read_domain(file)
            keystore = opened(desired, root, now)
            interrupted(desired, keystore, now, count, order)
            meddle(root, name, meddled)
            now += passed

            found = plan(desired, keystore, now=now)
            batches = apply_plan(desired, keystore, keystore.unlock(None), found, now=now)
            assert [step for batch in batches for step in batch] == list(found.steps)
            left = plan(desired, keystore, now=now)
            assert left.in_order, left
            assert left.unchanged == len(desired.members)
            assert set(desired.members) <= set(keystore.names())
        if set(keystore.names()) == set(desired.members):  # else meddled files may lie there
            audit(keystore)


SEED = """
name: Lab
domains: 0-3
governance: {preset: strict, topics: [a, {ros_topic: /b}]}
roles:
  r: {publish: [rt$name/$x], nodes: [{node: $name, clients: ~/y}], domains: 2, validity: 9d}
participants:
- {name: ["/a{1..3}", "/{b,c}"], role: r, values: {x: y}}
- csv: list.csv
- {list: list.csv, rules: [{allow: {publish: z}}]}
"""
ROWS = "name,role,x,domains\n/d,r,1,\n/e,r,2,0-3\n"
SNIPPETS = st.sampled_from(
    [
        *(
            "{",
            "}",
            "$",
            "$$",
            "${x}",
            "[",
            "]",
            ",",
            '"',
            "'",
            "{1..9}",
            "{9..1}",
            "0",
            "&a",
            "*a",
        ),
        *("name", "x", ": ", "- ", "#", "..", "/", "\n", "\t", "  ", "\0", "\u00e9", "\ud800"),
    ]
)
EDITS = st.lists(st.tuples(st.floats(0, 1), st.integers(0, 4), SNIPPETS), max_size=6)


def edited(text, edits):
    for place, cut, snippet in edits:
        at = int(place * len(text))
        text = text[:at] + snippet + text[at + cut :]
    return text.encode(errors="surrogatepass")


@settings(max_examples=examples(300), suppress_health_check=[HealthCheck.too_slow])
@given(EDITS, EDITS)
def test_whatever_stands_in_the_files_nothing_but_our_errors_comes_out(edits, list_edits):
    with tempfile.TemporaryDirectory() as folder:
        file, rows = Path(folder, "domain.yaml"), Path(folder, "list.csv")
        file.write_bytes(edited(SEED, edits))
        rows.write_bytes(edited(ROWS, list_edits))
        members, told = read_or_refused(file)
        assert all(line.startswith(folder) for line in told), told
        for member in members:
            with suppress(PqsecError):
                member.spec()


def read_or_refused(file):
    """(the participants, what is wrong)."""
    try:
        return list(read_domain(file).members.values()), ()
    except PqsecError as error:
        return [], error.lines
