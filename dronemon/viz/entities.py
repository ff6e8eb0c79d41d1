"""What the recording holds and how the viewer lays it out: paths, colours, map, blueprint.

The map is drawn in metres about the area's centre, north up: x = east, y = -north, since y points
down in Rerun's 2D views.

    map/area, map/fence, map/roadmap static: the unit square, the fence, nodes and edges
    map/belief                       fog where unsure, each target's colour where it is expected
    map/mean/NAME, map/std/NAME      one target's posterior on the grid
    map/seen/NAME, map/truth/NAME    where the target was seen last; where the simulator has it
    map/trajectory, map/vehicle, map/waypoint
    camera, camera/footprint, camera/detections
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

from dronemon.frames import AreaFrame
from dronemon.palette import Rgb, target_rgb
from dronemon.types import FloatArray, ImageArray

TIMELINE = "vehicle_time"
SERIES = {
    "ground_speed_m_s": "Ground speed (m/s)",
    "height_m": "Height (m)",
    "battery": "Battery (0 to 1)",
    "battery_needed": "Battery needed to come home (0 to 1)",
    "cross_track_m": "Cross-track error (m)",
    "decision_ms": "Decision time (ms)",
}
"""Time series about the vehicle and their titles."""
WHITE = (240, 244, 250)
GREY = (150, 160, 178)
DARK = (62, 70, 84)
BLUE = (122, 162, 247)
FOG_RGB = np.array([[14, 18, 26], [96, 106, 122]], dtype=np.float64)
"""Ground of the belief map where every target's standard deviation is 0, and where it is 1."""


def path(*parts: str) -> str:
    """Entity path of these parts, whatever characters a target's name has."""
    return rr.new_entity_path(list(parts))


def lines(
    strips: Any, rgb: Rgb | list[Rgb], width: float, *, order: float | None = None
) -> rr.LineStrips2D:
    """Lines of this width on the screen; a higher order covers a lower one."""
    return rr.LineStrips2D(strips, colors=rgb, radii=rr.Radius.ui_points(width), draw_order=order)


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


def belief_grid_au(num_points: int = 40) -> FloatArray:
    """Query points of belief images: [j, k] is (k, j) / (G - 1). -> (G, G, 2) au."""
    axis = np.linspace(0.0, 1.0, num_points)
    return np.stack(np.meshgrid(axis, axis, indexing="xy"), axis=-1)


def ned_to_map(position_ned_m: FloatArray, area: AreaFrame) -> FloatArray:
    """Map coordinates of local points. position_ned_m: (..., 2 or 3) m -> (..., 2) m."""
    offset_m = np.asarray(position_ned_m, dtype=np.float64)[..., :2] - area.centre_ned_m
    return offset_m[..., ::-1] * (1.0, -1.0)


def au_to_map(position_au: FloatArray, area: AreaFrame) -> FloatArray:
    """Map coordinates of unit-square points. position_au: (..., 2) au -> (..., 2) m."""
    return ned_to_map(area.au_to_ned(position_au), area)


def grid_transform(area: AreaFrame, num_points: int) -> rr.Transform3D:
    """Lay a belief image on the map: the centres of its pixels are the points of its grid."""
    pixel_au = 1.0 / (num_points - 1)
    corners_au = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]) * pixel_au - pixel_au / 2.0
    origin, right, down = au_to_map(corners_au, area)
    matrix = np.eye(3)
    matrix[:2, 0] = right - origin
    matrix[:2, 1] = down - origin
    return rr.Transform3D(translation=[*origin, 0.0], mat3x3=matrix)


def belief_rgb(mean: FloatArray, std: FloatArray) -> ImageArray:
    """Picture of all beliefs at once. mean, std: (N, G, G) -> (G, G, 3) uint8."""
    fog = np.clip(std, 0.0, 1.0).mean(axis=0)[..., None]
    rgb = FOG_RGB[0] + (FOG_RGB[1] - FOG_RGB[0]) * fog
    for index, presence in enumerate(np.clip(mean, 0.0, 1.0)):
        rgb += (np.array(target_rgb(index)) - rgb) * 0.9 * presence[..., None]
    image: ImageArray = rgb.astype(np.uint8)
    return image


def blueprint(
    names: Sequence[str], side_m: float, heading_rad: float, margin_m: float
) -> rrb.Blueprint:
    """Lay out the viewer: map, with a margin, and beliefs left; picture, plots and events right."""
    half_m = side_m * (abs(math.cos(heading_rad)) + abs(math.sin(heading_rad))) / 2.0 * 1.06
    beliefs = rrb.Grid(
        *(_belief_view(kind, name, half_m) for kind in ("mean", "std") for name in names),
        grid_columns=len(names),
    )
    targets = rrb.Tabs(
        _plot("Time since seen (s)", "plots/since_seen"),
        _plot("Standard deviation where last seen", "plots/std", (0.0, 1.05)),
        active_tab=1,
    )
    series = rrb.Tabs(*(_plot(title, f"plots/{key}") for key, title in SERIES.items()))
    events = rrb.TextLogView(
        origin="events",
        name="Events",
        columns=rrb.TextLogColumns(
            timeline_columns=[TIMELINE], text_log_columns=["loglevel", "body"]
        ),
    )
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(_map_view(half_m + margin_m), beliefs, row_shares=[3, 2]),
            rrb.Vertical(
                rrb.Spatial2DView(origin="camera", name="Camera"),
                targets,
                series,
                events,
                row_shares=[5, 2, 2, 2],
            ),
            column_shares=[5, 4],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
    )


def _bounds(half_m: float) -> rrb.VisualBounds2D:
    return rrb.VisualBounds2D(x_range=(-half_m, half_m), y_range=(-half_m, half_m))


def _map_view(half_m: float) -> rrb.Spatial2DView:
    flown = rrb.VisibleTimeRanges(
        rrb.VisibleTimeRange(
            TIMELINE,
            start=rrb.TimeRangeBoundary.infinite(),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        )
    )
    return rrb.Spatial2DView(
        origin="map",
        contents=["+ $origin/**", "- $origin/mean/**", "- $origin/std/**"],
        name="Map (dot: last seen, ring: true place)",
        visual_bounds=_bounds(half_m),
        overrides={"map/trajectory": flown},
    )


def _belief_view(kind: str, name: str, half_m: float) -> rrb.Spatial2DView:
    title = {"mean": f"{name} expected", "std": f"{name} uncertainty"}[kind]
    shown = [
        path("map", kind, name),
        path("map", "seen", name),
        path("map", "truth", name),
        "map/vehicle",
    ]
    return rrb.Spatial2DView(
        origin="map",
        contents=[f"+ {entity}/**" for entity in shown],
        name=title,
        visual_bounds=_bounds(half_m),
    )


def _plot(title: str, origin: str, limits: tuple[float, float] | None = None) -> rrb.TimeSeriesView:
    everything = rr.TimeRange(
        start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.infinite()
    )
    return rrb.TimeSeriesView(
        origin=origin,
        name=title,
        axis_x=rrb.TimeAxis(view_range=everything),
        axis_y=rrb.ScalarAxis(range=limits) if limits else None,
    )
