"""Participants that should not meet, on real stacks."""

from collections.abc import Callable, Sequence

from pqsec_pki.trial import TrialRole, TrialRun


def run_strangers(
    play: Callable[..., TrialRun], roles: Sequence[TrialRole], times: Sequence[float], said: str
) -> TrialRun:
    """The run in the first of these times (seconds) in which all join, and some log has `said`.

    It is the last one if none has: a busy machine may need a longer run until then.
    """
    for seconds in times:
        went = play(*roles, seconds=seconds)
        joined = all(each.joined for each in went.outcomes)
        if any(each.received for each in went.outcomes) or (
            joined and any(said in each.log for each in went.outcomes)
        ):
            break
    return went
