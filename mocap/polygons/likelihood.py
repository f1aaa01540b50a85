"""Colour likelihood of articulated polygons and their articulated problem: the observation of XN and SW."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data.problem import StateLayout
from mocap.polygons._kernels import (
    N_BINS,
    mark_runs_kernel,
    polygon_histograms_kernel,
    polygon_scores_kernel,
)
from mocap.polygons.tree import PolygonTree, corner_positions

Array = NDArray[np.float64]
Bins = NDArray[np.uint16]

FOREGROUND_BIT = np.uint16(1 << 9)


@dataclass(frozen=True)
class PolygonLikelihoodSettings:
    """Weights of the two terms: log w = -lambda_colour d^2 - lambda_silhouette (share of pixels off the foreground)."""

    lambda_colour: float = 50.0
    """On the squared Bhattacharyya distance of the colour histograms (XN 4.4.2)."""
    lambda_silhouette: float = 0.0
    """On the foreground term of XN 6.2; 0 leaves it out."""

    def __post_init__(self) -> None:
        for name in ("lambda_colour", "lambda_silhouette"):
            if not (np.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise ValueError(f"{name}: expected a finite number >= 0, got {getattr(self, name)}")


def colour_bins(image: NDArray[np.uint8], foreground: NDArray[np.bool_] | None = None) -> Bins:
    """Colour bins of every pixel, three times three bits, and the foreground bit above them.

    image : (H, W, 3) RGB.  foreground : (H, W); None marks every pixel as foreground. Returns (H, W) uint16.
    """
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise ValueError(f"image: expected (H, W, 3) uint8, got {image.shape} {image.dtype}")
    level = image >> np.uint8(8 - N_BINS.bit_length() + 1)
    bins = level[..., 0].astype(np.uint16)
    bins |= level[..., 1].astype(np.uint16) << np.uint16(3)
    bins |= level[..., 2].astype(np.uint16) << np.uint16(6)
    if foreground is None:
        return bins | FOREGROUND_BIT
    if foreground.shape != bins.shape:
        raise ValueError(f"foreground: expected shape {bins.shape}, got {foreground.shape}")
    return bins | np.where(foreground, FOREGROUND_BIT, np.uint16(0))


def mark_runs(bins: Bins) -> Bins:
    """The bins with the length of their runs above them: the same scores in half the time, once it is paid for.

    For a picture in which many polygons are counted; whoever changes a pixel afterwards marks the runs again.
    """
    out = np.empty_like(bins)
    mark_runs_kernel(bins, out)
    return out


def _arguments(tree: PolygonTree, parts: Sequence[int] | None) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Scored parts and the parts whose frames that takes (they and their ancestors)."""
    P = tree.layout.n_parts
    scored = np.arange(P) if parts is None else np.asarray(parts, dtype=np.int64).reshape(-1)
    if np.any((scored < 0) | (scored >= P)):
        raise ValueError(f"parts: expected indices 0 to {P - 1}, got {scored.tolist()}")
    needed: NDArray[np.bool_] = np.logical_or.reduce(tree.is_ancestor[scored], axis=0)
    return scored, needed


def part_histograms(tree: PolygonTree, bins: Bins, states: Array) -> tuple[Array, Array]:
    """Colour histograms (N, P, 24), sum 1, and areas in pixels (N, P) of all parts for states (N, D).

    8 bins for each of 3 channels. Pixels outside the image are missing from the sum; a part without pixels has
    zeros; a state that is not finite gives NaN.
    Source: XN 5.2.1 ("8-bin 3-channel histograms").
    """
    scored, needed = _arguments(tree, None)
    counts = np.empty((len(states), len(scored), 3 * N_BINS + 2), dtype=np.int64)
    states = np.ascontiguousarray(states, dtype=np.float64)
    polygon_histograms_kernel(states, scored, needed, *tree.chain, bins, counts)
    area = np.where(counts[..., -2] < 0, np.nan, counts[..., -2].astype(np.float64))
    return counts[..., :-2] / (3.0 * np.fmax(area, 1.0))[..., None] + 0.0 * area[..., None], area


def polygon_scores(
    tree: PolygonTree, bins: Bins, reference: Array, states: Array, parts: Sequence[int] | None = None
) -> tuple[Array, Array]:
    """Squared Bhattacharyya distance and share of pixels off the foreground, both (N, n_parts), in [0, 1].

    bins : (H, W) of `colour_bins`.  reference : (P, 24) histograms of `part_histograms`.  states : (N, D).
    A part without a pixel scores 1 in both; a state that is not finite scores infinity.
    """
    scored, needed = _arguments(tree, parts)
    squared = np.empty((len(states), len(scored)))
    uncovered = np.empty_like(squared)
    states = np.ascontiguousarray(states, dtype=np.float64)
    polygon_scores_kernel(states, scored, needed, *tree.chain, bins, np.sqrt(reference), squared, uncovered)
    return squared, uncovered


def polygon_scores_numpy(
    tree: PolygonTree, bins: Bins, reference: Array, states: Array, parts: Sequence[int] | None = None
) -> tuple[Array, Array]:
    """What `polygon_scores` computes, pixel by pixel with the crossing-number test; slow, for tests."""
    scored, _ = _arguments(tree, parts)
    corners = corner_positions(tree, states)
    squared = np.ones((len(states), len(scored)))
    uncovered = np.ones_like(squared)
    for n in range(len(states)):
        for j, p in enumerate(scored):
            polygon = corners[n, tree.corner_start[p] : tree.corner_start[p + 1]]
            if not np.all(np.isfinite(polygon)):
                squared[n, j] = uncovered[n, j] = np.inf
                continue
            u, v = _pixels_inside(polygon)
            if len(u) == 0:
                continue
            seen = (u >= 0) & (u < bins.shape[1]) & (v >= 0) & (v < bins.shape[0])
            values = bins[v[seen], u[seen]].astype(np.int64)
            histogram = [np.bincount((values >> s) & (N_BINS - 1), minlength=N_BINS) for s in (0, 3, 6)]
            overlap = np.sqrt(np.concatenate(histogram) / (3.0 * len(u)) * reference[p]).sum()
            squared[n, j] = 1.0 - min(overlap, 1.0)
            uncovered[n, j] = 1.0 - np.count_nonzero(values & int(FOREGROUND_BIT)) / len(u)
    return squared, uncovered


def _pixels_inside(polygon: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows of the pixels whose centres lie in a polygon (C, 2), left and upper border included."""
    low, high = np.floor(polygon.min(axis=0)), np.ceil(polygon.max(axis=0))
    u, v = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    n_crossings = np.zeros(u.shape, dtype=np.int64)
    for (x0, y0), (x1, y1) in zip(np.roll(polygon, 1, axis=0), polygon, strict=True):
        crosses = (y0 <= v) != (y1 <= v)
        if y1 < y0:
            x0, y0, x1, y1 = x1, y1, x0, y0
        if y1 != y0:
            n_crossings += crosses & (x0 + (v - y0) / (y1 - y0) * (x1 - x0) <= u)
    inside = n_crossings % 2 == 1
    return u[inside].astype(np.int64), v[inside].astype(np.int64)


@dataclass(frozen=True, eq=False)
class PolygonProblem:
    """An articulated polygon object against one picture: implements `ArticulatedProblem`.

    bins : (H, W) of `colour_bins`, with `mark_runs` or without.  reference : (P, 24), histograms of the parts at a
    known state (`part_histograms`), usually of the first frame.
    Parts do not interact: `given` has no effect.
    """

    tree: PolygonTree
    bins: Bins
    reference: Array
    settings: PolygonLikelihoodSettings = PolygonLikelihoodSettings()

    @property
    def layout(self) -> StateLayout:
        return self.tree.layout

    def propagate(self, particles: Array, std: Array, *, rng: np.random.Generator) -> Array:
        """A Gaussian random walk; there are no bounds.

        Source: XN 4.4.2 (sigma_x = sigma_y = 1 px, sigma_theta = 0.025 rad per frame).
        """
        out = particles.copy()
        moving = np.flatnonzero(std > 0)
        out[:, moving] += std[moving] * rng.standard_normal((len(particles), len(moving)))
        return out

    def log_likelihood(
        self, particles: Array, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> Array:
        """-lambda d^2 of each part, (N, n_parts); minus infinity for a state that is not finite.

        Source: XN 4.4.2; with the silhouette term XN 6.2.
        """
        squared, uncovered = polygon_scores(self.tree, self.bins, self.reference, particles, parts)
        cost = self.settings.lambda_colour * squared
        if self.settings.lambda_silhouette:
            cost += self.settings.lambda_silhouette * uncovered
        return np.where(np.isfinite(squared), -cost, -np.inf)


def random_walk_std(layout: StateLayout, position_px: float = 1.0, angle_rad: float = 0.025) -> Array:
    """Standard deviations (D,) of the random walk: pixels for x and y, radians for angles.

    Source: XN 4.4.2 (the defaults); XN 6.2 uses 2 px and 0.05 rad.
    """
    return np.where(layout.is_circular, angle_rad, position_px)
