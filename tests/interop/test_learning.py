"""Permissions learned from real nodes without security are enough for them to run secured."""

import pytest

from pqsec_pki.learning import compare, document_of, propose, read_recordings
from pqsec_pki.trial import unique_text
from tests.interop.conftest import LAB_PROFILES
from tests.interop.crew import Crew
from tests.interop.nodes import LOOPBACK, Does, ended

pytestmark = pytest.mark.interop

TRACING = "<Tracing><Category>discovery</Category><OutputFile>{path}</OutputFile></Tracing>"


@pytest.fixture
def traced(tmp_path):
    """traced("name") is a configuration that traces, and the file of the trace."""

    def made(name):
        path, config = tmp_path / f"{name}.log", tmp_path / f"{name}.xml"
        tracing = TRACING.format(path=path)
        config.write_text(LOOPBACK.replace("</Domain>", f"{tracing}</Domain>"))
        return config.as_uri(), path

    return made


def learned(path):
    found = read_recordings([path])
    assert not found.unread
    return found.participants


def test_what_is_learned_is_enough_to_run_secured(nodes, traced, tmp_path, now):
    """One of the processes traces, and sees the other."""
    uri, path = traced("server")
    went = nodes.run_peers(
        nodes.role(Does.ACT, "/guest"),
        nodes.role(Does.SERVE, "/cook", CYCLONEDDS_URI=uri),
        topic="/cook",
    )
    assert went.outcomes[0].received == "[1, 1, 2]", went.outcomes
    seen = learned(path)
    assert [each.name for each in seen] == ["/cook", "/guest"]
    proposals = propose(seen, validity="90d", now=now).proposals
    policy = document_of(proposals, ["learned"], {}).encode()
    assert b"action_servers" in policy

    crew = Crew.create(tmp_path / "crew", LAB_PROFILES["transition"], now, policy)
    went = nodes.run_peers(
        nodes.role(Does.ACT, "/guest", script=crew.script("/guest")),
        nodes.role(Does.SERVE, "/cook", script=crew.script("/cook")),
        topic="/cook",
    )
    assert went.outcomes[0].received == "[1, 1, 2]", went.outcomes
    # And not for more: the client may not serve.
    outcome = nodes.one(nodes.role(Does.SEND, "/guest", script=crew.script("/guest"), text="x"))
    assert not ended(outcome)
    assert "rt/chatter" in outcome.log


@pytest.mark.slow
def test_a_trace_of_a_secured_domain_confirms_what_is_granted(nodes, traced, tmp_path, now):
    """An authenticated participant sees the topics of the others."""
    crew = Crew.create(tmp_path / "crew", LAB_PROFILES["transition"], now)
    uri, path = traced("listener")
    text = unique_text()
    went = nodes.run_peers(
        nodes.role(Does.SEND, "/talker", script=crew.script("/talker"), text=text),
        nodes.role(Does.RECEIVE, "/listener", script=crew.script("/listener"), CYCLONEDDS_URI=uri),
    )
    assert went.outcomes[1].received == text, went.outcomes
    proposals = propose(learned(path), validity="90d", now=now).proposals
    assert [each.name for each in proposals] == ["/listener", "/talker"]
    found = compare(crew.keystore, proposals, now=now)
    assert found.ok
    assert [each.never_seen for each in found.comparisons] == [(), ()]
