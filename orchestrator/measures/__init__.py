"""Figures of a signal over time: what a control engineer reads off a response, as pure functions of samples.

Each takes stamps (K,) [s] that increase strictly, evenly or not, and values (K,), and refuses a NaN. Between samples a
signal is a line; with `hold` it keeps the earlier value, as the output of a sampled controller does. Times are counted
from the first stamp, so that whoever means the moment of a step begins there. Scenarios ask these figures of runs, and
tuning sets them as goals.
"""

from orchestrator.measures.closeness import correlation_lag, fit, largest_deviation, nrmse
from orchestrator.measures.ensemble import Membership, band, membership
from orchestrator.measures.events import changes, crossings, saturated_share, saturations
from orchestrator.measures.funnel import FunnelTolerance, funnel
from orchestrator.measures.harmonics import harmonic_amplitudes, total_harmonic_distortion
from orchestrator.measures.integrals import effort, iae, ise, itae, mean, rms
from orchestrator.measures.limit_cycle import SteadyOscillation, limit_cycle
from orchestrator.measures.oscillation import Oscillation, dominant_oscillation
from orchestrator.measures.parting import Parting, partings, together
from orchestrator.measures.response import (
    final_value,
    overshoot,
    peak,
    residual_rms,
    retreat,
    rise_time,
    settling_time,
    steady_error,
)
from orchestrator.measures.share import chance_of_fewer, share_interval

__all__ = [
    "FunnelTolerance",
    "Membership",
    "Oscillation",
    "Parting",
    "SteadyOscillation",
    "band",
    "chance_of_fewer",
    "changes",
    "correlation_lag",
    "crossings",
    "dominant_oscillation",
    "effort",
    "final_value",
    "fit",
    "funnel",
    "harmonic_amplitudes",
    "iae",
    "ise",
    "itae",
    "largest_deviation",
    "limit_cycle",
    "mean",
    "membership",
    "nrmse",
    "overshoot",
    "partings",
    "peak",
    "residual_rms",
    "retreat",
    "rise_time",
    "rms",
    "saturated_share",
    "saturations",
    "settling_time",
    "share_interval",
    "steady_error",
    "together",
    "total_harmonic_distortion",
]
