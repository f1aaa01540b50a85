"""Starts of a body: standing height from the hull, and candidate first poses around a centroid."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.body.kinematics import cones_of, neutral_state
from mocap.body.model import Body

# Grown-up people are no smaller.
LOWEST_STANDING_TOP_M = 1.45
# A hull whose top stays below this is a small person or a child who stands, or a person who sits, crouches or lies:
# poses tell, its shape does not. So high is a man of 2 m on a high chair.
_HIGHEST_SITTING_TOP_M = 1.60
_LOWEST_CHILD_TOP_M = 0.7
_RISEN = 1.05  # heads of who walks or bends now and then differ by less from frame to frame
# Volume over top cubed: 0.017 to 0.027 for hulls of people who stand; 0.042 and more for people who sit, unless the
# chair hides parts of them.
_SLENDER = 0.032
_FEET_M = 0.15  # a hull that begins higher above the floor is cut off, by a table perhaps
HIGHEST_STANDING_TOP_M = 2.20
DEFAULT_HEIGHT_M = 1.72
_HEAD_SEARCH_M = 0.9
# Areas of the slices of a hull: a crown's, larger than a forearm's, and a head's so far below it, of people who are not
# smaller than that. Heads of grown-up people have 0.023 to 0.035 there (dances and walks before four to seven cameras),
# hands and forearms 0.005 to 0.012 (decision 24).
_CROWN_AREA_M2 = 0.010
_HEAD_AREA_M2, _HEAD_DEPTH_M, _HEAD_OF_M = 0.018, 0.08, 1.75

# Name of the pose and joint angles that differ from the neutral state; mirrored names are written out.
_POSES: dict[str, dict[str, float]] = {
    "stand": {},
    "arms_out": {"right_shoulder_x": 0.1, "left_shoulder_x": -0.1},
    "arms_up": {"right_shoulder_x": -1.1, "left_shoulder_x": 1.1},
    "arms_forward": {
        "right_shoulder_x": 1.2,
        "left_shoulder_x": -1.2,
        "right_shoulder_z": 1.0,
        "left_shoulder_z": -1.0,
        "right_elbow_z": 0.6,
        "left_elbow_z": -0.6,
    },
    "guard": {
        "right_shoulder_x": 1.2,
        "left_shoulder_x": -1.2,
        "right_shoulder_z": 0.4,
        "left_shoulder_z": -0.4,
        "right_elbow_z": 1.8,
        "left_elbow_z": -1.8,
    },
    "stride_right": {
        "right_hip_y": -0.45,
        "left_hip_y": 0.35,
        "left_knee_y": 0.35,
        "right_shoulder_z": -0.35,
        "left_shoulder_z": -0.35,
    },
    "stride_left": {
        "left_hip_y": -0.45,
        "right_hip_y": 0.35,
        "right_knee_y": 0.35,
        "right_shoulder_z": 0.35,
        "left_shoulder_z": 0.35,
    },
    "one_arm_up_right": {"right_shoulder_x": -1.1},
    "one_arm_up_left": {"left_shoulder_x": 1.1},
    "lunge_right": {"right_hip_x": -0.5, "left_hip_x": 0.1, "right_shoulder_x": 0.2, "left_shoulder_x": -0.2},
    "lunge_left": {"left_hip_x": 0.5, "right_hip_x": -0.1, "right_shoulder_x": 0.2, "left_shoulder_x": -0.2},
    "sit": {
        "right_hip_y": -1.45,
        "left_hip_y": -1.45,
        "right_knee_y": 1.5,
        "left_knee_y": 1.5,
        "right_elbow_z": 0.9,
        "left_elbow_z": -0.9,
        "right_shoulder_z": 0.3,
        "left_shoulder_z": -0.3,
    },
    "crouch": {
        "right_hip_y": -1.3,
        "left_hip_y": -1.3,
        "right_knee_y": 1.7,
        "left_knee_y": 1.7,
        "root_pitch": 0.4,
        "waist_y": 0.3,
    },
}
_ALONG = {"right_hip_y": -0.2, "left_hip_y": -0.2, "right_knee_y": 0.3, "left_knee_y": 0.3}
_BENT = {"right_hip_y": -0.9, "left_hip_y": -0.9, "right_knee_y": 1.5, "left_knee_y": 1.5}
_ARMS_AHEAD = {
    "right_shoulder_x": 1.2,
    "left_shoulder_x": -1.2,
    "right_shoulder_z": 1.0,
    "left_shoulder_z": -1.0,
}
# Poses of a trunk that lies or is carried by hands and knees, for hulls that are lower than anybody sits.
_LOW_POSES: dict[str, dict[str, float]] = {kind: _POSES[kind] for kind in ("sit", "crouch")} | {
    "all_fours": _ARMS_AHEAD
    | {"root_pitch": 1.3, "right_hip_y": -1.3, "left_hip_y": -1.3, "right_knee_y": 1.5, "left_knee_y": 1.5},
    "on_elbows": _POSES["guard"] | _ALONG | {"root_pitch": 1.2},
    "prone": _ARMS_AHEAD | {"root_pitch": 1.4},
    "supine": {"root_pitch": -1.4} | _ALONG,
    "supine_knees_up": {"root_pitch": -1.4} | _BENT,
    "on_left_side": {"root_roll": -1.5} | _BENT,
    "on_right_side": {"root_roll": 1.5} | _BENT,
}
# Of the height. The bulk of hulls of who lies or crawls ends at 0.13 to 0.4, of who crouches at 0.5 (decision 101).
_LYING_SHARE = 0.45
N_KINDS = len(_POSES)  # of starting poses, each in all directions


@dataclass(frozen=True)
class HeightEstimate:
    """Standing height, m, and whether it was read from the hull (False: the default was taken).

    low_m : of a hull too low for that, the height that the person has if he stands: a child. None otherwise.
    is_given : it was stated, and nothing is to change it.
    """

    height_m: float
    is_measured: bool
    low_m: float | None = None
    is_given: bool = False


def head_top(centers: Array, voxel_size_m: float) -> float:
    """Height of the crown of the head in one person's hull, m; NaN for an empty hull.

    centers : (N, 3) m, voxel centres. Raised arms may be the highest voxels, so the highest slice counts in which a
    connected piece is as large as a crown and lies upon one that is as large as a head: hands and forearms do not
    widen like that, of which few cameras may leave as much as a crown. The head's top is 15 mm above that slice.
    """
    if len(centers) == 0:
        return float("nan")
    top = float(centers[:, 2].max())
    high = centers[centers[:, 2] > top - _HEAD_SEARCH_M]
    cell = np.round((high - high.min(axis=0)) / voxel_size_m).astype(int)
    slices = np.zeros(tuple(cell.max(axis=0) + 1), dtype=np.uint8)
    slices[cell[:, 0], cell[:, 1], cell[:, 2]] = 1
    deep, bottom = max(1, round(_HEAD_DEPTH_M / voxel_size_m)), float(high[:, 2].min())
    for iz in range(slices.shape[2] - 1, -1, -1):
        z = bottom + iz * voxel_size_m
        head_m2 = _HEAD_AREA_M2 * min(z / _HEAD_OF_M, 1.0) ** 2
        crown = _on_pieces(slices[:, :, iz], _CROWN_AREA_M2 / voxel_size_m**2)
        if crown.any() and (
            iz < deep or (crown & _on_pieces(slices[:, :, iz - deep], head_m2 / voxel_size_m**2)).any()
        ):
            return min(z + 0.5 * voxel_size_m + 0.015, top + 0.5 * voxel_size_m)
    return top + 0.5 * voxel_size_m


def _on_pieces(cells: NDArray[np.uint8], least: float) -> NDArray[np.bool_]:
    """Which of the cells (nx, ny) belong to a connected piece of at least so many."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(np.ascontiguousarray(cells))
    is_large = stats[:, cv2.CC_STAT_AREA] >= least
    is_large[0] = False  # what is no piece
    return np.asarray(is_large[labels])


def lowest_of(centers: Array) -> float:
    """Height of the lowest place of one person's hull, m.  centers : (N, 3) m, voxel centres; a few stray ones do not
    count."""
    return float(np.quantile(centers[:, 2], 0.002))


def is_upright(centers: Array, voxel_size_m: float, top_m: float | None = None) -> bool:
    """Whether one person's hull is as slender as somebody who stands, of whatever size, and reaches the floor.

    centers : (N, 3) m, voxel centres.  top_m : of `head_top`, None = found here.
    """
    top = head_top(centers, voxel_size_m) if top_m is None else top_m
    if not top > 0 or lowest_of(centers) > _FEET_M:
        return False
    return len(centers) * voxel_size_m**3 < _SLENDER * top**3


def height_from_tops(
    tops_m: Array, voxel_size_m: float, upright: NDArray[np.bool_] | None = None
) -> HeightEstimate:
    """Standing height from the highest point of a person's hull in each frame.

    tops_m : (T,) upper face of the highest voxel, m; NaN where the person was not seen. The 90th percentile is taken,
    because a walking person is at full height only in mid-stance and a speck may ride above the head, less
    half a voxel, the mean excess of a hull whose voxels count when their centre is inside.
    upright : (T,) of `is_upright`; who is so in some frames, and taller there, lies or sits in the others.
    Source: CF 6.3.4 (limb lengths proportional to the height, which comes from the volume).
    """
    tops = np.asarray(tops_m, dtype=np.float64)
    is_seen = np.isfinite(tops)
    if not is_seen.any():
        return HeightEstimate(DEFAULT_HEIGHT_M, False)
    top = float(np.quantile(tops[is_seen], 0.9))
    stands = is_seen if upright is None else is_seen & upright
    if stands.any():
        standing = float(np.quantile(tops[stands], 0.9))
        if standing > _RISEN * top:
            top = standing  # he lies or sits for most of the time
    height_m = top - 0.5 * voxel_size_m
    if _HIGHEST_SITTING_TOP_M <= top <= HIGHEST_STANDING_TOP_M:
        return HeightEstimate(height_m, True)
    may_stand = _LOWEST_CHILD_TOP_M <= top < _HIGHEST_SITTING_TOP_M
    return HeightEstimate(DEFAULT_HEIGHT_M, False, height_m if may_stand else None)


def is_low(centers: Array, body: Body) -> bool:
    """Whether one person's hull is lower than he sits: he lies, or is on hands and knees.  centers : (N, 3) m."""
    bottom, top = np.quantile(centers[:, 2], [0.002, 0.95])
    return bool(top - bottom < _LYING_SHARE * body.height_m)


def candidate_states(
    body: Body, centers: Array, yaws: Array, *, is_standing: bool | None = None
) -> tuple[Array, list[str]]:
    """Starting poses of several kinds and facing directions, put over a person's hull.

    centers : (N, 3) m, voxel centres of the person.  yaws : (Y,) rad, facing directions (0 = +x).
    is_standing : restricts the kinds to standing ones (True) or low ones (False); None tries all.
    Returns states (Y * K, D) and the name of the pose of each. The body's flesh centroid is put over the
    hull's; standing poses stand on the lowest voxels.
    Source: CF 6.3.3; departs from it by trying several poses and directions instead of the neutral one only.
    """
    if len(centers) == 0:
        raise ValueError("centers is empty: there is no hull to start from")
    names = body.layout.names
    centroid = centers.mean(axis=0)
    floor = float(np.quantile(centers[:, 2], 0.002))
    states, labels = [], []
    for label, angles in (_LOW_POSES if is_low(centers, body) else _POSES).items():
        low = label in _LOW_POSES
        if is_standing is not None and low == is_standing:
            continue
        base = neutral_state(body)
        for name, value in angles.items():
            if name in names:
                base[names.index(name)] = value
        base = np.clip(base, body.layout.lower, body.layout.upper)
        start, end = cones_of(body, base)
        weight = np.linalg.norm(end - start, axis=1) * (body.cones.radii**2).mean(axis=1)
        middle = 0.5 * (start + end)
        lowest = min(float((e[:, 2] - body.cones.radii[:, i]).min()) for i, e in enumerate((start, end)))
        for yaw in yaws:
            state = base.copy()
            if body.yaw_column is not None:
                state[body.yaw_column] = yaw
            turned = cones_of(body, state)
            middle = 0.5 * (turned[0] + turned[1])
            offset = weight @ middle / weight.sum()
            state[:2] += centroid[:2] - offset[:2]
            state[2] += floor - lowest
            states.append(state)
            labels.append(label)
    return np.array(states), labels
