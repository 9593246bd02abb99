"""The rows behind `verify-handshake --as` write as the real stacks do."""

from datetime import UTC, datetime

import pytest

from pqsec_pki.algorithms import KEY_AGREEMENTS
from pqsec_pki.handshake import (
    DataHolder,
    Final,
    IdentityToken,
    PeerRequirements,
    Reply,
    Request,
    Terms,
    begin,
    reply_to,
)
from pqsec_pki.selfcheck import stack_named
from tests.interop.cyclone import participant as cyclone_participant
from tests.interop.fastdds import participant as fastdds_participant
from tests.interop.fastdds_meeting import DOMAIN, identity, token

pytestmark = pytest.mark.interop


def form(message):
    """Names of properties, and what does not change from one handshake to the next."""
    introduction = getattr(message, "introduction", None)
    names = [name for name, _ in message.to_holder().binary_properties]
    algorithms = (
        (introduction.signature_algorithm, introduction.key_agreement) if introduction else ()
    )
    return sorted(names), algorithms


def shares(message):
    """The sizes of dh1 and dh2. One in 256 numbers of DH is shorter."""
    return [len(getattr(message, name, None) or b"") for name in ("dh1", "dh2")]


@pytest.fixture(params=["cyclonedds", "fastdds"])
def stack(request):
    """The row, and how to make a real participant with the files of a folder."""
    row = stack_named(request.param)
    if request.param == "fastdds":
        shim = request.getfixturevalue("fastdds")
        return row, lambda folder: fastdds_participant(shim, folder)
    plugins = request.getfixturevalue("plugins")
    return row, lambda folder: cyclone_participant(plugins, folder, optional=False)


def met(real, peer):
    """`real`, in the domain, having heard of `peer`."""
    real.show(*real.join(DOMAIN))
    return real.meet(
        peer.guid, token(IdentityToken.announced(peer.certificate, peer.ca, KEY_AGREEMENTS))
    )


@pytest.fixture
def alice(labs):
    return identity(labs("classical").alice, {})


@pytest.fixture
def bob(labs):
    return identity(labs("classical").bob, {})


def terms(row, own, **how):
    return Terms(own=own, policy=PeerRequirements(agreements=row.agreements), **how)


def test_a_request_and_a_final_are_written_as_the_stack_does(stack, labs, alice, bob):
    (row, participant), now = stack, datetime.now(UTC)
    with participant(labs("classical").bob) as real:
        handshake, sent = real.request(met(real, alice))
        request = Request.from_holder(DataHolder(*sent))
        answer, _ = reply_to(terms(row, alice), request, now=now)
        final = Final.from_holder(DataHolder(*real.process(handshake, token(answer))))
    ours, waiting = begin(terms(row, bob, conventions=row.conventions), row.agreements[0])
    answer, _ = reply_to(terms(row, alice), ours, now=now)
    assert form(ours) == form(request)
    assert shares(ours) == pytest.approx(shares(request), abs=2)
    assert form(waiting.receive(answer, now=now)[0]) == form(final)


@pytest.mark.parametrize("at", [0, 1], ids=["what it asks for", "the other"])
def test_a_reply_is_written_as_the_stack_does(stack, labs, alice, bob, at):
    (row, participant), now = stack, datetime.now(UTC)
    # As the stack itself asks: Fast DDS answers a NUL in c.kagree_algo with one.
    request, _ = begin(terms(row, bob, conventions=row.conventions), row.agreements[at])
    with participant(labs("classical").alice) as real:
        _, sent = real.reply(met(real, bob), token(request))
    reply = Reply.from_holder(DataHolder(*sent))
    ours, _ = reply_to(terms(row, alice, conventions=row.conventions), request, now=now)
    assert form(ours) == form(reply)
    assert shares(ours) == pytest.approx(shares(reply), abs=2)
