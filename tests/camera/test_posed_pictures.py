"""Pictures and where they were taken: what is read, and every bad thing by its file and line."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from recorded_flight import (
    BEGAN,
    BODY,
    GIMBAL,
    TABLE_HEAD,
    Shot,
    exif_of,
    gimbal_attitude,
    write_table,
    xmp_of,
)

from dronemon.camera import PosedCamera, PosedPictures, has_poses, read_posed
from dronemon.errors import CameraError
from dronemon.mission.schema import Camera

CAMERA = Camera(width_px=64, height_px=64)
SHOTS = [
    Shot(
        name=f"{name}.jpg", time_s=2.0 * k, place_m=(5.0 * k, -3.0 * k), angles_deg=(1.0, -80.0, 9)
    )
    for k, name in enumerate("bcda")
]
ROWS = [list(map(str, shot.row())) for shot in SHOTS]
DTD = b'<!DOCTYPE x [<!ENTITY a "35"><!ENTITY b "&a;&a;">]>'


def save(folder: Path, *, with_tags: bool = False) -> Path:
    folder.mkdir(exist_ok=True)
    for shot in SHOTS:
        told = {"exif": exif_of(shot), "xmp": xmp_of(shot)} if with_tags else {}
        Image.new("RGB", (64, 64)).save(folder / shot.name, **told)
    return folder


def read(folder: Path, table: Path | None = None) -> PosedPictures:
    return read_posed(folder, table, CAMERA)


def test_a_table_beside_them_tells_where_pictures_were_taken(tmp_path: Path) -> None:
    write_table(save(tmp_path), ROWS)
    assert has_poses(tmp_path)
    posed = read(tmp_path)
    assert [picture.name for picture in posed.pictures] == ["b.jpg", "c.jpg", "d.jpg", "a.jpg"]
    assert [picture.time_s for picture in posed.pictures] == [0.0, 2.0, 4.0, 6.0]
    assert abs(posed.began - (datetime.now(UTC) - timedelta(seconds=6.0))) < timedelta(minutes=5)
    *_, last = posed.poses(posed.start)
    np.testing.assert_allclose(last.position_ned_m, [15.0, -9.0, -35.0], atol=0.01)
    np.testing.assert_allclose(last.velocity_ned_m_s, [2.5, -1.5, 0.0], atol=0.01)
    np.testing.assert_allclose(last.attitude_rad, np.radians([1.0, -80.0, 9.0]))
    assert [p.name for p in posed.every(3).pictures] == ["b.jpg", "a.jpg"]


def test_a_gimbals_angles_are_the_cameras_and_come_before_the_vehicles(tmp_path: Path) -> None:
    rows = [[*row, "20", "10", "5"] for row in ROWS]
    write_table(save(tmp_path), rows, (*GIMBAL, *BODY))
    for pose in read(tmp_path).poses(read(tmp_path).start):
        np.testing.assert_allclose(pose.attitude_rad, gimbal_attitude((1.0, -80.0, 9.0)))
    turned = CAMERA.model_copy(update={"mount_deg": (0.0, 0.0, 90.0)})
    with pytest.raises(
        CameraError, match=r"poses\.csv:2: .*mount_deg, \[0.0, 0.0, 90.0\], must be"
    ):
        read_posed(tmp_path, None, turned)


@pytest.mark.parametrize("is_element", [False, True])
@pytest.mark.parametrize("has_place", [False, True])
def test_pictures_tell_it_by_themselves(tmp_path: Path, is_element: bool, has_place: bool) -> None:
    """Names are not in the order of times: a drone's count begins anew after 9999."""
    save(tmp_path, with_tags=True)
    for shot in SHOTS:
        xmp = xmp_of(shot, is_element=is_element, has_place=has_place)
        image = Image.new("RGB", (64, 64))
        image.save(tmp_path / shot.name, exif=exif_of(shot), xmp=xmp)
    assert has_poses(tmp_path)
    posed = read(tmp_path)
    assert [picture.name for picture in posed.pictures] == ["b.jpg", "c.jpg", "d.jpg", "a.jpg"]
    assert posed.began == (BEGAN - timedelta(hours=2)).replace(tzinfo=UTC)
    for pose, shot in zip(posed.poses(posed.start), SHOTS, strict=True):
        assert pose.time_s == pytest.approx(shot.time_s)
        np.testing.assert_allclose(pose.position_ned_m, (*shot.place_m, -35.0), atol=0.01)
        np.testing.assert_allclose(pose.attitude_rad, gimbal_attitude(shot.angles_deg), atol=1e-9)


def test_an_older_drones_spelling_of_longitude_is_read(tmp_path: Path) -> None:
    save(tmp_path, with_tags=True)
    for shot in SHOTS:
        xmp = xmp_of(shot).replace(b"GpsLongitude", b"GpsLongtitude")
        exif = exif_of(shot)
        del exif._ifds[0x8825]
        Image.new("RGB", (64, 64)).save(tmp_path / shot.name, exif=exif, xmp=xmp)
    assert read(tmp_path).pictures[3].place.longitude_deg == pytest.approx(SHOTS[3].degrees[1])


@pytest.mark.parametrize(
    ("stamps", "began"),
    [
        (
            ["2025-03-09T06:30:00.5Z", "2025-03-09T06:30:02Z"],
            datetime(2025, 3, 9, 6, 30, 0, 500_000),
        ),
        (
            ["2025-03-09 08:30:00+02:00", "2025-03-09 06:30:01.500+00:00"],
            datetime(2025, 3, 9, 6, 30),
        ),
    ],
)
def test_times_may_be_dates(tmp_path: Path, stamps: list[str], began: datetime) -> None:
    for shot in SHOTS[:2]:
        Image.new("RGB", (64, 64)).save(tmp_path / shot.name)
    rows = [[row[0], stamp, *row[2:]] for row, stamp in zip(ROWS, stamps, strict=False)]
    write_table(tmp_path, rows)
    posed = read(tmp_path)
    assert posed.began == began.replace(tzinfo=UTC)
    assert posed.pictures[1].time_s == pytest.approx(1.5)


def cell(row: int, column: str, text: str) -> Callable[[list[list[str]]], None]:
    def change(rows: list[list[str]]) -> None:
        rows[row][[*TABLE_HEAD, *BODY].index(column)] = text

    return change


def times(*texts: str) -> Callable[[list[list[str]]], None]:
    def change(rows: list[list[str]]) -> None:
        for row, text in zip(rows, texts, strict=True):
            row[1] = text

    return change


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (cell(1, "altitude_m", ""), r"poses\.csv:3: altitude_m is empty"),
        (cell(1, "altitude_m", "nan"), r"poses\.csv:3: altitude_m 'nan' is no number"),
        (cell(1, "altitude_m", "1e5"), r"poses\.csv:3: an altitude of 100000 m is no drone's"),
        (cell(0, "yaw_deg", "3,5"), r"poses\.csv:2: yaw_deg '3,5' is no number"),
        (cell(0, "yaw_deg", "1_0"), r"poses\.csv:2: yaw_deg '1_0' is no number"),
        (cell(2, "roll_deg", "900"), r"poses\.csv:4: roll, pitch, yaw of 900, .* no angles"),
        (cell(3, "latitude", "151.2"), r"poses\.csv:5: latitude 151.2, .* are they swapped\?"),
        (cell(3, "longitude", "181"), r"poses\.csv:5: .* longitude 181 is no place"),
        (cell(0, "time_s", "noon"), r"poses\.csv:2: time_s 'noon' is neither seconds nor"),
        (cell(0, "time_s", "0001-01-01"), r"poses\.csv:2: time_s '0001-.* 00:00:00 is before 1970"),
        (cell(0, "time_s", "1e999"), r"poses\.csv:2: time_s '1e999' is neither"),
        (cell(3, "time_s", "2025-03-09T06:30:00"), r"poses\.csv:5: gives a date without a zone"),
        (cell(2, "time_s", "2"), r"poses\.csv:4: d\.jpg is not later than c\.jpg, .* \(0 s\)"),
        (
            cell(2, "time_s", "1.5"),
            r"poses\.csv:4: d\.jpg is not later than c\.jpg, .* \(-0\.5 s\)",
        ),
        (cell(3, "time_s", "40"), r"poses\.csv:5: a\.jpg is 36 s later than d\.jpg, others 2\.0 s"),
        (times("0", "2e6", "4e6", "6e6"), r"poses\.csv:3: .* are these milliseconds\?"),
        (cell(1, "picture", "e.jpg"), r"poses\.csv:3: no picture 'e\.jpg' is there(.|\n)*"),
        (cell(1, "picture", "e.jpg"), r"poses\.csv: says nothing of c\.jpg"),
        (cell(1, "picture", "../x/c.jpg"), r"no picture '\.\./x/c\.jpg'"),
        (cell(1, "picture", "b.jpg"), r"poses\.csv:3: b\.jpg comes again"),
        (lambda rows: rows.pop(), r"poses\.csv: says nothing of a\.jpg; add its line"),
        (lambda rows: rows[2].append("0"), r"poses\.csv:4: has 9 values, its head 8 columns"),
        (lambda rows: rows[2].pop(), r"poses\.csv:4: has 7 values, its head 8 columns"),
        (lambda rows: rows.clear(), r"poses\.csv: says nothing of a\.jpg"),
    ],
)
def test_what_is_wrong_with_a_table_is_told_by_its_line(
    tmp_path: Path, change: Callable[[list[list[str]]], None], words: str
) -> None:
    rows = [list(row) for row in ROWS]
    change(rows)
    write_table(save(tmp_path), rows)
    with pytest.raises(CameraError, match=words):
        read(tmp_path)


def test_swapped_degrees_and_those_without_gps_are_told(tmp_path: Path) -> None:
    rows = [list(row) for row in ROWS]
    rows[2][2:4] = reversed(rows[2][2:4])
    table = write_table(save(tmp_path), rows)
    with pytest.raises(CameraError, match=r"csv:4: d\.jpg is \d{7} m from c\.jpg, .* swapped"):
        read(tmp_path)
    rows[2][2:4] = "0.0", "0"
    write_table(tmp_path, rows)
    with pytest.raises(CameraError, match=r"csv:4: latitude 0, longitude 0 is .* without GPS"):
        read(tmp_path, table)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"", r"poses\.csv:1: has no column picture, time_s, latitude"),
        (b"picture;time_s\n", r"poses\.csv:1: has no column picture.*with commas between"),
        (b"picture,time_s,longitude,latitude,altitude_m,roll_deg,pitch_deg\n", "no column yaw_deg"),
        (
            b"picture,time_s,longitude,latitude,gimbal_yaw_deg\n",
            "column altitude_m, gimbal_roll_deg",
        ),
        (",".join((*TABLE_HEAD, *BODY, "time_s")).encode(), "has the column time_s twice"),
        (b'picture\n"a"b', r"poses\.csv:2: "),
        (b"\xff\xfe\x00", r"poses\.csv: cannot be read"),
    ],
)
def test_a_file_that_is_no_such_table_is_told(tmp_path: Path, text: bytes, words: str) -> None:
    save(tmp_path)
    (tmp_path / "poses.csv").write_bytes(text)
    assert not has_poses(tmp_path) or b"latitude" in text
    with pytest.raises(CameraError, match=words):
        read(tmp_path)


def test_all_that_is_wrong_is_told_at_once_but_not_a_thousand_lines(tmp_path: Path) -> None:
    rows = [[f"{k}.jpg", str(k), "", "", "35", "0", "0", "x"] for k in range(30)]
    write_table(save(tmp_path), rows)
    with pytest.raises(CameraError) as caught:
        read(tmp_path)
    first, *rest, more = str(caught.value).splitlines()
    assert first.endswith("csv:2: latitude is empty; longitude is empty; yaw_deg 'x' is no number")
    assert (len(rest), more) == (9, "and 20 more")


def test_of_several_tables_one_is_named(tmp_path: Path) -> None:
    table = write_table(save(tmp_path), ROWS)
    (tmp_path / "labels.csv").write_text("a,b\n")
    assert not has_poses(tmp_path)
    with pytest.raises(CameraError, match=r"several tables, labels\.csv, poses\.csv; name one"):
        read(tmp_path)
    assert len(read(tmp_path, table).pictures) == 4


@pytest.mark.parametrize("with_tags", [False, True])
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (
            lambda f: Image.new("RGB", (64, 48)).save(f),
            r"c\.jpg: .*64 x 48 pixels, the mission says",
        ),
        (lambda f: f.write_bytes(b"text"), r"c\.jpg: is no picture that can be read"),
        (lambda f: f.write_bytes(f.read_bytes()[:30]), r"c\.jpg: "),
    ],
)
def test_pictures_that_do_not_fit_are_told(
    tmp_path: Path, with_tags: bool, spoil: Callable[[Path], object], words: str
) -> None:
    save(tmp_path, with_tags=with_tags)
    if not with_tags:
        write_table(tmp_path, ROWS)
    spoil(tmp_path / "c.jpg")
    with pytest.raises(CameraError, match=words):
        read(tmp_path)


def _without(name: str) -> Callable[[bytes], bytes]:
    return lambda xmp: xmp.replace(f"drone-dji:{name}".encode(), b"drone-dji:Else")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda _: b"", r"its XMP has no drone-dji:RelativeAltitude, GimbalRoll.*; give a table"),
        (_without("RelativeAltitude"), "its XMP has no drone-dji:RelativeAltitude; give a table"),
        (_without("GimbalYawDegree"), "its XMP has no drone-dji:GimbalYawDegree"),
        (lambda xmp: xmp.replace(b"+35.00", b"high"), "drone-dji:RelativeAltitude 'high' is no"),
        (lambda xmp: xmp.replace(b"-33.9", b"-93.9"), "latitude -93.9.* is no place"),
        (lambda xmp: xmp[:-60], "c.jpg: "),
        (lambda xmp: xmp.replace(b"?><x:", b"?>" + DTD + b"<x:"), "has a DTD, which no camera"),
        (
            lambda xmp: xmp.decode().replace("?><x:", f"?>{DTD.decode()}<x:").encode("utf-16"),
            "has a DTD, which no camera",
        ),
        (
            lambda xmp: xmp.replace(b"?><x:", b'?><!DOCTYPE x SYSTEM "file:///etc/passwd"><x:'),
            "has a DTD, which no camera",
        ),
        (lambda xmp: xmp.replace(b"+35.00", b"&a;"), "c.jpg: undefined entity"),
    ],
)
def test_what_a_picture_does_not_say_is_told(
    tmp_path: Path, change: Callable[[bytes], bytes], words: str
) -> None:
    save(tmp_path, with_tags=True)
    xmp = change(xmp_of(SHOTS[1]))
    Image.new("RGB", (64, 64)).save(tmp_path / "c.jpg", exif=exif_of(SHOTS[1]), xmp=xmp)
    with pytest.raises(CameraError, match=words):
        read(tmp_path)


@pytest.mark.parametrize(
    ("ifd", "changes", "words"),
    [
        (0x8825, {2: None}, r"c\.jpg: it has no GPS, neither in EXIF nor in XMP"),
        (0x8825, {1: "X"}, r"c\.jpg: it has no GPS"),
        (0x8769, {36867: None}, r"c\.jpg: its DateTimeOriginal '' with '250' and .* is no time"),
        (0x8769, {36867: "0000:00:00 00:00:00"}, "is no time"),
        (0x8769, {36867: "0001:01:01 00:00:00"}, "is no time"),
        (0x8769, {36881: "+99:99"}, "is no time"),
        (0x8769, {36881: None}, r"c\.jpg: gives a date without a zone, and .*b\.jpg a date with"),
        (0x8769, {36867: "2025:03:09 06:30:00"}, r"c\.jpg: c\.jpg is not later than b\.jpg"),
    ],
)
def test_what_exif_does_not_say_is_told(
    tmp_path: Path, ifd: int, changes: dict[int, str | None], words: str
) -> None:
    save(tmp_path, with_tags=True)
    exif, xmp = exif_of(SHOTS[1]), xmp_of(SHOTS[1], has_place=False)
    told = exif.get_ifd(ifd)
    for tag, value in changes.items():
        del told[tag]
        if value is not None:
            told[tag] = value
    Image.new("RGB", (64, 64)).save(tmp_path / "c.jpg", exif=exif, xmp=xmp)
    with pytest.raises(CameraError, match=words):
        read(tmp_path)


def test_pictures_without_a_word_and_folders_without_pictures(tmp_path: Path) -> None:
    assert not has_poses(tmp_path)
    assert not has_poses(tmp_path / "nowhere")
    for folder, words in ((tmp_path, "no pictures in it"), (tmp_path / "nowhere", "no folder")):
        with pytest.raises(CameraError, match=words):
            read(folder)
    assert not has_poses(save(tmp_path))
    with pytest.raises(CameraError, match="give a table with --poses"):
        read(tmp_path)


async def _captured(camera: PosedCamera) -> list[float | str]:
    """The time of each picture, or why there is none."""
    captured: list[float | str] = []
    async with camera:
        for _ in range(len(SHOTS) + 1):
            try:
                captured.append((await camera.capture()).time_s)
            except CameraError as exc:
                captured.append(str(exc))
    return captured


def test_a_picture_that_cannot_be_decoded_costs_no_other(tmp_path: Path) -> None:
    write_table(save(tmp_path), ROWS)
    camera = PosedCamera(read(tmp_path))
    (tmp_path / "c.jpg").write_bytes(b"spoilt since")
    spoilt = f"{tmp_path / 'c.jpg'}: is no picture that can be read"
    captured = asyncio.run(_captured(camera))
    assert captured == [0.0, spoilt, 4.0, 6.0, "there are no more pictures"]
