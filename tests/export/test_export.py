"""A flight's places, written for other programs and read back by theirs."""

from __future__ import annotations

import csv
import errno
import json
import math
import os
import shutil
import socket
import zipfile
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import fastkml
import gpxpy
import numpy as np
import pymap3d
import pytest
from fake_link import ORIGIN
from fastkml.validator import validate
from geojson_pydantic import FeatureCollection
from pymavlink.dialects.v20 import common as mavlink
from small_flight import MISSION

from dronemon import cli
from dronemon.errors import DronemonError, OptionError, RecordError
from dronemon.events import AreaLaid, Measured, Stretch
from dronemon.export.formats import FORMATS, geojson, gpx, kml, write_all
from dronemon.export.live import SightingSender, cot_pack, station_pack
from dronemon.export.story import Fix, Sighting, Story, read_story, redacted
from dronemon.frames import AreaFrame, GeoPoint, ned_to_geo
from dronemon.mission import load_mission
from dronemon.recorder import RunFolder
from dronemon.types import Measurement, Pose

PLACES = {
    "north-east": (47.4, 8.5),
    "south-west": (-33.9, -70.6),
    "at 180 degrees": (-17.0, 179.9999),
    "at zero": (0.0, 0.0),
}
WHEN = datetime(2026, 11, 27, 12, 0, 0, 250_000, tzinfo=UTC)


def export(*options: object) -> None:
    with pytest.raises(SystemExit) as ended:
        cli.app(["export", *map(str, options)], standalone_mode=False)
    assert ended.value.code == 0


def place(latitude_deg: float, longitude_deg: float, north_m: float, east_m: float) -> GeoPoint:
    lat, lon, _ = pymap3d.ned2geodetic(north_m, east_m, 0.0, latitude_deg, longitude_deg, 0.0)
    return GeoPoint(latitude_deg=float(lat), longitude_deg=float(lon), altitude_m=12.0)


def made_story(where: str) -> Story:
    """A square of 200 m, a track once across it and back, and a sighting in its east."""
    at = PLACES[where]
    corners = [(-100, -100), (-100, 100), (100, 100), (100, -100)]
    sighting = Sighting(
        number=0,
        target="Bella",
        appearance="cow",
        time=WHEN,
        place=place(*at, 30.0, 60.0),
        error_m=1.5,
        score=0.9,
        crop=None,
    )
    walk = [(0, -90), (10, 90), (20, -90)]
    return Story(
        name="made",
        title="made",
        started=WHEN,
        cell_m=0.0,
        corners=tuple(place(*at, north, east) for north, east in corners),
        track=tuple(Fix(time=WHEN, place=place(*at, *step)) for step in walk),
        sightings=(sighting,),
    )


def offset_m(lonlat: Sequence[float], origin: Sequence[float]) -> tuple[float, float]:
    """North and east of another longitude and latitude."""
    north, east, _ = pymap3d.geodetic2ned(lonlat[1], lonlat[0], 0.0, origin[1], origin[0], 0.0)
    return float(north), float(east)


def away_m(longitude_deg: float, latitude_deg: float, point: GeoPoint) -> float:
    origin = point.longitude_deg, point.latitude_deg
    return math.hypot(*offset_m((longitude_deg, latitude_deg), origin))


def of_kind(collection: dict[str, Any], kind: str) -> list[dict[str, Any]]:
    return [f for f in collection["features"] if f["properties"]["kind"] == kind]


def test_a_flight_is_written_in_every_format_and_read_back(flown: Path, tmp_path: Path) -> None:
    export(flown, "--to", tmp_path)
    story = read_story(RunFolder.open(flown))
    assert len(story.sightings) >= 8
    assert len(story.track) > 20
    assert {path.name for path in tmp_path.iterdir()} == {*FORMATS, "pictures"}
    collection = json.loads((tmp_path / "sightings.geojson").read_text())
    FeatureCollection(**collection)
    (area,) = of_kind(collection, "area")
    ring = area["geometry"]["coordinates"][0]
    legs = [offset_m(ring[k + 1], ring[k]) for k in range(4)]
    assert [math.hypot(*leg) for leg in legs] == pytest.approx([100.0] * 4, abs=0.1)
    bearings_deg = [math.degrees(math.atan2(east, north)) % 90.0 for north, east in legs]
    assert bearings_deg == pytest.approx([30.0] * 4, abs=0.1)
    assert ring[0] == ring[-1]
    seen = of_kind(collection, "sighting")
    rows = list(csv.DictReader((tmp_path / "sightings.csv").read_text("utf-8").splitlines()))
    assert len(seen) == len(rows) == len(story.sightings)
    for feature, row, told in zip(seen, rows, story.sightings, strict=True):
        assert away_m(*feature["geometry"]["coordinates"], told.place) < 0.02
        assert away_m(float(row["longitude_deg"]), float(row["latitude_deg"]), told.place) < 0.02
        assert row["target"] == feature["properties"]["target"] == "Bella <1>"
        assert row["time"] == feature["properties"]["time"] == told.time.isoformat()[:23] + "Z"
        assert 0.0 < float(row["error_m"]) < 10.0
        picture = cv2.imread(str(tmp_path / row["picture"]))
        assert picture.shape == (96, 96, 3)
    track = gpxpy.parse((tmp_path / "track.gpx").read_text())
    assert len(track.waypoints) == len(seen)
    (points,) = ([*segment.points] for t in track.tracks for segment in t.segments)
    assert [p.time for p in points] == sorted(p.time for p in points)
    assert max(p.elevation for p in points) == pytest.approx(ORIGIN.altitude_m + 22.0, abs=1.0)
    with zipfile.ZipFile(tmp_path / "run.kmz") as archive:
        shown = archive.read("doc.kml")
        pictures = {name for name in archive.namelist() if name.startswith("pictures/")}
    assert len(pictures) == len(seen)
    assert all(f'src="{name}"' in shown.decode().replace("&quot;", '"') for name in pictures)
    events = ElementTree.parse(tmp_path / "sightings.cot").getroot()
    (event,) = events
    point = event.find("point")
    assert point is not None
    assert (
        away_m(float(point.get("lon", "")), float(point.get("lat", "")), story.sightings[-1].place)
        < 0.02
    )
    assert event.get("uid") == "dronemon.Reserve & <north>.Bella <1>"


@pytest.mark.parametrize("where", PLACES)
def test_every_hemisphere_is_where_it_is(where: str, tmp_path: Path) -> None:
    story = made_story(where)
    sighting = story.sightings[0]
    collection = json.loads(geojson(story))
    FeatureCollection(**collection)
    (seen,) = of_kind(collection, "sighting")
    assert away_m(*seen["geometry"]["coordinates"], sighting.place) < 0.02
    for kind in ("area", "track"):
        (feature,) = of_kind(collection, kind)
        geometry = feature["geometry"]
        is_cut = geometry["type"].startswith("Multi")
        assert is_cut == (where == "at 180 degrees")
        parts = geometry["coordinates"] if is_cut else [geometry["coordinates"]]
        for part in parts:
            ring = np.array(part[0] if kind == "area" else part)
            assert np.ptp(ring[:, 0]) < 1.0  # not around the world
            assert np.abs(ring[:, 0]).max() <= 180.0
            if kind == "area":  # counter-clockwise
                x, y = (ring - ring[0]).T
                assert float(np.sum(x[:-1] * y[1:] - x[1:] * y[:-1])) > 0.0
    waypoint = gpxpy.parse(gpx(story).decode()).waypoints[0]
    assert away_m(waypoint.longitude, waypoint.latitude, sighting.place) < 0.02
    file = tmp_path / "doc.kml"
    file.write_bytes(kml(story))
    assert validate(file_to_validate=file)
    document = next(iter(fastkml.KML.parse(file).features))
    marks = {mark.name: mark for mark in document.features}
    assert set(marks) == {"Area", "Track", "Bella"}
    assert away_m(*marks["Bella"].geometry.coords[0][:2], sighting.place) < 0.02
    assert marks["Bella"].time_stamp.dt == WHEN


@pytest.mark.parametrize("where", PLACES)
def test_what_is_redacted_is_coarse_and_nothing_says_more(where: str, tmp_path: Path) -> None:
    story = made_story(where)
    near = [
        replace(story.sightings[0], place=place(*PLACES[where], 30.0 + 0.1 * k, 60.0))
        for k in range(5)
    ]
    crop = tmp_path / "crop.jpg"
    crop.write_bytes(b"a picture")
    coarse = redacted(replace(story, sightings=tuple(replace(s, crop=crop) for s in near)), 1000.0)
    assert len({s.place for s in coarse.sightings}) <= 2
    for shown, true in zip(coarse.sightings, near, strict=True):
        off_m = away_m(shown.place.longitude_deg, shown.place.latitude_deg, true.place)
        assert off_m <= shown.error_m
        assert shown.place.altitude_m == 0.0
    assert coarse.track == ()  # or it would say when the drone was at a cell's edge
    assert b"<ele>" not in gpx(coarse)
    assert all(-180.0 <= s.place.longitude_deg < 180.0 for s in coarse.sightings)
    written = write_all(coarse, tmp_path / "out")
    assert not (tmp_path / "out" / "pictures").exists()
    text = b"".join(p.read_bytes() for p in written if p.suffix != ".kmz") + kml(coarse)
    for fix in (*story.track, *near):
        assert f"{fix.place.latitude_deg:.5f}".encode() not in text
        assert f"{fix.place.longitude_deg:.5f}".encode() not in text


def test_what_cannot_be_exported_says_what_to_do(flown: Path, tmp_path: Path) -> None:
    export(flown, "--to", tmp_path / "a")
    with pytest.raises(OptionError, match=r"already holds sightings\.geojson"):
        export(flown, "--to", tmp_path / "a")
    (tmp_path / "file").write_text("")
    with pytest.raises(OptionError, match="cannot be written"):
        export(flown, "--to", tmp_path / "file")
    with pytest.raises(RecordError, match="no run folder"):
        export(tmp_path / "a", "--to", tmp_path / "b")
    spoilt = tmp_path / "spoilt"
    spoilt.mkdir()
    for file in flown.iterdir():
        if file.is_file():
            (spoilt / file.name).write_bytes(file.read_bytes())
    events = (spoilt / "events.jsonl").read_text().splitlines(keepends=True)
    (spoilt / "events.jsonl").write_text("".join(e for e in events if '"ready"' not in e))
    with pytest.raises(RecordError, match="never laid over the ground"):
        export(spoilt, "--to", tmp_path / "b")
    (spoilt / "events.jsonl").write_text("".join(e.replace('"origin"', '"o"') for e in events))
    with pytest.raises(DronemonError, match="not those of this version"):
        export(spoilt, "--to", tmp_path / "b")


def test_a_full_disk_leaves_no_half_that_holds_up_the_next_try(
    flown: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, full = Path.write_bytes, [True]

    def write_bytes(path: Path, data: bytes) -> int:
        if path.suffix == ".gpx" and full:
            write(path, data[:10])
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    with pytest.raises(OptionError, match="No space left"):
        export(flown, "--to", tmp_path)
    assert {path.name for path in tmp_path.iterdir()} <= {"pictures"}
    full.clear()
    export(flown, "--to", tmp_path)


def test_pictures_of_a_machine_without_a_clock_are_exported(flown: Path, tmp_path: Path) -> None:
    shutil.copytree(flown, tmp_path / "run")
    for crop in (tmp_path / "run" / "crops").iterdir():
        os.utime(crop, (0, 0))
    export(tmp_path / "run", "--to", tmp_path / "out")


class Receiver:
    """Hears datagrams on loopback."""

    def __init__(self) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(5.0)
        self.url = f"udp://127.0.0.1:{self._socket.getsockname()[1]}"

    def __enter__(self) -> Receiver:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()

    def next(self) -> bytes:
        return self._socket.recv(65536)


@pytest.mark.parametrize("cell_m", [0.0, 1000.0])
def test_sightings_are_sent_while_it_flies(tmp_path: Path, cell_m: float) -> None:
    (tmp_path / "m.yaml").write_text(MISSION)
    mission = load_mission(tmp_path / "m.yaml").mission
    laid, measured = laid_and_measured()
    with (
        Receiver() as receiver,
        SightingSender(
            receiver.url, "--cot", mission, partial(cot_pack, mission), cell_m
        ) as sender,
    ):
        sender.take(measured)  # nobody knows where
        sender.take(laid)
        sender.take(measured)
        event = ElementTree.fromstring(receiver.next())
        assert not sender.lost
    point = event.find("point")
    assert point is not None
    place = ned_to_geo((*laid.area.au_to_ned(np.array([0.3, 0.55])), 0.0), laid.origin)
    off_m = away_m(float(point.get("lon", "")), float(point.get("lat", "")), place)
    assert off_m <= float(point.get("ce", ""))
    assert (off_m < 0.02) == (cell_m == 0.0)
    assert event.get("uid") == "dronemon.Reserve & <north>.Bella <1>"


def test_a_ground_station_is_told_once_of_each_contact_and_marks_every_sighting(
    tmp_path: Path,
) -> None:
    (tmp_path / "m.yaml").write_text(MISSION)
    mission = load_mission(tmp_path / "m.yaml").mission
    laid, measured = laid_and_measured()
    packing = partial(station_pack, has_markers=True)
    reader = mavlink.MAVLink(None)
    with (
        Receiver() as receiver,
        SightingSender(receiver.url, "--station", mission, packing, 0.0) as sender,
    ):
        sender.take(laid)
        for time_s in (4.0, 8.0, 38.5):
            sender.take(replace(measured, time_s=time_s))
        heard = [reader.parse_char(receiver.next()) for _ in range(5)]
        assert not sender.lost
    kinds = ["STATUSTEXT", "ADSB_VEHICLE", "ADSB_VEHICLE", "STATUSTEXT", "ADSB_VEHICLE"]
    assert [message.get_type() for message in heard] == kinds
    assert {(m.get_srcSystem(), m.get_srcComponent()) for m in heard} == {(5, 191)}
    place = ned_to_geo((*laid.area.au_to_ned(np.array([0.3, 0.55])), 0.0), laid.origin)
    words = f"Bella <1> {place.latitude_deg:.5f} {place.longitude_deg:.5f} +-2 m"
    assert heard[0].text == words
    marker = heard[1]
    assert away_m(marker.lon / 1e7, marker.lat / 1e7, place) < 0.02
    assert (marker.callsign, marker.ICAO_address) == ("Bella <1", 0xF00000)


def laid_and_measured() -> tuple[AreaLaid, Measured]:
    area = AreaFrame(
        centre_ned_m=(10.0, 20.0),
        ground_down_m=0.0,
        side_m=100.0,
        heading_rad=0.5,
        cruise_speed_m_s=5.0,
    )
    laid = AreaLaid(
        system_id=5,
        area=area,
        origin=ORIGIN,
        footprint_radius_m=10.0,
        fence_ned_m=np.zeros((4, 2)),
        nodes_au=np.zeros((2, 2)),
        edges=np.array([[0, 1]]),
    )
    at_rest = (0.0, 0.0, 0.0)
    measured = Measured(
        number=1,
        time_s=4.0,
        measurement=Measurement(
            time_au=0.1,
            agent_au=np.array([0.3, 0.5]),
            seen=np.array([True, False]),
            target_au=np.array([[0.3, 0.55], [np.nan, np.nan]]),
        ),
        score=np.array([0.9, np.nan]),
        pose=Pose(
            time_s=4.0, position_ned_m=at_rest, velocity_ned_m_s=at_rest, attitude_rad=at_rest
        ),
        covariance_m2=np.array([0.4 * np.eye(2), np.full((2, 2), np.nan)]),
        error_m=np.array([1.5, np.nan]),
        stretch=Stretch(
            pictured_m=0.0,
            flown_m=0.0,
            duration_s=0.0,
            pictures_due=1,
            speeds_m_s=(),
            cross_track_m=(),
        ),
    )
    return laid, measured


@pytest.mark.parametrize(
    "url", ["udp://127.0.0.1", "tcp://127.0.0.1:1", "127.0.0.1:1", "udp://:9", "udp://a:b"]
)
def test_where_to_send_is_checked(url: str, tmp_path: Path) -> None:
    (tmp_path / "m.yaml").write_text(MISSION)
    mission = load_mission(tmp_path / "m.yaml").mission
    with pytest.raises(OptionError, match="give udp://HOST:PORT"):
        SightingSender(url, "--cot", mission, partial(cot_pack, mission))
