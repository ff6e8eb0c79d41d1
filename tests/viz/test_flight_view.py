import math
import os
import resource
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from functools import partialmethod
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import cv2
import numpy as np
import psutil
import pytest
from rerun.chunk import RrdReader

from dronemon.arena import ARENA
from dronemon.belief import Belief
from dronemon.errors import RecordError, ViewError
from dronemon.events import (
    AreaLaid,
    Attended,
    Believed,
    Decided,
    Event,
    Measured,
    Moved,
    Noted,
    Pictured,
    Stretch,
    TruthTold,
)
from dronemon.frames import AreaFrame, GeoPoint, ground_to_pixel, ned_to_geo
from dronemon.mission import Mission
from dronemon.mission.schema import Area, Target, View
from dronemon.recorder import LINE_FILES
from dronemon.sightings import Sightings
from dronemon.types import Detection, Measurement, Picture, Pose
from dronemon.viz import FlightView
from dronemon.viz.entities import belief_grid_au
from dronemon.viz.page import LivePage, find_viewer
from dronemon.viz.recorded import picture_of

AREA = AreaFrame(
    centre_ned_m=(30.0, -12.0),
    ground_down_m=0.5,
    side_m=200.0,
    heading_rad=0.4,
    cruise_speed_m_s=5.0,
)
MISSION = Mission(
    name="two animals",
    area=Area(side_m=AREA.side_m, heading_deg=math.degrees(AREA.heading_rad)),
    targets=(Target(name="Bella", appearance="cow"), Target(name="Rusty & co/2", appearance="fox")),
)
ORIGIN = GeoPoint(latitude_deg=47.4, longitude_deg=8.5, altitude_m=488.0)
CAMERA = MISSION.camera.model
PICTURE = "/scene/vehicle/camera/picture"
RERUN = Path(str(find_spec("rerun_cli").submodule_search_locations[0])) / "rerun"
REPOSITORY = Path(__file__).parents[2]


def view(path: Path, *, port: int | None = None, **limits: int) -> FlightView:
    """A view of the mission, live where a port is given."""
    view = View() if port is None else View(live=True, port=port)
    return FlightView(path, MISSION.model_copy(update={"view": view}), **limits)


@pytest.fixture(autouse=True)
def _nowhere_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """No display, and nobody who came by ssh: what is shown is shown on a page here."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SSH_CONNECTION"):
        monkeypatch.delenv(name, raising=False)


def pose(time_s: float, position_au: tuple[float, float] = (0.5, 0.5)) -> Pose:
    north_m, east_m = AREA.au_to_ned(np.array(position_au))
    return Pose(
        time_s=time_s,
        position_ned_m=(float(north_m), float(east_m), -34.5),
        velocity_ned_m_s=(3.0, 4.0, 0.0),
        attitude_rad=(0.05, -0.1, 0.3),
    )


def measurement(seen: list[bool]) -> Measurement:
    return Measurement(
        time_au=0.1,
        agent_au=np.array([0.5, 0.5]),
        seen=np.array(seen),
        target_au=np.where(np.array(seen)[:, None], [[0.25, 0.75], [0.5, 0.5]], np.nan),
    )


def area_laid() -> AreaLaid:
    rng = np.random.default_rng(1)
    nodes_au, edges = rng.random((20, 2)), rng.integers(0, 20, (60, 2))
    fence_ned_m = AREA.au_to_ned(np.array([[-0.1, -0.1], [-0.1, 1.1], [1.1, 1.1], [1.1, -0.1]]))
    return AreaLaid(
        system_id=1,
        area=AREA,
        origin=ORIGIN,
        footprint_radius_m=20.0,
        fence_ned_m=fence_ned_m,
        nodes_au=nodes_au,
        edges=edges,
    )


def noted(time_s: float | None, kind: str, text: str, level: str = "INFO") -> Noted:
    return Noted(time_s=time_s, kind=kind, text=text, level=level, fields={})


def measured(time_s: float, seen: list[bool], battery: float | None = None) -> Measured:
    return Measured(
        number=1,
        time_s=time_s,
        measurement=measurement(seen),
        score=np.array([0.9, 0.9]),
        pose=pose(time_s),
        covariance_m2=np.tile(0.4 * np.eye(2), (2, 1, 1)),
        error_m=np.array([1.5, 1.5]),
        battery=battery,
        stretch=Stretch(
            pictured_m=0.0,
            flown_m=0.0,
            duration_s=0.0,
            pictures_due=1,
            speeds_m_s=(),
            cross_track_m=(),
        ),
    )


def decided(time_s: float) -> Decided:
    return Decided(
        time_s=time_s,
        time_au=0.1,
        flown_au=0.1,
        remaining_au=2.9,
        position_au=np.array([0.5, 0.5]),
        waypoint_au=np.array([0.9, 0.1]),
        node=None,
        num_measurements=1,
        decision_ms=4.0,
        details={},
    )


def belief() -> Belief:
    sightings = Sightings(np.array([[0.25, 0.7], [np.nan, np.nan]]))
    sightings.add(measurement([True, False]))
    return Belief(sightings)


def believed(time_s: float) -> Believed:
    return Believed(time_s=time_s, time_au=0.1, posterior=belief().posterior_of_now())


@pytest.fixture(scope="module", autouse=True)
def _ready() -> None:
    """Load compiled code, as the rehearsal before a flight does."""
    belief().posterior(np.zeros((1, 3)))


def happenings(num_measurements: int = 3) -> Iterator[Event]:
    """One of everything for each measurement, 4 s of vehicle time apart."""
    rng = np.random.default_rng(10_000)
    yield noted(None, "connect", "vehicle heard")
    yield area_laid()
    for number in range(num_measurements):
        time_s = 100.0 + 4.0 * number
        for step in range(40):
            yield Moved(pose=pose(time_s - 4.0 + 0.1 * step))
        yield measured(time_s, [number > 0, False], 0.9 - 0.1 * number)
        targets_au = np.array([[0.3, 0.3], [0.7, 0.7]])
        yield TruthTold(time_s=time_s, targets_au=targets_au)
        yield believed(time_s)
        yield decided(time_s)
        image = rng.integers(0, 256, (480, 640, 3), dtype=np.uint8)
        found = [Detection(appearance="fox", pixel_px=(300.0, 200.0), score=0.9)] * (number % 2)
        picture = Picture(time_s=time_s - 0.1, image=image)
        yield Pictured(
            number=number + 1,
            picture=picture,
            detections=found,
            owners=[1] * len(found),
            pose=pose(time_s - 0.1),
        )
    yield noted(200.0, "landed", "on the ground", "WARN")


def fly(shown: FlightView, num_measurements: int = 3) -> None:
    for event in happenings(num_measurements):
        shown.take(event)


def verify(path: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [RERUN, "rrd", "verify", path], capture_output=True, text=True, check=False
    )


def rows(path: Path, entity: str, component: str) -> list[tuple[float, Any]]:
    """Vehicle time (NaN: static) and value of each row of one component, in order of time."""
    found = []
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        if chunk.entity_path != entity or component not in batch.schema.names:
            continue
        values = batch.column(component).to_pylist()
        times_s = (
            [math.nan] * len(values)
            if chunk.is_static
            else [ns.value / 1e9 for ns in batch.column("vehicle_time")]
        )
        found += [(t, v) for t, v in zip(times_s, values, strict=True) if v is not None]
    return sorted(found, key=lambda row: row[0])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "flight.rrd"
    with view(path) as shown:
        fly(shown)
    assert (shown.lost, shown.where) == ("", None)
    return path


def test_recording_passes_reruns_check(recording: Path) -> None:
    result = verify(recording)
    assert result.returncode == 0, result.stderr


def test_a_picture_is_read_back_with_its_marks(recording: Path) -> None:
    plain, marked = picture_of([recording], 1), picture_of([recording], 2)
    assert plain is not None
    assert marked is not None
    images = [cv2.imdecode(np.frombuffer(p.jpeg, np.uint8), 1) for p in (plain, marked)]
    assert [image.shape for image in images if image is not None] == [(480, 640, 3)] * 2
    assert (plain.names, plain.detections_px.shape) == ((), (0, 2))
    assert marked.names == ("Rusty & co/2 0.90",)
    assert np.allclose(marked.detections_px, [[300.0, 200.0]])
    assert len(marked.footprint_px) > 20
    assert picture_of([recording], 4) is None
    other = recording.with_name("other.rrd")
    other.write_bytes(recording.read_bytes()[:1000][::-1])
    with pytest.raises(RecordError, match=r"other\.rrd: cannot be read"):
        picture_of([other], 2)


def test_scalars_and_events_are_read_back_at_vehicle_time(recording: Path) -> None:
    battery = rows(recording, "/plots/battery", "Scalars:scalars")
    assert [t for t, _ in battery] == [100.0, 104.0, 108.0]
    assert np.allclose([v for _, v in battery], [[0.9], [0.8], [0.7]])
    assert rows(recording, "/plots/ground_speed_m_s", "Scalars:scalars")[0][1] == [5.0]
    assert rows(recording, "/plots/height_m", "Scalars:scalars")[0][1] == [35.0]
    assert [(t, v[0]) for t, v in rows(recording, "/events", "TextLog:text")] == [
        (96.0, "connect: vehicle heard"),  # held back until the vehicle's time was known
        (200.0, "landed: on the ground"),
    ]


def test_time_since_seen_counts_from_the_first_measurement_then_from_the_last_sight(
    recording: Path,
) -> None:
    name = "/plots/since_seen/Rusty\\ \\&\\ co\\/2"
    assert rows(recording, name, "Scalars:scalars") == [(100.0, [0]), (104.0, [4]), (108.0, [8])]
    assert [v for _, v in rows(recording, "/plots/since_seen/Bella", "Scalars:scalars")] == [
        [0]
    ] * 3


def test_map_is_north_up_in_metres_about_the_centre(recording: Path) -> None:
    ((_, [seen]), _) = rows(recording, "/map/seen/Bella", "Points2D:positions")
    north_m, east_m = AREA.au_to_ned(np.array([0.25, 0.75])) - np.array(AREA.centre_ned_m)
    assert np.allclose(seen, [east_m, -north_m], atol=1e-4)
    assert np.hypot(*seen) == pytest.approx(200.0 * math.hypot(0.25, 0.25), abs=1e-3)


def test_pixels_of_a_belief_image_lie_on_the_points_of_its_grid(recording: Path) -> None:
    ((_, [matrix]),) = rows(recording, "/map/mean/Bella", "Transform3D:mat3x3")
    ((_, [origin]),) = rows(recording, "/map/mean/Bella", "Transform3D:translation")
    columns = np.array(matrix).reshape(3, 3)  # stored column by column
    for j, k in ((0, 0), (0, 39), (39, 0), (17, 5)):
        centre = np.array(origin) + columns[0] * (k + 0.5) + columns[1] * (j + 0.5)
        north_m, east_m = AREA.au_to_ned(np.array([k, j]) / 39.0) - np.array(AREA.centre_ned_m)
        assert np.allclose(centre[:2], [east_m, -north_m], atol=1e-3)


def test_belief_values_and_their_orientation_survive(recording: Path) -> None:
    places_au = belief_grid_au(ARENA).reshape(-1, 2)
    for kind, when, which in (("std", 0.1, 1), ("mean", 0.1, 0), ("mean_later", 2.1, 0)):
        (_, [buffer]) = rows(recording, f"/map/{kind}/Bella", "DepthImage:buffer")[0]
        stored = np.frombuffer(bytes(buffer), dtype=np.float16).reshape(40, 40)
        query = np.column_stack([places_au, np.full(len(places_au), when)])
        expected = belief().posterior(query)[which][0].reshape(40, 40)
        assert np.ptp(expected) > 0.1
        assert np.allclose(stored, expected, atol=1e-3)
    std = rows(recording, "/plots/std/Bella", "Scalars:scalars")
    at_the_place = belief().posterior(np.array([[10 / 39, 29 / 39, 0.1]]))[1][0]
    assert std[-1][1] == pytest.approx(at_the_place, abs=1e-6)


def test_the_map_has_scale_north_and_legend(recording: Path) -> None:
    ((_, [label]),) = rows(recording, "/map/furniture/scale", "LineStrips2D:labels")
    ((_, [bar]),) = rows(recording, "/map/furniture/scale", "LineStrips2D:strips")
    (left, _), (right, _) = bar
    assert label == f"{right - left:g} m" == "50 m"
    ((_, [shaft, _]),) = rows(recording, "/map/furniture/north", "LineStrips2D:strips")
    assert shaft[0][0] == shaft[1][0]
    assert shaft[1][1] < shaft[0][1]  # y points down, and north is up
    ((_, names),) = rows(recording, "/map/furniture/targets", "Points2D:labels")
    assert names == ["Bella", "Rusty & co/2"]
    ((_, [words]),) = rows(recording, "/help", "TextDocument:text")
    for entity in ("Map", "Camera", "Time since seen", "Battery", "Beliefs"):
        assert f"**{entity}.**" in words


def test_the_scene_sees_what_the_camera_sees(recording: Path) -> None:
    """A place on the ground, taken through the scene's camera, is at its pixel."""

    def static(entity: str, component: str) -> np.ndarray:
        ((_, [value]),) = rows(recording, entity, component)
        return np.array(value, dtype=np.float64)

    lens = static("/scene/vehicle/camera", "Pinhole:image_from_camera").reshape(3, 3).T
    to_body = static("/scene/vehicle/camera", "Transform3D:mat3x3").reshape(3, 3).T
    time_s, [place] = rows(recording, "/scene/vehicle", "Transform3D:translation")[0]
    _, [turn] = rows(recording, "/scene/vehicle", "Transform3D:mat3x3")[0]
    to_scene = np.array(turn, dtype=np.float64).reshape(3, 3).T
    seen_from = pose(time_s)
    for ahead_m, aside_m in ((0.0, 0.0), (8.0, 0.0), (0.0, 11.0), (-7.0, 5.0)):
        ground_ned_m = np.add(seen_from.position_ned_m[:2], (ahead_m, aside_m))
        north_m, east_m = ground_ned_m - np.array(AREA.centre_ned_m)
        in_body = to_scene.T @ (np.array([east_m, north_m, 0.0]) - np.array(place))
        right, down, depth = lens @ (to_body.T @ in_body)
        pixel_px = ground_to_pixel(ground_ned_m, CAMERA, seen_from, AREA.ground_down_m)
        assert depth > 0.0
        assert (right / depth, down / depth) == pytest.approx(pixel_px, abs=0.05)


def test_the_globe_has_the_drone_where_it_is(recording: Path) -> None:
    _, [place] = rows(recording, "/world/vehicle", "GeoPoints:positions")[0]
    told = ned_to_geo(np.array(pose(100.0).position_ned_m), ORIGIN)
    assert place == pytest.approx([told.latitude_deg, told.longitude_deg], abs=1e-6)


def test_what_the_planner_weighed_is_drawn(tmp_path: Path) -> None:
    laid = area_laid()
    choice = replace(decided(1.0), details={"neighbours": [3, 5, 7], "logits": [2.0, 2.0, -9.0]})
    path = replace(decided(2.0), details={"path": [[0.6, 0.5], [0.7, 0.5]]})
    with view(tmp_path / "flight.rrd") as shown:
        for event in (laid, choice, path, replace(decided(3.0), details={})):
            shown.take(event)
    strips = [v for _, v in rows(tmp_path / "flight.rrd", "/map/choices", "LineStrips2D:strips")]
    labels = [v for _, v in rows(tmp_path / "flight.rrd", "/map/choices", "LineStrips2D:labels")]
    assert labels[:2] == [["50%", "50%"], [""]]
    assert [len(ways) for ways in strips] == [2, 1, 0]
    assert len(strips[1][0]) == 3
    north_m, east_m = AREA.au_to_ned(laid.nodes_au[5]) - np.array(AREA.centre_ned_m)
    assert strips[0][1][1] == pytest.approx([east_m, -north_m], abs=1e-3)


def test_attention_is_drawn_for_every_head(tmp_path: Path) -> None:
    laid = area_laid()
    rng = np.random.default_rng(10_000)
    spatial = rng.dirichlet(np.full(len(laid.nodes_au), 0.2), (4, 3))
    attention = {
        "nodes": np.array([2, 5, 7]),
        "ages_au": np.array([1.0, 0.0]),
        "target": np.full((len(laid.nodes_au), 4, 2), 0.5),
        "temporal": np.full((len(laid.nodes_au), 4, 2), 0.5),
        "spatial": spatial,
        "tracks": np.full((4, 3, 2), (0.25, 0.75)),
        "pointer": np.array([0.4, 0.6]),
    }
    path = tmp_path / "flight.rrd"
    with view(path) as shown:
        for event in (laid, Attended(time_s=1.0, weights=attention), decided(2.0)):
            shown.take(event)
    assert not shown.lost
    ((_, places),) = rows(path, "/attention/places/nodes", "Points2D:positions")
    ((_, radii),) = rows(path, "/attention/places/nodes", "Points2D:radii")
    assert len(places) == spatial[:, 0].size
    by_head = np.reshape(radii, spatial[:, 0].shape)
    assert (by_head.argmin(1) == spatial[:, 0].argmax(1)).all()  # on the screen: negative
    assert rows(path, "/attention/whom/Bella", "Scalars:scalars") == [(1.0, [0.25])]
    assert rows(path, "/attention/age", "Scalars:scalars") == [(1.0, [0.5])]
    ((_, [table]),) = rows(path, "/attention/heads", "TextDocument:text")
    assert "| track 4 | 25 | 75 |" in table


def test_the_trail_fades_and_ends_after_two_minutes(tmp_path: Path) -> None:
    with view(tmp_path / "flight.rrd") as shown:
        shown.take(area_laid())
        for second in range(200):
            shown.take(Moved(pose=pose(float(second), (0.004 * second, 0.5))))
    _, strips = rows(tmp_path / "flight.rrd", "/map/trail", "LineStrips2D:strips")[-1]
    _, colors = rows(tmp_path / "flight.rrd", "/map/trail", "LineStrips2D:colors")[-1]
    opacity = [color & 255 for color in colors]
    assert opacity == sorted(opacity)
    assert opacity[0] < 60
    assert opacity[-1] == 255
    length_m = sum(math.dist(a, b) for strip in strips for a, b in pairwise(strip))
    assert length_m == pytest.approx(0.8 * 120.0, abs=5.0)  # 0.004 au a second


def test_pictures_are_jpeg_and_carry_footprint_and_detections(recording: Path) -> None:
    pictures = rows(recording, PICTURE, "EncodedImage:blob")
    assert [t for t, _ in pictures] == [99.9, 103.9, 107.9]
    assert all(bytes(blob[0])[:2] == b"\xff\xd8" for _, blob in pictures)
    labels = [v for _, v in rows(recording, "/scene/vehicle/camera/detections", "Points2D:labels")]
    assert labels == [[], ["Rusty & co/2 0.90"], []]
    (_, [ring]) = rows(recording, "/scene/vehicle/camera/footprint", "LineStrips2D:strips")[0]
    north_m, east_m = pose(99.9).position_ned_m[:2]
    edge_px = ground_to_pixel(
        np.array([north_m + 20.0, east_m]), CAMERA, pose(99.9), AREA.ground_down_m
    )
    assert np.abs(np.array(ring) - edge_px).sum(axis=1).min() < 0.1


def test_poses_are_thinned_and_a_reboot_goes_on_with_them(tmp_path: Path) -> None:
    with view(tmp_path / "flight.rrd") as shown:
        shown.take(area_laid())
        for step in range(100):
            shown.take(Moved(pose=pose(50.0 + 0.01 * step)))
        shown.take(Moved(pose=pose(0.5)))
    times_s = [
        t for t, _ in rows(tmp_path / "flight.rrd", "/map/vehicle", "Transform3D:translation")
    ]
    assert times_s == pytest.approx([50.0, 50.75, 50.75], abs=0.011)  # 15 times real time


def block_worker(shown: FlightView) -> threading.Event:
    """Keep the worker busy until the event returned is set."""
    started, go_on = threading.Event(), threading.Event()

    draw = shown._drawing.draw

    def wait(event: Event) -> None:
        started.set()
        go_on.wait(30.0)
        shown._drawing.draw = draw

    shown._drawing.draw = wait
    shown.take(noted(None, "blocked", "until the test goes on"))
    assert started.wait(10.0)
    return go_on


def test_a_full_queue_drops_the_newest_and_counts_them(tmp_path: Path) -> None:
    with view(tmp_path / "flight.rrd", max_events=5) as shown:
        go_on = block_worker(shown)
        for number in range(12):
            shown.take(measured(float(number), [False, False], 0.5))
        assert shown.lost.startswith("7 events")
        go_on.set()
    battery = rows(tmp_path / "flight.rrd", "/plots/battery", "Scalars:scalars")
    assert [t for t, _ in battery] == [0, 1, 2, 3, 4]


def test_waiting_pictures_are_limited_by_their_size(tmp_path: Path) -> None:
    with view(tmp_path / "flight.rrd", max_bytes=2_000_000) as shown:
        go_on = block_worker(shown)
        image = np.zeros((480, 640, 3), dtype=np.uint8)
        for number in range(5):
            time_s = float(number)
            picture = Picture(time_s=time_s, image=image)
            shown.take(
                Pictured(number=1, picture=picture, detections=[], owners=[], pose=pose(time_s))
            )
        assert shown.lost.startswith("3 events")
        go_on.set()
    assert len(rows(tmp_path / "flight.rrd", PICTURE, "EncodedImage:blob")) == 2


def test_closing_has_a_time_limit_and_counts_what_it_leaves(tmp_path: Path) -> None:
    shown = view(tmp_path / "flight.rrd").__enter__()
    go_on = block_worker(shown)
    shown.take(measured(1.0, [False, False], 0.5))
    shown.take(measured(2.0, [False, False], 0.4))
    threading.Timer(0.5, go_on.set).start()
    shown.close(timeout_s=0.0)
    shown.take(measured(3.0, [False, False], 0.3))
    assert shown.lost.startswith("3 events")
    assert verify(tmp_path / "flight.rrd").returncode == 0


def test_a_value_that_cannot_be_shown_is_counted_and_the_rest_recorded(tmp_path: Path) -> None:
    with view(tmp_path / "flight.rrd") as shown:
        shown.take(area_laid())
        shown.take(TruthTold(time_s=1.0, targets_au=np.zeros((1, 3))))
        shown.take(measured(2.0, [False, False], 0.5))
    assert shown.lost.startswith("1 events that could not be drawn (")
    assert len(rows(tmp_path / "flight.rrd", "/plots/battery", "Scalars:scalars")) == 1


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    (tmp_path / "flight.rrd").write_text("precious")
    with pytest.raises(ViewError, match=r"cannot make the recording .*flight\.rrd: File exists"):
        view(tmp_path / "flight.rrd").__enter__()
    assert (tmp_path / "flight.rrd").read_text() == "precious"


def test_a_full_disk_ends_the_file_but_not_the_flight(tmp_path: Path) -> None:
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    ignored = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
    try:
        with view(tmp_path / "flight.rrd") as shown:
            fly(shown)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, ignored)
    assert "File too large" in shown.lost
    assert rows_of_a_broken_file(tmp_path / "flight.rrd") > 0


def rows_of_a_broken_file(path: Path) -> int:
    """Rows that Rerun still reads from a file without its end."""
    result = subprocess.run(
        [RERUN, "rrd", "stats", path], capture_output=True, text=True, check=False
    )
    (line,) = [line for line in result.stdout.splitlines() if line.startswith("num_rows =")]
    return int(line.split("=")[1].replace("\u2009", "").replace(" ", ""))


FLIGHT = """
import faulthandler, signal, sys
from pathlib import Path
faulthandler.dump_traceback_later(25.0)  # longer than closing may take: says where it hangs
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored under a background shell
path, repository, tests, port = sys.argv[1:]
sys.path[:0] = [repository, tests]
from test_flight_view import fly, view
with view(Path(path), port=None if port == "none" else int(port)) as shown:
    fly(shown)
    print(shown.where, flush=True)
    sys.stdin.read()
"""


def start_flight(path: Path, port: str) -> subprocess.Popen[str]:
    """Start a process that flies, prints its page's address, and waits for a signal."""
    child = subprocess.Popen(
        [sys.executable, "-c", FLIGHT, path, REPOSITORY, Path(__file__).parent, port],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert child.stdout is not None
    assert child.stdout.readline()
    return child


def end_flight(child: subprocess.Popen[str], number: signal.Signals) -> None:
    """Signal it and wait: closing may take 20 s where a disk is slow to sync."""
    child.send_signal(number)
    try:
        child.communicate(timeout=60.0)
    except subprocess.TimeoutExpired:
        child.kill()
        pytest.fail(f"did not end after {number.name}:\n{child.communicate()[1]}")


@pytest.mark.lengthy
def test_an_interrupted_flight_leaves_a_whole_recording(tmp_path: Path) -> None:
    end_flight(start_flight(tmp_path / "flight.rrd", "none"), signal.SIGINT)
    assert verify(tmp_path / "flight.rrd").returncode == 0
    assert len(rows(tmp_path / "flight.rrd", PICTURE, "EncodedImage:blob")) == 3


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
    return port


def wait_until(is_so: Callable[[], bool], limit_s: float = 20.0) -> None:
    end_s = time.monotonic() + limit_s
    while not is_so():
        assert time.monotonic() < end_s, "waited too long"
        time.sleep(0.05)


def listening() -> set[tuple[str, int]]:
    """Addresses on which this process and those it started listen."""
    processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
    return {
        tuple(connection.laddr)
        for process in processes
        for connection in process.net_connections()
        if connection.status == psutil.CONN_LISTEN
    }


def is_served(url: str) -> bool:
    try:
        with urllib.request.urlopen(url, timeout=5.0) as answer:
            return b"Rerun" in answer.read()
    except OSError:
        return False


def test_the_live_page_is_served_on_loopback_only_and_carries_the_recording(
    tmp_path: Path,
) -> None:
    before, port = listening(), free_port()
    with view(tmp_path / "flight.rrd", port=port) as shown:
        fly(shown)
        assert shown.where is not None
        wait_until(lambda: is_served(shown.where or ""))
        opened = listening() - before
        assert {address for address, _ in opened} == {"127.0.0.1"}
        assert port in {number for _, number in opened}
        copy = subprocess.Popen(
            [RERUN, "--save", tmp_path / "copy.rrd", f"rerun+http://127.0.0.1:{port}/proxy"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        wait_until(lambda: rows_of_a_broken_file(tmp_path / "copy.rrd") > 100)
        copy.kill()
        copy.wait()
    assert not shown.lost
    assert listening() == before
    assert verify(tmp_path / "flight.rrd").returncode == 0


@pytest.mark.slow
def test_a_killed_flight_leaves_a_recording_that_rerun_reads_and_no_page(tmp_path: Path) -> None:
    port = free_port()
    child = start_flight(tmp_path / "flight.rrd", str(port))
    wait_until(lambda: is_open(port))
    wait_until(lambda: rows_of_a_broken_file(tmp_path / "flight.rrd") > 100)
    end_flight(child, signal.SIGKILL)
    assert rows_of_a_broken_file(tmp_path / "flight.rrd") > 100
    wait_until(lambda: not is_open(port))


def is_open(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_a_taken_port_is_named_with_the_next_step(tmp_path: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(ViewError, match=rf"port {port} on 127\.0\.0\.1 is taken.*view\.port"):
            view(tmp_path / "flight.rrd", port=port).__enter__()
    assert not (tmp_path / "flight.rrd").exists()


@pytest.mark.lengthy
def test_a_page_whose_process_stands_still_holds_up_neither_recording_nor_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(LivePage, "close", partialmethod(LivePage.close, 0.5))
    others = set(psutil.Process().children(recursive=True))  # of tests before this one
    with view(tmp_path / "flight.rrd", port=free_port(), max_events=2000) as shown:
        wait_until(lambda: is_served(shown.where or ""))
        for process in set(psutil.Process().children(recursive=True)) - others:
            process.suspend()
        fly(shown, num_measurements=20)
    assert shown.lost == "the live page stopped: its process ended"
    assert set(psutil.Process().children(recursive=True)) <= others
    assert len(rows(tmp_path / "flight.rrd", PICTURE, "EncodedImage:blob")) == 20


def test_by_ssh_it_is_said_how_to_get_to_the_page(monkeypatch: pytest.MonkeyPatch) -> None:
    port = free_port()
    monkeypatch.setenv("SSH_CONNECTION", "10.0.0.1 50000 10.0.0.2 22")
    viewer = find_viewer(port)
    assert viewer.url is not None
    page_port = urlsplit(viewer.url).port
    assert f"-L {port}:127.0.0.1:{port} -L {page_port}:127.0.0.1:{page_port}" in viewer.where


@pytest.mark.parametrize("name", ["DISPLAY", "WAYLAND_DISPLAY"])
def test_on_a_display_a_window_opens(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(name, ":0")
    viewer = find_viewer(free_port())
    assert viewer.url is None
    assert "window" in viewer.where
    assert "--serve-web" not in viewer.command
    assert "127.0.0.1" in viewer.command


@pytest.fixture
def start_view(tmp_path: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts `dronemon view` on a recording; whatever of it still runs is killed with the test.

    It heeds Ctrl-C, which a shell has what it runs in the background ignore, and its children.
    """
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    run = tmp_path / "run"
    run.mkdir()
    for name in ("mission.yaml", "summary.json", *LINE_FILES):
        (run / name).write_text("{}")
    with view(run / "flight.rrd") as shown:
        fly(shown)
    with ExitStack() as running:

        def start(port: int, **environment: str) -> subprocess.Popen[str]:
            child = subprocess.Popen(
                [sys.executable, "-m", "dronemon.cli", "view", str(run), "--port", str(port)],
                stdout=subprocess.PIPE,
                text=True,
                start_new_session=True,
                env=os.environ | environment,
            )
            running.enter_context(child)
            running.callback(_kill_group, child.pid)
            return child

        yield start
    signal.signal(signal.SIGINT, before)


def _kill_group(pid: int) -> None:
    with suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)


@pytest.mark.lengthy
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_recording_is_shown_until_a_signal(
    start_view: Callable[..., subprocess.Popen[str]], number: int
) -> None:
    port = free_port()
    child = start_view(port)
    assert child.stdout is not None
    url = child.stdout.readline().strip()  # alone on its line, to be copied
    wait_until(lambda: is_served(url))
    wait_until(lambda: is_open(port))
    os.kill(child.pid, number)
    assert child.wait(30.0) == 0
    assert not is_open(port)


@pytest.mark.lengthy
def test_a_viewer_that_does_not_heed_is_ended_all_the_same(
    start_view: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    """Seen of a real one on a busy machine: the first signal kept us waiting without a limit."""
    package, started = tmp_path / "rerun_cli", tmp_path / "started"
    package.mkdir()
    (package / "__init__.py").touch()
    program = package / "rerun"
    program.write_text(f"#!/bin/sh\ntrap '' INT TERM HUP\necho $$ > {started}\nexec sleep 60\n")
    program.chmod(0o755)
    child = start_view(free_port(), PYTHONPATH=f"{tmp_path}:{REPOSITORY}")
    wait_until(lambda: started.is_file() and started.read_text().endswith("\n"))
    os.kill(child.pid, signal.SIGTERM)
    assert child.wait(30.0) == 0
    assert not psutil.pid_exists(int(started.read_text()))


def test_nothing_is_served_without_a_live_view(tmp_path: Path) -> None:
    before = listening()
    with view(tmp_path / "flight.rrd") as shown:
        assert listening() == before
        assert shown.where is None


@pytest.mark.lengthy
def test_handing_over_costs_the_flight_little(tmp_path: Path) -> None:
    """The calls of one measurement, pictures and beliefs included, return within milliseconds."""
    events = list(happenings(num_measurements=50))
    with view(tmp_path / "flight.rrd", max_events=len(events)) as shown:
        start_s = time.thread_time()
        for event in events:
            shown.take(event)
        spent_ms = (time.thread_time() - start_s) * 1e3 / 50
        assert not shown.lost
    assert spent_ms < 2.0
