"""Makes the pictures of README and docs from a run: `python docs/pictures.py RUN [--at AU]`.

README's is of `dronemon fly animals --horizon-au 13 --out RUN`, at 9.56 au.
Needs what draws without a screen:
apt-get install mesa-vulkan-drivers libvulkan1 libgl1-mesa-dri libegl1
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np
from rerun.experimental import ViewerClient

from dronemon.recorder import RunFolder
from dronemon.types import ImageArray
from dronemon.viz.entities import TIMELINE
from dronemon.viz.page import free_port, rerun_program

DOCS = Path(__file__).parent
WIDTH_PX, _TOP_BAR_PX = 1600, 30
LIMIT_S = 60.0
_STILL = 0.5
"""Mean difference of two pictures in a row, of 255, below which nothing is loading any more."""


def main() -> None:
    """Show the run in a viewer without a screen, and take the picture once it stands still."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--at", type=float, default=12.0, metavar="AU")
    options = parser.parse_args()
    folder = RunFolder.open(options.run)
    mission = folder.mission()
    start_s = next(event["start_s"] for event in folder.events() if "start_s" in event)
    with ViewerClient.spawn(
        headless=True,
        port=free_port(9876),
        hide_welcome_screen=True,
        executable_path=rerun_program(),
    ) as viewer:
        viewer.open(str(folder.rrd_path.absolute()))
        viewer.set_time(
            TIMELINE,
            duration=start_s + options.at * mission.seconds_per_au,
            play_state="paused",
        )
        picture = _still_picture(viewer)
    cv2.imwrite(str(DOCS / "flight.png"), picture[_TOP_BAR_PX:])


def _still_picture(viewer: ViewerClient) -> ImageArray:
    """A screenshot in which all has loaded."""
    deadline_s, before = time.monotonic() + LIMIT_S, None
    while time.monotonic() < deadline_s:
        time.sleep(2.0)
        png = viewer.take_screenshot(max_size=WIDTH_PX)
        picture = np.asarray(cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR), np.uint8)
        if before is not None and np.abs(picture.astype(float) - before).mean() < _STILL:
            return picture
        before = picture
    raise TimeoutError(f"the viewer was still drawing after {LIMIT_S:g} s")


if __name__ == "__main__":
    main()
