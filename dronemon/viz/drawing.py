"""Turns the flight's events into Rerun data: one method for each kind.

What happens before the area is known appears in the log and the time series, but not on the map.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import rerun as rr

from dronemon.events import (
    AreaLaid,
    Believed,
    Decided,
    Event,
    Level,
    Measured,
    Moved,
    Noted,
    Pictured,
    RoadmapDrawn,
    TruthTold,
)
from dronemon.frames import AreaFrame, ground_to_pixel
from dronemon.types import (
    CameraModel,
    Detection,
    FloatArray,
    IntArray,
    Picture,
    Pose,
)
from dronemon.viz import entities

JPEG_QUALITY = 80
TRAJECTORY_INTERVAL_S = 0.5
INFERNO, VIRIDIS = rr.components.Colormap.Inferno, rr.components.Colormap.Viridis


class Drawing:
    """The state of the drawing; not thread-safe."""

    def __init__(self, *, targets: Mapping[str, str], camera: CameraModel) -> None:
        self._names = tuple(targets)
        self._numbers = {appearance: i for i, appearance in enumerate(targets.values())}
        self._camera = camera
        self._area: AreaFrame | None = None
        self._radius_m = 0.0
        self._grid_points = 0
        self._trail: tuple[float, FloatArray] | None = None
        self._first_s: float | None = None
        self._seen_s: dict[int, float] = {}
        self._seen_au: dict[int, FloatArray] = {}
        self._time_s: float | None = None
        self._early_events: list[tuple[str, Level]] = []

    def start(self, rec: rr.RecordingStream) -> None:
        """Name and colour the time series."""
        for number, name in enumerate(self._names):
            style = rr.SeriesLines(colors=entities.target_rgb(number), names=name, widths=2.0)
            for kind in ("since_seen", "std"):
                rec.log(entities.path("plots", kind, name), style, static=True)
        for key, title in entities.SERIES.items():
            style = rr.SeriesLines(colors=entities.BLUE, names=title, widths=1.5)
            rec.log(f"plots/{key}", style, static=True)

    def draw(self, rec: rr.RecordingStream, event: Event) -> None:
        """Draw an event; those of no interest are passed over."""
        match event:
            case Noted():
                self._note(rec, event.time_s, f"{event.kind}: {event.text}", event.level)
            case AreaLaid():
                self._lay_area(rec, event.area, event.footprint_radius_m)
            case RoadmapDrawn():
                self._roadmap(rec, event.nodes_au, event.edges)
            case Moved():
                self._move(rec, event.pose)
            case Pictured():
                self._picture(rec, event.picture, event.detections, event.pose)
            case Measured():
                self._measure(rec, event)
            case Believed():
                self._beliefs(rec, event.time_s, event.mean, event.std)
            case Decided():
                self._waypoint(rec, event)
            case TruthTold():
                self._truth(rec, event.time_s, event.targets_au)

    def _lay_area(self, rec: rr.RecordingStream, area: AreaFrame, radius_m: float) -> None:
        """Keep the area and draw its border, and the vehicle that is moved over it."""
        self._area, self._radius_m = area, radius_m
        corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]], dtype=np.float64)
        rec.log(
            "map/area",
            rr.LineStrips2D(
                [entities.au_to_map(corners, area)],
                draw_order=5.0,
                colors=entities.GREY,
                radii=rr.Radius.ui_points(1.0),
            ),
            static=True,
        )
        nose_m = 0.035 * area.side_m
        rec.log(
            "map/vehicle/footprint",
            rr.Ellipses2D(
                half_sizes=[[radius_m, radius_m]],
                draw_order=30.0,
                colors=entities.WHITE,
                line_radii=rr.Radius.ui_points(1.0),
            ),
            static=True,
        )
        rec.log(
            "map/vehicle/nose",
            rr.LineStrips2D(
                [
                    np.array([[-0.6, 0.8], [0.0, -1.0], [0.6, 0.8], [0.0, 0.4], [-0.6, 0.8]])
                    * nose_m
                ],
                draw_order=40.0,
                colors=entities.WHITE,
                radii=rr.Radius.ui_points(1.5),
            ),
            static=True,
        )

    def _roadmap(self, rec: rr.RecordingStream, nodes_au: FloatArray, edges: IntArray) -> None:
        """Draw each edge once, whatever its direction."""
        if self._area is None:
            return
        nodes = entities.au_to_map(nodes_au, self._area)
        pairs = np.unique(np.sort(edges, axis=1), axis=0)
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        rec.log(
            "map/roadmap/edges",
            rr.LineStrips2D(
                nodes[pairs], colors=entities.DARK, draw_order=10.0, radii=rr.Radius.ui_points(0.5)
            ),
            static=True,
        )
        rec.log(
            "map/roadmap/nodes",
            rr.Points2D(
                nodes, colors=entities.DARK, draw_order=10.0, radii=rr.Radius.ui_points(1.5)
            ),
            static=True,
        )

    def _move(self, rec: rr.RecordingStream, pose: Pose) -> None:
        """Move the vehicle, extend its trajectory and the series of speed and height."""
        self._set_time(rec, pose.time_s)
        rec.log("plots/ground_speed_m_s", rr.Scalars(pose.ground_speed_m_s))
        if self._area is None:
            return
        height_m = self._area.height_m(pose.position_ned_m[2])
        rec.log("plots/height_m", rr.Scalars(height_m))
        position = entities.ned_to_map(np.array(pose.position_ned_m), self._area)
        turn = rr.RotationAxisAngle(axis=[0, 0, 1], radians=pose.attitude_rad[2])
        rec.log("map/vehicle", rr.Transform3D(translation=[*position, 0.0], rotation=turn))
        self._trajectory(rec, pose.time_s, position)

    def _trajectory(self, rec: rr.RecordingStream, time_s: float, position: FloatArray) -> None:
        if self._trail is None or time_s < self._trail[0]:
            self._trail = (time_s, position)
        elif time_s - self._trail[0] >= TRAJECTORY_INTERVAL_S:
            rec.log(
                "map/trajectory",
                rr.LineStrips2D(
                    [[self._trail[1], position]],
                    draw_order=20.0,
                    colors=entities.GREY,
                    radii=rr.Radius.ui_points(0.8),
                ),
            )
            self._trail = (time_s, position)

    def _picture(
        self,
        rec: rr.RecordingStream,
        picture: Picture,
        detections: Sequence[Detection],
        pose: Pose,
    ) -> None:
        """Show picture, detections and the footprint's edge."""
        self._set_time(rec, picture.time_s)
        rec.log("camera", rr.Image(picture.image, color_model="BGR").compress(JPEG_QUALITY))
        rec.log(
            "camera/detections",
            rr.Points2D(
                [found.pixel_px for found in detections],
                colors=[self._detection_rgb(found) for found in detections],
                labels=[self._detection_label(found) for found in detections],
                radii=rr.Radius.ui_points(5.0),
                show_labels=True,
            ),
        )
        if self._area is not None:
            angle = np.linspace(0.0, 2.0 * np.pi, 61)
            ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * self._radius_m
            edge_px = ground_to_pixel(
                ring + pose.position_ned_m[:2], self._camera, pose, self._area.ground_down_m
            )
            rec.log(
                "camera/footprint",
                rr.LineStrips2D(
                    [edge_px[np.isfinite(edge_px).all(axis=-1)]],
                    colors=entities.WHITE,
                    radii=rr.Radius.ui_points(1.0),
                ),
            )

    def _detection_rgb(self, found: Detection) -> tuple[int, int, int]:
        number = self._numbers.get(found.appearance)
        return entities.GREY if number is None else entities.target_rgb(number)

    def _detection_label(self, found: Detection) -> str:
        number = self._numbers.get(found.appearance)
        name = found.appearance if number is None else self._names[number]
        return f"{name} {found.score:.2f}"

    def _measure(self, rec: rr.RecordingStream, event: Measured) -> None:
        """Mark what was seen; extend the series of times since, battery and cross-track error."""
        time_s, measurement = event.time_s, event.measurement
        self._series(rec, time_s, battery=event.battery, cross_track_m=event.cross_track_m)
        if self._first_s is None:
            self._first_s = time_s
        for number, name in enumerate(self._names):
            if measurement.seen[number]:
                self._seen_s[number] = time_s
                self._seen_au[number] = measurement.target_au[number]
                self._mark_seen(rec, number, name)
            since_s = time_s - self._seen_s.get(number, self._first_s)
            rec.log(entities.path("plots", "since_seen", name), rr.Scalars(since_s))

    def _mark_seen(self, rec: rr.RecordingStream, number: int, name: str) -> None:
        if self._area is None:
            return
        rec.log(
            entities.path("map", "seen", name),
            rr.Points2D(
                [entities.au_to_map(self._seen_au[number], self._area)],
                draw_order=60.0,
                colors=entities.target_rgb(number),
                radii=rr.Radius.ui_points(5.0),
                labels=[name],
                show_labels=True,
            ),
        )

    def _beliefs(
        self, rec: rr.RecordingStream, time_s: float, mean: FloatArray, std: FloatArray
    ) -> None:
        """Show the posteriors of all targets together and one by one."""
        if self._area is None:
            return
        self._set_time(rec, time_s)
        self._lay_grids(rec, mean.shape[-1])
        rec.log(
            "map/belief", rr.Image(entities.belief_rgb(mean, std), magnification_filter="linear")
        )
        for number, name in enumerate(self._names):
            for kind, values, colormap in (("mean", mean, INFERNO), ("std", std, VIRIDIS)):
                rec.log(
                    entities.path("map", kind, name),
                    rr.DepthImage(
                        values[number].astype(np.float16),
                        depth_range=(0.0, 1.0),
                        colormap=colormap,
                        magnification_filter="linear",
                    ),
                )
            if number in self._seen_au:
                x, y = np.rint(self._seen_au[number] * (std.shape[-1] - 1)).astype(int)
                rec.log(
                    entities.path("plots", "std", name),
                    rr.Scalars(std[number, y, x]),
                )

    def _lay_grids(self, rec: rr.RecordingStream, num_points: int) -> None:
        if self._area is None or num_points == self._grid_points:
            return
        self._grid_points = num_points
        transform = entities.grid_transform(self._area, num_points)
        kinds = [
            entities.path("map", kind, name) for kind in ("mean", "std") for name in self._names
        ]
        for entity in ("map/belief", *kinds):
            rec.log(entity, transform, static=True)

    def _waypoint(self, rec: rr.RecordingStream, event: Decided) -> None:
        """Draw the leg; extend the series of decision times."""
        self._series(rec, event.time_s, decision_ms=event.decision_ms)
        if self._area is None:
            return
        leg = entities.au_to_map(np.stack([event.position_au, event.waypoint_au]), self._area)
        rec.log(
            "map/waypoint",
            rr.LineStrips2D(
                [leg], draw_order=25.0, colors=entities.WHITE, radii=rr.Radius.ui_points(1.5)
            ),
            rr.Points2D(leg[1:], colors=entities.WHITE, radii=rr.Radius.ui_points(4.0)),
        )

    def _truth(self, rec: rr.RecordingStream, time_s: float, position_au: FloatArray) -> None:
        """Draw a ring around each target."""
        if self._area is None:
            return
        self._set_time(rec, time_s)
        ring_m = 0.022 * self._area.side_m
        for number, name in enumerate(self._names):
            rec.log(
                entities.path("map", "truth", name),
                rr.Ellipses2D(
                    centers=[entities.au_to_map(position_au[number], self._area)],
                    half_sizes=[[ring_m, ring_m]],
                    draw_order=50.0,
                    colors=entities.target_rgb(number),
                    line_radii=rr.Radius.ui_points(1.5),
                ),
            )

    def _note(self, rec: rr.RecordingStream, time_s: float | None, text: str, level: Level) -> None:
        """Add a line to the log, once a vehicle time is known."""
        if time_s is not None:
            self._set_time(rec, time_s)
        if self._time_s is None:
            self._early_events.append((text, level))
        else:
            rec.log("events", rr.TextLog(text, level=level))

    def _series(self, rec: rr.RecordingStream, time_s: float, **values: float | None) -> None:
        """Extend the time series whose value is known."""
        self._set_time(rec, time_s)
        for key, value in values.items():
            if value is not None:
                rec.log(f"plots/{key}", rr.Scalars(value))

    def _set_time(self, rec: rr.RecordingStream, time_s: float) -> None:
        rec.set_time(entities.TIMELINE, duration=time_s)
        self._time_s = time_s
        for text, level in self._early_events:
            rec.log("events", rr.TextLog(text, level=level))
        self._early_events.clear()
