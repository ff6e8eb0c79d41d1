"""Recipes are read whole, and every mistake in one is named with its line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from dronemon.errors import OptionError
from dronemon.policy import NetworkConfig, find_checkpoint, load_checkpoint
from dronemon.training.imitation import ExpertConfig
from dronemon.training.ppo import PpoConfig
from dronemon.training.recipe import Recipe, load_recipe


def test_what_a_recipe_leaves_out_keeps_its_default(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        "learner: expert\nnetwork: {width: 32}\n"
        "settings: {learning_rate: 1e-3, num_nodes: [20, 30], finish: {decisions: 9}}\n"
    )
    expert = ExpertConfig()
    assert load_recipe(str(path)) == Recipe(
        learner="expert",
        network=NetworkConfig(width=32),
        settings=replace(
            expert,
            learning_rate=1e-3,
            num_nodes=(20, 30),
            finish=replace(expert.finish, decisions=9),
        ),
    )


def test_a_recipe_written_down_is_the_same_recipe(tmp_path: Path) -> None:
    recipe = Recipe(learner="ppo", settings=PpoConfig(decisions=9))
    (tmp_path / "mine.yaml").write_text(recipe.text)
    assert load_recipe(str(tmp_path / "mine.yaml")) == recipe


def test_the_shipped_recipes_are_the_papers_ours_and_that_of_the_shipped_weights() -> None:
    assert load_recipe("paper") == Recipe(learner="ppo", settings=PpoConfig())
    assert load_recipe("expert") == Recipe()
    shipped, lessons = load_checkpoint(find_checkpoint(None)), load_recipe("anywhere")
    recipe = load_recipe("stamp")
    assert recipe.network == lessons.network == shipped.network.config
    assert recipe.facts["settings"] == dict(shipped.card.settings)
    assert lessons.scope == shipped.card.scope


def test_the_networks_of_table_2_differ_in_one_thing_alone() -> None:
    whole, blind, lstm = map(load_recipe, ("table2", "table2-no-predictions", "table2-lstm"))
    assert replace(blind, network=replace(blind.network, predictions=True)) == whole
    assert replace(lstm, network=replace(lstm.network, temporal="attention")) == whole
    assert whole.network == NetworkConfig(width=64, feed_forward=128, ways=True)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("settings: {priors: [all]}", ":1: settings.priors[0]: input should be 'full', 'number'"),
        ("settings: {priors: []}", ":1: settings.priors: "),
        ("learner: export", ":1: learner: input should be 'ppo' or 'expert', but is 'export'"),
        ("network:\n  widht: 32", ":2: network.widht: no such key; did you mean `width`?"),
        ("settings:\n  clip: 0.1", ":2: settings.clip: no such key"),
        ("learner: ppo\nsettings:\n  clip: 0", ":3: settings.clip: input should be greater than"),
        ("settings:\n  num_nodes: [9, 3]", ":2: settings.num_nodes: is [9, 3]; the lower bound"),
        ("settings: {finish: {lamb: 1}}", ":1: settings.finish.lamb: no such key; did you mean"),
        ("network: {width: 33}", ":1: network: width 33 is no multiple of 4 heads"),
        ("network: {stride: 0}", ":1: network: stride is 0; it must be at least 1"),
        ("- learner", ":1: a recipe file is a mapping"),
    ],
)
def test_a_mistake_is_named_with_its_line(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text + "\n")
    with pytest.raises(OptionError) as caught:
        load_recipe(str(path))
    assert str(caught.value).startswith(f"{path}{complaint}")


def test_a_missing_recipe_is_named_with_those_there_are() -> None:
    with pytest.raises(OptionError, match="shipped are: anywhere, expert, paper, stamp, table2"):
        load_recipe("stomp")
