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
def double(value):
    return 2 * value
if __name__ == "__main__":
    print(sorted(share_out(double, [1, 2, 3], 2)))
"""


def threads(_: int) -> int:
    return torch.get_num_threads()


def die(_: int) -> None:
    os._exit(9)


@pytest.mark.parametrize("num_workers", [1, 2])
def test_every_item_is_done_once_on_one_thread(num_workers: int) -> None:
    assert sorted(share_out(abs, [-3, 2, 1], num_workers)) == [1, 2, 3]
    assert list(share_out(threads, [0, 0], num_workers)) == [1, 1]


def test_nothing_to_do_needs_no_process() -> None:
    assert list(share_out(abs, [], 4)) == []


def test_an_error_of_the_work_is_the_callers() -> None:
    with pytest.raises(ZeroDivisionError):
        list(share_out(divmod_by_zero, [1, 2], 2))


def divmod_by_zero(value: int) -> tuple[int, int]:
    return divmod(value, 0)


def test_a_process_that_dies_is_told_with_what_to_do() -> None:
    with (
        closing(share_out(die, [1, 2], 2)) as shared,
        pytest.raises(WorkerError, match=r"one of 2 worker processes died.*--workers"),
    ):
        next(shared)


@pytest.mark.parametrize(
    ("script", "exit_code", "said"), [(GUARDED, 0, "[2, 4, 6]"), (UNGUARDED, 1, "under `if __name")]
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
    assert said in (done.stdout + done.stderr).splitlines()[-1]
