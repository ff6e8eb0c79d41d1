"""How fast the vectorised environment is: `python benchmarks/env.py [--decisions N] [--threads T]`.

Plays random moves at B = 64, N = 4, |V| = 200 and prints node decisions a second, rewards and
observations included. In the same run it takes the Gaussian processes of one decision, all targets
of all episodes, and prints how much faster they are fitted and predicted than by scikit-learn's
GaussianProcessRegressor, with the number of threads that suits it better, by the clock and in time
of the processors, and how far the results differ. With many decisions the most memory ever in use,
printed with each part of them, tells whether it stays flat.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import Matern
from threadpoolctl import threadpool_limits
from torch import Tensor

from dronemon.belief import fit
from dronemon.env import Env, Observation, Setup
from dronemon.problem import FIRST_DEVELOPMENT_SEED
from dronemon.types import FloatArray

WARM_UP_DECISIONS = 64
"""Decisions each episode takes before anything is timed: windows are full then."""


def random_moves(observation: Observation, generator: torch.Generator) -> Tensor:
    """One allowed neighbour of each episode. -> (B,)."""
    column = torch.multinomial(observation.neighbour_mask.double(), 1, generator=generator)
    return observation.neighbours.gather(1, column)[:, 0]


def play(env: Env, setups: list[Setup], num_decisions: int, num_parts: int) -> float:
    """Take `num_decisions` in all, printing speed and memory. -> decisions a second."""
    generator = torch.Generator().manual_seed(0)
    observation = env.reset(setups)
    for _ in range(WARM_UP_DECISIONS):
        observation = env.step(random_moves(observation, generator)).observation
    num_rounds = max(1, num_decisions // len(setups) // num_parts)
    begin_s = time.perf_counter()
    for part in range(1, num_parts + 1):
        for _ in range(num_rounds):
            observation = env.step(random_moves(observation, generator)).observation
        done, taken_s = part * num_rounds * len(setups), time.perf_counter() - begin_s
        memory_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**10
        print(f"{done:8d} decisions  {done / taken_s:7.0f} a second  {memory_mib:6.0f} MiB")
    return done / taken_s


def shortest_s(work: Callable[[], object], repeats: int) -> FloatArray:
    """Shortest times of some repetitions: what it takes when nothing else is in the way.

    -> (2,) s by the clock, and of all processors.
    """
    taken_s = []
    for _ in range(repeats):
        begin_s = np.array([time.perf_counter(), time.process_time()])
        work()
        taken_s.append(np.array([time.perf_counter(), time.process_time()]) - begin_s)
    shortest: FloatArray = np.min(taken_s, axis=0)
    return shortest


def sklearn_posterior(points: Tensor, values: Tensor, query: Tensor) -> list[np.ndarray]:
    """Mean and standard deviation by scikit-learn. (n, 3), (n,), (m, 3) -> two of (m,)."""
    kernel = Matern(length_scale=[0.1, 0.1, 3.0], nu=1.5)
    process = GaussianProcessRegressor(kernel, optimizer=None, alpha=1e-10)
    process.fit(points.numpy(), values.numpy())
    return list(process.predict(query.numpy(), return_std=True))


def compare_with_sklearn(env: Env, num_threads: int) -> None:
    """Fit and predict one decision's Gaussian processes both ways; print ratio and difference."""
    points, values, mask = (x.clone() for x in env.observations())
    query = env.query()
    cases = [
        (points[b, i, mask[b, i]], values[b, i, mask[b, i]], query[b, 0])
        for b, i in np.ndindex(*mask.shape[:2])
    ]
    work = partial(fit, points, values, mask, num_threads=num_threads)
    ours_s = shortest_s(lambda: work().predict(query), 100)
    theirs_s = np.full(2, np.inf)
    for limit in {1, num_threads}:
        with threadpool_limits(limit):
            taken_s = np.sum([shortest_s(partial(sklearn_posterior, *c), 5) for c in cases], axis=0)
        theirs_s = np.minimum(theirs_s, taken_s)
    expected = torch.as_tensor(np.array([sklearn_posterior(*case) for case in cases]))
    got = torch.stack(work().predict(query), dim=2).flatten(0, 1)
    print(
        f"{len(cases)} processes of up to {mask.shape[-1]} observations, mean and standard"
        f" deviation at {query.shape[-2]} points; largest difference"
        f" {(got - expected).abs().max().item():.1e}"
    )
    for kind, ours, theirs in zip(("clock", "processors"), ours_s, theirs_s, strict=True):
        print(
            f"{kind}: {ours * 1e3:.1f} ms; scikit-learn {theirs * 1e3:.0f} ms;"
            f" ratio {theirs / ours:.1f}"
        )


def main() -> None:
    """Read the arguments, run, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--decisions", type=int, default=6_400, help="of all episodes together")
    parser.add_argument("--parts", type=int, default=5, help="lines of speed and memory")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--targets", type=int, default=4)
    parser.add_argument("--nodes", type=int, default=200)
    arguments = parser.parse_args()
    torch.set_num_threads(1)  # the beliefs' threads each work alone
    env = Env(num_threads=arguments.threads)
    setups = [
        Setup(
            seed=FIRST_DEVELOPMENT_SEED + k,
            num_targets=arguments.targets,
            num_nodes=arguments.nodes,
        )
        for k in range(arguments.batch)
    ]
    speed = play(env, setups, arguments.decisions, arguments.parts)
    compare_with_sklearn(env, arguments.threads)
    print(f"{speed:.0f} node decisions a second")


if __name__ == "__main__":
    main()
