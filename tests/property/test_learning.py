"""A proposal allows what was seen, and what nodes need to start; nothing else."""

import tempfile
from datetime import UTC, datetime
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st

from pqsec_pki.access import Action
from pqsec_pki.documents import permissions_from_yaml, ros
from pqsec_pki.errors import PqsecError
from pqsec_pki.learning import Endpoint, SeenParticipant, document_of, propose, read_recordings

NOW = datetime(2026, 6, 1, tzinfo=UTC)
NODES = ("/ns/node", "/ns/node/c")
NAMES = ("/a", "/ns/b", "/ns/node/c", "/a/_action/send_goal")
WORDS = (
    *(ros.topic_publisher, ros.topic_subscriber, ros.service_server, ros.service_client),
    *(ros.action_server, ros.action_client, ros.parameter_client, ros.lifecycle_client),
    ros.lifecycle_node,
)
POINTS = sorted(
    {
        Endpoint(0, action, topic)
        for word in WORDS
        for name in NAMES
        for action, topics in zip((Action.PUBLISH, Action.SUBSCRIBE), word(name), strict=True)
        for topic in topics
    }
    | {Endpoint(0, Action.PUBLISH, topic) for topic in ("plain", "rt/1", "rt//a", "rq/a")}
)
USES = st.tuples(st.sampled_from(WORDS), st.sampled_from(NAMES))


def points_of(uses):
    return {
        Endpoint(0, action, topic)
        for word, name in uses
        for action, topics in zip((Action.PUBLISH, Action.SUBSCRIBE), word(name), strict=True)
        for topic in topics
    }


@given(
    whole=st.sets(USES, max_size=4),
    single=st.sets(st.sampled_from(POINTS), max_size=6),
    nodes=st.sets(st.sampled_from(NODES)),
)
def test_a_proposal_allows_what_was_seen_and_the_minimum(whole, single, nodes):
    seen = points_of(whole) | single
    participant = SeenParticipant(name="/p", nodes=tuple(sorted(nodes)), endpoints=frozenset(seen))
    result = propose([participant], validity="1y", now=NOW)
    assert bool(result.proposals) is bool(seen)
    for proposal in result.proposals:
        [rule] = proposal.grant.rules
        allowed = {
            Endpoint(0, action, topic)
            for action in (Action.PUBLISH, Action.SUBSCRIBE)
            for criteria in getattr(rule, action.value)
            for topic in criteria.topics
        }
        assert allowed == seen | points_of((ros.node_minimum, node) for node in nodes)


RECORDED = Path(__file__).parents[1] / "vectors/learning"
LINES = {
    name: (RECORDED / name).read_bytes().split(b"\n")[-60:]
    for name in ("kitchen.log", "partitions.log", "nodes.txt")
}
CHANGES = st.lists(
    st.tuples(
        st.integers(0, 20_000),
        st.integers(0, 40),
        st.one_of(
            st.binary(max_size=6),
            st.sampled_from([b'"', b"}", b"QOS={", b"\n", b'partition={"', b"\x1b[2J", b"*", b"["]),
        ),
    ),
    max_size=6,
)


@given(name=st.sampled_from(sorted(LINES)), changes=CHANGES)
def test_altered_recordings_give_a_proposal_or_an_error(name, changes):
    """Whatever is proposed can be read again, and has no pattern in it."""
    data = b"\n".join(LINES[name])
    for at, length, new in changes:
        place = at % (len(data) + 1)
        data = data[:place] + new + data[place + length :]
    with tempfile.NamedTemporaryFile() as file:
        file.write(data)
        file.flush()
        try:
            found = read_recordings([Path(file.name)])
        except PqsecError:
            return
    assert all(each.reason.isprintable() for each in found.unread)
    proposals = propose(found.participants, validity="1y", now=NOW).proposals
    if proposals:
        text = document_of(proposals, [], {})
        grants = permissions_from_yaml(text.encode(), now=NOW).grants
        assert list(grants) == [each.grant for each in proposals]
        for grant in grants:
            for rule in grant.rules:
                for criteria in (*rule.publish, *rule.subscribe):
                    assert not set("*?[") & set("".join((*criteria.topics, *criteria.partitions)))
