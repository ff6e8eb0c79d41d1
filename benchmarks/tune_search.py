"""What each setting of the search is worth: `python benchmarks/tune_search.py [NAME=VALUE ...]`.

Flies the same development instances (seeds 10000 and up) with the settings of `SearchSettings` and
with each change given, and prints Unc, MinOb and JSD of each cell and their mean differences, with
the standard error over paired instances. Names are those of `SearchSettings` or `MotionSettings`;
several changes joined by commas are made together; `kinds=tour+legs` keeps those ways of moving.
Without changes it prints the ablations: each
ingredient off (the table in docs/experiments.md: `--instances 32`).
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, replace
from typing import Any, get_args

import numpy as np
import torch

from dronemon.evaluation.episode import Conditions, fly_episode
from dronemon.planner import Planner
from dronemon.planner.search import ClairvoyantSearchPlanner, SearchPlanner
from dronemon.planner.settings import MotionSettings, SearchSettings
from dronemon.planner.walking import KINDS
from dronemon.problem import FIRST_DEVELOPMENT_SEED, Prior
from dronemon.types import FloatArray
from dronemon.world import Instance

CORNERS = "2:1/30,2:1/7,8:1/30,8:1/7"
ABLATIONS = (
    "num_refined=0,num_drawn=350",
    "guided_share=0",
    "sight_gain=0",
    "shape_worth=0",
    "drift=0",
    "walk_au=10",
    "kinds=tour",
    "kinds=legs+wander+jitter+circle+graze",
    "slowest=0.0731,fastest=0.0731",  # the expected speed before any sighting, not learned
    "num_planned=10",
    "scatter_au=0",
)


def changed(text: str) -> SearchSettings:
    """Default settings with changes. text: `name=value,name=value`, or nothing."""
    settings = SearchSettings()
    of_motion = {field.name for field in fields(MotionSettings)}
    for change in filter(None, text.split(",")):
        name, value = change.split("=")
        owner = settings.motion if name in of_motion else settings
        kinds = {kind.name: kind for kind in KINDS}
        given: Any = (
            tuple(kinds[kind] for kind in value.split("+"))
            if name == "kinds"
            else type(getattr(owner, name))(value)
        )
        if name in of_motion:
            settings = replace(settings, motion=replace(settings.motion, **{name: given}))
        else:
            settings = replace(settings, **{name: given})
    return settings


def scores(
    planner: Planner, cells: list[tuple[int, float]], prior: Prior, num_instances: int
) -> FloatArray:
    """Unc, MinOb and JSD of every cell and instance. -> (C, K, 3)."""
    torch.set_num_threads(1)
    table = np.empty((len(cells), num_instances, 3))
    for c, (num_targets, speed_ratio) in enumerate(cells):
        for k in range(num_instances):
            instance = Instance.draw(FIRST_DEVELOPMENT_SEED + k, num_targets)
            conditions = Conditions(speed_ratio=speed_ratio, prior=prior)
            got = fly_episode(planner, instance, conditions).metrics().scores
            table[c, k] = got.unc, got.min_ob, got.jsd
    return table


def line(name: str, table: FloatArray, base: FloatArray) -> str:
    """One line of the report."""
    cells = "  ".join("{:.3f} {:5.1f} {:.3f}".format(*cell) for cell in table.mean(axis=1))
    change = (table - base).mean(axis=0)  # (K, 3)
    error = change.std(axis=0, ddof=1) / np.sqrt(len(change))
    return (
        f"{name:32s} {cells}  Unc {change[:, 0].mean():+.4f} ± {error[0]:.4f}  "
        f"JSD {change[:, 2].mean():+.4f} ± {error[2]:.4f}"
    )


def main() -> None:
    """Compare settings on paired instances."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("changes", nargs="*", default=list(ABLATIONS))
    parser.add_argument("--instances", type=int, default=8)
    parser.add_argument("--cells", default=CORNERS, help="number of targets : speed ratio, ...")
    parser.add_argument("--prior", choices=get_args(Prior), default="full")
    parser.add_argument("--clairvoyant", action="store_true")
    parser.add_argument("--workers", type=int, default=os.cpu_count(), help="processes")
    arguments = parser.parse_args()
    cells = []
    for cell in arguments.cells.split(","):
        count, ratio = cell.split(":")
        cells.append((int(count), 1.0 / float(ratio.removeprefix("1/"))))
    make = ClairvoyantSearchPlanner if arguments.clairvoyant else SearchPlanner
    print(f"Unc MinOb JSD of {arguments.cells}; {arguments.instances} instances a cell")
    with ProcessPoolExecutor(
        arguments.workers, mp_context=multiprocessing.get_context("spawn")
    ) as pool:
        names = ["", *arguments.changes]
        planners = [make(changed(name)) for name in names]
        count = len(names)
        tables: Iterator[FloatArray] = pool.map(
            scores,
            planners,
            [cells] * count,
            [arguments.prior] * count,
            [arguments.instances] * count,
        )
        base = next(tables)
        print(line("as it is", base, base), flush=True)
        for name, table in zip(arguments.changes, tables, strict=True):
            print(line(name, table, base), flush=True)


if __name__ == "__main__":
    main()
