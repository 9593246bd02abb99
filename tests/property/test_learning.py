"""A proposal allows what was seen, and what nodes need to start; nothing else."""

from datetime import UTC, datetime

from hypothesis import given
from hypothesis import strategies as st

from pqsec_pki.access import Action
from pqsec_pki.documents import ros
from pqsec_pki.learning import Endpoint, SeenParticipant, propose

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
