"""A body with other proportions: every segment stretched along its own axes, left and right alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.body.kinematics import cones_of, landmarks_of, neutral_state
from mocap.body.model import Body, Cones
from mocap.data.motion import LANDMARKS

_NO_LENGTH_M = 1e-6  # a joint nearer to its parent is at its place
_BARE = ("neck", "wrist", "ankle", "mtp")  # segments of head, hands and feet


def segment_groups(body: Body) -> NDArray[np.int64]:
    """Group of every joint's segment, (J,): joints whose names differ by left_ and right_ only share one."""
    names = [_of_either_side(j) for j in body.joints]
    order = list(dict.fromkeys(names))
    return np.array([order.index(n) for n in names], dtype=np.int64)


def segment_kinds(body: Body) -> NDArray[np.int64]:
    """Kind of every joint's segment, (J,): as its group, but a joint at its parent's place, about which a forearm
    pronates, is of the parent's."""
    kinds = segment_groups(body)
    for j, parent in enumerate(body.parent):
        if parent >= 0 and np.linalg.norm(body.offset[j]) < _NO_LENGTH_M:
            kinds[j] = kinds[parent]
    return kinds


def covered_kinds(body: Body) -> NDArray[np.bool_]:
    """Which kinds of segments clothes cover, (G,): all but head, hands and feet."""
    kinds = segment_kinds(body)
    covered = np.zeros(int(kinds.max()) + 1, dtype=np.bool_)
    for joint, kind in zip(body.joints, kinds, strict=True):
        covered[kind] |= _of_either_side(joint) not in _BARE
    return covered


def _of_either_side(joint: str) -> str:
    return joint.removeprefix("left_").removeprefix("right_")


def stretch_body(body: Body, stretch: Array) -> Body:
    """The body with every length on joint j's segment multiplied by stretch[j], (J, 3), along the joint's axes at rest.

    Child joints, landmarks and the axes of the flesh move; radii grow with the mean of the two directions across.
    `height_m` becomes the height at which the head's top stands in the neutral pose.
    Raises ValueError for a stretch that is not positive and finite.
    """
    s = np.asarray(stretch, dtype=np.float64)
    if s.shape != (len(body.joints), 3) or not (np.isfinite(s).all() and (s > 0).all()):
        raise ValueError(f"stretch must be positive, shape ({len(body.joints)}, 3); got shape {s.shape}")
    cones = body.cones
    along = np.abs(cones.end - cones.start)
    along = along / np.maximum(along.sum(axis=1, keepdims=True), 1e-12)
    across = ((1.0 - along) * s[cones.joint]).sum(axis=1) / 2.0
    out = replace(
        body,
        offset=np.where(body.parent[:, None] >= 0, body.offset * s[body.parent], body.offset),
        landmark_offset=body.landmark_offset * s[body.landmark_joint],
        cones=Cones(
            start=cones.start * s[cones.joint],
            end=cones.end * s[cones.joint],
            radii=cones.radii * across[:, None],
            joint=cones.joint,
            part=cones.part,
        ),
    )
    return replace(out, height_m=body.height_m * standing_height(out) / standing_height(body))


def standing_height(body: Body) -> float:
    """Height of the top of the head over the lowest flesh in the neutral pose, m."""
    state = neutral_state(body)
    head = float(landmarks_of(body, state[None])[0, LANDMARKS.index("head"), 2])
    start, end = cones_of(body, state)
    floor = min(float((e[:, 2] - body.cones.radii[:, i]).min()) for i, e in enumerate((start, end)))
    return head - floor


def lengths_of(body: Body) -> dict[str, list[list[float]]]:
    """What sets a person's body apart from the scaled model, as plain numbers: for files, see `with_lengths`."""
    return {
        "offset_m": body.offset.tolist(),
        "landmark_offset_m": body.landmark_offset.tolist(),
        "cone_start_m": body.cones.start.tolist(),
        "cone_end_m": body.cones.end.tolist(),
        "cone_radii_m": body.cones.radii.tolist(),
    }


def with_lengths(body: Body, lengths: dict[str, list[list[float]]]) -> Body:
    """The body with the lengths that `lengths_of` gave.  Raises ValueError when they are of another body."""
    arrays = {name: np.array(value, dtype=np.float64) for name, value in lengths.items()}
    expected = {name: np.shape(value) for name, value in lengths_of(body).items()}
    found = {name: value.shape for name, value in arrays.items()}
    if found != expected:
        raise ValueError(f"lengths have shapes {found}, expected {expected}")
    cones = body.cones
    return replace(
        body,
        offset=arrays["offset_m"],
        landmark_offset=arrays["landmark_offset_m"],
        cones=Cones(
            arrays["cone_start_m"], arrays["cone_end_m"], arrays["cone_radii_m"], cones.joint, cones.part
        ),
    )


def resize_body(body: Body, lengths: float, radii: float | Array) -> Body:
    """The body with all lengths multiplied by one factor, the radii of its flesh by another, and the height with the
    lengths.

    radii : one factor, or one of each kind of segment, (G,) as `segment_kinds` counts them.
    """
    factors = np.asarray(radii, dtype=np.float64)
    if not (np.isfinite(lengths) and np.isfinite(factors).all() and lengths > 0 and (factors > 0).all()):
        raise ValueError(f"lengths and radii must be positive factors, got {lengths} and {radii}")
    cones = body.cones
    of_cones = factors[segment_kinds(body)[cones.joint], None] if factors.ndim else factors
    return replace(
        body,
        height_m=body.height_m * lengths,
        offset=body.offset * lengths,
        landmark_offset=body.landmark_offset * lengths,
        cones=replace(
            cones, start=cones.start * lengths, end=cones.end * lengths, radii=cones.radii * of_cones
        ),
    )
