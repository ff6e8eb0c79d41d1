"""A run's story as files that other programs read.

- sightings.geojson: area, track and sightings (RFC 7946, so cut where they cross 180 degrees)
- sightings.csv: a line per sighting
- run.kmz: the same for Google Earth, with pictures and a time slider (OGC KML 2.2)
- track.gpx: track and sightings (GPX 1.1)
- sightings.cot: the newest sighting of each target as Cursor-on-Target events, for ATAK
"""

from __future__ import annotations

import csv
import io
import json
import zipfile
from collections.abc import Callable, Iterable
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import shapely
from shapely.affinity import translate
from shapely.geometry import mapping
from shapely.geometry.base import BaseGeometry

from dronemon.export.story import Sighting, Story
from dronemon.frames import GeoPoint
from dronemon.palette import target_rgb

KML, GX = "http://www.opengis.net/kml/2.2", "http://www.google.com/kml/ext/2.2"
GPX = "http://www.topografix.com/GPX/1/1"
CREATOR = "dronemon"
_PLACE = ("latitude_deg", "longitude_deg")
TABLE_HEAD = ("time", "target", "class", *_PLACE, "error_m", "score", "picture")
_COT_STALE = timedelta(minutes=10)
_UNKNOWN_M = "9999999.0"
"""What Cursor-on-Target writes for a height or an error that is not known."""


PICTURES_FOLDER = "pictures/"


def geojson(story: Story, pictures: str = PICTURES_FOLDER) -> bytes:
    """Area, track and sightings as one FeatureCollection. pictures: where crops are from there"""
    features = []
    if story.corners:
        area = shapely.Polygon(_unwound(story.corners))
        features.append(_feature(area, kind="area", name=story.title))
    if len(story.track) > 1:
        places = [fix.place for fix in story.track]
        times = {"began": _iso(story.track[0].time), "ended": _iso(story.track[-1].time)}
        features.append(_feature(shapely.LineString(_unwound(places)), kind="track", **times))
    for sighting in story.sightings:
        point = shapely.Point(_lonlat(sighting.place))
        features.append(_feature(point, kind="sighting", **_facts(sighting, pictures)))
    collection = {"type": "FeatureCollection", "features": features}
    return json.dumps(collection, ensure_ascii=False, indent=1).encode()


def table(story: Story) -> bytes:
    """A line per sighting, with a head."""
    file = io.StringIO(newline="")
    writer = csv.DictWriter(file, TABLE_HEAD)
    writer.writeheader()
    for sighting in story.sightings:
        place = sighting.place.latitude_deg, sighting.place.longitude_deg
        where = {name: f"{value:.7f}" for name, value in zip(_PLACE, place, strict=True)}
        writer.writerow(where | _facts(sighting))
    return file.getvalue().encode()


def gpx(story: Story) -> bytes:
    """The track, and a waypoint per sighting."""
    root = ElementTree.Element(f"{{{GPX}}}gpx", version="1.1", creator=CREATOR)
    has_height = not story.cell_m
    for sighting in story.sightings:
        point = _gpx_point(root, "wpt", sighting.place, sighting.time, has_height)
        _text(point, f"{{{GPX}}}name", sighting.target)
        _text(point, f"{{{GPX}}}desc", _words(sighting))
    track = ElementTree.SubElement(root, f"{{{GPX}}}trk")
    _text(track, f"{{{GPX}}}name", story.title)
    segment = ElementTree.SubElement(track, f"{{{GPX}}}trkseg")
    for fix in story.track:
        _gpx_point(segment, "trkpt", fix.place, fix.time, has_height)
    return _document(root, {"": GPX})


def _gpx_point(
    parent: ElementTree.Element, tag: str, place: GeoPoint, time: datetime, has_height: bool
) -> ElementTree.Element:
    where = {"lat": f"{place.latitude_deg:.7f}", "lon": f"{place.longitude_deg:.7f}"}
    point = ElementTree.SubElement(parent, f"{{{GPX}}}{tag}", where)
    if has_height:
        _text(point, f"{{{GPX}}}ele", f"{place.altitude_m:.2f}")
    _text(point, f"{{{GPX}}}time", _iso(time))
    return point


def kmz(story: Story) -> bytes:
    """A KML document and its pictures in one archive."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("doc.kml", kml(story))
        for crop in (sighting.crop for sighting in story.sightings if sighting.crop):
            archive.writestr(f"pictures/{crop.name}", crop.read_bytes())
    return file.getvalue()


def kml(story: Story) -> bytes:
    """Area, track and sightings, the latter with times for the slider and a picture each."""
    root = ElementTree.Element(f"{{{KML}}}kml")
    document = ElementTree.SubElement(root, f"{{{KML}}}Document")
    _text(document, f"{{{KML}}}name", story.title)
    for number in sorted({sighting.number for sighting in story.sightings}):
        style = ElementTree.SubElement(document, f"{{{KML}}}Style", id=f"target-{number}")
        icon = ElementTree.SubElement(style, f"{{{KML}}}IconStyle")
        _text(icon, f"{{{KML}}}color", _kml_color(number))
    if story.corners:
        area = _placemark(document, "Area")
        ring: ElementTree.Element = area
        for tag in ("Polygon", "outerBoundaryIs", "LinearRing"):
            ring = ElementTree.SubElement(ring, f"{{{KML}}}{tag}")
        _text(ring, f"{{{KML}}}coordinates", _kml_places(story.corners))
    if story.track:
        placemark = _placemark(document, "Track")
        track = ElementTree.SubElement(placemark, f"{{{GX}}}Track")
        for fix in story.track:
            _text(track, f"{{{KML}}}when", _iso(fix.time))
        for fix in story.track:
            _text(track, f"{{{GX}}}coord", _kml_places([fix.place]).replace(",", " "))
    for sighting in story.sightings:
        placemark = _placemark(document, sighting.target, _description(sighting))
        stamp = ElementTree.SubElement(placemark, f"{{{KML}}}TimeStamp")
        _text(stamp, f"{{{KML}}}when", _iso(sighting.time))
        _text(placemark, f"{{{KML}}}styleUrl", f"#target-{sighting.number}")
        point = ElementTree.SubElement(placemark, f"{{{KML}}}Point")
        _text(point, f"{{{KML}}}coordinates", _kml_places([sighting.place]))
    return _document(root, {"": KML, "gx": GX})


def _placemark(
    document: ElementTree.Element, name: str, description: str = ""
) -> ElementTree.Element:
    placemark = ElementTree.SubElement(document, f"{{{KML}}}Placemark")
    _text(placemark, f"{{{KML}}}name", name)
    if description:
        _text(placemark, f"{{{KML}}}description", description)
    return placemark


def _kml_color(number: int) -> str:
    """Alpha, blue, green, red."""
    red, green, blue = target_rgb(number)
    return f"ff{blue:02x}{green:02x}{red:02x}"


def _kml_places(places: Iterable[GeoPoint]) -> str:
    """Longitude, latitude and height above the sea of each."""
    return " ".join(
        f"{p.longitude_deg:.7f},{p.latitude_deg:.7f},{p.altitude_m:.2f}" for p in places
    )


def _description(sighting: Sighting) -> str:
    picture = f'<img src="pictures/{sighting.crop.name}"/><br/>' if sighting.crop else ""
    return picture + _words(sighting)


def cot(story: Story) -> bytes:
    """The newest sighting of each target, as one document of Cursor-on-Target events."""
    newest = {sighting.target: sighting for sighting in story.sightings}
    root = ElementTree.Element("events")
    root.extend(cot_event(story.name, sighting) for sighting in newest.values())
    return _document(root, {})


def cot_event(run: str, sighting: Sighting) -> ElementTree.Element:
    """One sighting as a Cursor-on-Target event: neutral, on the ground, found by a machine."""
    event = ElementTree.Element(
        "event",
        version="2.0",
        uid=f"{CREATOR}.{run}.{sighting.target}",
        type="a-n-G",
        how="m-r",
        time=_iso(sighting.time),
        start=_iso(sighting.time),
        stale=_iso(sighting.time + _COT_STALE),
    )
    where = sighting.place
    point = {"lat": f"{where.latitude_deg:.7f}", "lon": f"{where.longitude_deg:.7f}"}
    error = {"hae": _UNKNOWN_M, "ce": f"{sighting.error_m:.1f}", "le": _UNKNOWN_M}
    ElementTree.SubElement(event, "point", point | error)
    detail = ElementTree.SubElement(event, "detail")
    ElementTree.SubElement(detail, "contact", callsign=sighting.target)
    _text(detail, "remarks", _words(sighting))
    return event


FORMATS: dict[str, Callable[[Story], bytes]] = {
    "sightings.geojson": geojson,
    "sightings.csv": table,
    "run.kmz": kmz,
    "track.gpx": gpx,
    "sightings.cot": cot,
}
"""Names of the files, and what makes them."""


def _facts(sighting: Sighting, pictures: str = PICTURES_FOLDER) -> dict[str, Any]:
    return {
        "time": _iso(sighting.time),
        "target": sighting.target,
        "class": sighting.appearance,
        "error_m": round(sighting.error_m, 1),
        "score": None if sighting.score is None else round(sighting.score, 2),
        "picture": f"{pictures}{sighting.crop.name}" if sighting.crop else None,
    }


def _words(sighting: Sighting) -> str:
    score = "" if sighting.score is None else f", score {sighting.score:.2f}"
    return f"{sighting.appearance}, within {sighting.error_m:.1f} m{score}"


def _feature(geometry: BaseGeometry, **properties: object) -> dict[str, Any]:
    shape = mapping(shapely.orient_polygons(_cut(geometry)))
    return {"type": "Feature", "geometry": shape, "properties": properties}


def _lonlat(place: GeoPoint) -> tuple[float, float]:
    return round(place.longitude_deg, 7), round(place.latitude_deg, 7)


def _unwound(places: Iterable[GeoPoint]) -> list[tuple[float, float]]:
    """Longitudes and latitudes without leaps from 180 to -180 degrees."""
    unwound: list[tuple[float, float]] = []
    for longitude_deg, latitude_deg in map(_lonlat, places):
        turns = round((unwound[-1][0] - longitude_deg) / 360.0) if unwound else 0
        unwound.append((longitude_deg + 360.0 * turns, latitude_deg))
    return unwound


def _cut(geometry: BaseGeometry) -> BaseGeometry:
    """Geometry that goes on beyond 180 degrees, in the parts that RFC 7946 asks for."""
    west, _, east, _ = geometry.bounds
    if west >= -180.0 and east <= 180.0:
        return geometry
    cuts = (
        translate(shapely.clip_by_rect(geometry, low, -90.0, low + 360.0, 90.0), -180.0 - low)
        for low in (-540.0, -180.0, 180.0)
    )
    parts = [part for cut in cuts for part in getattr(cut, "geoms", [cut]) if not part.is_empty]
    is_area = isinstance(geometry, shapely.Polygon)
    return shapely.MultiPolygon(parts) if is_area else shapely.MultiLineString(parts)


def _iso(time: datetime) -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%S.") + f"{time.microsecond // 1000:03d}Z"


def _text(parent: ElementTree.Element, tag: str, text: str) -> None:
    ElementTree.SubElement(parent, tag).text = text


def _document(root: ElementTree.Element, prefixes: dict[str, str]) -> bytes:
    for prefix, uri in prefixes.items():
        ElementTree.register_namespace(prefix, uri)
    ElementTree.indent(root)
    data: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return data


def write_all(story: Story, folder: Path) -> list[Path]:
    """Write every format and the pictures into a folder. -> the files. Raises OSError."""
    contents = {folder / name: make(story) for name, make in FORMATS.items()}
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for crop in (sighting.crop for sighting in story.sightings if sighting.crop):
            (folder / "pictures").mkdir(exist_ok=True)
            (folder / "pictures" / crop.name).write_bytes(crop.read_bytes())
        for path, content in contents.items():
            written.append(path)
            path.write_bytes(content)
    except OSError:
        for path in written:  # half of it would look like all, and hold up the next try
            path.unlink(missing_ok=True)
        raise
    return written
