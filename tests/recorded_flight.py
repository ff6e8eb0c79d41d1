"""A flight's pictures as a drone leaves them: the simulator's, with poses in a table or in tags.

Degrees and attitudes are reckoned here without `dronemon.frames`: two derivations do not share an
error.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from functools import cache
from pathlib import Path

from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational
from scipy.spatial.transform import Rotation

from dronemon.frames import AreaFrame
from dronemon.types import CameraModel, Pose
from sim.renderer import Renderer
from sim.scene import Animal, Scene

CAMERA = CameraModel(width_px=640, height_px=480, horizontal_fov_rad=math.radians(90))
CENTRE = -33.9180, 18.4230
"""South and east, of the area."""
BEGAN = datetime(2025, 3, 9, 6, 30, 0, 250_000)
MISSION = f"""
name: pasture
area: {{side_m: 200, latitude_deg: {CENTRE[0]}, longitude_deg: {CENTRE[1]}}}
targets:
  - {{name: Bella, appearance: cow, prior_au: [0.5, 0.6]}}
  - {{name: Zuri, appearance: zebra}}
  - {{name: Rusty, appearance: fox, prior_au: simulated}}
  - {{name: Pan, appearance: panda}}
"""
PLACES_M = {"cow": (12.0, -8.0), "zebra": (-15.0, 22.0), "fox": (21.0, 30.0)}
"""North and east of the centre; the panda is nowhere."""
_E2 = 0.00669437999014
_W2 = 1.0 - _E2 * math.sin(math.radians(CENTRE[0])) ** 2
NORTH_M_PER_DEG = math.radians(6_378_137.0 * (1.0 - _E2) / _W2**1.5)
EAST_M_PER_DEG = math.radians(6_378_137.0 / math.sqrt(_W2) * math.cos(math.radians(CENTRE[0])))
"""By the radii of curvature of WGS-84."""
HEIGHT_M = 35.0
TABLE_HEAD = ("picture", "time_s", "latitude", "longitude", "altitude_m")
BODY = ("roll_deg", "pitch_deg", "yaw_deg")
GIMBAL = tuple(f"gimbal_{name}" for name in BODY)


@dataclass(frozen=True, slots=True, kw_only=True)
class Shot:
    """A picture: when, where (north, east in m), and roll, pitch, yaw of the vehicle or gimbal."""

    name: str
    time_s: float
    place_m: tuple[float, float]
    angles_deg: tuple[float, float, float]
    height_m: float = HEIGHT_M

    @property
    def degrees(self) -> tuple[float, float]:
        """Latitude and longitude."""
        north_m, east_m = self.place_m
        return CENTRE[0] + north_m / NORTH_M_PER_DEG, CENTRE[1] + east_m / EAST_M_PER_DEG

    def row(self) -> tuple[object, ...]:
        """Of a table."""
        latitude, longitude = self.degrees
        place = f"{latitude:.8f}", f"{longitude:.8f}"
        return (self.name, f"{self.time_s:.3f}", *place, self.height_m, *self.angles_deg)


def away_m(place: Mapping[str, float], place_m: tuple[float, float]) -> float:
    """How far a place on the globe is from north and east of the centre."""
    north_m = (place["latitude_deg"] - CENTRE[0]) * NORTH_M_PER_DEG
    east_m = (place["longitude_deg"] - CENTRE[1]) * EAST_M_PER_DEG
    return math.dist((north_m, east_m), place_m)


def mounted_attitude(
    body_deg: Sequence[float], mount_deg: Sequence[float]
) -> tuple[float, float, float]:
    """Of a camera on a vehicle, seen as looking down from a body."""
    body, mount = (
        Rotation.from_euler("ZYX", angles[::-1], degrees=True) for angles in (body_deg, mount_deg)
    )
    yaw, pitch, roll = (body * mount).as_euler("ZYX").tolist()
    return roll, pitch, yaw


def gimbal_attitude(angles_deg: Sequence[float]) -> tuple[float, float, float]:
    """Of a camera that looks ahead from the gimbal, seen as looking down from a body."""
    roll, pitch, yaw = angles_deg
    turned = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)
    down = turned * Rotation.from_euler("Y", 90.0, degrees=True)
    yaw, pitch, roll = down.as_euler("ZYX").tolist()
    return roll, pitch, yaw


def lanes(angles_deg: Sequence[Sequence[float]]) -> list[Shot]:
    """To the north and back, 6 m a picture at 4 m/s; the angles come in turn."""
    places_m = [(-24.0 + 6.0 * step, 0.0) for step in range(9)]
    places_m += [(24.0 - 6.0 * step, 24.0) for step in range(9)]
    return [
        Shot(
            name=f"DJI_{number:04d}.JPG",
            time_s=1.5 * number,
            place_m=place_m,
            angles_deg=tuple(angles_deg[number % len(angles_deg)]),
        )
        for number, place_m in enumerate(places_m)
    ]


@cache
def renderer() -> Renderer:
    return Renderer(CAMERA, 10_500)


def draw(shot: Shot, attitude_rad: tuple[float, float, float]) -> Image.Image:
    frame = AreaFrame(
        centre_ned_m=(0.0, 0.0),
        ground_down_m=0.0,
        side_m=200.0,
        heading_rad=0.0,
        cruise_speed_m_s=5.0,
    )
    pose = Pose(
        time_s=shot.time_s,
        position_ned_m=(*shot.place_m, -shot.height_m),
        velocity_ned_m_s=(0.0, 0.0, 0.0),
        attitude_rad=attitude_rad,
    )
    animals = tuple(
        Animal(name=look, appearance=look, position_ned_m=at, heading_rad=0.7, walked_m=0.0)
        for look, at in PLACES_M.items()
    )
    return Image.fromarray(
        renderer().render(Scene(pose=pose, frame=frame, animals=animals))[..., ::-1]
    )


def exif_of(shot: Shot) -> Image.Exif:
    """Date and place, south and east, to hundredths of seconds of arc."""
    exif, time = Image.Exif(), BEGAN + timedelta(seconds=shot.time_s)
    exif.get_ifd(ExifTags.IFD.Exif).update(
        {
            ExifTags.Base.DateTimeOriginal: time.strftime("%Y:%m:%d %H:%M:%S"),
            ExifTags.Base.SubsecTimeOriginal: f"{time.microsecond // 1000:03d}",
            ExifTags.Base.OffsetTimeOriginal: "+02:00",
        }
    )
    gps: dict[int, object] = {}
    names = zip((1, 3), (("S", "N"), ("W", "E")), shot.degrees, strict=True)
    for tag, (minus, plus), value in names:
        seconds = round(abs(value) * 3600.0 * 10_000.0)
        degrees, rest = divmod(seconds, 36_000_000)
        minutes, rest = divmod(rest, 600_000)
        gps |= {tag: plus if value > 0 else minus}
        gps |= {tag + 1: (IFDRational(degrees), IFDRational(minutes), IFDRational(rest, 10_000))}
    exif.get_ifd(ExifTags.IFD.GPSInfo).update(gps)
    return exif


def xmp_of(shot: Shot, *, is_element: bool = False, has_place: bool = True) -> bytes:
    """As a drone of DJI writes it, as attributes or as elements."""
    roll, pitch, yaw = shot.angles_deg
    latitude, longitude = shot.degrees
    said = {
        "AbsoluteAltitude": f"{shot.height_m + 210.0:+.2f}",
        "RelativeAltitude": f"{shot.height_m:+.2f}",
        "GimbalRollDegree": f"{roll:+.2f}",
        "GimbalYawDegree": f"{yaw:+.2f}",
        "GimbalPitchDegree": f"{pitch:+.2f}",
        "FlightYawDegree": "+12.30",
    }
    if has_place:
        said |= {"GpsLatitude": f"{latitude:+.9f}", "GpsLongitude": f"{longitude:+.9f}"}
    attributes = "" if is_element else " ".join(f'drone-dji:{k}="{v}"' for k, v in said.items())
    inside = "".join(f"<drone-dji:{k}>{v}</drone-dji:{k}>" for k, v in said.items())
    return (
        '<?xpacket begin="\ufeff" id="W5M0MpCehiHzreSzNTczkc9d"?>'
        '<x:xmpmeta xmlns:x="adobe:ns:meta/">'
        '<rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description '
        f'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/" {attributes}>'
        f"{inside if is_element else ''}</rdf:Description></rdf:RDF></x:xmpmeta>"
        '<?xpacket end="w"?>'
    ).encode()


def save_tagged(folder: Path, shots: Sequence[Shot], **xmp: bool) -> None:
    """Pictures that tell by themselves how the gimbal held the camera."""
    folder.mkdir(exist_ok=True)
    for shot in shots:
        picture = draw(shot, gimbal_attitude(shot.angles_deg))
        told = {"exif": exif_of(shot), "xmp": xmp_of(shot, **xmp)}
        picture.save(folder / shot.name, "JPEG", quality=92, **told)


def save_with_table(
    folder: Path, shots: Sequence[Shot], mount_deg: Sequence[float] = (0.0, 0.0, 0.0)
) -> Path:
    """Pictures of a camera mounted on a vehicle, with a table beside them."""
    folder.mkdir(exist_ok=True)
    for shot in shots:
        picture = draw(shot, mounted_attitude(shot.angles_deg, mount_deg))
        picture.save(folder / shot.name, "JPEG", quality=92)
    return write_table(folder, [shot.row() for shot in shots])


def write_table(
    folder: Path, rows: Sequence[Sequence[object]], angles: tuple[str, ...] = BODY
) -> Path:
    path = folder / "poses.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([(*TABLE_HEAD, *angles), *rows])
    return path
