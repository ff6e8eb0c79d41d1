"""One field, whichever program drew it and wherever on earth it is."""

from __future__ import annotations

import json
import math
from pathlib import Path

import fastkml
import numpy as np
import pytest
import shapely
from fastkml.utils import find_all
from geojson_pydantic import FeatureCollection
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from outlines import (
    INNER,
    RESERVE,
    SQUARE,
    circle,
    feature,
    geojson,
    kml,
    placemark,
    plan,
    polygon,
)

from dronemon.errors import MissionFileError
from dronemon.frames import GeoPoint, ned_to_degrees
from dronemon.outline import Field, LaidZone, Outline, circle_in_metres, read_outline

HOME = GeoPoint(latitude_deg=47.397742, longitude_deg=8.545594, altitude_m=488.0)


@pytest.fixture
def read(tmp_path: Path):
    def written(text: str, suffix: str) -> Outline:
        path = tmp_path / f"field.{suffix}"
        path.write_text(text, encoding="utf-8")
        return read_outline(path)

    return written


def _names(outline: Outline) -> list[str]:
    return [zone.name for zone in outline.no_fly]


@pytest.mark.parametrize("form", ["kml", "plan"])
def test_a_field_is_the_same_from_every_program(form: str):
    expected, found = (read_outline(RESERVE[f]).laid(HOME) for f in ("geojson", form))
    assert found.border_ned_m == pytest.approx(expected.border_ned_m, abs=0.1)
    assert len(found.no_fly) == len(expected.no_fly) == 2
    for zone, other in zip(found.no_fly, expected.no_fly, strict=True):
        assert zone.corners_ned_m == pytest.approx(other.corners_ned_m, abs=0.1)


def test_other_readers_see_the_same_corners():
    """Others' libraries, which know what KML and GeoJSON are."""
    document = next(iter(fastkml.KML.parse(RESERVE["kml"]).features))
    marks = {mark.name: mark for mark in find_all(document, of_type=fastkml.Placemark)}
    collection = FeatureCollection.model_validate_json(RESERVE["geojson"].read_text())
    for outline, corners in (
        (read_outline(RESERVE["kml"]), marks["Reserve"].geometry.exterior.coords),
        (read_outline(RESERVE["geojson"]), collection.features[0].geometry.coordinates[0]),
    ):
        assert outline.border_deg == tuple((c[1], c[0]) for c in corners[:-1])


def test_the_shipped_reserve_is_what_it_is_said_to_be():
    outline = read_outline(RESERVE["geojson"])
    field = outline.laid(HOME)
    border = shapely.Polygon(field.border_ned_m)
    north_m, east_m = np.ptp(field.border_ned_m, axis=0)
    assert (north_m, east_m) == pytest.approx((600, 900), abs=50)
    assert border.area < 0.9 * border.convex_hull.area
    assert _names(outline) == ["lake", "farm"]
    free = border.difference(
        shapely.union_all([shapely.Polygon(z.corners_ned_m) for z in field.no_fly])
    )
    assert free.contains(shapely.Point(0.0, 0.0))
    assert len(free.interiors) == 2


@pytest.mark.parametrize("name", ["no-fly hut", "No fly hut", "NOFLY", " no_fly hut"])
def test_a_zone_may_be_called_so(read, name: str):
    marked = name.strip()
    assert _names(read(kml(placemark(SQUARE), placemark(INNER, name=name)), "kml")) == [marked]
    assert _names(read(geojson(feature(INNER, name=name), feature(SQUARE)), "geojson")) == [marked]


@pytest.mark.parametrize("mark", [True, 1, "true", "yes"])
def test_a_zone_may_be_marked_so_in_geojson(read, mark: object):
    text = geojson(feature(SQUARE, no_fly=None), feature(INNER, Name="hut", no_fly=mark))
    assert _names(read(text, "geojson")) == ["hut"]


@pytest.mark.parametrize(
    "data",
    [
        '<Data name="no_fly"><value>true</value></Data>',
        '<SchemaData schemaUrl="#s"><SimpleData name="NO_FLY">1</SimpleData></SchemaData>',
    ],
)
def test_a_zone_may_be_marked_so_in_kml(read, data: str):
    more = f"<ExtendedData>{data}</ExtendedData>"
    assert _names(read(kml(placemark(SQUARE), placemark(INNER, more=more)), "kml")) == ["zone 1"]


@pytest.mark.parametrize("mark", [60, 60.0, "60"])
def test_a_zone_may_reach_up_to_a_height(read, mark):
    text = geojson(feature(SQUARE), feature(INNER, name="hut", no_fly=True, below_m=mark))
    data = "".join(
        f'<Data name="{name}"><value>{value}</value></Data>'
        for name, value in (("no_fly", 1), ("below_m", mark))
    )
    more = f"<ExtendedData>{data}</ExtendedData>"
    same = kml(placemark(SQUARE), placemark(INNER, name="hut", more=more))
    for outline in (read(text, "geojson"), read(same, "kml")):
        assert [(zone.name, zone.below_m) for zone in outline.no_fly] == [("hut", 60.0)]


@pytest.mark.parametrize(
    ("marks", "top_m"),
    [
        ({"height_m": 12}, 12.0),
        ({"height_m": "12.5", "below_m": 60}, 60.0),
        ({"height_m": 60, "below_m": 60}, 60.0),
        ({"below_m": 60}, 60.0),
        ({}, None),
    ],
)
def test_a_zone_reaches_as_high_as_what_stands_there_unless_it_says(read, marks, top_m):
    text = geojson(feature(SQUARE), feature(INNER, name="no-fly wood", **marks))
    data = "".join(f'<Data name="{n}"><value>{v}</value></Data>' for n, v in marks.items())
    more = f"<ExtendedData>{data}</ExtendedData>"
    same = kml(placemark(SQUARE), placemark(INNER, name="no-fly wood", more=more))
    height_m = float(marks["height_m"]) if "height_m" in marks else None
    for outline in (read(text, "geojson"), read(same, "kml")):
        field = outline.laid(GeoPoint.at(SQUARE[0]))
        (zone,) = field.no_fly
        assert (zone.height_m, zone.top_m) == (height_m, top_m)
        for above_m in (-0.5, 0.5):
            is_binding = top_m is None or above_m < 0.0
            assert len(field.at((top_m or 500.0) + above_m).no_fly) == is_binding


@pytest.mark.parametrize("key", ["below_m", "height_m"])
@pytest.mark.parametrize("mark", [0, -1, 501, "high", True, "nan", [60]])
def test_a_height_that_is_none_is_told(read, key, mark):
    text = geojson(feature(SQUARE), feature(INNER, name="hut", no_fly=True, **{key: mark}))
    with pytest.raises(MissionFileError, match=rf"feature 2, 'hut'.*: {key} is '.*not a height"):
        read(text, "geojson")


@pytest.mark.parametrize("key", ["below_m", "height_m"])
def test_a_height_of_what_is_no_zone_is_told(read, key):
    text = geojson(feature(SQUARE, **{key: 12}))
    with pytest.raises(MissionFileError, match=rf"feature 1.*: {key} is a no-fly zone's"):
        read(text, "geojson")
    blank = geojson(feature(SQUARE, **{key: " "}))
    assert read(blank, "geojson").no_fly == ()


def test_what_stands_in_a_zone_does_not_reach_out_of_it(read):
    hut = feature(INNER, name="no-fly hut", below_m=10, height_m=12)
    with pytest.raises(
        MissionFileError, match=r"feature 2, 'no-fly hut': height_m 12 is more than below_m 10"
    ):
        read(geojson(feature(SQUARE), hut), "geojson")


def test_what_is_not_no_fly_in_words_is_the_field(read):
    text = geojson(feature(SQUARE, name="north field", no_fly="false"))
    assert len(read(text, "geojson").border_deg) == 4


def test_zones_without_a_name_are_numbered_and_names_are_fit_to_be_shown(read):
    name = "no-fly\n\tBauern\u2028hof Ü" + "x" * 100
    text = geojson(feature(SQUARE, INNER), feature(INNER, name=name), feature(INNER, no_fly=True))
    first, second, third = _names(read(text, "geojson"))
    assert (first, third) == ("zone 1", "zone 2")
    assert second.startswith("no-fly Bauern hof Üxx")
    assert len(second) == 80


def test_parts_of_a_zone_are_zones_and_their_holes_are_no_fly_too(read):
    parts = {"type": "MultiPolygon", "coordinates": []}
    for ring in (SQUARE, INNER):
        parts["coordinates"].append(polygon([(a + 0.1, b) for a, b in ring])["coordinates"])
    parts["coordinates"][0] += polygon([(a + 0.1, b) for a, b in INNER])["coordinates"]
    marked = {"type": "Feature", "properties": {"name": "no-fly lake"}, "geometry": parts}
    outline = read(geojson(feature(SQUARE), marked), "geojson")
    assert _names(outline) == ["no-fly lake 1", "no-fly lake 2"]
    assert [len(zone.corners_deg) for zone in outline.no_fly] == [4, 3]


def test_a_bare_geometry_and_a_bare_feature_are_geojson(read):
    bare = {"type": "GeometryCollection", "geometries": [polygon(SQUARE)]}
    for data in (polygon(SQUARE), feature(SQUARE), bare):
        assert read(json.dumps(data), "json").border_deg == tuple(SQUARE)


def test_what_is_no_polygon_is_passed_over(read):
    point = {"type": "Feature", "properties": None, "geometry": {"type": "Point"}}
    nowhere = {"type": "Feature", "properties": {}, "geometry": None}
    assert read(geojson(point, feature(SQUARE), nowhere), "geojson").border_deg == tuple(SQUARE)
    line = "<Placemark><LineString><coordinates>1,2 3,4</coordinates></LineString></Placemark>"
    assert read(kml(line, placemark(SQUARE)), "kml").border_deg == tuple(SQUARE)


@pytest.mark.parametrize("head", ["<kml>", '<kml xmlns="http://earth.google.com/kml/2.1">'])
def test_old_kml_and_a_byte_order_mark_are_read(read, head: str):
    assert read(f"\ufeff{kml(placemark(SQUARE), head=head)}", "KML").border_deg == tuple(SQUARE)


@pytest.mark.parametrize("mode", ["", "<altitudeMode>clampToGround</altitudeMode>"])
def test_heights_of_what_is_clamped_to_the_ground_do_not_count(read, mode: str):
    high = [(*corner, 512.5) for corner in SQUARE]
    assert read(kml(placemark(high, inside=mode)), "kml").border_deg == tuple(SQUARE)


def test_crs84_is_degrees(read):
    for name in ("urn:ogc:def:crs:OGC:1.3:CRS84", "urn:ogc:def:crs:EPSG::4326", "EPSG:4326"):
        crs = {"type": "name", "properties": {"name": name}}
        assert read(geojson(feature(SQUARE), crs=crs), "geojson").border_deg == tuple(SQUARE)


def test_circles_are_polygons_on_the_safe_side(read):
    place, radius_m = (47.005, 8.005), 300.0
    kept = read(plan(circles=[circle(place, 900.0, inclusion=True)]), "plan")
    origin = GeoPoint.at(place)
    around = read(plan(SQUARE, circles=[circle(place, radius_m, inclusion=False)]), "plan")
    included = shapely.Polygon(kept.laid(origin).border_ned_m)
    excluded = shapely.Polygon(around.laid(origin).no_fly[0].corners_ned_m)
    middle = shapely.Point(0.0, 0.0)
    assert middle.buffer(900.001, 256).contains(included)
    assert excluded.contains(middle.buffer(radius_m - 0.001, 256))
    assert included.area == pytest.approx(math.pi * 900.0**2, rel=0.01)
    assert excluded.area == pytest.approx(math.pi * radius_m**2, rel=0.01)


def test_a_polygon_that_geojson_cuts_at_180_degrees_is_one(read):
    east = [(-17.0, 179.99), (-17.0, 180.0), (-16.99, 180.0), (-16.99, 179.99)]
    west = [(-17.0, -180.0), (-17.0, -179.99), (-16.99, -179.99), (-16.99, -180.0)]
    parts = [polygon(ring)["coordinates"] for ring in (east, west)]
    text = geojson(
        {
            "type": "Feature",
            "properties": {},
            "geometry": {"type": "MultiPolygon", "coordinates": parts},
        }
    )
    border = read(text, "geojson").border_deg
    assert shapely.Polygon(border).area == pytest.approx(0.01 * 0.02)
    assert {longitude for _, longitude in border} >= {179.99, 180.01}


@pytest.mark.parametrize("zone_deg", [179.998, -180.002, -179.998])
def test_longitudes_go_on_over_180_and_zones_go_with_them(read, zone_deg: float):
    border = [(-17.0, 179.99), (-17.0, -179.99), (-16.99, -179.99), (-16.99, 179.99)]
    zone = [(a - 64.0, zone_deg + (b - 8.0) / 10.0) for a, b in INNER]
    outline = read(plan(border, excluded=[zone]), "plan")
    field = outline.laid(GeoPoint.at((-16.995, -180.0)))
    kept = shapely.Polygon(field.border_ned_m)
    assert kept.area == pytest.approx(1106.0 * 2129.0, rel=0.01)
    assert kept.contains(shapely.Polygon(field.no_fly[0].corners_ned_m))
    assert np.ptp(np.array(outline.border_deg)[:, 1]) == pytest.approx(0.02)
    assert abs(outline.no_fly[0].corners_deg[0][1] - outline.border_deg[0][1]) < 0.02


@st.composite
def stars(draw: st.DrawFn) -> list[tuple[float, float]]:
    """Corners in metres, north and east, of a polygon that is seen whole from its middle."""
    count = draw(st.integers(3, 12))
    shares = [draw(st.floats(0.1, 1.0)) for _ in range(count)]
    turns = np.cumsum(shares) / sum(shares) * 2.0 * np.pi
    assume(np.diff(turns, append=turns[0] + 2.0 * np.pi).max() < 3.0)
    radii_m = np.array([draw(st.floats(50.0, 3000.0)) for _ in range(count)])
    return np.stack([radii_m * np.cos(turns), radii_m * np.sin(turns)], axis=-1).tolist()


places = st.tuples(st.floats(-89.5, 89.5), st.floats(-180.0, 180.0))
FORMS = {
    "kml": lambda ring: kml(placemark(ring)),
    "geojson": lambda ring: geojson(feature(ring)),
    "plan": plan,
}


@pytest.mark.parametrize("form", FORMS)
@settings(max_examples=30)
@given(places, stars(), st.booleans())
@example((0.0, 180.0), [(100.0, 0.0), (0.0, 90.0), (-80.0, -70.0)], True)
@example((-16.0, -180.0), [(100.0, 0.0), (0.0, 90.0), (-80.0, -70.0)], False)
def test_any_polygon_anywhere_is_read_as_it_was_written(
    tmp_path_factory, form: str, place: tuple[float, float], star, is_wrapped: bool
):
    origin = GeoPoint.at(place)
    ring = [
        (latitude, (longitude + 180.0) % 360.0 - 180.0 if is_wrapped else longitude)
        for latitude, longitude in ned_to_degrees(np.array(star), origin).tolist()
    ]
    path = tmp_path_factory.getbasetemp() / f"any.{form}"
    path.write_text(FORMS[form](ring))
    outline = read_outline(path)
    assert outline.laid(origin).border_ned_m == pytest.approx(np.array(star), abs=0.1)
    longitudes = np.array(outline.border_deg)[:, 1]
    assert np.abs(np.diff(longitudes)).max() < 180.0


def test_a_field_that_crosses_itself_in_metres_is_told():
    bow_tie = np.array([(0.0, 0.0), (9.0, 9.0), (9.0, 0.0), (0.0, 9.0)])
    square = 9.0 * np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    zone = LaidZone(name="hut", corners_ned_m=bow_tie)
    assert "the field crosses" in str(Field(border_ned_m=bow_tie, no_fly=()).flaw())
    assert "'hut' crosses" in str(Field(border_ned_m=square, no_fly=(zone,)).flaw())
    assert Field(border_ned_m=square, no_fly=()).flaw() is None


def test_circles_touch_what_they_stand_for():
    inside, outside = (shapely.Polygon(circle_in_metres(10.0, is_inside=i)) for i in (True, False))
    rim = shapely.Point(0.0, 0.0).buffer(10.0, 4096).exterior
    assert not inside.buffer(-1e-9).crosses(rim)
    assert not outside.buffer(1e-5).exterior.crosses(rim)
    assert outside.area > inside.area
