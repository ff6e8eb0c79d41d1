"""Our search on a public task: `python benchmarks/dsse.py [--episodes 100] [--first-seed 10000]`.

One drone looks for a person in the water in the Drone Swarm Search Environment (DSSE, MIT): 40 x 40
cells, 100 steps, each a move to one of eight cells or a search of the cell below, which finds the
person if it is there. All that is told is a matrix of chances, which drifts and widens; searches
that found nothing are not in it. Start, dispersion and place are those of its authors' examples.

    random    any action
    greedy    their example: to the likeliest cell of the matrix, and search there
    counting  to the cell with most chance for the steps that it takes, our misses taken out
    search    our planner, its particles carried by the matrix

DSSE asks for a matplotlib older than ours, which this task does not use, so it goes beside:
`pip install --no-deps DSSE==1.1.9 pettingzoo pygame gymnasium farama-notifications cloudpickle`.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import io
import math
import random
import sys
import time
from collections.abc import Callable
from typing import Protocol

import numpy as np

from dronemon.arena import Arena
from dronemon.belief import Belief
from dronemon.planner import Briefing, Snapshot
from dronemon.planner.search import SearchPlanner
from dronemon.planner.settings import SearchSettings
from dronemon.problem import FIRST_DEVELOPMENT_SEED, MEASUREMENT_INTERVAL_AU, SENSOR_RADIUS_AU
from dronemon.roadmap import Roadmap
from dronemon.sightings import Sightings
from dronemon.types import FloatArray, Measurement

Cell = tuple[int, int]
"""Column and row."""
SIZE, LIMIT_STEPS, START, PLACE, DISPERSION = 40, 100, (20, 0), (20, 20), 0.1
SEARCH = 8
MOVES: dict[Cell, int] = {
    (-1, 0): 0,
    (1, 0): 1,
    (0, -1): 2,
    (0, 1): 3,
    (-1, -1): 4,
    (1, -1): 5,
    (-1, 1): 6,
    (1, 1): 7,
}
CELL_AU = SENSOR_RADIUS_AU * math.sqrt(math.pi)
"""Side of a cell, so that it is as large as what our planner takes to be in view."""
STEP_AU = CELL_AU / 2.0
"""Time of a step, so that to fly to the next cell and search it takes as long as to fly there."""
NUM_PARTICLES, NUM_PLANNED, NUM_STEPS = 4000, 100, 40
KEPT = 0.99
"""Of a particle's place in the cloud from step to step: the person wanders in it."""


class Policy(Protocol):
    """Flies one episode."""

    def act(self, here: Cell, matrix: FloatArray) -> int:
        """The next action. matrix: (rows, columns) chances."""
        ...


class Cloud:
    """Where the person may be: particles that the matrix carries, less those where we searched.

    A particle keeps its place in the matrix's bell, in standard deviations from its middle. How
    middle and width go on is read off how they went so far: nothing is known of the current.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._offsets = rng.normal(size=(NUM_PARTICLES, 2))
        self._bells: list[FloatArray] = []  # x, y and width, in cells

    def learn(self, matrix: FloatArray) -> None:
        """Go a step on with the matrix."""
        chance = matrix / matrix.sum()
        rows, columns = np.indices(matrix.shape)
        x, y = float((chance * columns).sum()), float((chance * rows).sum())
        squared = (columns - x) ** 2 + (rows - y) ** 2
        self._bells.append(np.array([x, y, math.sqrt(float((chance * squared).sum()) / 2.0)]))
        self._offsets = KEPT * self._offsets + math.sqrt(1.0 - KEPT**2) * self._rng.normal(
            size=self._offsets.shape
        )

    def miss(self, cell: Cell) -> None:
        """The person is not there: particles that are become copies of others."""
        is_there = (np.rint(self.places()) == cell).all(axis=1)
        others = np.flatnonzero(~is_there)
        if len(others) == 0:
            self._offsets = self._rng.normal(size=self._offsets.shape)
        elif is_there.any():
            self._offsets[is_there] = self._offsets[self._rng.choice(others, int(is_there.sum()))]

    @property
    def change(self) -> FloatArray:
        """(3,) by how many cells a step the middle moves, x and y, and the bell widens."""
        steps = len(self._bells) - 1
        change: FloatArray = (self._bells[-1] - self._bells[0]) / max(steps, 1)
        return change

    def places(self, steps: float = 0.0) -> FloatArray:
        """(M, 2) x, y of all particles, some steps from now, in cells."""
        x, y, width = self._bells[-1] + steps * self.change
        places: FloatArray = np.clip((x, y) + width * self._offsets, 0, SIZE - 1)
        return places

    def chances(self) -> FloatArray:
        """(rows, columns) share of particles in each cell."""
        columns, rows = np.rint(self.places()).astype(int).T
        counts = np.bincount(rows * SIZE + columns, minlength=SIZE * SIZE)
        chances: FloatArray = counts.reshape(SIZE, SIZE) / NUM_PARTICLES
        return chances


class Random:
    """Any action."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def act(self, here: Cell, matrix: FloatArray) -> int:
        """The next action."""
        return int(self._rng.integers(len(MOVES) + 1))


class Greedy:
    """To the likeliest cell of the matrix."""

    def __init__(self, rng: np.random.Generator) -> None:
        pass

    def act(self, here: Cell, matrix: FloatArray) -> int:
        """The next action."""
        row, column = divmod(int(matrix.argmax()), SIZE)
        return towards(here, (column, row))


class Counting:
    """To the cell with most chance for the steps that it takes to be there and search."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._cloud = Cloud(rng)

    def act(self, here: Cell, matrix: FloatArray) -> int:
        """The next action."""
        self._cloud.learn(matrix)
        rows, columns = np.indices(matrix.shape)
        steps = 1 + np.maximum(abs(columns - here[0]), abs(rows - here[1]))
        row, column = divmod(int((self._cloud.chances() / steps).argmax()), SIZE)
        action = towards(here, (column, row))
        if action == SEARCH:
            self._cloud.miss(here)
        return action


class Carried(SearchPlanner):
    """Our search, which is given its particles."""

    def carry(self, cloud: Cloud) -> None:
        """Take the cloud that the next decision is about."""
        self._cloud = cloud

    def _foreseen(self, time_au: float) -> tuple[FloatArray, FloatArray, float]:
        """Some of the cloud now and at the next measurements; its speed is how fast it widens."""
        steps = MEASUREMENT_INTERVAL_AU / STEP_AU * np.arange(self.settings.num_steps + 1)
        places_au = CELL_AU * np.stack([self._cloud.places(s)[:NUM_PLANNED] for s in steps])
        speed = float(np.clip(self._cloud.change[2] * CELL_AU / STEP_AU, 0.01, 0.3))
        return places_au[:1], places_au[1:, None], speed


class Search:
    """Our planner: along its path, with a search where a step of that finds more than to go on.

    To go on is to fly to the next cells and search each, two steps a cell, as far as pays best.
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._cloud = Cloud(rng)
        self._planner = Carried(
            SearchSettings(
                num_drawn=100,
                num_refined=75,
                num_steps=NUM_STEPS,  # as far as the person may be at first,
                walk_au=1.2,  # and not fewer for a target that is fast: its drift is known
                num_planned=NUM_PLANNED,
                num_places=NUM_STEPS * NUM_PLANNED,
            )
        )
        self._sightings = Sightings(np.full((1, 2), np.nan))
        self._steps = 0
        here_au = CELL_AU * np.array(START)
        self._roadmap = Roadmap(nodes_au=here_au[None], neighbours=np.zeros((1, 1), dtype=np.int64))
        briefing = Briefing(
            num_targets=1,
            priors_au=self._sightings.priors_au,
            start_au=here_au,
            horizon_au=LIMIT_STEPS * STEP_AU,
            rng=rng,
            arena=Arena(low_au=(0.0, 0.0), high_au=((SIZE - 1) * CELL_AU,) * 2),
        )
        self._planner.reset(briefing, self._roadmap)
        self._planner.carry(self._cloud)

    def act(self, here: Cell, matrix: FloatArray) -> int:
        """The next action."""
        self._cloud.learn(matrix)
        self._steps += 1
        ahead = self._ahead(here)
        chances = self._cloud.chances()
        found = np.cumsum([chances[row, column] for column, row in ahead])
        if chances[here[1], here[0]] >= (found / (2.0 * np.arange(1, len(ahead) + 1))).max():
            self._cloud.miss(here)
            self._look(here)
            return SEARCH
        return towards(here, ahead[0])

    def _ahead(self, here: Cell) -> list[Cell]:
        """Other cells on the planner's path, in their order."""
        time_au = self._steps * STEP_AU
        snapshot = Snapshot(
            time_au=time_au,
            flown_au=0.0,
            position_au=CELL_AU * np.array(here, dtype=np.float64),
            node=None,
            sightings=self._sightings,
            belief=Belief(self._sightings),
            roadmap=self._roadmap,
            remaining_au=LIMIT_STEPS * STEP_AU - time_au,
        )
        path_au = np.array(self._planner.next_waypoint(snapshot).details["path"])
        cells = [(column, row) for column, row in np.rint(path_au / CELL_AU).astype(int).tolist()]
        return [cell for cell in dict.fromkeys(cells) if cell != here]

    def _look(self, here: Cell) -> None:
        """Tell the log that nothing was seen here."""
        self._sightings.add(
            Measurement(
                time_au=self._steps * STEP_AU,
                agent_au=CELL_AU * np.array(here, dtype=np.float64),
                seen=np.array([False]),
                target_au=np.full((1, 2), np.nan),
            )
        )


POLICIES: dict[str, Callable[[np.random.Generator], Policy]] = {
    "random": Random,
    "greedy": Greedy,
    "counting": Counting,
    "search": Search,
}


def towards(here: Cell, goal: Cell) -> int:
    """The move that comes nearest to a cell; a search if it is this one."""
    step = tuple(int(np.sign(to - at)) for at, to in zip(here, goal, strict=True))
    return SEARCH if step == (0, 0) else MOVES[step]


def fly(policy: Policy, seed: int) -> tuple[bool, int]:
    """Fly one episode. -> whether the person was found, and the steps taken."""
    from DSSE import DroneSwarmSearch

    random.seed(seed)  # the environment draws from both, and the person alike for all policies
    np.random.seed(seed)  # noqa: NPY002
    with contextlib.redirect_stdout(io.StringIO()):
        env = DroneSwarmSearch(
            grid_size=SIZE,
            dispersion_inc=DISPERSION,
            person_initial_position=PLACE,
            timestep_limit=LIMIT_STEPS,
            drone_amount=1,
        )
    observations, infos = env.reset(options={"drones_positions": [START]})
    steps = 0
    while env.agents:
        here, matrix = observations["drone0"]
        action = policy.act((int(here[0]), int(here[1])), matrix.astype(np.float64))
        observations, _, _, _, infos = env.step({"drone0": action})
        steps += 1
    return bool(infos["drone0"]["Found"]), steps


def told(values: FloatArray) -> str:
    """Mean and standard error."""
    return f"{values.mean():.1f} ± {values.std() / math.sqrt(len(values)):.1f}"


def main() -> None:
    """Fly all policies on the same seeds, and print a row for each, and the last beside others."""
    parser = argparse.ArgumentParser(description="Our search on DSSE's task, one drone")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=FIRST_DEVELOPMENT_SEED)
    parser.add_argument("--policies", default=",".join(POLICIES))
    given = parser.parse_args()
    if importlib.util.find_spec("DSSE") is None:
        sys.exit((__doc__ or "").strip().rpartition("\n\n")[2])
    seeds = range(given.first_seed, given.first_seed + given.episodes)
    print("| policy | found | steps to find, of those found | steps, at most 100 | ms a step |")
    print("|---|---|---|---|---|")
    scores: dict[str, FloatArray] = {}
    for name in given.policies.split(","):
        began_s = time.perf_counter()
        flown = [fly(POLICIES[name](np.random.default_rng([seed, 1])), seed) for seed in seeds]
        took_s = time.perf_counter() - began_s
        found = np.array([is_found for is_found, _ in flown])
        steps = np.array([min(count, LIMIT_STEPS) for _, count in flown])
        scores[name] = np.stack([100.0 * found, steps])
        to_find = f"{steps[found].mean():.1f}" if found.any() else "-"
        print(
            f"| {name} | {told(100.0 * found)} % | {to_find} | {told(steps)} "
            f"| {1e3 * took_s / steps.sum():.1f} |",
            flush=True,
        )
    *others, last = scores
    for name in others:
        found, steps = map(told, scores[last] - scores[name])
        print(f"{last} minus {name}, on the same seeds: {found} % found, {steps} steps")


if __name__ == "__main__":
    main()
