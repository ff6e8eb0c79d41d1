"""Checkpoints come back as they were written, or are refused with the reason."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import torch

from dronemon.card import read_card
from dronemon.errors import CheckpointMismatch
from dronemon.policy import (
    Card,
    NetworkConfig,
    PolicyNetwork,
    Scope,
    find_checkpoint,
    load_checkpoint,
    save_checkpoint,
)

SMALL = NetworkConfig(width=16, num_heads=4, feed_forward=24)
CARD = Card(
    recipe="expert",
    command="dronemon train --recipe expert",
    commit="0123abc",
    date="2026-01-01",
    seeds="20000 and up; chosen on 10000..10015",
    settings={"episodes": 3},
    curve=({"minutes": 1.0, "unc": 0.8}, {"minutes": 2.0, "unc": 0.75}),
    scores={"unc": 0.75},
    scope=Scope(num_targets=(2, 8), num_nodes=(150, 200), speed_ratio=(0.025, 0.15)),
)


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    path = tmp_path / "small.pt"
    save_checkpoint(path, PolicyNetwork(SMALL), CARD)
    return path


def test_network_and_card_come_back(saved: Path) -> None:
    checkpoint = load_checkpoint(saved, expected=SMALL)
    assert checkpoint.card == CARD
    assert not checkpoint.network.training
    again = saved.with_name("again.pt")
    save_checkpoint(again, checkpoint.network, checkpoint.card)
    for name, value in load_checkpoint(again).network.state_dict().items():
        assert torch.equal(value, checkpoint.network.state_dict()[name])
    assert sorted(p.name for p in saved.parent.iterdir()) == ["again.pt", "small.pt"]


def test_the_card_is_a_page() -> None:
    page = CARD.markdown("small", asdict(SMALL))
    assert "`dronemon train --recipe expert`" in page
    assert "| 2 | 0.75 |" in page


@pytest.mark.parametrize(
    ("mission", "sentence"),
    [
        ({}, None),
        ({"speed_ratio": None}, None),
        ({"num_targets": 9}, "9 targets: the network was trained for 2 to 8"),
        ({"num_nodes": 149}, "149 nodes of the roadmap: the network was trained for 150 to 200"),
        ({"speed_ratio": 0.2}, "0.2 times the drone's speed for the targets: the network was"),
        ({"unplaced": ["Zuri", "Rua"]}, "the first position is unknown of Zuri, Rua: the network"),
    ],
)
def test_what_lies_outside_training_is_said(mission: dict[str, Any], sentence: str | None) -> None:
    usual = {"num_targets": 2, "num_nodes": 200, "speed_ratio": 0.025, "unplaced": []}
    assert CARD.scope is not None
    said = CARD.scope.outside(**{**usual, **mission})
    assert len(said) == (sentence is not None)
    assert not said or said[0].startswith(str(sentence))


def test_the_card_is_read_from_a_whole_file_without_its_weights(saved: Path) -> None:
    assert read_card(saved) == CARD
    content = bytearray(saved.read_bytes())
    content[len(content) // 2] ^= 0x55
    saved.write_bytes(content)
    with pytest.raises(CheckpointMismatch, match="damaged"):
        read_card(saved)
    saved.write_text("notes")
    with pytest.raises(CheckpointMismatch, match="not a readable checkpoint"):
        read_card(saved)


def test_another_network_is_refused(saved: Path) -> None:
    with pytest.raises(CheckpointMismatch, match="its stride is 5, not 3"):
        load_checkpoint(saved, expected=replace(SMALL, stride=3))


@pytest.mark.parametrize("position", [0.02, 0.5, 0.98])
def test_a_damaged_file_is_refused(saved: Path, position: float) -> None:
    content = bytearray(saved.read_bytes())
    at = int(position * len(content))
    content[at : at + 64] = bytes(b ^ 0x55 for b in content[at : at + 64])
    saved.write_bytes(content)
    with pytest.raises(CheckpointMismatch):
        load_checkpoint(saved)


@pytest.mark.parametrize("content", [b"\x80\x02.", b"R" * 300, b"0.", b"\x80\x02e", b"PK\x03\x04"])
def test_foreign_bytes_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "foreign.pt"
    path.write_bytes(content)
    with pytest.raises(CheckpointMismatch, match=r"foreign\.pt"):
        load_checkpoint(path)
    with pytest.raises(CheckpointMismatch, match=r"foreign\.pt"):
        read_card(path)


def test_half_a_file_is_refused(saved: Path) -> None:
    saved.write_bytes(saved.read_bytes()[: saved.stat().st_size // 2])
    with pytest.raises(CheckpointMismatch, match=r"small\.pt"):
        load_checkpoint(saved)


def test_a_file_that_runs_code_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "unsafe.pt"
    torch.save({"format": Path.cwd}, path)
    with pytest.raises(CheckpointMismatch, match="unsafe"):
        load_checkpoint(path)


def test_other_content_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "other.pt"
    torch.save({"weights": torch.zeros(2)}, path)
    with pytest.raises(CheckpointMismatch, match="something else"):
        load_checkpoint(path)
    torch.save([1, 2], path)
    with pytest.raises(CheckpointMismatch, match="holds a list"):
        load_checkpoint(path)


def test_a_missing_file_is_named() -> None:
    with pytest.raises(CheckpointMismatch, match=r"nowhere\.pt: no such checkpoint"):
        find_checkpoint("nowhere.pt")
    with pytest.raises(CheckpointMismatch, match="no such file"):
        load_checkpoint(Path("nowhere.pt"))


def test_no_file_of_ones_own_stands_in_for_the_shipped_weights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("stamp").write_text("notes")
    assert find_checkpoint(None).name == "stamp.pt"
    assert find_checkpoint("stamp") == Path("stamp")


def test_the_training_page_tells_how_the_shipped_weights_were_made() -> None:
    root = Path(__file__).parents[2]
    command = load_checkpoint(find_checkpoint(None)).card.command
    assert f"\n    {command}\n" in (root / "docs" / "training.md").read_text()
    assert f"- Command: `{command}`\n" in (root / "models" / "stamp.md").read_text()
