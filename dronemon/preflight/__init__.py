"""Go or no-go before a take-off."""

from dronemon.preflight.findings import Facts, Finding, OwnFence, Relief, Sight, Verdict
from dronemon.preflight.table import PARAMETERS, against, judge, mending_options

__all__ = [
    "PARAMETERS",
    "Facts",
    "Finding",
    "OwnFence",
    "Relief",
    "Sight",
    "Verdict",
    "against",
    "judge",
    "mending_options",
]
