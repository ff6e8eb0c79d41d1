"""Worlds in fields of other forms than the square."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from test_polygons import U, drawn_arena

from dronemon.arena import Arena
from dronemon.errors import OptionError
from dronemon.problem import MOTIONS
from dronemon.types import FloatArray
from dronemon.world import Instance
from dronemon.world.motions import draw_paths
from dronemon.world.tracks import draw_tracks

WIDE = Arena(low_au=(-0.5, 1.0), high_au=(1.5, 2.5))
TINY = Arena(low_au=(3.0, 3.0), high_au=(3.12, 3.07))
SLIVER = Arena.polygon(np.array([[0.0, 0.0], [2.0, 0.9], [2.0, 0.93]]))
NECK = Arena.polygon(  # two rooms, and a way of 0.02 au between them
    np.array(
        [
            *([0.0, 0.0], [0.45, 0.0], [0.45, 0.45], [0.55, 0.45], [0.55, 0.0], [1.0, 0.0]),
            *([1.0, 0.5], [0.55, 0.5], [0.55, 0.47], [0.45, 0.47], [0.45, 0.5], [0.0, 0.5]),
        ]
    )
)
LARGE = Arena.polygon(np.array([[0.0, 0.0], [12.5, 1.0], [11.0, 7.5], [6.0, 4.0], [1.0, 7.0]]))
FIELDS = {"wide": WIDE, "tiny": TINY, "neck": NECK, "large": LARGE, "U": U}


def check(motion: str, arena: Arena, seed: int, num_targets: int = 2) -> FloatArray:
    """Targets are in the field at 500 times, move, and none is too fast. -> (500, N, 2)."""
    paths = Instance.draw(seed, num_targets, motion, arena=arena).paths
    walked = np.linspace(0.0, 1.3 * paths.lengths_au.max(), 500)
    places = paths.positions_au(walked)
    assert arena.contains(places).all()
    assert (np.ptp(places, axis=0) > 0.0).all()
    if motion != "herd":  # its members go to and fro about a centre that keeps the speed
        steps = np.linalg.norm(np.diff(places, axis=0), axis=-1)
        assert steps.max() <= walked[1] * (1.0 + 1e-9)
    assert np.isfinite(paths.headings_rad(walked)).all()
    return places


@pytest.mark.parametrize("motion", MOTIONS)
def test_targets_stay_in_the_field_whatever_its_form(motion: str) -> None:
    for number, arena in enumerate(FIELDS.values()):
        check(motion, arena, 10_000 + number)


@pytest.mark.parametrize("motion", MOTIONS)
def test_targets_stay_in_drawn_polygons(motion: str) -> None:
    for seed in range(3):
        check(motion, drawn_arena(seed), 10_000 + seed)


@pytest.mark.slow
@pytest.mark.parametrize("motion", MOTIONS)
def test_targets_stay_in_many_drawn_polygons(motion: str) -> None:
    check(motion, SLIVER, 10_000)
    for seed in range(3, 60):
        check(motion, drawn_arena(seed), 10_000 + seed, 3)


@pytest.mark.parametrize("motion", MOTIONS)
def test_first_targets_do_not_depend_on_how_many_there_are(motion: str) -> None:
    few, many = (Instance.draw(10_000, n, motion, arena=U).paths for n in (1, 3))
    walked = np.linspace(0.0, 100.0, 200)
    np.testing.assert_array_equal(few.positions_au(walked), many.positions_au(walked)[:, :1])


@pytest.mark.parametrize("motion", sorted(set(MOTIONS) - {"loop"}))
def test_all_of_a_field_is_walked(motion: str) -> None:
    places = np.concatenate([check(motion, U, seed, 3).reshape(-1, 2) for seed in (10_000, 10_001)])
    is_high = places[:, 1] > 0.4
    for is_there in (is_high & (places[:, 0] < 0.5), is_high & (places[:, 0] > 0.5), ~is_high):
        assert is_there.mean() > 0.05


@pytest.mark.parametrize("motion", ["correlated", "brownian"])
def test_wanderers_neither_cling_to_the_border_nor_shun_it(motion: str) -> None:
    walks = [check(motion, U, seed, 3).reshape(-1, 2) for seed in range(10_000, 10_004)]
    inner = U.field.shrunk(0.04)
    near, expected = (
        1.0 - inner.contains(places).mean()
        for places in (np.concatenate(walks), U.sample(20_000, np.random.default_rng(0)))
    )
    assert 0.7 < near / expected < 1.3


def test_loops_fit_into_narrow_fields_and_are_as_large_as_ever_in_wide_ones() -> None:
    for arena, low, high in ((LARGE, 0.08, 0.25), (WIDE, 0.08, 0.25), (SLIVER, 0.0, 0.02)):
        lengths = Instance.draw(10_000, 5, "loop", arena=arena).paths.lengths_au
        assert (lengths > 2.0 * np.pi * low * 0.99).all()
        assert (lengths < 2.0 * np.pi * high).all()


def test_streets_are_as_dense_as_in_the_square() -> None:
    lengths = {}
    for name, arena in {"square": Arena(), **FIELDS}.items():
        way = Instance.draw(10_000, 1, "road", arena=arena).paths.points_au[0]
        lengths[name] = np.median(np.linalg.norm(np.diff(way, axis=0), axis=1))
    assert lengths["wide"] == pytest.approx(lengths["square"], rel=0.2)
    assert lengths["large"] == pytest.approx(lengths["square"], rel=0.2)


def test_roads_lead_through_a_neck_that_no_street_of_the_grid_leads_through() -> None:
    crossed = [
        np.ptp(np.sign(check("road", NECK, seed)[..., 0] - 0.5), axis=0).max() == 2.0
        for seed in range(10_000, 10_004)
    ]
    assert any(crossed)


def test_targets_cross_no_fly_zones() -> None:
    zone = np.array([[0.3, 0.3], [0.7, 0.3], [0.7, 0.7], [0.3, 0.7]])
    arena = Arena.polygon(Arena().outline_au[:-1], [zone])
    for motion in MOTIONS:
        places = check(motion, arena, 10_000, 4)
        assert (~arena.free.contains(places)).mean() > 0.02, motion


def tracks(folder, *lines: str):
    path = folder / "tracks.csv"
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


AU = "time,target,x,y"


@pytest.mark.parametrize(
    ("lines", "told"),
    [
        (("0,cow,0.1,0.1", "1,cow,0.5,0.5"), "line 3: cow at 0.5, 0.5 is not in the area"),
        (
            ("0,cow,0.1,0.1", "1,cow,0.1,0.9", "2,cow,0.9,0.9"),
            "line 4: the straight way of cow from its place in line 3 leaves the area",
        ),
    ],
)
def test_tracks_that_leave_a_field_are_told_by_their_line(tmp_path, lines, told) -> None:
    path = tracks(tmp_path, AU, *lines)
    with pytest.raises(OptionError, match=told):
        draw_paths(str(path), 1, np.random.default_rng(0), U)


def test_tracks_in_au_are_where_they_are_in_any_field(tmp_path) -> None:
    path = tracks(tmp_path, AU, "0,cow,1.2,2.1", "1,cow,1.4,2.4")
    np.testing.assert_allclose(draw_tracks(path, 1, WIDE).positions_au(0.0), [[1.2, 2.1]])
    with pytest.raises(OptionError, match="which lies within x 0 to 1, y 0 to 1 au"):
        draw_tracks(path, 1)


def test_tracks_on_the_globe_are_laid_into_any_field(tmp_path) -> None:
    rng = np.random.default_rng(0)
    fixes = [
        f"{t},cow,{47 + 0.01 * a},{8 + 0.01 * b}" for t, (a, b) in enumerate(rng.random((40, 2)))
    ]
    path = tracks(tmp_path, "time,target,lat,lon", *fixes)
    for arena in (*FIELDS.values(), SLIVER, *map(drawn_arena, range(10))):
        points = draw_tracks(path, 1, arena).points_au[0]
        assert all(arena.field.is_free(a, b) for a, b in pairwise(points))
        _, radius = arena.field.largest_circle()
        assert np.ptp(points, axis=0).max() >= 1.4 * radius
