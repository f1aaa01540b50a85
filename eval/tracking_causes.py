"""Whether lag makes three orders of CF Table 4.3 fail, and CF Figures 4.7 and 4.12, on hulls made by hand.

    python -m eval.tracking_causes [--seeds 1] [--only worlds surface crossing]

- worlds (eval/results/tracking_causes.csv): the trackers as published on two persons, ellipsoids in clothes of one
  colour each, who walk past each other 1.2 m apart. `walk`: at 1 m/s and 15 frames/s, as in the scenes of the table.
  `slow`: every frame is shown four times, so that persons move a quarter as far from step to step, as they do who
  mostly sit.
- surface (tracking_surface.csv): CF Figure 4.7, how far the mean of a random share of the surface's or the interior's
  voxels lies from the centroid; an ellipsoid of 30 x 30 x 100 cm, voxels of 2 cm.
- crossing (tracking_crossing.csv): CF Figure 4.12, the two persons nearer to each other; in how many of ten runs
  nobody's identity is lost, with colour and without, by the gap between their middles.

About a minute on one core.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from eval.tracking import hulls as H
from eval.tracking.methods import Method, observations, run_method
from eval.tracking.runs import pooled, scored
from eval.whole import write_csv
from mocap.data import Hull, Tracks, VoxelGrid
from mocap.volume import surface_voxels

RESULTS = Path(__file__).with_name("results")
PARTS = ("worlds", "surface", "crossing")
TIMES_SLOWER = 4
METHODS = (
    Method("naive", settings="published"),
    *(Method("sparse", 800, colour, settings="published") for colour in (False, True)),
    *(Method("particle", 100, colour, settings="published") for colour in (False, True)),
)
WORLDS = ("walk", "slow")
VOXEL_CM = (5, 2)
_APART_M = 1.2
FIELDS = ("world", "voxel_cm", "method", "mota_percent", "motp_mm", "false_positives_percent", "runs")
SEMI_AXES_M = (0.3, 0.3, 1.0)  # of CF Figure 4.7
SHARES = (0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)
_N_DRAWS = 400
GAPS_M = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
_SPEED_M_S, _FPS, _HALF_WAY_M = 1.0, 15.0, 1.6
_PERSON_SEMI_M = (0.22, 0.22, 0.85)
CLOTHES = ((200, 40, 40), (40, 60, 200))


def slowed(clip: H.HullClip, times: int) -> H.HullClip:
    """Every frame shown so many times in a row."""

    def repeated(tracks: Tracks) -> Tracks:
        row = np.repeat(np.arange(len(tracks.frame)), times)
        frame = times * (tracks.frame[row] - clip.frames[0]) + np.tile(np.arange(times), len(tracks.frame))
        return Tracks(frame, tracks.person[row], frame / (times * clip.fps), tracks.xyz[row])

    return H.HullClip(
        clip.name,
        times * clip.fps,
        np.arange(times * len(clip.frames)),
        tuple(hull for hull in clip.hulls for _ in range(times)),
        repeated(clip.truth),
        None,
    )


def in_world(world: str, voxel_cm: int) -> H.HullClip:
    """The walk of two persons in one of WORLDS."""
    clip = crossing_clip(_APART_M, voxel_cm / 100)
    return slowed(clip, TIMES_SLOWER) if world == "slow" else clip


def world_lines(seeds: int) -> list[dict[str, Any]]:
    """Scores of every world, voxel size and method."""
    lines = []
    for world in WORLDS:
        for cm in VOXEL_CM:
            clip = in_world(world, cm)
            seen, _ = observations(clip)
            for method in METHODS:
                is_random = method.tracker != "naive"
                rows = [
                    scored(run_method(replace(method, seed=seed), seen, clip), clip)
                    for seed in range(seeds if is_random else 1)
                ]
                scores = pooled(rows)
                key = (world, cm, method.label if is_random else "Naive")
                values = [f"{scores[name]:.4g}" for name in FIELDS[3:6]]
                lines.append(dict(zip(FIELDS, (*key, *values, len(rows)), strict=True)))
    return lines


def _ellipsoid(grid: VoxelGrid, center: ArrayLike, semi: ArrayLike) -> NDArray[np.int32]:
    centers = grid.centers(np.arange(grid.n_voxels, dtype=np.int32))
    inside = (((centers - np.asarray(center)) / np.asarray(semi)) ** 2).sum(axis=1) < 1.0
    return np.flatnonzero(inside).astype(np.int32)


def surface_lines() -> list[dict[str, Any]]:
    """The centroid of random shares of an ellipsoid's voxels.  Source: CF Figure 4.7."""
    semi = np.array(SEMI_AXES_M)
    grid = VoxelGrid.from_bounds(-semi - 0.04, semi + 0.04, 0.02)
    voxels = _ellipsoid(grid, (0.0, 0.0, 0.0), semi)
    is_surface = surface_voxels(voxels, grid)
    centers = grid.centers(voxels)
    rng = np.random.default_rng(47)
    lines = []
    for share in SHARES:
        line: dict[str, Any] = {"share": share}
        for name, pool in (("surface", centers[is_surface]), ("interior", centers[~is_surface])):
            n = max(1, round(share * len(pool)))
            draws = 1 if n == len(pool) else _N_DRAWS
            means = np.array(
                [pool[rng.choice(len(pool), n, replace=False)].mean(axis=0) for _ in range(draws)]
            )
            error = 1000.0 * np.linalg.norm(means - centers.mean(axis=0), axis=1)
            in_plane = 1000.0 * np.linalg.norm((means - centers.mean(axis=0))[:, :2], axis=1)
            line |= {
                f"{name}_voxels": n,
                f"{name}_mm": f"{error.mean():.2f}",
                f"{name}_xy_mm": f"{in_plane.mean():.2f}",
            }
        lines.append(line)
    return lines


def crossing_clip(gap_m: float, voxel_m: float = 0.05) -> H.HullClip:
    """Two persons, ellipsoids in clothes of one colour each, who walk past each other along x with a gap between
    their middles; where they overlap the hull is one."""
    reach = _HALF_WAY_M + 0.5
    grid = VoxelGrid.from_bounds(np.array([-reach, -1.0, 0.0]), np.array([reach, 1.0, 1.8]), voxel_m)
    frames, rows = [], []
    n = int(2 * _HALF_WAY_M / _SPEED_M_S * _FPS)
    for f in range(n + 1):
        x = -_HALF_WAY_M + f * _SPEED_M_S / _FPS
        places = ((x, gap_m / 2, _PERSON_SEMI_M[2]), (-x, -gap_m / 2, _PERSON_SEMI_M[2]))
        parts = [_ellipsoid(grid, place, _PERSON_SEMI_M) for place in places]
        voxels = np.union1d(*parts).astype(np.int32)
        to_first = ((grid.centers(voxels) - np.array(places[0])) ** 2).sum(axis=1)
        to_second = ((grid.centers(voxels) - np.array(places[1])) ** 2).sum(axis=1)
        rgb = np.where(
            (to_first <= to_second)[:, None], *(np.array(c, dtype=np.uint8) for c in CLOTHES)
        ).astype(np.uint8)
        surface = surface_voxels(voxels, grid)
        frames.append(Hull(grid, voxels, surface, surface.astype(np.uint8), rgb))
        rows += [(f, k + 1, *place) for k, place in enumerate(places)]
    table = np.array(rows)
    frame = table[:, 0].astype(np.int64)
    truth = Tracks(frame, table[:, 1].astype(np.int64), frame / _FPS, table[:, 2:])
    return H.HullClip(f"crossing {gap_m:g} m", _FPS, np.arange(n + 1), tuple(frames), truth, None)


def crossing_lines(seeds: int) -> list[dict[str, Any]]:
    """Runs in which both persons keep their identity.  Source: CF Figure 4.12."""
    lines = []
    for gap in GAPS_M:
        clip = crossing_clip(gap)
        seen, _ = observations(clip)
        for method in METHODS[1:]:
            rows = [scored(run_method(replace(method, seed=seed), seen, clip), clip) for seed in range(seeds)]
            kept = sum(float(row["assa_percent"] or 0.0) > 75.0 for row in rows)
            lines.append(
                {
                    "gap_m": gap,
                    "method": method.label,
                    "runs": seeds,
                    "identities_kept": kept,
                    "idf1_percent": f"{pooled(rows)['idf1_percent']:.1f}",
                }
            )
    return lines


def main(argv: Sequence[str] | None = None) -> int:
    """Run the parts and write their files."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=1, help="runs of the random trackers in the worlds")
    parser.add_argument("--only", choices=PARTS, nargs="*", default=PARTS)
    chosen = parser.parse_args(argv)
    if "worlds" in chosen.only:
        write_csv(RESULTS / "tracking_causes.csv", FIELDS, world_lines(chosen.seeds))
    if "surface" in chosen.only:
        lines = surface_lines()
        write_csv(RESULTS / "tracking_surface.csv", list(lines[0]), lines)
    if "crossing" in chosen.only:
        lines = crossing_lines(10)
        write_csv(RESULTS / "tracking_crossing.csv", list(lines[0]), lines)
    return 0


if __name__ == "__main__":
    sys.exit(main())
