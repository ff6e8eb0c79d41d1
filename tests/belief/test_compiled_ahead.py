"""What `python -m dronemon.belief` compiles is found by the next process."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_compiled_loops_are_found(tmp_path: Path):
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}

    def run(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, *arguments],
            env=environment,
            check=True,
            capture_output=True,
            text=True,
            timeout=120,
        )
        return done.stdout.strip()

    ask = "from dronemon.belief.compiled import is_ready; print(is_ready())"
    count = (
        "import numpy as np, torch; from dronemon.belief import __main__ as ahead, compiled;"
        "ahead.main(); print(sum(compiled._predict.stats.cache_misses.values()))"
    )
    assert run("-c", ask) == "False"
    run("-m", "dronemon.belief")
    assert run("-c", ask) == "True"
    assert run("-c", count) == "0"
