"""The live page in a real browser, beside a flight that must not be slower for it.

apt-get install chromium && pip install -e '.[browser]' && python -m pytest -m browser
"""

from __future__ import annotations

import json
import re
import shutil
import sys
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
import pytest
from simulated_vehicle import StartProgram

sync_api = pytest.importorskip("playwright.sync_api")
CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome")
FIRST_PICTURE_LIMIT_S = 90.0
HORIZON_AU = 1.5  # a minute

pytestmark = [
    pytest.mark.browser,
    pytest.mark.timeout(400),
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here"),
]


def patrol_s(run: Path) -> float:
    """By the wall clock."""
    lines = [json.loads(line) for line in (run / "events.jsonl").read_text().splitlines()]
    walls = {line["kind"]: datetime.fromisoformat(line["wall"]) for line in lines}
    return (walls["homecoming"] - walls["patrol"]).total_seconds()


def spread(png: bytes) -> float:
    """How much the colours of a picture differ."""
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return float(picture.astype(np.float64).std(axis=(0, 1)).max())


def test_the_page_shows_the_flight_and_does_not_slow_it(
    tmp_path: Path, start_program: StartProgram, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SSH_CONNECTION"):
        monkeypatch.delenv(name, raising=False)

    def start(out: str, *options: str):
        options = ("--speed-up", "1", "--horizon-au", str(HORIZON_AU), *options)
        command = [sys.executable, "-m", "dronemon.cli", "fly", "animals", "--planner", "tsp"]
        return start_program(
            [*command, "--out", str(tmp_path / out), *options], stdout=-1, text=True
        )

    plain = start("plain")
    assert plain.wait(200.0) == 0
    shown = start("shown", "--view")
    assert shown.stdout is not None
    url = next(found[0] for line in shown.stdout if (found := re.search(r"http://\S+", line)))
    pictures: list[bytes] = []
    with sync_api.sync_playwright() as playwright:
        arguments = [
            "--no-sandbox",
            "--use-gl=angle",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
        ]
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=arguments)
        page = browser.new_page(viewport={"width": 1400, "height": 900})
        page.goto(url)
        while shown.poll() is None and len(pictures) < 60:
            page.wait_for_timeout(1000.0)
            pictures.append(page.screenshot(timeout=FIRST_PICTURE_LIMIT_S * 1e3))
            if spread(pictures[-1]) > 20.0 and len(pictures) > 5:
                break
        browser.close()
    (tmp_path / "page.png").write_bytes(pictures[-1])
    assert spread(pictures[-1]) > 20.0, f"a uniform page: {tmp_path / 'page.png'}"
    assert shown.wait(200.0) == 0
    assert patrol_s(tmp_path / "shown") < 1.05 * patrol_s(tmp_path / "plain")
