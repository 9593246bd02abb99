"""Predict what a fleet's handshakes cost when its participants start together.

    messages       bytes and datagrams of the three messages, of a profile or of a keystore
    costs          processor time of a handshake: stored, or from the JSON of `pqsec bench`
    scenario       the fleet, its machines and its network: what is asked
    closed_form    times by distributions, for any number of participants
    simulation     times by discrete events, for the fleet or a sample of it
    estimate       both together, with advice and the range in which they hold
    plot           the share of pairs that have met over time, as SVG

The timers are Cyclone DDS's: see `scenario`. Nothing here runs a stack or reads a clock.
"""

from typing import TYPE_CHECKING

from pqsec_pki._lazy import lazy_exports

if TYPE_CHECKING:
    from pqsec_pki.estimation.closed_form import ClosedForm
    from pqsec_pki.estimation.costs import Costs, costs_of, read_costs
    from pqsec_pki.estimation.estimate import TIMES, VALIDITY, Estimate, estimated
    from pqsec_pki.estimation.messages import mean_of, sizes_in, sizes_of
    from pqsec_pki.estimation.plot import svg_of
    from pqsec_pki.estimation.scenario import Scenario
    from pqsec_pki.estimation.simulation import MOST_PAIRS, Simulated, simulated
else:
    __getattr__ = lazy_exports(__name__, __file__)

__all__ = [
    "MOST_PAIRS",
    "TIMES",
    "VALIDITY",
    "ClosedForm",
    "Costs",
    "Estimate",
    "Scenario",
    "Simulated",
    "costs_of",
    "estimated",
    "mean_of",
    "read_costs",
    "simulated",
    "sizes_in",
    "sizes_of",
    "svg_of",
]
