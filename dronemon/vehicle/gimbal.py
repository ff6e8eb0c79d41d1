"""What is heard of a gimbal's attitude: MAVLink messages to samples in vehicle time."""

from __future__ import annotations

import math
import statistics
from collections import deque
from collections.abc import Mapping
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

from dronemon.errors import CameraError
from dronemon.frames import body_to_ned, quaternion_to_rotation
from dronemon.types import FloatArray, GimbalAttitude
from dronemon.vehicle.vehicle_clock import LATE_MS

_DEVICE, _MOUNT = "GIMBAL_DEVICE_ATTITUDE_STATUS", "MOUNT_ORIENTATION"
GIMBAL_MESSAGES = {
    _DEVICE: mavlink.MAVLINK_MSG_ID_GIMBAL_DEVICE_ATTITUDE_STATUS,
    _MOUNT: mavlink.MAVLINK_MSG_ID_MOUNT_ORIENTATION,
}
"""Names and numbers of the messages that tell it; the second is the older one."""
GIMBAL_COMPONENTS = (
    mavlink.MAV_COMP_ID_GIMBAL,
    *range(mavlink.MAV_COMP_ID_GIMBAL2, mavlink.MAV_COMP_ID_GIMBAL6 + 1),
)
"""Components of a vehicle that may send them beside its autopilot."""
GIMBAL_GAP_S = 1.0
"""Vehicle time from one sample to the next by which what is between is not known."""
_KEPT, _LAGS_KEPT = 128, 20
_LENGTHS = 0.95, 1.05
_WIDEST_DEG = 720.0
_YAW_FRAMES = (
    mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
    | mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_EARTH_FRAME
)
_Source = tuple[str, int, int]


class GimbalTrack:
    """The last samples of one gimbal.

    A gimbal counts time from when itself was switched on: what its clock is behind the vehicle's is
    the median of how old its last stamps were when they were heard.
    """

    def __init__(self) -> None:
        self._samples: deque[GimbalAttitude] = deque(maxlen=_KEPT)
        self._lags_s: deque[float] = deque(maxlen=_LAGS_KEPT)
        self._sources: list[_Source] = []  # message, component, device; the first is followed
        self._stamp_ms = 0

    def forget(self) -> None:
        """Begin anew, as with a vehicle's clock that does."""
        self._samples.clear()
        self._lags_s.clear()
        self._sources.clear()

    def take(self, name: str, fields: Mapping[str, Any], now_s: float) -> None:
        """Take one message; `now_s` is vehicle time. Raises ValueError for what cannot be.

        Where the newer message is heard the older one, of the same gimbal, is left out.
        """
        rotation, is_from_heading = _READERS[name](fields)
        source = name, int(fields["component"]), int(fields.get("gimbal_device_id", 0))
        heard = {message for message, _, _ in self._sources}
        if name == _MOUNT and _DEVICE in heard:
            return
        if name == _DEVICE and _MOUNT in heard:
            self.forget()
        if source not in self._sources:
            self._sources.append(source)
        if source != self._sources[0]:
            return
        time_s = self._time_s(fields["time_boot_ms"], now_s)
        if time_s is not None and time_s > self.newest_s:
            sample = GimbalAttitude(
                time_s=time_s, rotation=rotation, is_from_heading=is_from_heading
            )
            self._samples.append(sample)

    def _time_s(self, stamp_ms: int, now_s: float) -> float | None:
        """Vehicle time of a stamp heard now; None for a copy that comes late."""
        if self._lags_s and 0 <= self._stamp_ms - stamp_ms <= LATE_MS:
            return None
        self._stamp_ms = stamp_ms
        lag_s = now_s - stamp_ms / 1000.0
        if self._lags_s and abs(lag_s - statistics.median(self._lags_s)) > GIMBAL_GAP_S:
            self._lags_s.clear()  # it was switched on anew
        self._lags_s.append(lag_s)
        return stamp_ms / 1000.0 + statistics.median(self._lags_s)

    @property
    def newest(self) -> GimbalAttitude | None:
        """The newest sample."""
        return self._samples[-1] if self._samples else None

    @property
    def newest_s(self) -> float:
        """Vehicle time of the newest sample."""
        return self._samples[-1].time_s if self._samples else -math.inf

    @property
    def doubt(self) -> str | None:
        """What is against believing it at all."""
        if len(self._sources) < 2:
            return None
        components = " and ".join(str(component) for _, component, _ in self._sources)
        return (
            f"several gimbals are heard, of components {components}, and nobody says which has the "
            "camera; have that one alone send to this link"
        )

    def around(self, time_s: float) -> tuple[GimbalAttitude, GimbalAttitude]:
        """The samples just before and just after an instant. Raises CameraError."""
        if self.doubt:
            raise CameraError(self.doubt)
        after = [sample for sample in self._samples if sample.time_s >= time_s]
        before = [sample for sample in self._samples if sample.time_s <= time_s]
        if before and after and after[0].time_s - before[-1].time_s <= GIMBAL_GAP_S:
            return before[-1], after[0]
        heard = f"; the one before is {time_s - before[-1].time_s:.1f} s older" if before else ""
        raise CameraError(
            f"the gimbal's attitude at the picture's instant was not heard{heard}, "
            f"{GIMBAL_GAP_S:g} s is the limit; does the gimbal still send it to this link?"
        )


def _from_device(fields: Mapping[str, Any]) -> tuple[FloatArray, bool]:
    """Rotation, and whether it is from the vehicle's heading. Raises ValueError."""
    quaternion = [float(value) for value in fields["q"]]
    length, flags = math.hypot(*quaternion), fields["flags"]
    if len(quaternion) != 4 or not _LENGTHS[0] <= length <= _LENGTHS[1]:  # NaN is never
        raise ValueError(f"q {quaternion} is no rotation")
    frame = flags & _YAW_FRAMES
    if frame == _YAW_FRAMES:
        raise ValueError(f"flags {flags} put its yaw into two frames")
    is_from_heading = (
        frame == mavlink.GIMBAL_DEVICE_FLAGS_YAW_IN_VEHICLE_FRAME
        if frame
        else not flags & mavlink.GIMBAL_DEVICE_FLAGS_YAW_LOCK
    )
    return quaternion_to_rotation([value / length for value in quaternion]), is_from_heading


def _from_mount(fields: Mapping[str, Any]) -> tuple[FloatArray, bool]:
    """The same. None stands for NaN, and a yaw over ground of 0 also for one that is not sent."""
    over_ground_deg, yaw_deg = (_number(fields.get(name)) for name in ("yaw_absolute", "yaw"))
    is_from_heading = not math.isnan(yaw_deg)
    if not is_from_heading:
        yaw_deg = over_ground_deg or math.nan
    angles_deg = (_number(fields["roll"]), _number(fields["pitch"]), yaw_deg)
    if not all(abs(angle) <= _WIDEST_DEG for angle in angles_deg):  # NaN is never
        raise ValueError(f"roll, pitch, yaw of {angles_deg} degrees")
    roll_rad, pitch_rad, yaw_rad = (math.radians(angle) for angle in angles_deg)
    return body_to_ned((roll_rad, pitch_rad, yaw_rad)), is_from_heading


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


_READERS = {_DEVICE: _from_device, _MOUNT: _from_mount}
