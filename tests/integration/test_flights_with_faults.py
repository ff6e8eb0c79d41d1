"""A few of the flights of `benchmarks/faults.py`, each judged as there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    ("moment", "cases"),
    [
        ("take-off", ["everything again 1.5 s later", "Ctrl-C"]),
        ("patrol", ["GPS lost 12 s", "geofence", "SIGSTOP 5 s", "planner hangs", "disk full"]),
        ("return", ["silence 8 s", "never disarms"]),
    ],
)
def test_a_flight_with_a_fault_ends_as_promised(tmp_path: Path, moment: str, cases: list[str]):
    results = tmp_path / "faults.jsonl"
    options = ["--seeds", "1", "--moments", moment, "--results", str(results)]
    done = subprocess.run(
        [sys.executable, "benchmarks/faults.py", *options, "--cases", *cases],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert len(results.read_text().splitlines()) == len(cases) + 1
    assert "against what is promised 0" in results.with_suffix(".md").read_text()
