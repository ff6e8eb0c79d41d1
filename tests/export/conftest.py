"""One small flight for all."""

from __future__ import annotations

from pathlib import Path

import pytest
import virtual_time
from small_flight import fly


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flown")
    virtual_time.run(fly(folder))
    return folder / "run"
