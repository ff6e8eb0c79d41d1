"""Time and pose of a picture in its own EXIF and XMP, as drones of DJI write them.

The time is EXIF's DateTimeOriginal, with SubSecTimeOriginal and OffsetTimeOriginal where they are;
without the latter, by this machine's zone. The place is XMP's GpsLatitude and GpsLongitude, or
EXIF's; the altitude XMP's RelativeAltitude, above the take-off; the attitude its Gimbal...Degree.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator, Mapping
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from xml.parsers import expat

from PIL import ExifTags, Image

from dronemon.camera.taken import Taken, checked_attitude, checked_place, checked_time, number
from dronemon.errors import CameraError, blaming

_DJI = "http://www.dji.com/drone-dji/1.0/"
_ALTITUDE = "RelativeAltitude"
_ANGLES = ("GimbalRollDegree", "GimbalPitchDegree", "GimbalYawDegree")
_LATITUDE, _LONGITUDE = "GpsLatitude", "GpsLongitude"
_AS_ONCE_SPELT = "GpsLongtitude"
"""So older drones have it."""
_MOST_BYTES = 1 << 20
_ELSE = "give a table with --poses"


@contextlib.contextmanager
def opened(file: Path) -> Iterator[Image.Image]:
    """A picture's header. Raises CameraError, which does not name it."""
    with blaming("Pillow", CameraError), warnings.catch_warnings(action="ignore"):
        try:
            image = Image.open(file)
        except (OSError, Image.DecompressionBombError) as exc:
            raise CameraError(f"is no picture that can be read: {exc}") from exc
        with image:
            yield image


def read_tags(image: Image.Image, file: Path) -> Taken:
    """What a picture says of itself. Raises CameraError, which does not name it."""
    try:
        said, exif = _said(image), image.getexif()
        if missing := [name for name in (_ALTITUDE, *_ANGLES) if name not in said]:
            raise ValueError(f"its XMP has no drone-dji:{', '.join(missing)}; {_ELSE}")
        return Taken(
            told_by=str(file),
            name=file.name,
            time=_time(exif.get_ifd(ExifTags.IFD.Exif)),
            place=checked_place(*_place(said, exif), _number(said, _ALTITUDE)),
            attitude_rad=checked_attitude([_number(said, a) for a in _ANGLES], has_gimbal=True),
            has_gimbal=True,
        )
    except (ValueError, expat.ExpatError) as exc:
        raise CameraError(str(exc)) from exc


def has_tags(image: Image.Image) -> bool:
    """Whether a picture seems to say where it was taken."""
    with contextlib.suppress(ValueError, expat.ExpatError):
        return _ALTITUDE in _said(image)
    return False


def _said(image: Image.Image) -> dict[str, str]:
    """What the XMP says in DJI's names, as attributes or elements.

    Raises ValueError, also for a DTD: no entity is ever read; and ExpatError.
    """
    said: dict[str, str] = {}
    packet = image.info.get("xmp", b"")
    if not isinstance(packet, bytes) or len(packet) > _MOST_BYTES:
        raise ValueError(f"its XMP is no text, or larger than {_MOST_BYTES} bytes")
    if not (packet := packet.strip(b"\0 \t\r\n")):
        return said
    inside: list[str] = []

    def start(name: str, attributes: Mapping[str, str]) -> None:
        inside.append(name)
        said.update(
            (key.removeprefix(f"{_DJI} "), value)
            for key, value in attributes.items()
            if key.startswith(f"{_DJI} ")
        )

    def text(data: str) -> None:
        if inside[-1].startswith(f"{_DJI} "):
            key = inside[-1].removeprefix(f"{_DJI} ")
            said[key] = said.get(key, "") + data

    def refuse(*_: object) -> None:
        raise ValueError("its XMP has a DTD, which no camera writes: it is not read")

    parser = expat.ParserCreate(namespace_separator=" ")
    parser.StartElementHandler, parser.CharacterDataHandler = start, text
    parser.EndElementHandler = lambda _: inside.pop()
    parser.StartDoctypeDeclHandler = refuse
    parser.Parse(packet, True)
    return said


def _number(said: Mapping[str, str], name: str) -> float:
    try:
        return number(said[name])
    except ValueError as exc:
        raise ValueError(f"drone-dji:{name} {exc}") from exc


def _place(said: Mapping[str, str], exif: Image.Exif) -> tuple[float, float]:
    """Latitude and longitude: XMP has more digits."""
    longitude = next((name for name in (_LONGITUDE, _AS_ONCE_SPELT) if name in said), None)
    if _LATITUDE in said and longitude is not None:
        return _number(said, _LATITUDE), _number(said, longitude)
    gps = exif.get_ifd(ExifTags.IFD.GPSInfo)
    try:
        return (
            _degrees(gps, ExifTags.GPS.GPSLatitude, ExifTags.GPS.GPSLatitudeRef),
            _degrees(gps, ExifTags.GPS.GPSLongitude, ExifTags.GPS.GPSLongitudeRef),
        )
    except (LookupError, TypeError, ValueError, ArithmeticError):
        raise ValueError(f"it has no GPS, neither in EXIF nor in XMP; {_ELSE}") from None


def _degrees(gps: Mapping[int, Any], value: int, ref: int) -> float:
    degrees, minutes, seconds = map(float, gps[value])
    sign = {"N": 1.0, "E": 1.0, "S": -1.0, "W": -1.0}[gps[ref].strip("\0 ")]
    return sign * (degrees + minutes / 60.0 + seconds / 3600.0)


def _time(exif: Mapping[int, Any]) -> datetime:
    told = str(exif.get(ExifTags.Base.DateTimeOriginal, ""))
    part = str(exif.get(ExifTags.Base.SubsecTimeOriginal, "")).strip("\0 ")
    zone = str(exif.get(ExifTags.Base.OffsetTimeOriginal, "")).strip("\0 ")
    try:
        time = checked_time(datetime.strptime(told.strip("\0 "), "%Y:%m:%d %H:%M:%S"))
        if zone:
            time = time.replace(tzinfo=datetime.strptime(zone, "%z").tzinfo)
        return time + timedelta(seconds=number(f"0.{part}") if part else 0.0)
    except ValueError:
        shown = f"{told!a:.40} with {part!a:.20} and {zone!a:.20}"
        raise ValueError(f"its DateTimeOriginal {shown} is no time; {_ELSE}") from None
