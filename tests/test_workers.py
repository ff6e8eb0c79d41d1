"""Shared work comes back, and ends with whoever asked for it."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
import torch

from dronemon.errors import WorkerError
from dronemon.workers import share_out

UNGUARDED = """
from dronemon.workers import share_out
print(sorted(share_out(abs, [-1, -2, -3], 2)))
"""
GUARDED = """
from dronemon.workers import share_out
def done(value):
    import torch
    return value, torch.get_num_threads()
if __name__ == "__main__":
    print(sorted(share_out(done, [1, 2, 3], 2)))
"""


def threads(_: int) -> int:
    return torch.get_num_threads()


def die(_: int) -> None:
    os._exit(9)


def test_one_worker_is_this_process_on_one_thread() -> None:
    torch.set_num_threads(2)
    try:
        assert list(share_out(threads, [0, 0], 1)) == [1, 1]
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(1)


def test_nothing_to_do_needs_no_process() -> None:
    assert list(share_out(abs, [], 4)) == []


@pytest.mark.slow
def test_a_process_that_dies_is_told_with_what_to_do() -> None:
    with (
        closing(share_out(die, [1, 2], 2)) as shared,
        pytest.raises(WorkerError, match=r"one of 2 worker processes died.*--workers"),
    ):
        next(shared)


@pytest.mark.parametrize(
    ("script", "exit_code", "said"),
    [
        pytest.param(GUARDED, 0, "[(1, 1), (2, 1), (3, 1)]", marks=pytest.mark.slow),
        (UNGUARDED, 1, "under `if __name"),
    ],
)
def test_a_script_of_ones_own_can_share_work_behind_a_guard(
    tmp_path: Path, script: str, exit_code: int, said: str
) -> None:
    path = tmp_path / "mine.py"
    path.write_text(script)
    done = subprocess.run(
        [sys.executable, str(path)], capture_output=True, text=True, timeout=60.0, check=False
    )
    assert done.returncode == exit_code, done.stderr
    assert said in done.stdout + done.stderr
