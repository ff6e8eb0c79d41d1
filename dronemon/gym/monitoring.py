"""`dronemon/Monitoring-v0`: one episode at a time, and many in step.

Targets walk on and are watched on, so nothing ends an episode from within: `terminated` is never
true. A limit of decisions, Gymnasium's `max_episode_steps`, breaks it off, which is `truncated`.
"""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from dronemon.errors import OptionError, did_you_mean
from dronemon.gym.episodes import Episodes, check_count, drawn_seed
from dronemon.gym.scene import Shown, line
from dronemon.types import ImageArray

NAME = "dronemon/Monitoring-v0"
DECISIONS = 256
"""Of an episode, unless `max_episode_steps` says otherwise; the paper's. Section IV-C."""


class Monitoring(gymnasium.Env[Shown, Any]):
    """One episode at a time. terms: as `Episodes` has them.

    `reset(seed=s)` begins the episode that `dronemon.env.Env` draws from `Setup(seed=s)`; without a
    seed one for training is drawn. `info` tells it, then of each decision `leg_au`, the length
    flown, and `area_std`, sigma_bar of each target at the leg's end.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # of the class there, too
        "render_modes": ["rgb_array"],
        "render_fps": 4,
    }

    def __init__(self, *, render_mode: str | None = None, **terms: Any) -> None:
        self.render_mode = _known(render_mode)
        self._episodes = _episodes(terms)
        self.observation_space = self._episodes.observation_space
        self.action_space = self._episodes.action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Shown, dict[str, Any]]:
        """Begin an episode. Raises OptionError if there are options: it knows none."""
        super().reset(seed=seed)
        _refuse(options)
        begun = drawn_seed(self.np_random) if seed is None else seed
        return line(self._episodes.begin([begun]), 0), {"seed": begun}

    def step(self, action: Any) -> tuple[Shown, float, bool, bool, dict[str, Any]]:
        """Fly where the action leads. Raises ValueError if it is not in the action space."""
        actions = _checked(action, self.action_space)[None]
        shown, rewards, told = self._episodes.step(actions)
        return line(shown, 0), float(rewards[0]), False, False, told[0]

    def render(self) -> ImageArray | None:
        """North up: beliefs, targets where they truly are, the agent and what it sees."""
        return self._episodes.draw()[0] if self.render_mode == "rgb_array" else None


_MOST = 1_000_000
"""Episodes in step, and decisions of one: more is a mistake."""


class MonitoringVector(VectorEnv[Shown, NDArray[Any], NDArray[Any]]):
    """Many episodes in step, each as `Monitoring` would play it; they begin and end together.

    The decision that ends them begins the next ones (`AutoresetMode.SAME_STEP`): what was observed
    last is in `infos["final_obs"]`, and what was told in `infos["final_info"]`, as `SyncVectorEnv`
    has it.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]  # of the class there, too
        **Monitoring.metadata,
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    def __init__(
        self,
        *,
        num_envs: int = 1,
        max_episode_steps: int = DECISIONS,
        render_mode: str | None = None,
        **terms: Any,
    ) -> None:
        check_count("num_envs", num_envs, 1, _MOST)
        check_count("max_episode_steps", max_episode_steps, 1, _MOST)
        self.num_envs, self.render_mode = num_envs, _known(render_mode)
        self._episodes = _episodes(terms)
        self.single_observation_space = self._episodes.observation_space
        self.single_action_space = self._episodes.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._max_decisions, self._decisions_left = max_episode_steps, 0
        self._streams = [seeding.np_random()[0] for _ in range(num_envs)]

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Shown, dict[str, Any]]:
        """Begin all episodes: of seeds `seed`, `seed` + 1, …, or of those listed.

        Raises OptionError if there are options, or not as many seeds as episodes.
        """
        _refuse(options)
        if isinstance(seed, Sequence):
            seeds = list(seed)
        else:
            seeds = [None if seed is None else seed + i for i in range(self.num_envs)]
        if len(seeds) != self.num_envs:
            raise OptionError(f"{len(seeds)} seeds for {self.num_envs} episodes; give each one")
        for given in seeds:
            if given is not None:
                check_count("seed", given, 0, 2**63 - 1)
        for i, given in enumerate(seeds):
            if given is not None:
                self._streams[i] = seeding.np_random(int(given))[0]
        return self._begin(seeds, {})

    def step(
        self, actions: NDArray[Any]
    ) -> tuple[Shown, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Fly where the actions lead. Raises ValueError if they are not in the action space."""
        shown, rewards, told = self._episodes.step(_checked(actions, self.action_space))
        self._decisions_left -= 1
        is_over = self._decisions_left == 0
        if is_over:
            told = [{"final_obs": line(shown, i), "final_info": t} for i, t in enumerate(told)]
        infos = self._gathered({}, told)
        if is_over:
            shown, infos = self._begin([None] * self.num_envs, infos)
        ends = np.full(self.num_envs, is_over)
        return shown, rewards, np.zeros_like(ends), ends, infos

    def render(self) -> tuple[ImageArray, ...] | None:
        """A picture of each episode, as `Monitoring.render` has it."""
        return tuple(self._episodes.draw()) if self.render_mode == "rgb_array" else None

    def _begin(
        self, seeds: Sequence[int | None], infos: dict[str, Any]
    ) -> tuple[Shown, dict[str, Any]]:
        """Begin all episodes, with drawn seeds where none is given. -> observed, told besides."""
        begun = [
            drawn_seed(stream) if seed is None else seed
            for seed, stream in zip(seeds, self._streams, strict=True)
        ]
        self._decisions_left = self._max_decisions
        shown = self._episodes.begin(begun)
        return shown, self._gathered(infos, [{"seed": seed} for seed in begun])

    def _gathered(self, infos: dict[str, Any], told: Sequence[dict[str, Any]]) -> dict[str, Any]:
        """What is told of each episode, as Gymnasium has it of many."""
        for i, info in enumerate(told):
            infos = self._add_info(infos, info, i)
        return infos


def _episodes(terms: dict[str, Any]) -> Episodes:
    """Episodes on these terms. Raises OptionError if there is no such term."""
    known = list(inspect.signature(Episodes).parameters)
    for name in terms:
        if name not in known:
            raise OptionError(
                f"{NAME} has no term {name!r}; {did_you_mean(name, known)}it has {', '.join(known)}"
            )
    return Episodes(**terms)


def _checked(action: Any, space: gymnasium.Space[Any]) -> NDArray[Any]:
    """An action as an array. Raises ValueError."""
    array = np.asarray(action)
    if array not in space:
        raise ValueError(f"action {action!r:.200} is not in the action space, {space}")
    return np.array(array, dtype=space.dtype)  # in this machine's order, and its own


def _known(render_mode: str | None) -> str | None:
    """The same, if it is one. Raises OptionError."""
    if render_mode not in (None, "rgb_array"):
        raise OptionError(f"render_mode is {render_mode!r}; it can be None or 'rgb_array'")
    return render_mode


def _refuse(options: dict[str, Any] | None) -> None:
    if options:
        raise OptionError(f"reset knows no options, and was given {', '.join(map(repr, options))}")


gymnasium.register(
    id=NAME,
    entry_point="dronemon.gym:Monitoring",
    vector_entry_point="dronemon.gym:MonitoringVector",
    max_episode_steps=DECISIONS,
)
