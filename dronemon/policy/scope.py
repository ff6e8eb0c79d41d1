"""What a network was trained for, and what of a mission lies outside it."""

from __future__ import annotations

from dataclasses import dataclass

from dronemon.problem import Prior


@dataclass(frozen=True, slots=True, kw_only=True)
class Scope:
    """Missions that a network was trained on; ranges are inclusive."""

    num_targets: tuple[int, int]
    num_nodes: tuple[int, int]
    speed_ratio: tuple[float, float]
    priors: tuple[Prior, ...] = ("full",)

    def outside(
        self, *, num_targets: int, num_nodes: int, speed_ratio: float | None, prior: Prior
    ) -> list[str]:
        """A sentence for each number of a mission that training never met.

        speed_ratio: the targets' speed over the drone's, None where nobody knows it
        """
        numbers = (
            (num_targets, "targets", self.num_targets),
            (num_nodes, "nodes of the roadmap", self.num_nodes),
            (speed_ratio, "times the drone's speed for the targets", self.speed_ratio),
        )
        sentences = [
            f"{value:g} {what}: the network was trained for {low:g} to {high:g}"
            for value, what, (low, high) in numbers
            if value is not None and not low <= value <= high
        ]
        if prior not in self.priors:
            known = " or ".join(self.priors)
            sentences.append(f"prior {prior}: the network was trained with prior {known}")
        return sentences

    def __str__(self) -> str:
        ranges = self.num_targets, self.num_nodes, self.speed_ratio
        targets, nodes, speed = (f"{low:g} to {high:g}" for low, high in ranges)
        known = " or ".join(self.priors)
        return f"{targets} targets, {nodes} nodes, {speed} times the agent's speed, prior {known}"
