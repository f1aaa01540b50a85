"""Components of the hulls with their features, labelled from the truth; and furniture that is carried into the room."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from eval.tracking.hulls import SHARED, WORK, HullClip
from mocap.data import CameraRig, VoxelGrid
from mocap.io.calibration import read_calibration
from mocap.synth.furniture import Box, Chair, Table
from mocap.tracking import BlobFeatures
from mocap.tracking.features import Components, components_of
from mocap.volume import Carver, connected_components

Array = NDArray[np.float64]
FEATURES = tuple(f.name for f in fields(BlobFeatures))
SEMI_AXIS_M = 0.3
PERSON_KINDS = ("person", "merged")


@dataclass(frozen=True, eq=False)
class Blobs:
    """Components of many frames.

    features : (N, 6) in the order of FEATURES.  kind : person, merged (several persons), part (of a person whose
    trunk is elsewhere), furniture, or ghost (all else).  scene : where each comes from.
    """

    features: Array
    kind: NDArray[np.str_]
    scene: NDArray[np.str_]

    @property
    def is_person(self) -> NDArray[np.bool_]:
        return np.isin(self.kind, PERSON_KINDS)


def joined(parts: Iterable[Blobs]) -> Blobs:
    """All of them as one."""
    columns = zip(*((b.features, b.kind, b.scene) for b in parts), strict=True)
    return Blobs(*(np.concatenate(c) for c in columns))


def blobs_of(clip: HullClip, every: int = 1) -> Blobs:
    """Components of every so many-th frame of a clip.

    A person's component is the one with most voxels inside the ellipsoid round the true centroid, which stands on the
    floor. Source: CF Eq. 4.2-4.3. Left out: what reaches the border of the volume and holds nobody, because there
    persons stand in the door.
    """
    rows, kinds = [], []
    for frame, hull in list(clip)[::every]:
        labels, _ = connected_components(hull.voxels, hull.grid)
        centers = hull.centers
        parts = components_of(centers, labels, clip.voxel_size_m)
        truth = clip.truth.xyz[clip.truth.frame == frame]
        kind = label(parts, centers, truth)
        border = np.any(parts.lower[:, :2] < hull.grid.origin[:2] + 0.1, axis=1)
        border |= np.any(parts.upper[:, :2] > hull.grid.upper[:2] - 0.1, axis=1)
        for k in range(len(parts)):
            if not (border[k] and kind[k] == "ghost"):
                rows.append(row(parts, k))
                kinds.append(kind[k])
    return _blobs(rows, kinds, clip.name)


def label(parts: Components, centers: Array, truth: Array) -> list[str]:
    """What each component is.  truth : (P, 3) m, centroids of the persons."""
    owners = np.zeros(len(parts), dtype=int)
    inside_any = np.zeros(len(centers), dtype=bool)
    for x in truth:
        semi = np.array([SEMI_AXIS_M, SEMI_AXIS_M, max(x[2], 0.1)])
        inside = (((centers - x) / semi) ** 2).sum(axis=1) <= 1.0
        inside_any |= inside
        count = np.bincount(parts.component_of[inside & (parts.component_of >= 0)], minlength=len(parts))
        if len(count) and count.max() > 0:
            owners[int(np.argmax(count))] += 1
    kinds = []
    for k, n in enumerate(owners):
        is_part = inside_any[parts.voxels(k)].mean() > 0.5
        kinds.append("merged" if n > 1 else "person" if n else "part" if is_part else "ghost")
    return kinds


def row(parts: Components, k: int) -> list[float]:
    """The features of one component."""
    found = parts.features(k)
    return [getattr(found, name) for name in FEATURES]


def rig_of(scene: str, work: Path = WORK) -> CameraRig:
    """The cameras of a scene."""
    folder = work / "sessions" / scene
    return read_calibration((folder if folder.exists() else SHARED / scene) / "calibration.toml").rig


def furniture_blobs(
    scene: str, grid: VoxelGrid, rig: CameraRig, n_rooms: int, *, rng: np.random.Generator
) -> Blobs:
    """What one or two pieces of furniture that were carried into the room look like, carved from exact silhouettes.

    Chairs, tables and boxes up to 1.2 m: what is as tall and as slim as a person cannot be told from one by these
    features.
    """
    carver = Carver(rig, grid)
    rows, kinds = [], []
    for _ in range(n_rooms):
        pieces = [_piece(grid, rng) for _ in range(int(rng.integers(1, 3)))]
        masks = [silhouette(pieces, camera) for camera in rig]
        voxels = carver.carve(masks, n_faulty_views=int(len(rig) >= 6), min_views=min(4, len(rig)))
        labels, _ = connected_components(voxels, grid)
        parts = components_of(grid.centers(voxels), labels, grid.voxel_size_m)
        rows += [row(parts, k) for k in range(len(parts))]
        kinds += ["furniture"] * len(parts)
    return _blobs(rows, kinds, scene)


def silhouette(pieces: list[Array], camera: object) -> NDArray[np.bool_]:
    """Silhouette of boxes, (B, 8, 3) m each piece; every box is convex, so its picture is that of its corners' hull."""
    width, height = camera.size  # type: ignore[attr-defined]
    mask = np.zeros((height, width), dtype=np.uint8)
    for box in np.concatenate(pieces):
        uv, depth = camera.project(box)  # type: ignore[attr-defined]
        if np.all(depth > 0.05):
            cv2.fillConvexPoly(mask, cv2.convexHull(np.round(uv).astype(np.int32)), 1)
    return mask.astype(bool)


def _piece(grid: VoxelGrid, rng: np.random.Generator) -> Array:
    low, high = grid.origin[:2] + 0.6, grid.upper[:2] - 0.6
    center = tuple(rng.uniform(low, high).tolist())
    heading = float(rng.uniform(0, 360))
    what = rng.choice(["chair", "chair", "table", "box"])
    if what == "chair":
        chair = {
            "kind": "chair",
            "center_m": center,
            "heading_deg": heading,
            "solid": bool(rng.uniform() < 0.3),
        }
        return Chair.model_validate(chair).boxes()
    if what == "table":
        size = (float(rng.uniform(0.5, 1.6)), float(rng.uniform(0.4, 0.9)))
        return Table.model_validate(
            {"kind": "table", "center_m": center, "heading_deg": heading, "size_m": size}
        ).boxes()
    half = rng.uniform(0.1, 0.4, 2)
    lower = (center[0] - half[0], center[1] - half[1], 0.0)
    upper = (center[0] + half[0], center[1] + half[1], float(rng.uniform(0.2, 1.2)))
    return Box(lower_m=lower, upper_m=upper).boxes()


def _blobs(rows: list[list[float]], kinds: list[str], scene: str) -> Blobs:
    return Blobs(
        np.array(rows, dtype=float).reshape(-1, len(FEATURES)),
        np.array(kinds, dtype=np.str_),
        np.array([scene] * len(rows), dtype=np.str_),
    )


def kinds_of(blobs: Blobs) -> Iterator[tuple[str, int]]:
    """How many there are of each kind."""
    for kind in ("person", "merged", "part", "furniture", "ghost"):
        yield kind, int(np.count_nonzero(blobs.kind == kind))
