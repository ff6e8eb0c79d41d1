"""Run an evaluation: fly what is missing on all cores, then write tables and figures."""

from __future__ import annotations

import os
from collections.abc import Generator, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing, contextmanager
from fractions import Fraction
from functools import cache, partial
from pathlib import Path

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from dronemon.durable import claim
from dronemon.errors import OptionError, RecordError
from dronemon.evaluation.episode import Episode, fly_episode
from dronemon.evaluation.options import (
    EpisodeSpec,
    Key,
    Options,
    PlannerSpec,
    settings_digest,
)
from dronemon.evaluation.report import write_tables
from dronemon.evaluation.results import Result, append_result, load_results
from dronemon.evaluation.sections import table2_rows, ways_covered
from dronemon.evaluation.tables import average_by_cell
from dronemon.planner import Planner, create_planner
from dronemon.problem import is_tracks
from dronemon.terminal import LenientConsole
from dronemon.version import code_version
from dronemon.workers import share_out
from dronemon.world import Instance

PUBLISHED_HORIZON_AU = 30.0
"""Of the paper's tables."""


def evaluate(
    options: Options, console: LenientConsole | None = None, cluster: Executor | None = None
) -> list[Result]:
    """Fly all episodes that the output folder does not hold yet, and write what they show.

    The folder gets results.jsonl, table.csv, table.md, paired.csv, over_time.csv, figures, and with
    `save_episodes` one file of arrays per episode. A run that was killed, or is given more
    instances, goes on where it was; episodes that other code flew are kept, with a warning.

    Raises OptionError, RecordError, WorkerError, and what planners raise.

    cluster: flies them instead of processes of our own
    """
    console = console if console is not None else LenientConsole(stderr=True)
    claim(options.out)
    path = options.out / "results.jsonl"
    results = load_results(path)
    specs = list(options.episodes())
    missing = [s for s in specs if s.key not in results or (s.path and not s.path.is_file())]
    again = set(missing)
    _warn_of_other_code([results[spec.key] for spec in specs if spec not in again], path, console)
    with closing(_flown(missing, len(specs), options, console, cluster)) as flown:
        for result in flown:
            with _written(path):
                append_result(path, result)
            results[result.key] = result
    others = list(_of_others(results, specs))
    finished = [*(results[spec.key] for spec in specs), *others]
    with _written(options.out):
        verdicts = write_tables(
            finished,
            options.out,
            options.command,
            is_as_published=options.horizon_au == PUBLISHED_HORIZON_AU,
            kept=list(dict.fromkeys(result.method for result in others)),
        )
        for verdict in verdicts:
            console.print(verdict, soft_wrap=True, markup=False)
        _draw(finished, options)
    return finished


@contextmanager
def _written(path: Path) -> Iterator[None]:
    """What a run leaves is written there meanwhile. Raises RecordError."""
    try:
        yield
    except OSError as exc:
        raise RecordError(
            f"{exc.filename or path}: cannot be written: {exc.strerror or exc}; mend that, and the"
            " same command goes on from here"
        ) from exc


def _flown(
    missing: Sequence[EpisodeSpec],
    num_specs: int,
    options: Options,
    console: LenientConsole,
    cluster: Executor | None,
) -> Generator[Result]:
    """Fly what is missing, under a progress bar over all."""
    flights = share_out(partial(_run, code=code_version()), missing, options.workers, cluster)
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()
    bars = Progress(*columns, TimeRemainingColumn(), console=console)
    with bars as progress, closing(flights) as flown:
        bar = progress.add_task("episodes", total=num_specs, completed=num_specs - len(missing))
        for result in flown:
            yield result
            progress.advance(bar)


def _of_others(results: Mapping[Key, Result], specs: Sequence[EpisodeSpec]) -> Iterator[Result]:
    """Episodes of planners not named now that an earlier run left, of these cells and instances."""
    named = {spec.planner.method for spec in specs}
    asked = {(spec.cell, spec.seed, len(spec.conditions.times_au) - 1) for spec in specs}
    kept = [
        result
        for result in results.values()
        if result.method not in named
        and result.found_over_time  # older lines do not tell how many nodes they had
        and (result.cell, result.seed, len(result.unc_over_time)) in asked
    ]
    newest = {result.method: result.settings for result in kept}  # the same weights in all cells
    yield from (result for result in kept if result.settings == newest[result.method])


def fly_spec(spec: EpisodeSpec) -> Episode:
    """Fly one episode with the planner that this process keeps for it."""
    _check_files(spec.planner, spec.cell.motion, spec.conditions.horizon_au, spec.settings)
    instance = Instance.draw(spec.seed, spec.cell.num_targets, spec.cell.motion)
    return fly_episode(_planner(spec.planner, spec.settings), instance, spec.conditions)


def _draw(results: Sequence[Result], options: Options) -> None:
    """Draw all results over time, and one instance that every planner flies once more.

    Its cell is that of the paper's figure 4, or the nearest to it.
    """
    # Imported here: matplotlib would slow the start of every worker and every other command.
    from dronemon.evaluation import figures

    out = options.out
    figures.draw_over_time(results, lambda r: r.unc_over_time, "Unc", out / "unc_over_time.png")
    if unplaced := [r for r in results if r.cell.prior == "none"]:
        found = "share of targets found"
        path = out / "found_over_time.png"
        figures.draw_over_time(unplaced, lambda r: r.found_over_time, found, path)
    if flown := table2_rows(average_by_cell(results)):
        figures.draw_table2(flown, out / "table2.png")
    covered = ways_covered(average_by_cell(results))
    if len({(of.cell.num_targets, of.cell.speed_ratio, of.cell.num_nodes) for of in covered}) == 1:
        for name in ("unc", "jsd"):
            figures.draw_conditions(covered, name, out / f"conditions_{name}.png")
    cell = min(
        options.sweep.cells,
        key=lambda cell: (abs(cell.num_targets - 4), abs(cell.speed_ratio - Fraction(1, 20))),
    )
    specs = [options.episode(planner, cell, options.first_seed) for planner in options.planners]
    methods = [spec.planner.method for spec in specs]
    episodes = dict(zip(methods, share_out(fly_spec, specs, 1), strict=True))
    uncertainties = {method: episode.metrics().unc for method, episode in episodes.items()}
    title = f"N = {cell.num_targets}, $r_v$ = {cell.speed_ratio}, seed {options.first_seed}"
    figures.draw_traces(uncertainties, title, out / "traces.png")
    instant = (len(specs[0].conditions.times_au) - 1) * 2 // 3
    figures.draw_overview(episodes, instant, title, out / "overview.png")


def _warn_of_other_code(kept: Sequence[Result], path: Path, console: LenientConsole) -> None:
    """Say so if finished episodes that this run takes over were not flown by the code that runs."""
    others = [result.code for result in kept if result.code != code_version()]
    if others:
        console.print(
            f"warning: {len(others)} finished episodes in {path} were flown by other code "
            f"({' and '.join(sorted(set(others)))}; running now: {code_version()}); they are kept, "
            "and the tables name every version. To measure this code alone, take a fresh --out",
            style="yellow",
            soft_wrap=True,
            markup=False,
        )


@cache
def _check_files(planner: PlannerSpec, motion: str, horizon_au: float, settings: str) -> None:
    """Make sure that this process reads the files that the run was begun with."""
    if settings_digest(planner, motion, horizon_au) != settings:
        raise OptionError(
            f"the files of {planner.text}{f', or of {motion},' if is_tracks(motion) else ''} are"
            " not those that the run was begun with; have them the same wherever episodes are"
            " flown, or, if they were edited meanwhile, give the same command again"
        )


@cache
def _planner(spec: PlannerSpec, settings: str) -> Planner:
    """One planner serves all episodes of a process; `settings` changes with its files."""
    return create_planner(spec.kind, checkpoint=spec.checkpoint, history=spec.history)


def _run(spec: EpisodeSpec, *, code: str) -> Result:
    """Fly and score one episode, and keep its arrays if they have a path."""
    episode = fly_spec(spec)
    metrics = episode.metrics()
    if (path := spec.path) is not None:
        path.parent.mkdir(exist_ok=True)
        partial = path.with_suffix(f".{os.getpid()}.part")
        with partial.open("wb") as file:
            np.savez_compressed(
                file,
                agent_au=episode.agent_au,
                targets_au=episode.targets_au,
                unc=metrics.unc,
                jsd=metrics.jsd,
                told_au=episode.told_au,
            )
        partial.replace(path)
    found = np.logical_or.accumulate(metrics.observed)
    return Result(
        method=spec.planner.method,
        cell=spec.cell,
        seed=spec.seed,
        settings=spec.settings,
        scores=metrics.scores,
        unc_over_time=tuple(metrics.unc[1:].mean(axis=1).round(5).tolist()),
        found_over_time=tuple(found[1:].mean(axis=1).round(5).tolist()),
        decisions=len(episode.decisions_s),
        decision_s=float(episode.decisions_s.mean()),
        code=code,
    )
