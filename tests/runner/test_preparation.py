"""A rehearsal comes before every flight, and its end never waits for a planner that hangs."""

from __future__ import annotations

import asyncio
import gc
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dronemon.errors import PlannerError
from dronemon.mission import Mission, load_mission
from dronemon.planner import Briefing, Snapshot, Waypoint
from dronemon.roadmap import Roadmap
from dronemon.runner.interrupts import Interrupted, Interrupts
from dronemon.runner.preparation import rehearse
from dronemon.vision.registry import make_detector

MISSION = Path(__file__).parents[2] / "missions" / "animals.yaml"


class Watched:
    """A planner that keeps what it was given, and does something else as well."""

    name = "watched"

    def __init__(self, act: Callable[[], Any] = lambda: None) -> None:
        self.act = act
        self.asked: list[Snapshot] = []

    def reset(self, briefing: Briefing, roadmap: Roadmap) -> None:
        self.act()

    def next_waypoint(self, snapshot: Snapshot) -> Waypoint:
        self.asked.append(snapshot)
        return Waypoint(position_au=np.array([0.5, 0.5]))


@pytest.fixture
def mission() -> Mission:
    return load_mission(MISSION).mission


def test_the_planner_decides_once_on_the_missions_own_terms(mission: Mission) -> None:
    planner = Watched()
    asyncio.run(rehearse(mission, make_detector(mission), planner, Interrupts()))
    (snapshot,) = planner.asked
    assert len(snapshot.roadmap.nodes_au) == mission.roadmap.num_nodes + 1
    assert snapshot.belief.num_targets == len(mission.targets)


def test_what_is_loaded_by_then_is_not_searched_for_garbage_in_flight(mission: Mission) -> None:
    gc.unfreeze()
    before = len(gc.get_objects())
    asyncio.run(rehearse(mission, make_detector(mission), Watched(), Interrupts()))
    assert gc.get_freeze_count() > 0.8 * before
    assert len(gc.get_objects()) < 0.2 * before


def test_a_planner_that_fails_is_named(mission: Mission) -> None:
    with pytest.raises(PlannerError, match="planner 'watched' failed: ZeroDivisionError"):
        asyncio.run(
            rehearse(mission, make_detector(mission), Watched(lambda: 1 // 0), Interrupts())
        )


def test_a_person_does_not_wait_for_a_planner_that_hangs(mission: Mission) -> None:
    interrupts, hangs = Interrupts(), threading.Event()

    async def run() -> None:
        loop = asyncio.get_running_loop()

        def hang() -> None:
            loop.call_soon_threadsafe(interrupts.request)
            hangs.wait()

        async with asyncio.timeout(30):
            await rehearse(mission, make_detector(mission), Watched(hang), interrupts)
            with pytest.raises(Interrupted):
                async with interrupts.leaving():
                    pass

    asyncio.run(run())
    hangs.set()
