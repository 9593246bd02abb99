"""The share of pairs that have met over time, as SVG that loads nothing."""

from math import isfinite

from pqsec_pki.estimation.closed_form import HORIZON
from pqsec_pki.estimation.estimate import Estimate

_WIDTH, _HEIGHT, _LEFT, _TOP = 560, 280, 50, 40
_POINTS = 200
_TICKS = 5


def svg_of(estimate: Estimate) -> str:
    """A line for the closed form, and one for the simulation; numbers only, nothing from files."""
    times = [each for each in estimate.simulation.pairs if isfinite(each)]
    end = max(estimate.closed.mesh(0.95) or HORIZON, times[-1] if times else 0.0) * 1.05
    grid = [end * each / _POINTS for each in range(_POINTS + 1)]
    closed = [(time, 1 - estimate.closed.apart(time)) for time in grid]
    total, met, stepped = len(estimate.simulation.pairs), 0, list[tuple[float, float]]()
    for time in grid:
        while met < len(times) and times[met] <= time:
            met += 1
        stepped.append((time, met / total))
    scenario = estimate.scenario
    title = f"{scenario.participants} participants, {scenario.loss:.1%} loss: pairs that have met"
    below = _TOP + _HEIGHT
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH + 90} {_HEIGHT + 100}">',
        '<g font-family="sans-serif" font-size="12">',
        f"<title>{title}</title>",
        f'<text x="{_LEFT}" y="22" font-size="14">{title}</text>',
    ]
    for tick in range(_TICKS + 1):
        share = tick / _TICKS
        x, y = _LEFT + _WIDTH * share, _TOP + _HEIGHT * (1 - share)
        parts += [
            f'<path d="M{_LEFT} {y:.0f}h{_WIDTH}" stroke="#ccc"/>',
            f'<text x="{_LEFT - 6}" y="{y + 4:.0f}" text-anchor="end">{share:.0%}</text>',
            f'<text x="{x:.0f}" y="{below + 18}" text-anchor="middle">{end * share:.3g} s</text>',
        ]
    for row, (name, colour, points) in enumerate(
        (("closed form", "#0072b2", closed), ("simulation", "#d55e00", stepped))
    ):
        line = " ".join(
            f"{_LEFT + _WIDTH * time / end:.1f},{_TOP + _HEIGHT * (1 - share):.1f}"
            for time, share in points
        )
        parts += [
            f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2"/>',
            f'<text x="{_LEFT + 150 * row}" y="{below + 45}" fill="{colour}">{name}</text>',
        ]
    return "\n".join([*parts, "</g></svg>", ""])
