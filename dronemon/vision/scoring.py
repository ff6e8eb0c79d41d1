"""How a detector's finds agree with what pictures are known to show."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from dronemon.sensor import Sensor
from dronemon.types import Detection, FloatArray

_OTHER = 0.5
"""What it weighs, over the distance allowed, that a find has another appearance."""


class Score:
    """Counts over pictures.

    labelled:     of each appearance, what was to be found
    taken_for:    of each appearance, as what it was found
    false_alarms: finds of nothing, or of what is not watched
    off_m:        (x, y) m by which each find was beside its label, along the picture's sides
    """

    def __init__(self, appearances: Sequence[str], within_m: float) -> None:
        """within_m: distance up to which a find is of a label."""
        self._within_m = within_m
        self.num_pictures = 0
        self.labelled = Counter[str](dict.fromkeys(appearances, 0))
        self.taken_for = {name: Counter[str]() for name in self.labelled}
        self.false_alarms = 0
        self.off_m: list[FloatArray] = []

    def add(
        self,
        labels: Sequence[Detection],
        finds: Sequence[Detection],
        m_per_px: float,
        counts: Callable[[Detection], bool],
    ) -> None:
        """Take what one picture shows of what is watched, and what was found in it.

        Each find is of one label at most, and the other way round.
        counts: whether something lies where it is to be found; what is near there may be its pair
        """
        pairs = self._pairs(labels, finds, m_per_px)
        self.num_pictures += 1
        self.labelled.update(label.appearance for label in labels if counts(label))
        found = {find for _, find in pairs}
        self.false_alarms += sum(counts(f) for i, f in enumerate(finds) if i not in found)
        for i, j in pairs:
            if counts(label := labels[i]):
                self.taken_for[label.appearance][finds[j].appearance] += 1
                self.off_m.append(m_per_px * np.subtract(finds[j].pixel_px, label.pixel_px))

    def _pairs(
        self, labels: Sequence[Detection], finds: Sequence[Detection], m_per_px: float
    ) -> list[tuple[int, int]]:
        """Which find is of which label: as many as can be, and the nearest."""
        if not labels or not finds:
            return []
        labels_px, finds_px = ([of.pixel_px for of in them] for them in (labels, finds))
        distance_m = m_per_px * cdist(labels_px, finds_px)
        differ = np.array([[f.appearance != label.appearance for f in finds] for label in labels])
        # What is too far off costs more than any two pairs, so that it is never preferred.
        near = np.where(distance_m <= self._within_m, distance_m / self._within_m, 4.0)
        rows, columns = linear_sum_assignment(near + _OTHER * differ)
        pairs = zip(rows.tolist(), columns.tolist(), strict=True)
        return [(i, j) for i, j in pairs if distance_m[i, j] <= self._within_m]

    @property
    def num_labelled(self) -> int:
        """All that was to be found."""
        return self.labelled.total()

    @property
    def num_found(self) -> int:
        """What of it was found, as itself or as another."""
        return sum(taken.total() for taken in self.taken_for.values())

    @property
    def position_m(self) -> float:
        """Standard deviation of a find's place about its label's, along each axis."""
        return float(np.sqrt(np.mean(np.square(self.off_m)))) if self.off_m else 0.0

    def sensor(self, side_m: float) -> Sensor:
        """The errors as planners take them. side_m: of the area.

        Raises OptionError if they are greater than planners can be told.
        """
        as_itself = sum(taken[name] for name, taken in self.taken_for.items())
        return Sensor(
            miss=1.0 - self.num_found / self.num_labelled,
            false_alarms=self.false_alarms / self.num_pictures,
            position_au=self.position_m / side_m,
            confusion=1.0 - as_itself / self.num_found if self.num_found else 0.0,
        )

    def confusion(self) -> dict[str, dict[str, float]]:
        """Shares of each appearance's finds that have another's, as `detector.confusion` has it.

        Without what is never found as itself, of which that cannot be said.
        """
        return {
            name: {other: taken[other] / taken.total() for other in taken if other != name}
            for name, taken in self.taken_for.items()
            if taken.total() > taken[name] > 0
        }
