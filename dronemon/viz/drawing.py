"""Turns the flight's events into Rerun data: one method for each kind.

What happens before the area is known appears in the log and the time series, but not on the map.
"""

from __future__ import annotations

from collections import deque

import numpy as np
import rerun as rr

from dronemon.events import (
    AreaLaid,
    Attended,
    Believed,
    Decided,
    Event,
    Level,
    Measured,
    Moved,
    Noted,
    Pictured,
    TruthTold,
)
from dronemon.frames import AreaFrame, ground_to_pixel
from dronemon.mission import Mission
from dronemon.palette import belief_rgb, target_rgb
from dronemon.problem import PREDICTION_AU
from dronemon.types import FloatArray, Pose
from dronemon.viz.attention import Attention
from dronemon.viz.entities import (
    BLUE,
    CAMERA,
    DARK,
    GREY,
    KINDS,
    PICTURES,
    RED,
    SERIES,
    TIMELINE,
    WHITE,
    au_to_map,
    belief_grid_au,
    dots,
    grid_transform,
    lines,
    ned_to_map,
    path,
    rings,
    shown_half_m,
)
from dronemon.viz.furniture import lay_furniture
from dronemon.viz.scene import Scene

JPEG_QUALITY = 80
TRAJECTORY_INTERVAL_S = 0.5
TRAIL_S, TRAIL_PARTS, TRAIL_INTERVAL_S = 120.0, 12, 2.0
"""Of the way flown lately: how much of it fades, in how many steps, and how often it is drawn."""
_LIKELY = 0.02
"""A choice that the planner thinks less likely than this is not drawn."""
_CLOCK_DOUBT_S = 5.0
_ARROW = np.array([[-0.6, 0.8], [0.0, -1.0], [0.6, 0.8], [0.0, 0.4], [-0.6, 0.8]])
_COLORMAPS = {"mean": rr.components.Colormap.Inferno, "std": rr.components.Colormap.Viridis}


class Drawing:
    """The state of the drawing; not thread-safe."""

    def __init__(self, rec: rr.RecordingStream, mission: Mission) -> None:
        self._rec = rec
        self._names = tuple(target.name for target in mission.targets)
        self._camera = mission.camera.model
        self._margin_m = mission.flight.fence_margin_m
        self._area: AreaFrame | None = None
        self._radius_m = 0.0
        self._is_grid_laid = False
        self._scene: Scene | None = None
        self._nodes_au: FloatArray | None = None
        self._attention: Attention | None = None
        self._trail = deque[tuple[float, FloatArray, list[float]]]()
        self._trail_due_s = -np.inf
        self._seen_s: dict[int, float] = {}
        self._seen_au: dict[int, FloatArray] = {}
        self._time_s: float | None = None
        self._clock_s, self._offset_s = -np.inf, 0.0
        self._early_notes: list[tuple[str, Level]] = []

    def start(self) -> None:
        """Name and colour the time series."""
        for number, name in enumerate(self._names):
            style = rr.SeriesLines(colors=target_rgb(number), names=name, widths=2.0)
            for kind in ("since_seen", "std"):
                self._rec.log(path("plots", kind, name), style, static=True)
        for key, title in SERIES.items():
            color = GREY if key == "battery_needed" else BLUE
            style = rr.SeriesLines(colors=color, names=title, widths=1.5)
            self._rec.log(f"plots/{key}", style, static=True)

    def draw(self, event: Event) -> None:
        """Draw an event; those of no interest are passed over."""
        match event:
            case Noted():
                self._note(event)
            case AreaLaid():
                self._lay_area(event)
            case Moved():
                self._move(event.pose)
            case Pictured():
                self._picture(event)
            case Measured():
                self._measure(event)
            case Believed() if self._area is not None:
                self._beliefs(event, self._area)
            case Decided():
                self._waypoint(event)
            case Attended() if self._nodes_au is not None:
                self._attend(event, self._nodes_au)
            case TruthTold() if self._area is not None:
                self._truth(event, self._area)

    def _lay_area(self, event: AreaLaid) -> None:
        """Keep the area; draw border, fence, roadmap, and the vehicle that is moved over them."""
        log, area = self._rec.log, event.area
        self._area, self._radius_m = area, event.footprint_radius_m
        border = au_to_map(area.arena.outline_au, area)
        log("map/area", lines([border], GREY, 1.0, order=5), static=True)
        zones = [au_to_map(zone_au, area) for zone_au in area.arena.zones_au]
        log("map/no_fly", lines(zones, RED, 1.0, order=5), static=True)
        fence = ned_to_map(np.concatenate([event.fence_ned_m, event.fence_ned_m[:1]]), area)
        log("map/fence", lines([fence], BLUE, 1.0, order=5), static=True)
        footprint = rings(None, self._radius_m, WHITE, 1.0, order=30)
        log("map/vehicle/footprint", footprint, static=True)
        nose = _ARROW * 0.035 * area.side_m
        log("map/vehicle/nose", lines([nose], WHITE, 1.5, order=40), static=True)
        nodes = au_to_map(event.nodes_au, area)
        pairs = np.unique(np.sort(event.edges, axis=1), axis=0)  # once, whatever the direction
        pairs = pairs[pairs[:, 0] != pairs[:, 1]]
        log("map/roadmap/edges", lines(nodes[pairs], DARK, 0.5, order=10), static=True)
        log("map/roadmap/nodes", dots(nodes, DARK, 1.5, order=10), static=True)
        self._nodes_au = event.nodes_au
        self._scene = Scene(self._rec, event, self._camera, self._names)
        half_m = shown_half_m(area.arena, area.side_m, area.heading_rad) + self._margin_m
        lay_furniture(self._rec, half_m, area.side_m, self._names)

    def _move(self, pose: Pose) -> None:
        """Move the vehicle, extend its trajectory and the series of speed and height."""
        self._follow_clock(pose.time_s)
        self._series(pose.time_s, ground_speed_m_s=pose.ground_speed_m_s)
        if self._area is None:
            return
        self._series(pose.time_s, height_m=self._area.height_m(pose.position_ned_m[2]))
        position = ned_to_map(np.array(pose.position_ned_m), self._area)
        turn = rr.RotationAxisAngle(axis=[0, 0, 1], radians=pose.attitude_rad[2])
        self._rec.log("map/vehicle", rr.Transform3D(translation=[*position, 0.0], rotation=turn))
        assert self._scene is not None  # laid with the area
        self._follow(pose.time_s + self._offset_s, position, self._scene.move(pose))

    def _follow(self, now_s: float, position: FloatArray, lat_lon: list[float]) -> None:
        """Extend the way flown, and let its last part fade."""
        trail = self._trail
        if trail and now_s - trail[-1][0] < TRAJECTORY_INTERVAL_S:
            return
        if trail:
            self._rec.log("map/trajectory", lines([[trail[-1][1], position]], DARK, 0.8, order=20))
        trail.append((now_s, position, lat_lon))
        while trail[0][0] < now_s - TRAIL_S:
            trail.popleft()
        if now_s < self._trail_due_s or len(trail) < 2:
            return
        self._trail_due_s = now_s + TRAIL_INTERVAL_S
        points = np.array([place for _, place, _ in trail])
        size = -(-len(points) // TRAIL_PARTS)
        strips = [points[first : first + size + 1] for first in range(0, len(points) - 1, size)]
        shares = np.linspace(0.15, 1.0, len(strips))
        rgba = [(*WHITE, round(255 * share)) for share in shares]
        self._rec.log("map/trail", lines(strips, rgba, 1.4, order=22))
        assert self._scene is not None  # as above
        self._scene.draw_trail([lat_lon for *_, lat_lon in trail])

    def _picture(self, event: Pictured) -> None:
        """Show picture, detections and the footprint's edge."""
        picture, found = event.picture, event.detections
        self._set_time(picture.time_s)
        self._rec.set_time(PICTURES, sequence=event.number)
        self._rec.log(
            f"{CAMERA}/picture", rr.Image(picture.image, color_model="BGR").compress(JPEG_QUALITY)
        )
        shown = [
            (d.appearance, GREY) if owner < 0 else (self._names[owner], target_rgb(owner))
            for d, owner in zip(found, event.owners, strict=True)
        ]
        labels = [f"{name} {d.score:.2f}" for (name, _), d in zip(shown, found, strict=True)]
        marks = dots([d.pixel_px for d in found], [rgb for _, rgb in shown], 5.0, labels=labels)
        self._rec.log(f"{CAMERA}/detections", marks)
        if self._area is not None:
            angle = np.linspace(0.0, 2.0 * np.pi, 61)
            ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * self._radius_m
            edge = ring + event.pose.position_ned_m[:2]
            edge_px = ground_to_pixel(edge, self._camera, event.pose, self._area.ground_down_m)
            edge_px = edge_px[np.isfinite(edge_px).all(axis=-1)]
            self._rec.log(f"{CAMERA}/footprint", lines([edge_px], WHITE, 1.0))
        self._rec.disable_timeline(PICTURES)

    def _measure(self, event: Measured) -> None:
        """Mark what was seen; extend the series of times since, battery and cross-track error."""
        time_s, measurement = event.time_s, event.measurement
        now_s = time_s + self._offset_s
        self._series(
            time_s,
            battery=event.battery,
            battery_needed=event.battery_needed,
            cross_track_m=next(reversed(event.stretch.cross_track_m), None),
        )
        for number, name in enumerate(self._names):
            if measurement.seen[number]:
                self._seen_s[number] = now_s
                self._seen_au[number] = measurement.target_au[number]
                if self._area is not None:
                    place = [au_to_map(self._seen_au[number], self._area)]
                    mark = dots(place, target_rgb(number), 5.0, order=60, labels=[name])
                    self._rec.log(path("map", "seen", name), mark)
                if self._scene is not None:
                    self._scene.see(number, self._seen_au[number])
            since_s = now_s - self._seen_s.setdefault(number, now_s)  # or from the first look
            self._rec.log(path("plots", "since_seen", name), rr.Scalars(since_s))

    def _beliefs(self, event: Believed, area: AreaFrame) -> None:
        """Show the posteriors of all targets together and one by one."""
        log = self._rec.log
        self._set_time(event.time_s)
        grid_au = belief_grid_au(area.arena)
        num_points = len(grid_au)
        mean, std, mean_later, std_later = _beliefs_on(grid_au, event)
        if not self._is_grid_laid:
            self._is_grid_laid = True
            each = [path("map", kind, name) for kind in KINDS for name in self._names]
            for entity in ("map/belief", *each):
                log(entity, grid_transform(area, num_points), static=True)
        rgb = belief_rgb(mean, std)
        log("map/belief", rr.Image(rgb, magnification_filter="linear"))
        if self._scene is not None:
            self._scene.lay_belief(rgb)
        shown = zip(KINDS, (mean, std, mean_later, std_later), strict=True)
        for kind, values in shown:
            for number, name in enumerate(self._names):
                image = rr.DepthImage(
                    values[number].astype(np.float16),
                    depth_range=(0.0, 1.0),
                    colormap=_COLORMAPS[kind.removesuffix("_later")],
                    magnification_filter="linear",
                )
                log(path("map", kind, name), image)
        for number, name in enumerate(self._names):
            if number in self._seen_au:
                low_au, extent_au = area.arena.bounds[0], area.arena.extent_au
                share = (self._seen_au[number] - low_au) / extent_au
                x, y = np.rint(share * (num_points - 1)).astype(int)
                log(path("plots", "std", name), rr.Scalars(std[number, y, x]))

    def _waypoint(self, event: Decided) -> None:
        """Draw the leg; extend the series of decision times."""
        value = event.details.get("value", event.details.get("gain"))
        self._series(
            event.time_s,
            decision_ms=event.decision_ms,
            value=value if isinstance(value, float) else None,
        )
        if self._area is not None:
            self._choices(event, self._area)
            leg = au_to_map(np.stack([event.position_au, event.waypoint_au]), self._area)
            end = dots(leg[1:], WHITE, 4.0)
            self._rec.log("map/waypoint", lines([leg], WHITE, 1.5, order=25), end)

    def _attend(self, event: Attended, nodes_au: FloatArray) -> None:
        """Show what the network looked at."""
        self._set_time(event.time_s)
        self._attention = self._attention or Attention(self._rec, self._names, nodes_au)
        self._attention.draw(event.weights)

    def _choices(self, event: Decided, area: AreaFrame) -> None:
        """Draw what the planner weighed: neighbours by their probability, or the path it has."""
        ways_au, shares, labels = list[FloatArray](), np.empty(0), list[str]()
        match event.details:
            case {"neighbours": [*nodes], "logits": [*logits]} if self._nodes_au is not None:
                chances = np.exp(np.array(logits, dtype=np.float64))
                chances /= chances.sum()
                likely = np.flatnonzero(chances >= _LIKELY)
                ends_au = self._nodes_au[np.array(nodes, dtype=np.int64)[likely]]
                ways_au = [np.stack([event.position_au, end_au]) for end_au in ends_au]
                shares = chances[likely]
                labels = [f"{s:.0%}" if s == shares.max() else "" for s in shares]
            case {"path": [*path_au]}:
                way_au = [event.position_au, *np.array(path_au, dtype=np.float64)]
                ways_au, shares, labels = [np.array(way_au)], np.array([0.5]), [""]
        rgba = [(*BLUE, round(60 + 195 * share)) for share in shares]
        strips = [au_to_map(way_au, area) for way_au in ways_au]
        self._rec.log("map/choices", lines(strips, rgba, 1.2, order=24, labels=labels))

    def _truth(self, event: TruthTold, area: AreaFrame) -> None:
        """Draw a ring around each target."""
        self._set_time(event.time_s)
        for number, name in enumerate(self._names):
            centre = [au_to_map(event.targets_au[number], area)]
            ring = rings(centre, 0.022 * area.side_m, target_rgb(number), 1.5, order=50)
            self._rec.log(path("map", "truth", name), ring)

    def _note(self, event: Noted) -> None:
        """Add a line to the log, once a vehicle time is known."""
        self._early_notes.append((f"{event.kind}: {event.text}", event.level))
        if event.time_s is not None:
            self._follow_clock(event.time_s)
            self._set_time(event.time_s)
        elif self._time_s is not None:
            self._set_time(self._time_s)

    def _follow_clock(self, time_s: float) -> None:
        """Go on with the recording where a vehicle that was switched off begins anew."""
        if time_s < self._clock_s - _CLOCK_DOUBT_S:
            self._offset_s += self._clock_s - time_s
        self._clock_s = time_s

    def _series(self, time_s: float, **values: float | None) -> None:
        """Extend the time series whose value is known."""
        self._set_time(time_s)
        for key, value in values.items():
            if value is not None:
                self._rec.log(f"plots/{key}", rr.Scalars(value))

    def _set_time(self, time_s: float) -> None:
        self._rec.set_time(TIMELINE, duration=time_s + self._offset_s)
        self._time_s = time_s
        for text, level in self._early_notes:
            self._rec.log("events", rr.TextLog(text, level=level))
        self._early_notes.clear()


def _beliefs_on(grid_au: FloatArray, event: Believed) -> tuple[FloatArray, ...]:
    """The posteriors on a grid. grid_au: (G, G, 2)

    -> (N, G, G) mean and std now, and both PREDICTION_AU later, if nobody looks until then
    """
    places_au = grid_au.reshape(-1, 2)
    times_au = np.repeat([event.time_au, event.time_au + PREDICTION_AU], len(places_au))
    query = np.column_stack([np.tile(places_au, (2, 1)), times_au])
    mean, std = (values.reshape(-1, 2, *grid_au.shape[:2]) for values in event.posterior(query))
    return mean[:, 0], std[:, 0], mean[:, 1], std[:, 1]
