"""How the eye errs: what the world makes of it, and what beliefs and planners make of its word.

The paper's sensor never errs.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass

from dronemon.errors import OptionError

LIMITS = {"miss": 0.9, "false_alarms": 1.0, "position_au": 0.05, "confusion": 0.5}
"""Greatest value of each error."""
_OTHERS_SEEN = 0.2
"""Targets that a picture shows, about, and that may be taken for another."""


@dataclass(frozen=True, slots=True, order=True, kw_only=True)
class Sensor:
    """How often, and how far, what is seen is not so.

    miss:         chance that a target in view is not seen
    false_alarms: targets seen in a picture where there are none, in the mean (Poisson)
    position_au:  standard deviation, along each axis, of the place of a target seen
    confusion:    chance that a target seen is taken for another

    Raises OptionError for a value out of `LIMITS`.
    """

    miss: float = 0.0
    false_alarms: float = 0.0
    position_au: float = 0.0
    confusion: float = 0.0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            if not (math.isfinite(value) and 0.0 <= value <= LIMITS[name]):
                raise OptionError(f"{name}={value:g} is not 0 to {LIMITS[name]:g}")

    @property
    def is_perfect(self) -> bool:
        """Whether it is the paper's."""
        return self == PERFECT

    @property
    def needs_hindsight(self) -> bool:
        """Whether what it says of a picture may have to be taken back, or seen through."""
        return self.untold > 0.0 or self.false_sights > 0.0

    @property
    def false_sights(self) -> float:
        """Targets told of in a picture where they are not, in the mean and about."""
        return self.false_alarms + _OTHERS_SEEN * self.confusion

    @property
    def untold(self) -> float:
        """Chance that a target in view is not told of as itself."""
        return 1.0 - (1.0 - self.miss) * (1.0 - self.confusion)

    @classmethod
    def parse(cls, text: str) -> Sensor:
        """Read `perfect`, or errors such as `miss=0.1+false_alarms=0.05`. Raises OptionError."""
        if text == "perfect":
            return PERFECT
        given: dict[str, float] = {}
        for part in text.split("+"):
            name, _, value = part.partition("=")
            try:
                number = float(value)
            except ValueError:
                number = math.nan
            if name not in LIMITS or name in given or math.isnan(number):
                raise OptionError(
                    f"{part!r:.60} of {text!r:.200} is no error of a sensor; say perfect, or each "
                    f"of {', '.join(LIMITS)} at most once, such as miss=0.1+false_alarms=0.05"
                )
            given[name] = number
        return cls(**given)

    def __str__(self) -> str:
        """What `parse` reads."""
        errors = [f"{name}={value}" for name, value in asdict(self).items() if value]
        return "+".join(errors) or "perfect"


PERFECT = Sensor()
"""The paper's."""
