"""What a report tells of a run, read from its folder and reckoned once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dronemon.arena import Arena
from dronemon.belief import Belief
from dronemon.errors import RecordError
from dronemon.export.story import Story, coarse, read_story, redacted
from dronemon.frames import AreaFrame, GeoPoint
from dronemon.mission import Mission, mission_arena
from dronemon.recorder import RunFolder
from dronemon.runner.history import Laid, recorded, understanding
from dronemon.runner.preparation import make_belief
from dronemon.runner.watch import Watched, watch
from dronemon.sightings import is_in_view
from dronemon.types import FloatArray, Measurement

GRID_SIZE = 60
"""Points of the maps along each axis."""
RECENTLY_S = 600.0
"""A place that nobody looked at for this long is as good as never looked at."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Flight:
    """A run as its report tells it. Times are seconds of the patrol, also over fresh batteries.

    times_s:        (T,)   of the measurements
    agent_au:       (T, 2) where they were taken
    seen:           (T, N) whether each target was
    seen_au:        (T, N, 2) where, NaN where it was not
    std:            (T, N) of the belief at the place where the target was seen last, NaN before
    battery:        (T,)   share left, NaN where it is not known; battery_needed: to come home
    decisions:      (D, 2) time and milliseconds of each
    mean:           (N, G, G) the last belief on the grid
    unseen_for_s:   (G, G) since each place was looked at last, at the end; inf if it never was
    watched:        how each target was
    events:         the lines of events.jsonl
    """

    folder: RunFolder
    story: Story
    mission: Mission
    frame: AreaFrame
    summary: Mapping[str, Any]
    times_s: FloatArray
    agent_au: FloatArray
    seen: FloatArray
    seen_au: FloatArray
    std: FloatArray
    battery: FloatArray
    battery_needed: FloatArray
    decisions: FloatArray
    mean: FloatArray
    unseen_for_s: FloatArray
    watched: Sequence[Watched]
    events: Sequence[Mapping[str, Any]]

    @property
    def names(self) -> list[str]:
        """Of the targets."""
        return [target.name for target in self.mission.targets]

    def share_looked_at(self, within_s: float = np.inf) -> float:
        """Share of the area that was looked at, ever or within a time before the end."""
        return float(np.mean(self.unseen_for_s < within_s))


def read_flight(folder: RunFolder, cell_m: float = 0.0) -> Flight:
    """Read a run, finished or not. Raises RecordError for one that never patrolled.

    cell_m: to which places on the globe are told, and no words that may hold one; 0: exactly
    """
    story = read_story(folder)
    if cell_m:
        story = redacted(story, cell_m)
    mission = folder.mission()
    with understanding(folder):
        events, lines = list(folder.events()), list(folder.observations())
        if not lines:
            raise RecordError(f"{folder.path}: no picture was looked at: nothing is there to tell")
        laid = Laid.told_by([event for event in events if event["kind"] == "ready"][-1])
        sightings, measurements = recorded(folder, mission)
        belief = make_belief(mission, sightings)
        std = []
        for measurement in measurements:
            sightings.add(measurement)
            std.append(_std_where_seen(belief))
        seconds = mission.seconds_per_au
        agent_au = np.array([m.agent_au for m in measurements])
        times_au = np.array([m.time_au for m in measurements])

        def place_of(position_au: FloatArray) -> GeoPoint:
            exact = laid.frame.au_to_geo(position_au, laid.origin)
            return coarse(exact, cell_m) if cell_m else exact

        return Flight(
            folder=folder,
            story=story,
            mission=mission,
            frame=laid.frame,
            summary=folder.summary(),
            times_s=times_au * seconds,
            agent_au=agent_au,
            seen=np.array([m.seen for m in measurements], dtype=np.float64),
            seen_au=np.array([m.target_au for m in measurements]),
            std=np.array(std),
            battery=_numbers(lines, "battery"),
            battery_needed=_numbers(lines, "battery_needed"),
            decisions=np.array(
                [(d["time_au"] * seconds, d["decision_ms"]) for d in folder.decisions()]
            ).reshape(-1, 2),
            mean=_on_grid(belief, laid.frame.arena)[0],
            unseen_for_s=_unseen_for_au(measurements, laid.frame.arena) * seconds,
            watched=[
                watch(sightings, number, seconds, place_of)
                for number in range(len(mission.targets))
            ],
            events=() if cell_m else events,
        )


def beliefs_at(folder: RunFolder, mission: Mission, count: int) -> tuple[FloatArray, FloatArray]:
    """The beliefs when so many pictures had been looked at. -> (N, G, G) mean and std, rows are y

    Raises RecordError.
    """
    with understanding(folder):
        sightings, measurements = recorded(folder, mission)
    for measurement in measurements[:count]:
        sightings.add(measurement)
    return _on_grid(make_belief(mission, sightings), mission_arena(mission))


def _numbers(lines: Sequence[Mapping[str, Any]], key: str) -> FloatArray:
    return np.array([line[key] for line in lines], dtype=np.float64)  # None becomes NaN


def _std_where_seen(belief: Belief) -> FloatArray:
    """(N,) how unsure the belief is where each target was seen last; NaN if it never was."""
    places_au, time_au = belief.sightings.last_places_au, belief.sightings.time_au
    query = np.concatenate([places_au, np.full((len(places_au), 1), time_au)], axis=-1)
    _, std = belief.posterior(np.nan_to_num(query))
    at_last: FloatArray = np.where(np.isnan(places_au[:, 0]), np.nan, np.diagonal(std))
    return at_last


def _on_grid(belief: Belief, arena: Arena) -> tuple[FloatArray, FloatArray]:
    """(N, G, G) expected presence and its standard deviation now; rows are y."""
    grid_au = arena.grid(GRID_SIZE)
    time_au = np.full((len(grid_au), 1), belief.sightings.time_au)
    mean, std = (
        values.reshape(-1, GRID_SIZE, GRID_SIZE).swapaxes(1, 2)
        for values in belief.posterior(np.concatenate([grid_au, time_au], axis=-1))
    )
    return mean, std


def _unseen_for_au(measurements: Sequence[Measurement], arena: Arena) -> FloatArray:
    """(G, G) time at the end since the footprint lay over each place; rows are y."""
    grid_au = arena.grid(GRID_SIZE)
    looked_at_au = np.full(len(grid_au), -np.inf)
    for look in measurements:
        looked_at_au[is_in_view(look, grid_au)] = look.time_au
    since_au = measurements[-1].time_au - looked_at_au
    unseen_for_au: FloatArray = since_au.reshape(GRID_SIZE, GRID_SIZE).T
    return unseen_for_au
