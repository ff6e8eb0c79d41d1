"""Finds and names the drawn targets in a picture, with colours and shapes only.

Every pixel is looked up in a table of coat and ground colours. Connected coat pixels of a target's
size become candidates; each is cut out once more as a patch of ground of one of three scales, so
that its traits do not depend on height and tilt, and named after the prototype that they fit best.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from dronemon.frames import ground_to_pixel, pixel_to_ground
from dronemon.types import APPEARANCES, CameraModel, Detection, FloatArray, ImageArray, Pose
from dronemon.vision.prototypes import (
    COAT_COLOURS,
    COAT_SHADES,
    GROUND_COLOURS,
    GROUND_SHADES,
    PROTOTYPES,
    STONE_COLOURS,
    STONE_SHADES,
)

_PATCH_PX = 64
_PATCH_REACHES_M = (1.2, 4.0, 9.0)
"""From a patch's centre to its edges, for people, for animals and cars, and for what is longer."""
_PATCH_SHARE = 0.85
"""What may be seen of a target's length and width, over the patch that it is shown in."""
_PATCH_HEIGHT_M = 0.81
"""Height of the plane that patches are cut from: between the feet and the back of most animals."""
_LEAST, _ENOUGH = 0.73, 1.45
"""Detail at which a candidate is too far away to tell, over what the largest target watched needs;
and detail that pictures are shrunk to, over what the smallest one needs."""
_MIN_AREA = 0.2
"""Least area of a candidate, over that of the smallest target watched."""
_MAX_CANDIDATES = 64
_MIN_HEIGHT_M = 2.0
_MISFIT_LIMIT, _MISFIT_SLOPE = 40.0, 8.0
"""Squared deviation, in spreads, at which it is as likely none of them, and how sharply so."""
_FAINT = 60.0
"""Contrast below which a coat counts as plain."""
_GAP = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """Something with the colours of a target, and not too small for one.

    centre_px: (2,) u, v of the centre of its area
    traits:    as in Prototype
    """

    centre_px: FloatArray
    traits: FloatArray


class DrawnDetector:
    """Names the drawn targets of some appearances in pictures of one camera; a `Detector`.

    All known ones compete for a candidate, so that one which nobody watches is not taken for
    another.
    """

    def __init__(self, appearances: Sequence[str], camera: CameraModel, min_score: float) -> None:
        unknown = sorted(set(appearances) - set(APPEARANCES))
        if unknown:
            raise ValueError(f"{unknown} are not drawn; {', '.join(APPEARANCES)} are")
        self._appearances = frozenset(appearances)
        self._camera = camera
        self._min_score = min_score
        self._names = tuple(PROTOTYPES)
        self._traits = np.stack([prototype.traits for prototype in PROTOTYPES.values()])
        self._spreads = np.stack([prototype.spreads for prototype in PROTOTYPES.values()])
        watched = [PROTOTYPES[appearance] for appearance in self._appearances]
        self._least_area_m2 = _MIN_AREA * min(prototype.area_m2 for prototype in watched)
        needed_px_per_m = [prototype.needed_px_per_m for prototype in watched]
        self._least_px_per_m = _LEAST * min(needed_px_per_m)
        self._enough_px_per_m = _ENOUGH * max(needed_px_per_m)
        self._colour_table = _colour_table()

    def detect(self, image: ImageArray, pose: Pose, ground_down_m: float) -> tuple[Detection, ...]:
        """The targets that are wholly in a picture.

        image: (height, width, 3) uint8 BGR
        """
        detections = []
        for candidate in self.candidates(image, pose, ground_down_m):
            appearance, score = self._name(candidate.traits)
            if appearance in self._appearances and score >= self._min_score:
                u, v = self._below_trunk(candidate.centre_px, appearance, pose, ground_down_m)
                detections.append(Detection(appearance=appearance, pixel_px=(u, v), score=score))
        return tuple(detections)

    def candidates(self, image: ImageArray, pose: Pose, ground_down_m: float) -> list[Candidate]:
        """Whatever may be a target, not named yet; for `detect` and to measure new prototypes."""
        height_m = ground_down_m - pose.position_ned_m[2]
        if height_m < _MIN_HEIGHT_M:
            return []
        px_per_m = self._camera.focal_px / height_m
        shrink = max(1, int(px_per_m / self._enough_px_per_m))
        if shrink > 1:
            size = (self._camera.width_px // shrink, self._camera.height_px // shrink)
            image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        scale = np.array(image.shape[1::-1]) / (self._camera.width_px, self._camera.height_px)

        found = []
        for spot, extent_m in self._spots(image, px_per_m / shrink):
            reach_m = _patch_reach_m(extent_m)
            corners_px = self._patch_corners(spot / scale, reach_m, pose, ground_down_m)
            if not np.isfinite(corners_px).all():
                continue
            if _size(corners_px) < self._least_px_per_m * 2.0 * reach_m:
                continue  # too far away to tell
            patch_from_image = _square_from(corners_px * scale)
            patch = cv2.warpPerspective(
                image,
                patch_from_image,
                (_PATCH_PX, _PATCH_PX),
                flags=cv2.INTER_LINEAR,
                borderValue=GROUND_COLOURS["meadow"],
            )
            shape = self._largest_near_centre(np.asarray(patch, np.uint8), reach_m)
            if shape is not None:
                centre, traits = shape
                image_from_patch = np.asarray(np.linalg.inv(patch_from_image), np.float64)
                centre_px = _apply(image_from_patch, centre) / scale
                found.append(Candidate(centre_px=centre_px, traits=traits))
        return found

    def _spots(self, image: ImageArray, px_per_m: float) -> list[tuple[FloatArray, float]]:
        """Centre (u, v) and extent in m of connected coat colours clear of the picture's edge."""
        coat = cv2.morphologyEx((self._coat(image) > 0).astype(np.uint8), cv2.MORPH_CLOSE, _GAP)
        num, _, stats, centres = cv2.connectedComponentsWithStats(coat, connectivity=8)
        left, top, width, height, area = stats[1:num].T
        is_whole = (left > 0) & (top > 0)
        is_whole &= (left + width < image.shape[1]) & (top + height < image.shape[0])
        chosen = np.flatnonzero(is_whole & (area >= self._least_area_m2 * px_per_m**2)) + 1
        chosen = chosen[np.argsort(-stats[chosen, cv2.CC_STAT_AREA])][:_MAX_CANDIDATES]
        extent_m = np.maximum(width, height) / px_per_m
        return [(centres[i] + 0.5, float(extent_m[i - 1])) for i in chosen]

    def _coat(self, image: ImageArray) -> NDArray[np.uint8]:
        """Every pixel's coat: 0 for ground, or 1 + its place in COAT_COLOURS. -> (height, width)"""
        blue, green, red = (image[..., i].astype(np.uint16) >> 3 for i in range(3))
        coat: NDArray[np.uint8] = self._colour_table[blue << 10 | green << 5 | red]
        return coat

    def _patch_corners(
        self, centre_px: FloatArray, reach_m: float, pose: Pose, ground_down_m: float
    ) -> FloatArray:
        """Pixels of the north-west, north-east, south-east and south-west corner. -> (4, 2)"""
        down_m = ground_down_m - _PATCH_HEIGHT_M
        centre_m = pixel_to_ground(centre_px, self._camera, pose, down_m)
        corners_m = centre_m + reach_m * np.array([[1, -1], [1, 1], [-1, 1], [-1, -1]])
        return ground_to_pixel(corners_m, self._camera, pose, down_m)

    def _largest_near_centre(
        self, patch: ImageArray, reach_m: float
    ) -> tuple[FloatArray, FloatArray] | None:
        """Centre (2,) in the patch and traits of the target that the patch was cut around."""
        px_per_m = 0.5 * _PATCH_PX / reach_m
        coat = self._coat(patch)
        mask = cv2.morphologyEx((coat > 0).astype(np.uint8), cv2.MORPH_CLOSE, _GAP)
        num, labels, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8)
        is_near = np.abs(centres[1:num] - _PATCH_PX / 2.0).max(axis=1) < _PATCH_PX / 5.0
        area = stats[1:num, cv2.CC_STAT_AREA] * is_near
        if area.max(initial=0) < self._least_area_m2 * px_per_m**2:
            return None
        rows, columns = np.nonzero(labels == 1 + int(area.argmax()))
        light = patch[rows, columns].mean(axis=1)
        traits = _traits(np.stack([columns, rows]), coat[rows, columns], light, px_per_m)
        return np.array([columns.mean() + 0.5, rows.mean() + 0.5]), traits

    def _name(self, traits: FloatArray) -> tuple[str, float]:
        """The prototype that fits best, and how sure that is."""
        deviation = (traits - self._traits) / self._spreads
        log_fit = -0.5 * (deviation**2).sum(axis=1) - np.log(self._spreads).sum(axis=1)
        best = int(log_fit.argmax())
        share = 1.0 / np.exp(log_fit - log_fit[best]).sum()
        misfit = (deviation[best] ** 2).sum()
        is_target = 0.5 * (1.0 - np.tanh(0.5 * (misfit - _MISFIT_LIMIT) / _MISFIT_SLOPE))
        return self._names[best], float(share * is_target)

    def _below_trunk(
        self, centre_px: FloatArray, appearance: str, pose: Pose, ground_down_m: float
    ) -> tuple[float, float]:
        """Pixel of the ground under a trunk that is seen at a pixel."""
        trunk_down_m = ground_down_m - PROTOTYPES[appearance].height_m
        at_m = pixel_to_ground(centre_px, self._camera, pose, trunk_down_m)
        u, v = ground_to_pixel(at_m, self._camera, pose, ground_down_m)
        return float(u), float(v)


def _patch_reach_m(extent_m: float) -> float:
    """From the centre to the edges of the smallest patch that shows something whole."""
    fitting = (reach_m for reach_m in _PATCH_REACHES_M if extent_m < 2.0 * _PATCH_SHARE * reach_m)
    return next(fitting, _PATCH_REACHES_M[-1])


def _traits(
    points_px: NDArray[np.intp], coat: NDArray[np.uint8], light: FloatArray, px_per_m: float
) -> FloatArray:
    """Traits of the pixels of one target, in the order of Prototype.traits.

    points_px: (2, n) of a patch; coat, light: (n,)
    """
    points_m = (points_px - points_px.mean(axis=1, keepdims=True)) / px_per_m
    variances, axes = np.linalg.eigh(points_m @ points_m.T / light.size)
    width_m, length_m = 4.0 * np.sqrt(np.maximum(variances, 1e-6))
    across_m, along_m = axes.T @ points_m
    counts = np.bincount(coat, minlength=1 + len(COAT_COLOURS))[1:]

    spine = np.abs(across_m) < 0.3 * width_m
    bins = np.rint((along_m[spine] - along_m.min()) * 0.85 * px_per_m).astype(np.intp)
    num = np.bincount(bins)
    profile = np.bincount(bins, light[spine])[num > 0] / num[num > 0]
    bands = np.abs(np.diff(profile)).sum() / max(np.ptp(profile), _FAINT)
    return np.concatenate([[length_m, width_m], counts / max(counts.sum(), 1), [bands]])


def _colour_table() -> NDArray[np.uint8]:
    """Nearest known colour, in CIE Lab, of every colour of five bits a channel. -> (32768,)"""
    known, labels = [], []
    for i, variants in enumerate(COAT_COLOURS.values()):
        known += [np.multiply(c, shade) for c in variants for shade in COAT_SHADES]
        labels += [1 + i] * len(variants) * len(COAT_SHADES)
    for colours, shades in ((GROUND_COLOURS, GROUND_SHADES), (STONE_COLOURS, STONE_SHADES)):
        known += [np.multiply(c, shade) for c in colours.values() for shade in shades]
        labels += [0] * len(colours) * len(shades)
    levels = np.arange(32) * 8 + 4
    cells = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(-1, 3)
    nearest = KDTree(_lab(np.clip(known, 0, 255))).query(_lab(cells))[1]
    return np.array(labels, np.uint8)[nearest]


def _lab(bgr: FloatArray | NDArray[np.int64]) -> FloatArray:
    """CIE Lab of colours.

    bgr: (n, 3) 0 to 255
    -> (n, 3)
    """
    unit = np.asarray(bgr, np.float32)[:, None] / np.float32(255.0)
    return np.asarray(cv2.cvtColor(unit, cv2.COLOR_BGR2Lab)[:, 0], np.float64)


def _square_from(corners_px: FloatArray) -> FloatArray:
    """Homography from array indices of a picture to those of a patch.

    corners_px: (4, 2) u, v
    """
    patch_px = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * _PATCH_PX
    image, patch = ((corners - 0.5).astype(np.float32) for corners in (corners_px, patch_px))
    return np.asarray(cv2.getPerspectiveTransform(image, patch), np.float64)


def _apply(homography: FloatArray, point_px: FloatArray) -> FloatArray:
    """Image of a point u, v under a homography of array indices. -> (2,) u, v"""
    u, v, w = homography @ np.append(point_px - 0.5, 1.0)
    return np.array([u / w, v / w]) + 0.5


def _size(corners_px: FloatArray) -> float:
    """Side of the square that has the area of a quadrangle."""
    return float(np.sqrt(cv2.contourArea(corners_px.astype(np.float32))))
