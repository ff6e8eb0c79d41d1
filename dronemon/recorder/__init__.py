"""The run folder: what a flight leaves behind, written as it happens and read whenever it ends."""

from dronemon.recorder.folder import (
    IN_FLIGHT,
    LINE_FILES,
    MISSION_FILE,
    NEEDED_BYTES,
    REWATCHED,
    RUN_FILES,
    SIMULATOR_LOG,
    TRUTH_FILE,
    Earlier,
    RunFolder,
)
from dronemon.recorder.writer import RunRecorder

__all__ = [
    "IN_FLIGHT",
    "LINE_FILES",
    "MISSION_FILE",
    "NEEDED_BYTES",
    "REWATCHED",
    "RUN_FILES",
    "SIMULATOR_LOG",
    "TRUTH_FILE",
    "Earlier",
    "RunFolder",
    "RunRecorder",
]
