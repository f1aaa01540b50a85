"""Depth cameras: the maps that they would give of a scene, with noise, holes and mixed pixels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import ndtri

from mocap.data.depth import DepthNoise
from mocap.synth.section import Section

Array = NDArray[np.float64]

MAP_UNIT_MM = 1.0
_STEP_M = 0.08  # a larger one from pixel to pixel is an edge
_HOLE_PX = 9  # size of the blobs in which absorbent things are lost


class DepthConfig(Section):
    """Which cameras measure depth, and how well. Sensor figures are those of structured light and stereo cameras."""

    cameras: tuple[str, ...] = Field(min_length=1)
    noise_m: float = Field(0.003, ge=0.0, le=0.1)
    """Standard deviation of a reading next to the camera."""
    noise_per_m: float = Field(0.0015, ge=0.0, le=0.1)
    """By how much it grows with the square of the distance, m per m^2."""
    noise_size_px: float = Field(1.0, ge=0.0, le=10.0)
    """How far the noise of neighbours hangs together: matching windows smooth it."""
    range_m: tuple[float, float] = (0.4, 6.0)
    """What lies nearer or further gives no reading."""
    edge_loss: float = Field(0.5, ge=0.0, le=1.0)
    """Share of the pixels at edges without a reading; a third of the others there mixes what lies before and behind."""
    absorbed: float = Field(0.6, ge=0.0, le=1.0)
    """Share of what is nearly black without a reading, in blobs."""
    dark: float = Field(0.06, ge=0.0, le=1.0)
    """Albedo below which a thing is nearly black."""
    grazing_deg: float = Field(80.0, gt=0.0, le=90.0)
    """A surface that is seen at a larger angle to its normal gives no reading."""


@dataclass(frozen=True, eq=False)
class TrueDepth:
    """What a perfect depth camera would see.

    depth_m : (H, W) m along the optical axis.  albedo : (H, W) of the bodies, 1 elsewhere.  cosine : (H, W) between
    line of sight and normal.
    """

    depth_m: Array
    albedo: Array
    cosine: Array


def measured_depth(true: TrueDepth, config: DepthConfig, *, rng: np.random.Generator) -> NDArray[np.uint16]:
    """The map (H, W) in MAP_UNIT_MM that a depth camera gives, 0 = no reading."""
    depth = true.depth_m.astype(np.float32)
    kernel = np.ones((3, 3), np.uint8)
    nearest, farthest = cv2.erode(depth, kernel), cv2.dilate(depth, kernel)
    is_edge = farthest - nearest > _STEP_M
    fate = rng.random(depth.shape)
    is_mixed = is_edge & (fate > 1 - (1 - config.edge_loss) / 3)
    share = rng.random(depth.shape)
    read = np.where(is_mixed, nearest + share * (farthest - nearest), depth)
    std = DepthNoise(config.noise_m, config.noise_per_m).std_m(read)
    read = read + std * _grain(depth.shape, config.noise_size_px, rng)
    blob = _grain(depth.shape, _HOLE_PX / 2, rng)
    is_lost = (true.albedo < config.dark) & (blob < ndtri(config.absorbed))
    is_lost |= (is_edge & (fate < config.edge_loss)) | (true.cosine < np.cos(np.radians(config.grazing_deg)))
    is_lost |= (read < config.range_m[0]) | (read > config.range_m[1])
    number = np.rint(read * 1000.0 / MAP_UNIT_MM)
    return np.where(is_lost, 0, np.clip(number, 0, 65535)).astype(np.uint16)


def _grain(shape: tuple[int, ...], size_px: float, rng: np.random.Generator) -> Array:
    """Standard normal numbers (H, W) that hang together over some pixels."""
    grain = rng.standard_normal(shape)
    if size_px <= 0:
        return grain
    smooth = cv2.GaussianBlur(grain, (0, 0), size_px)
    return np.asarray(smooth / smooth.std())
