"""Furniture of a scene: boxes, tables, chairs and stairs, all made of boxes."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from mocap.synth.motions.stairs import FIRST_EDGE_M
from mocap.synth.rooms import box_corners
from mocap.synth.section import Section

Array = NDArray[np.float64]
Vector = tuple[float, float, float]
Piece = tuple[float, ...]

_LEG_M, _TOP_M = 0.05, 0.035
_CHAIR_LEG_M, _SEAT_M, _BACK_M = 0.032, 0.04, 0.035


class Box(Section):
    """An axis-aligned box that hides what is behind it and throws shadows."""

    kind: Literal["box"] = "box"
    lower_m: Vector
    upper_m: Vector

    @model_validator(mode="after")
    def _not_empty(self) -> Box:
        if not all(a < b for a, b in zip(self.lower_m, self.upper_m, strict=True)):
            raise ValueError("lower_m must be below upper_m in every direction")
        return self

    def boxes(self) -> Array:
        """Corners (B, 8, 3) m."""
        return box_corners(np.array(self.lower_m), np.array(self.upper_m))[None]

    @property
    def tint(self) -> Vector:
        """Factor on the colour of the room's furniture."""
        return (1.0, 1.0, 1.0)


class Table(Section):
    """A top on four legs, or a solid block."""

    kind: Literal["table"]
    center_m: tuple[float, float]
    size_m: tuple[float, float] = (1.6, 0.8)
    height_m: float = Field(0.74, ge=0.2, le=1.5)
    heading_deg: float = 0.0
    solid: bool = False

    @model_validator(mode="after")
    def _large_enough(self) -> Table:
        if min(self.size_m) < 0.2:
            raise ValueError("size_m: a table is at least 0.2 m wide and deep")
        return self

    def boxes(self) -> Array:
        """Corners (B, 8, 3) m."""
        half = np.array(self.size_m) / 2
        if self.solid:
            pieces: list[Piece] = [(-half[0], -half[1], 0.0, half[0], half[1], self.height_m)]
        else:
            under = self.height_m - _TOP_M
            pieces = [(-half[0], -half[1], under, half[0], half[1], self.height_m)]
            pieces += _legs(half - _LEG_M, _LEG_M, under)
        return _placed(pieces, self.center_m, self.heading_deg)

    @property
    def tint(self) -> Vector:
        """Factor on the colour of the room's furniture."""
        return (1.15, 1.1, 1.0)


class Chair(Section):
    """Seat, back and four legs, or a solid block with a back; `heading_deg` is where a sitting person looks."""

    kind: Literal["chair"]
    center_m: tuple[float, float]
    heading_deg: float = 0.0
    seat_height_m: float = Field(0.45, ge=0.2, le=0.8)
    back_height_m: float = Field(0.88, ge=0.3, le=1.5)
    solid: bool = False

    def boxes(self) -> Array:
        """Corners (B, 8, 3) m."""
        half, seat = 0.21, self.seat_height_m
        pieces: list[Piece] = [(-half - _BACK_M, -half, seat, -half, half, self.back_height_m)]
        if self.solid:
            pieces.append((-half - _BACK_M, -half, 0.0, half, half, seat))
        else:
            pieces.append((-half - _BACK_M, -half, seat - _SEAT_M, half, half, seat))
            pieces += _legs(np.array([half, half]) - _CHAIR_LEG_M, _CHAIR_LEG_M, seat - _SEAT_M)
        return _placed(pieces, self.center_m, self.heading_deg)

    @property
    def tint(self) -> Vector:
        """Factor on the colour of the room's furniture."""
        return (0.45, 0.7, 1.3)


class Stairs(Section):
    """A solid flight of stairs with a landing, for the motion `stairs` with the same place, heading and measures."""

    kind: Literal["stairs"]
    position_m: tuple[float, float]
    """Where a person stands before the flight."""
    heading_deg: float = 0.0
    """Up the flight."""
    n_stairs: int = Field(3, ge=1, le=5)
    rise_m: float = Field(0.16, ge=0.08, le=0.22)
    going_m: float = Field(0.30, ge=0.26, le=0.45)
    width_m: float = Field(0.9, ge=0.5, le=2.0)
    landing_m: float = Field(0.6, ge=0.3, le=1.5)
    """Depth of the uppermost stair."""

    def boxes(self) -> Array:
        """Corners (B, 8, 3) m."""
        end = FIRST_EDGE_M + (self.n_stairs - 1) * self.going_m + self.landing_m
        pieces: list[Piece] = []
        for k in range(self.n_stairs):
            edge = FIRST_EDGE_M + k * self.going_m
            low, high = k * self.rise_m, (k + 1) * self.rise_m
            pieces.append((edge, -0.5 * self.width_m, low, end, 0.5 * self.width_m, high))
        return _placed(pieces, self.position_m, self.heading_deg)

    @property
    def tint(self) -> Vector:
        """Factor on the colour of the room's furniture."""
        return (0.9, 0.9, 0.95)


def _legs(at: Array, width: float, top: float) -> list[Piece]:
    """Four legs whose inner corners are at (+-at[0], +-at[1]), from the floor to `top`."""
    out: list[Piece] = []
    for sx in (-1, 1):
        for sy in (-1, 1):
            x, y = sorted((sx * at[0], sx * (at[0] + width))), sorted((sy * at[1], sy * (at[1] + width)))
            out.append((x[0], y[0], 0.0, x[1], y[1], top))
    return out


def _placed(pieces: list[Piece], center_m: tuple[float, float], heading_deg: float) -> Array:
    middle = np.array([*center_m, 0.0])
    turn = float(np.deg2rad(heading_deg))
    return np.stack(
        [box_corners(np.array(p[:3]), np.array(p[3:]), middle=middle, turn_rad=turn) for p in pieces]
    )


def _box_by_default(value: Any) -> Any:
    return {"kind": "box", **value} if isinstance(value, dict) else value


AnyFurniture = Box | Table | Chair | Stairs
Furniture: TypeAlias = Annotated[
    Annotated[AnyFurniture, Field(discriminator="kind")], BeforeValidator(_box_by_default)
]
KINDS = tuple(k for f in get_args(AnyFurniture) for k in get_args(f.model_fields["kind"].annotation))


def furniture_boxes(pieces: tuple[AnyFurniture, ...]) -> tuple[Array, Array]:
    """Corners (B, 8, 3) m of all boxes of all pieces, and the tint (B, 3) of each box."""
    boxes = [piece.boxes() for piece in pieces]
    tints = [np.tile(piece.tint, (len(b), 1)) for piece, b in zip(pieces, boxes, strict=True)]
    return (
        np.concatenate(boxes) if boxes else np.zeros((0, 8, 3)),
        np.concatenate(tints) if tints else np.zeros((0, 3)),
    )
