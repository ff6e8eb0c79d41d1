"""What is wrong with a file is told by file and feature, with what to do; nothing is guessed."""

from __future__ import annotations

import contextlib
import json
import math
from pathlib import Path

import numpy as np
import pytest
from outlines import (
    BOW_TIE,
    INNER,
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
from dronemon.outline import read_outline

COVER = [(46.9, 7.9), (46.9, 8.1), (47.1, 8.1), (47.1, 7.9)]
HALVES = [
    [(46.9, 7.9), (46.9, 8.005), (47.1, 8.005), (47.1, 7.9)],
    [(46.9, 8.004), (46.9, 8.1), (47.1, 8.1), (47.1, 8.004)],
]
MANY = [(math.cos(i / 1500.0 * math.tau), math.sin(i / 1500.0 * math.tau)) for i in range(1500)]
HIGH = [(*corner, 12.0) for corner in SQUARE]
LINE = [(47.0, 8.0), (47.01, 8.0), (47.02, 8.0)]
SWAPPED = [(147.0 - a, 8.0) for a, _ in SQUARE[:2]] + [(120.0, 8.1)]
METRES = [(5249000.0, 2683000.0), (5249000.0, 2684000.0), (5250000.0, 2684000.0)]
FAR = [(8.0, 47.0), (8.0, 47.01), (8.01, 47.01)]
NAN = [(47.0, 8.0), (47.0, float("nan")), (47.01, 8.01)]
ENDLESS = [(47.0, 8.0), (47.0, 1e999), (47.01, 8.01)]
TWICE = [(47.0, 8.0), (47.0, 8.01), (47.0, 8.0), (47.0, 8.0)]
SPIKE = [(47.0, 8.0), (47.0, 8.01), (47.0, 8.02), (47.0, 8.01), (47.01, 8.0)]
LAUGHS = (
    '<?xml version="1.0"?><!DOCTYPE kml [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;">'
    '<!ENTITY c "&b;&b;&b;&b;">]><kml><name>&c;</name></kml>'
)
SPY = '<!DOCTYPE kml [<!ENTITY x SYSTEM "file:///etc/passwd">]><kml><name>&x;</name></kml>'
AFAR = '<!DOCTYPE kml SYSTEM "http://localhost:9/kml.dtd"><kml></kml>'
ABSOLUTE = "<altitudeMode>absolute</altitudeMode>"
POINTS = "<Placemark><Point><coordinates>8,47</coordinates></Point></Placemark>"
BAD_CRS = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::2056"}}
LINKED_CRS = {"type": "link", "properties": {"href": "http://localhost/crs"}}
APART = {"type": "MultiPolygon", "coordinates": [polygon(r)["coordinates"] for r in (SQUARE, FAR)]}

KML = {
    "bow tie": (
        kml(placemark(BOW_TIE, name="Reserve")),
        ["Placemark 1, 'Reserve'", "crosses", "corners 1 and 3", "redraw"],
    ),
    "bow tie in a hole": (
        kml(placemark(SQUARE, INNER, BOW_TIE)),
        ["Placemark 1: hole 2: crosses"],
    ),
    "heights": (
        kml(placemark(HIGH, inside=ABSOLUTE)),
        ["Placemark 1: corner 1", "12 m", "one height"],
    ),
    "swapped": (kml(placemark(SWAPPED)), ["corner 1", "latitude 100", "swapped?"]),
    "metres": (kml(placemark(METRES)), ["Placemark 1: corner 1", "are these metres?"]),
    "nan": (kml(placemark(NAN)), ["corner 2", "not of finite"]),
    "infinite": (kml(placemark(ENDLESS)), ["corner 2", "not of finite"]),
    "several": (
        kml(placemark(SQUARE, name="a"), POINTS, placemark(INNER)),
        ["has 2 polygons", "Placemark 1, 'a'; Placemark 3", "no-fly"],
    ),
    "points": (kml(POINTS, POINTS), ["no polygon among its 2 features"]),
    "a no-fly line": (
        kml(placemark(SQUARE), POINTS.replace("<Point>", "<name>No-fly road</name><Point>")),
        ["Placemark 2, 'No-fly road': is no-fly, but no polygon"],
    ),
    "nothing": (kml(), ["no polygon among its 0 features"]),
    "zones only": (kml(placemark(SQUARE, name="no-fly all")), ["no-fly zones only"]),
    "words": (
        kml(placemark(SQUARE).replace("8.01,47.0,0", "8.01, 47.0, 0")),
        ["Placemark 1: '8.01,' is not longitude,latitude"],
    ),
    "four": (kml(placemark(SQUARE).replace("47.0,0", "47.0,0,0")), ["'8.0,47.0,0,0' has more"]),
    "no corners": (kml(placemark([])), ["Placemark 1: has no corners"]),
    "no ring": (kml("<Placemark><Polygon/></Placemark>"), ["Placemark 1: is a polygon with 0"]),
    "mark": (
        kml(placemark(SQUARE, more='<Data name="no_fly"><value>maybe</value></Data>')),
        ["Placemark 1: no_fly is 'maybe'"],
    ),
    "truncated": (kml(placemark(SQUARE))[:200], ["not valid XML", "complete?"]),
    "gpx": ("<gpx></gpx>", ["not KML", "<gpx>"]),
    "laughs": (LAUGHS, ["DOCTYPE"]),
    "spy": (SPY, ["DOCTYPE"]),
    "afar": (AFAR, ["DOCTYPE"]),
    "deep": ("<kml>" + "<Placemark>" * 9999 + "</Placemark>" * 9999 + "</kml>", ["nested"]),
}
GEOJSON = {
    "bow tie": (geojson(feature(BOW_TIE, name="R")), ["feature 1, 'R': crosses"]),
    "spike": (geojson(feature(SPIKE)), ["feature 1: crosses or touches"]),
    "two corners": (geojson(feature(TWICE)), ["feature 1", "fewer than three different"]),
    "corner twice": (
        geojson(feature([*SQUARE, SQUARE[1]])),
        ["feature 1: crosses or touches", "from corners 2 and 5 meet"],
    ),
    "many": (geojson(feature(MANY)), ["feature 1: has 1500 corners, more than 1000"]),
    "no area": (geojson(feature(LINE)), ["feature 1", "encloses no area"]),
    "swapped": (geojson(feature(SWAPPED)), ["corner 1", "swapped?"]),
    "metres": (geojson(feature(METRES)), ["corner 1", "are these metres?"]),
    "heights": (geojson(feature(HIGH)), ["feature 1: corner 1", "12 m high"]),
    "crs": (geojson(feature(SQUARE), crs=BAD_CRS), ["EPSG::2056", "WGS 84"]),
    "linked crs": (geojson(feature(SQUARE), crs=LINKED_CRS), ["another projection"]),
    "crs of a feature": (
        geojson({**feature(SQUARE), "crs": BAD_CRS}),
        ["feature 1: crs", "EPSG::2056"],
    ),
    "covered": (geojson(feature(SQUARE), feature(COVER, name="no-fly A")), ["'no-fly A' covers"]),
    "covered by two": (
        geojson(feature(SQUARE), *(feature(half, no_fly=True) for half in HALVES)),
        ["'zone 1', 'zone 2' covers all"],
    ),
    "hole as large": (geojson(feature(SQUARE, SQUARE)), ["'zone 1' covers all"]),
    "far zone": (
        geojson(feature(SQUARE), feature(FAR, name="no-fly hut")),
        ["'no-fly hut' is", "km from the field", "swapped?"],
    ),
    "wide": (geojson(feature([*SQUARE[:2], (8.0, 47.0)])), ["km across", "misplaced"]),
    "apart": (
        geojson({"type": "Feature", "properties": {}, "geometry": APART}),
        ["feature 1: is of 2 polygons apart"],
    ),
    "nan": (geojson(feature(NAN)), ["not valid JSON: NaN"]),
    "infinite": (geojson(feature(SQUARE)).replace("8.01", "1e999", 1), ["not of finite"]),
    "huge": (geojson(feature(SQUARE)).replace("8.01", "9" * 5000, 1), ["not of finite"]),
    "text": (geojson(feature(SQUARE)).replace("8.01", '"8.01"', 1), ["a corner is not of 2 or 3"]),
    "true": (geojson(feature(SQUARE)).replace("8.01", "true", 1), ["a corner is not of 2 or 3"]),
    "truncated": (geojson(feature(SQUARE))[:100], ["not valid JSON", "complete?"]),
    "deep": ("[" * 100_000, ["nested too deeply"]),
    "list": ("[1, 2]", ["no object"]),
    "topology": ('{"type": "Topology"}', ["'Topology' is no type of GeoJSON's"]),
    "no features": ('{"type": "FeatureCollection"}', ["features is no list"]),
    "a number for a feature": (geojson(3), ["feature 1: it is no object"]),  # type: ignore[arg-type]
    "a number for rings": (
        geojson({**feature(), "geometry": {**polygon(), "coordinates": 3}}),
        ["coordinates is no list"],
    ),
    "no rings": (geojson(feature()), ["feature 1: is a polygon without corners"]),
    "mark": (geojson(feature(SQUARE, no_fly=["x"])), ["feature 1: no_fly is"]),
}
PLAN = {
    "bow tie": (plan(BOW_TIE), ["fence polygon 1: crosses"]),
    "bow-tied zone": (plan(SQUARE, excluded=[BOW_TIE]), ["fence polygon 2: crosses"]),
    "several": (plan(SQUARE, INNER), ["has 2 polygons", "fence polygon 1; fence polygon 2"]),
    "exclusion only": (plan(excluded=[SQUARE]), ["no-fly zones only"]),
    "no fence": (plan(), ["has no fence", "Fence"]),
    "no geoFence": ('{"fileType": "Plan", "mission": {}}', ["has no fence"]),
    "wrong type": (plan(SQUARE, fileType="Parameters"), ["fileType is 'Parameters'"]),
    "old": (plan(SQUARE, geoFence={"polygon": [], "version": 1}), ["version 1.0", "newer"]),
    "swapped": (plan([(120.0, 8.0), *SQUARE[1:]]), ["corner 1", "swapped?"]),
    "covered": (
        plan(SQUARE, circles=[circle((47.0, 8.0), 9000.0, inclusion=False)]),
        ["'zone 1' covers all"],
    ),
    "radius": (plan(circles=[circle(SQUARE[0], -3.0, inclusion=True)]), ["circle 1: radius -3.0"]),
    "center": (plan(circles=[circle((147.0, 8.0), 3.0, inclusion=True)]), ["circle 1: its center"]),
    "inclusion": (plan(SQUARE).replace("true", "3"), ["fence polygon 1: inclusion"]),
    "one number": (plan([(47.0,), *SQUARE]), ["fence polygon 1: a corner is not of"]),
    "truncated": (plan(SQUARE)[:100], ["not valid JSON"]),
}
CASES = [
    pytest.param(suffix, text, words, id=f"{suffix} {what}")
    for suffix, cases in (("kml", KML), ("geojson", GEOJSON), ("plan", PLAN))
    for what, (text, words) in cases.items()
]


def _error(path: Path) -> str:
    with pytest.raises(MissionFileError) as caught:
        read_outline(path)
    told = str(caught.value)
    assert told.startswith(f"{path}: "), told
    assert len(told) < len(str(path)) + 400
    return told


@pytest.mark.parametrize(("suffix", "text", "words"), CASES)
def test_a_bad_file_is_told_by_feature(tmp_path: Path, suffix: str, text: str, words: list[str]):
    path = tmp_path / f"field.{suffix}"
    path.write_text(text)
    told = _error(path)
    for word in words:
        assert word in told


@pytest.mark.parametrize("suffix", ["kml", "geojson", "plan"])
def test_files_that_are_no_text_of_this_size(tmp_path: Path, suffix: str):
    path = tmp_path / f"field.{suffix}"
    assert "no such file" in _error(path)
    path.write_text(" \n")
    assert "is empty" in _error(path)
    path.write_bytes(b"<kml>\xff</kml>")
    assert "is not UTF-8: byte 5 is 0xff" in _error(path)
    path.write_bytes("<kml/>".encode("utf-16"))
    assert "is not UTF-8" in _error(path)
    path.write_text(" " * 2_000_001)
    assert "larger than 2 MB" in _error(path)
    path.unlink()
    path.mkdir()
    assert "no such file" in _error(path)


def test_zones_of_many_corners_are_refused_before_they_are_joined(tmp_path: Path):
    angle = np.arange(800) / 400.0 * np.pi
    reach = np.where(np.arange(800) % 2, 4e-3, 4e-5)
    star = np.stack([47.4 + reach * np.cos(angle), 8.5 + reach * np.sin(angle)], axis=-1)
    zones = [placemark(star.tolist(), name="no-fly") for _ in range(4)]
    path = tmp_path / "field.kml"
    path.write_text(kml(placemark(SQUARE), *zones))
    assert "its no-fly zones have 3200 corners, more than 3000; simplify them" in _error(path)


@pytest.mark.parametrize("name", ["field.kmz", "field.shp", "field", "field.kml.bak"])
def test_other_endings_are_refused(tmp_path: Path, name: str):
    path = tmp_path / name
    path.write_text(kml(placemark(SQUARE)))
    assert ".geojson" in _error(path)


def test_every_cut_of_a_file_is_an_error_and_nothing_else(tmp_path: Path):
    texts = {
        "kml": kml(placemark(SQUARE)),
        "geojson": geojson(feature(SQUARE)),
        "plan": plan(SQUARE),
    }
    for suffix, text in texts.items():
        path = tmp_path / f"field.{suffix}"
        for end in range(0, len(text) - 1, 7):
            path.write_text(text[:end])
            _error(path)


def test_every_wrong_value_is_an_error_or_a_field_and_nothing_else(tmp_path: Path):
    """Each value of a good file, in turn, is another one."""
    texts = {
        "geojson": geojson(feature(INNER, name="a", no_fly=0), feature(INNER[:1], no_fly=True)),
        "plan": plan(SQUARE, circles=[circle(INNER[0], 9.0, inclusion=False)]),
    }
    for suffix, text in texts.items():
        path = tmp_path / f"field.{suffix}"
        for where in _paths(json.loads(text)):
            for wrong in (None, -1e9, "x", []):
                data = json.loads(text)
                holder = data
                for key in where[:-1]:
                    holder = holder[key]
                holder[where[-1]] = wrong
                path.write_text(json.dumps(data))
                with contextlib.suppress(MissionFileError):
                    read_outline(path)


def _paths(value: object, above: tuple = ()):
    if isinstance(value, dict | list):
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            yield (*above, key)
            yield from _paths(item, (*above, key))
