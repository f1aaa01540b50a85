"""Rooms, lights and camera rigs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.synth.looks import value_noise

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Light:
    """Area light sampled at points.  samples : (S, 3) m.  power : (3,) RGB.  is_dome : no cosine at the lamp."""

    samples: Array
    power: Array
    is_dome: bool


@dataclass(frozen=True, eq=False)
class Room:
    """A box-shaped room with furniture boxes and ceiling lights; the floor is z = 0.

    lower, upper : (3,) m.  furniture : (B, 8, 3) m, corners of boxes as `box_corners` orders them.
    furniture_rgb : (B, 3).
    """

    lower: Array
    upper: Array
    furniture: Array
    lights: tuple[Light, ...]
    floor_kind: str
    floor_rgb: Array
    wall_rgb: Array
    furniture_rgb: Array
    ambient: Array
    table: Array

    def mesh(self) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
        """Vertices, faces and the box of each face (0 = walls, b + 1 = furniture box b)."""
        corners, faces, owner = [], [], []
        for b, box in enumerate([box_corners(self.lower, self.upper), *self.furniture]):
            faces.append(_BOX_FACES + 8 * b)
            owner.append(np.full(len(_BOX_FACES), b))
            corners.append(box)
        return np.concatenate(corners), np.concatenate(faces), np.concatenate(owner)

    def holds_some(self, points: Array) -> bool:
        """Whether any of the points (N, 3) m lies between the walls."""
        return bool(
            np.any(np.all((points[:, :2] > self.lower[:2]) & (points[:, :2] < self.upper[:2]), axis=1))
        )

    def paint(self, points: Array, normals: Array, owner: NDArray[np.int64]) -> Array:
        """Linear RGB (N, 3) of room points, sharp features only; inward unit normals (N, 3), owner of each."""
        out = np.tile(self.wall_rgb, (len(points), 1))
        is_floor = (owner == 0) & (normals[:, 2] > 0.5)
        is_ceiling = (owner == 0) & (normals[:, 2] < -0.5)
        is_wall = (owner == 0) & ~is_floor & ~is_ceiling
        # Walls: panels with dark joints, a skirting board and a few posters.
        at, facing, height = points[is_wall], normals[is_wall], points[is_wall, 2]
        along = np.where(np.abs(facing[:, 0]) > 0.5, at[:, 1], at[:, 0])
        colour = np.tile(self.wall_rgb, (len(at), 1))
        joint = (np.abs((along / 1.2) % 1.0 - 0.5) > 0.494) | (np.abs(height / 1.1 % 1.0 - 0.5) > 0.494)
        colour[joint] *= 0.72
        cell = np.floor(along / 1.7 + 0.31).astype(int) + 5 * (facing[:, 0] > 0.5) + 11 * (facing[:, 1] > 0.5)
        has_poster = self.table[cell % 32, (cell * 7) % 32, 3] > 0.6
        poster = (
            has_poster & (np.abs((along / 1.7 + 0.31) % 1.0 - 0.5) < 0.22) & (np.abs(height - 1.65) < 0.36)
        )
        hue = np.stack([self.table[cell % 32, k, 9] for k in range(3)], axis=1)
        colour[poster] = (0.06 + 0.35 * hue)[poster]
        colour[height < 0.09] = 0.35 * self.wall_rgb
        out[is_wall] = colour
        out[is_ceiling] = (0.62, 0.62, 0.60)
        out[is_floor] = self._floor(points[is_floor])
        out[owner > 0] = self.furniture_rgb[owner[owner > 0] - 1]
        return out

    def texture(self, points: Array, normals: Array, owner: NDArray[np.int64]) -> Array:
        """Factor (N,) about 1 by which the albedo varies smoothly."""
        is_floor = (owner == 0) & (normals[:, 2] > 0.5)
        large = value_noise(self.table, points, 0.55) - 0.5
        middle = value_noise(self.table, points + 3.1, 0.16) - 0.5
        shade = 1 + 0.10 * large + 0.06 * middle
        on_floor = points[is_floor]
        fine = value_noise(self.table, on_floor + 9.7, 0.03 if self.floor_kind == "carpet" else 0.05) - 0.5
        shade[is_floor] = 1 + 0.14 * large[is_floor] + 0.12 * middle[is_floor] + 0.16 * fine
        wood = value_noise(self.table, points[owner > 0] * np.array([1.0, 8.0, 1.0]), 0.12) - 0.5
        shade[owner > 0] = 1 + 0.3 * wood
        return shade

    def _floor(self, points: Array) -> Array:
        out = np.tile(self.floor_rgb, (len(points), 1))
        if self.floor_kind == "carpet":
            return out
        size = np.array([0.5, 0.5]) if self.floor_kind == "tiles" else np.array([1.1, 0.14])
        cell = np.floor(points[:, :2] / size).astype(int)
        tint = self.table[cell[:, 0] % 32, cell[:, 1] % 32, 5] - 0.5
        edge = np.abs((points[:, :2] / size) % 1.0 - 0.5) * size > 0.5 * size - 0.005
        return out * (1 + 0.35 * tint - 0.4 * (edge[:, 0] | edge[:, 1]))[:, None]


def box_corners(lower: Array, upper: Array, *, middle: Array | None = None, turn_rad: float = 0.0) -> Array:
    """The corners (8, 3) m of a box, turned about the vertical through `middle` (3,) and then shifted by it."""
    sides = np.stack([lower, upper])
    corners = np.array([[sides[i >> 2 & 1, 0], sides[i >> 1 & 1, 1], sides[i & 1, 2]] for i in range(8)])
    if middle is None:
        return corners
    c, s = np.cos(turn_rad), np.sin(turn_rad)
    return corners @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + middle


_BOX_FACES = np.array(
    [
        [0, 1, 3],
        [0, 3, 2],
        [4, 6, 7],
        [4, 7, 5],
        [0, 4, 5],
        [0, 5, 1],
        [2, 3, 7],
        [2, 7, 6],
        [0, 2, 6],
        [0, 6, 4],
        [1, 5, 7],
        [1, 7, 3],
    ],
    dtype=np.int64,
)


def make_room(
    size_m: tuple[float, float, float],
    *,
    floor: str,
    furniture: Array,
    tint: Array,
    rng: np.random.Generator,
) -> Room:
    """A room centred on the origin with two ceiling panels and diffuse light from everywhere.

    floor : "tiles", "planks" or "carpet".  furniture : (B, 8, 3) m, corners of boxes.  tint : (B, 3), factor on
    the colour of each box. Raises ValueError for an unknown floor.
    """
    if floor not in ("tiles", "planks", "carpet"):
        raise ValueError(f"floor must be tiles, planks or carpet, got {floor!r}")
    half = np.array(size_m) / 2
    lower, upper = np.array([-half[0], -half[1], 0.0]), np.array([half[0], half[1], size_m[2]])
    grey = rng.uniform(0.30, 0.50)
    wall = np.clip(grey * rng.uniform(0.93, 1.07, 3), 0.05, 0.8)
    palette = {
        "tiles": [(0.32, 0.19, 0.18), (0.30, 0.29, 0.26), (0.20, 0.23, 0.27)],
        "planks": [(0.34, 0.22, 0.12), (0.42, 0.31, 0.19)],
        "carpet": [(0.12, 0.15, 0.22), (0.20, 0.21, 0.19), (0.23, 0.13, 0.11)],
    }[floor]
    lights = []
    z = size_m[2] - 0.06
    corner = rng.uniform(0, 2 * np.pi)
    for i in range(2):
        angle = corner + np.pi * i + rng.uniform(-0.4, 0.4)
        center = np.array([0.42 * half[0] * np.cos(angle), 0.42 * half[1] * np.sin(angle), z])
        lights.append(
            Light(_square(center, 0.32, rng), np.array([1.0, 0.97, 0.92]) * rng.uniform(5.0, 11.0), False)
        )
    spread = np.array([[1, 0.2], [-0.2, 1], [-1, -0.2], [0.2, -1]]) * 0.30 * half[:2]
    dome = np.column_stack([spread, np.full(4, z)])
    lights.append(Light(dome, np.array([0.92, 0.96, 1.0]) * 0.50, True))
    return Room(
        lower,
        upper,
        furniture,
        tuple(lights),
        floor,
        np.array(palette[int(rng.integers(len(palette)))]) * rng.uniform(0.85, 1.15),
        wall,
        np.array([0.30, 0.20, 0.12]) * rng.uniform(0.7, 1.3) * tint,
        np.array([0.22, 0.22, 0.23]),
        rng.uniform(size=(32, 32, 32)),
    )


def _square(center: Array, half: float, rng: np.random.Generator) -> Array:
    """Four jittered points of a square panel, one per quarter."""
    quarter = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * half / 2
    xy = center[:2] + quarter + rng.uniform(-0.2, 0.2, size=(4, 2)) * half
    return np.column_stack([xy, np.full(4, center[2])])
