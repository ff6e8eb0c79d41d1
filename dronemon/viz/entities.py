"""What the recording holds and how the viewer lays it out: paths, colours, map, blueprint.

The map is drawn in metres about the area's centre, north up: x = east, y = -north, since y points
down in Rerun's 2D views.

    map/area, map/no_fly, map/fence  static: the area, its no-fly zones, the fence
    map/roadmap                      static: nodes and edges
    map/belief                       fog where unsure, each target's colour where it is expected
    map/mean/NAME, map/std/NAME      one target's posterior on the grid
    map/mean_later/..., map/std_later/...  the same PREDICTION_AU later
    map/seen/NAME, map/truth/NAME    where the target was seen last; where the simulator has it
    map/trajectory, map/trail        all of the way flown, and the last two minutes, fading
    map/vehicle, map/waypoint        the drone; where it goes now
    map/choices                      ways that the planner weighed, the better the brighter
    map/furniture/...                scale, north, whose colour is whose
    attention/...                    see `viz.attention`
    help                             words on all that
    scene/..., world/...             see `viz.scene`; the camera is CAMERA, in the scene
    plots/SERIES, plots/since_seen/NAME, plots/std/NAME
    events
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from dronemon.arena import Arena
from dronemon.frames import AreaFrame
from dronemon.mission import Mission, mission_arena
from dronemon.palette import Rgb
from dronemon.types import FloatArray

TIMELINE = "vehicle_time"
PICTURES = "picture"
"""A second timeline, of the camera: the number of a picture's measurement."""
CAMERA = "scene/vehicle/camera"
"""Its pictures and what is marked in them; the scene shows them where they are taken."""
KINDS = {
    "mean": "expected",
    "std": "uncertainty",
    "mean_later": "expected soon",
    "std_later": "uncertainty soon",
}
"""Pictures of one target's belief."""
SERIES = {
    "ground_speed_m_s": "Ground speed (m/s)",
    "height_m": "Height (m)",
    "battery": "Battery (0 to 1)",
    "battery_needed": "Battery needed to come home (0 to 1)",
    "cross_track_m": "Cross-track error (m)",
    "decision_ms": "Decision time (ms)",
    "value": "What the planner expects to gain",
}
"""Time series about the vehicle and their titles."""
WHITE = (240, 244, 250)
GREY = (150, 160, 178)
DARK = (62, 70, 84)
BLUE = (122, 162, 247)
RED = (247, 118, 122)


def path(*parts: str) -> str:
    """Entity path of these parts, whatever characters a target's name has."""
    return rr.new_entity_path(list(parts))


def lines(
    strips: Any,
    rgb: Any,
    width: float,
    *,
    order: float | None = None,
    labels: Sequence[str] | None = None,
) -> rr.LineStrips2D:
    """Lines of this width on the screen, with labels if given; a higher order covers a lower one.

    rgb: of all, or of each, with opacity or without
    """
    return rr.LineStrips2D(
        strips,
        colors=rgb,
        radii=rr.Radius.ui_points(width),
        draw_order=order,
        labels=labels,
        show_labels=None if labels is None else True,
    )


def dots(
    places: Any,
    rgb: Rgb | list[Rgb],
    width: float,
    *,
    order: float | None = None,
    labels: Sequence[str] | None = None,
) -> rr.Points2D:
    """Dots of this radius on the screen, with labels if given."""
    return rr.Points2D(
        places,
        colors=rgb,
        radii=rr.Radius.ui_points(width),
        draw_order=order,
        labels=labels,
        show_labels=None if labels is None else True,
    )


def rings(centres: Any, radius_m: float, rgb: Rgb, width: float, *, order: float) -> rr.Ellipses2D:
    """Circles about each centre, about the origin without one."""
    return rr.Ellipses2D(
        centers=centres,
        half_sizes=[[radius_m, radius_m]],
        colors=rgb,
        line_radii=rr.Radius.ui_points(width),
        draw_order=order,
    )


def belief_grid_au(arena: Arena, num_points: int = 40) -> FloatArray:
    """Query points of belief images, over the arena's box; rows are y. -> (G, G, 2) au."""
    return np.stack(np.meshgrid(*arena.axes(num_points), indexing="xy"), axis=-1)


def ned_to_map(position_ned_m: FloatArray, area: AreaFrame) -> FloatArray:
    """Map coordinates of local points. position_ned_m: (..., 2 or 3) m -> (..., 2) m."""
    offset_m = np.asarray(position_ned_m, dtype=np.float64)[..., :2] - area.centre_ned_m
    return offset_m[..., ::-1] * (1.0, -1.0)


def au_to_map(position_au: FloatArray, area: AreaFrame) -> FloatArray:
    """Map coordinates of unit-square points. position_au: (..., 2) au -> (..., 2) m."""
    return ned_to_map(area.au_to_ned(position_au), area)


def grid_transform(area: AreaFrame, num_points: int) -> rr.Transform3D:
    """Lay a belief image on the map: the centres of its pixels are the points of its grid."""
    pixel_au = area.arena.extent_au / (num_points - 1)
    corners_au = area.arena.bounds[0] + (np.array([[0, 0], [1, 0], [0, 1]]) - 0.5) * pixel_au
    origin, right, down = au_to_map(corners_au, area)
    matrix = np.eye(3)
    matrix[:2, 0] = right - origin
    matrix[:2, 1] = down - origin
    return rr.Transform3D(translation=[*origin, 0.0], mat3x3=matrix)


def shown_half_m(arena: Arena, side_m: float, heading_rad: float) -> float:
    """Half the width of what a map of the area shows, the area being turned about its centre."""
    reach_m = 2.0 * side_m * float(np.abs(arena.bounds - 0.5).max())
    return reach_m * (abs(math.cos(heading_rad)) + abs(math.sin(heading_rad))) / 2.0 * 1.06


def blueprint(mission: Mission, legend_m: float) -> rrb.Blueprint:
    """Lay out the viewer: a tab for who flies, one for who studies, one that says what is what.

    legend_m: more left of the map than round it
    """
    area = mission.area
    half_m = shown_half_m(mission_arena(mission), area.side_m, math.radians(area.heading_deg))
    bounds = _bounds(half_m + mission.flight.fence_margin_m, legend_m)
    maps = rrb.Tabs(
        _map_view("Map", bounds, hidden=(*KINDS, "truth", "roadmap")),
        *(
            [_map_view("Map and truth", bounds, hidden=tuple(KINDS))]
            if mission.camera.is_simulated
            else []
        ),
        rrb.Spatial3DView(origin="scene", name="3-D"),
        rrb.MapView(origin="world", name="On the globe", zoom=_zoom(area.side_m)),
    )
    names = [target.name for target in mission.targets]
    return rrb.Blueprint(
        rrb.Tabs(
            rrb.Horizontal(maps, _instruments(), column_shares=[5, 4], name="Flight"),
            _research(names, half_m),
            *([_attention()] if mission.planner.kind == "stamp" else []),
            rrb.TextDocumentView(origin="help", name="What is what"),
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )


def _instruments() -> rrb.Vertical:
    """Camera, times since seen, the vehicle's series, and events."""
    batteries = rrb.TimeSeriesView(
        origin="plots",
        contents=["+ plots/battery", "+ plots/battery_needed"],
        name="Battery (0 to 1)",
        axis_x=_ALL_TIME,
        axis_y=rrb.ScalarAxis(range=(0.0, 1.0)),
    )
    events = rrb.TextLogView(
        origin="events",
        name="Events",
        columns=rrb.TextLogColumns(
            timeline_columns=[TIMELINE], text_log_columns=["loglevel", "body"]
        ),
    )
    return rrb.Vertical(
        rrb.Spatial2DView(origin=CAMERA, name="Camera"),
        _plot("Time since seen (s)", "plots/since_seen"),
        rrb.Tabs(batteries, *map(_series, ("ground_speed_m_s", "height_m", "cross_track_m"))),
        events,
        row_shares=[5, 2, 2, 2],
    )


def _research(names: Sequence[str], half_m: float) -> rrb.Vertical:
    """Each target's belief, and what the planner makes of them all."""
    each = [
        rrb.Horizontal(*(_belief_view(kind, name, half_m) for kind in KINDS), name=name)
        for name in names
    ]
    return rrb.Vertical(
        rrb.Tabs(*each),
        rrb.Horizontal(
            _plot("Uncertainty where last seen (0 to 1)", "plots/std", (0.0, 1.05)),
            *map(_series, ("decision_ms", "value")),
        ),
        row_shares=[3, 2],
        name="Beliefs and decisions",
    )


def _attention() -> rrb.Horizontal:
    """What the network looks at: places by head, whom, how long ago."""
    return rrb.Horizontal(
        rrb.Spatial2DView(origin="attention/places", name="Where each head looks"),
        rrb.Vertical(
            _plot("Whom it looks at (0 to 1)", "attention/whom", (0.0, 1.0)),
            _plot("How far back it looks (au flown)", "attention/age"),
            rrb.TextDocumentView(origin="attention/heads", name="Every head in numbers"),
        ),
        column_shares=[3, 2],
        name="Attention",
    )


def _series(key: str) -> rrb.TimeSeriesView:
    return _plot(SERIES[key], f"plots/{key}")


def _zoom(side_m: float) -> float:
    """Of a globe at which an area takes about a third of the view."""
    return math.log2(4.0e7 / side_m) - 1.0


_ALL_TIME = rrb.TimeAxis(
    view_range=rr.TimeRange(
        start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
    )
)


def _bounds(half_m: float, more_left_m: float = 0.0) -> rrb.VisualBounds2D:
    return rrb.VisualBounds2D(x_range=(-half_m - more_left_m, half_m), y_range=(-half_m, half_m))


def _map_view(name: str, bounds: rrb.VisualBounds2D, hidden: Sequence[str]) -> rrb.Spatial2DView:
    flown = rrb.VisibleTimeRanges(
        rrb.VisibleTimeRange(
            TIMELINE,
            start=rrb.TimeRangeBoundary.infinite(),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
    )
    return rrb.Spatial2DView(
        origin="map",
        contents=["+ $origin/**", *(f"- $origin/{kind}/**" for kind in hidden)],
        name=name,
        visual_bounds=bounds,
        overrides={"map/trajectory": flown},
    )


def _belief_view(kind: str, name: str, half_m: float) -> rrb.Spatial2DView:
    shown = [
        path("map", kind, name),
        path("map", "seen", name),
        path("map", "truth", name),
        "map/vehicle",
    ]
    return rrb.Spatial2DView(
        origin="map",
        contents=[f"+ {entity}/**" for entity in shown],
        name=KINDS[kind].capitalize(),
        visual_bounds=_bounds(half_m),
    )


def _plot(title: str, origin: str, limits: tuple[float, float] | None = None) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=origin,
        name=title,
        axis_x=_ALL_TIME,
        axis_y=rrb.ScalarAxis(range=limits) if limits else None,
    )
