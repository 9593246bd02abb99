"""The share of pairs that have met over time, as SVG that loads nothing."""

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from math import isfinite

from pqsec_pki.estimation.closed_form import HORIZON
from pqsec_pki.estimation.estimate import Estimate

_WIDTH, _HEIGHT, _LEFT, _TOP = 560, 280, 50, 40
_BELOW = _TOP + _HEIGHT
_POINTS = 200
_TICKS = 5


Curve = Sequence[tuple[float, float]]
"""Points: seconds, and the share of pairs that have met by then."""


def svg_of(estimate: Estimate) -> str:
    """A line for the closed form, and one for the simulation; numbers only, nothing from files."""
    times = [each for each in estimate.simulation.pairs if isfinite(each)]
    end = max(estimate.closed.mesh(0.95) or HORIZON, times[-1] if times else 0.0) * 1.05
    grid = [end * each / _POINTS for each in range(_POINTS + 1)]
    total = len(estimate.simulation.pairs)
    closed = [(time, 1 - estimate.closed.apart(time)) for time in grid]
    simulated = [(time, bisect_right(times, time) / total) for time in grid]
    scenario = estimate.scenario
    title = f"{scenario.participants} participants, {scenario.loss:.1%} loss: pairs that have met"
    parts = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH + 90} {_HEIGHT + 100}">',
        '<g font-family="sans-serif" font-size="12">',
        f"<title>{title}</title>",
        f'<text x="{_LEFT}" y="22" font-size="14">{title}</text>',
        *_axes(end),
        *_curve(closed, end, "closed form", "#0072b2", _LEFT),
        *_curve(simulated, end, "simulation", "#d55e00", _LEFT + 150),
        "</g></svg>\n",
    )
    return "\n".join(parts)


def _axes(end: float) -> Iterator[str]:
    for tick in range(_TICKS + 1):
        share = tick / _TICKS
        x, y = _LEFT + _WIDTH * share, _TOP + _HEIGHT * (1 - share)
        yield f'<path d="M{_LEFT} {y:.0f}h{_WIDTH}" stroke="#ccc"/>'
        yield f'<text x="{_LEFT - 6}" y="{y + 4:.0f}" text-anchor="end">{share:.0%}</text>'
        when = f"{end * share:.3g} s"
        yield f'<text x="{x:.0f}" y="{_BELOW + 18}" text-anchor="middle">{when}</text>'


def _curve(curve: Curve, end: float, name: str, colour: str, place: int) -> Iterator[str]:
    """The curve, and its name in the legend at `place`."""
    points = " ".join(
        f"{_LEFT + _WIDTH * time / end:.1f},{_TOP + _HEIGHT * (1 - share):.1f}"
        for time, share in curve
    )
    yield f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="2"/>'
    yield f'<text x="{place}" y="{_BELOW + 45}" fill="{colour}">{name}</text>'
