"""Falling to the floor and lying there.

Falls are key postures in anatomical angles. Where the body is follows from contact: the lowest point of the flesh is on
the floor, and what touches the floor does not slip.
"""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import gaussian_filter1d

from mocap.synth.body import Body, build_body
from mocap.synth.figure import JOINT, SIDES, Figure, forward_kinematics, rotation_about
from mocap.synth.motions.anatomy import pose_of
from mocap.synth.motions.kit import Array, Pose, blend_rotations, identity, wander
from mocap.synth.motions.steps import Footsteps, follow_feet, look_about, swing_arms, timeline

DIRECTIONS = ("back", "front", "left", "right")
_TAKE_OVER_S = 0.35  # from standing or walking to the key postures
_TOUCH_M = 0.012  # what is nearer to the floor than about this does not slip
_CELL_M = 0.030  # of the mesh that feels the floor

_Key = tuple[float, dict[str, float]]  # time since the fall began, s, and angles, degrees


def fall(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    start_s: float = 1.3,
    direction: str | None = None,
    body: Body | None = None,
    rng: np.random.Generator,
) -> Pose:
    """Walk a few steps, fall, and lie on the floor to the end.

    position : (x, y) m where the person is when it begins to fall.  start_s : when.
    direction : one of DIRECTIONS; drawn when not given.  body : the flesh that touches the floor, built when not
    given. Raises ValueError for another one.
    """
    drawn = str(rng.choice(DIRECTIONS))
    direction = drawn if direction is None else direction
    if direction not in DIRECTIONS:
        raise ValueError(f"direction must be one of {', '.join(DIRECTIONS)}, got {direction!r}")
    t, keep = timeline(n_frames, fps)
    upright = _walk_up(figure, t, fps, position, heading_rad, start_s, direction, rng)
    body = build_body(figure, cell_m=_CELL_M) if body is None else body
    near = (
        "left" if direction == "left" or (direction in ("back", "front") and rng.uniform() < 0.5) else "right"
    )
    kind = direction if direction in ("back", "front") else "side"
    document = tomllib.loads((Path(__file__).parent / "fall.toml").read_text(encoding="utf-8"))
    keys = tuple(
        (float(row["at_s"]), {n: v for n, v in row.items() if n != "at_s"}) for row in document[kind]
    )
    since = t - start_s
    falling = np.flatnonzero(since >= -0.5 / fps)
    if not len(falling):
        return Pose(upright.root_position[keep], upright.rotations[keep], upright.contact[keep])
    rotations = _keyed(body, keys, near, kind == "side", since[falling], heading_rad, fps, rng)
    share = np.clip(since[falling] / _TAKE_OVER_S, 0, 1)
    share = share * share * (3 - 2 * share)
    rotations = blend_rotations(upright.rotations[falling], rotations, share[:, None])
    root = _rest_on_floor(body, rotations, upright.root_position[falling], share, fps)
    upright.root_position[falling] = root
    upright.rotations[falling] = rotations
    upright.contact[falling] = False
    return Pose(upright.root_position[keep], upright.rotations[keep], upright.contact[keep])


def _walk_up(
    figure: Figure,
    t: Array,
    fps: float,
    position: tuple[float, float],
    heading_rad: float,
    begin: float,
    direction: str,
    rng: np.random.Generator,
) -> Pose:
    """A few steps to `position`; a person that falls to the front stumbles while walking, others have stopped."""
    n = int(rng.integers(2, 4))
    step_m, step_s = 0.26 * figure.stature_m, 0.56
    ahead = np.array([np.cos(heading_rad), np.sin(heading_rad)])
    start = np.array(position) - n * step_m * ahead
    plan = Footsteps(figure, (float(start[0]), float(start[1])), heading_rad)
    side = int(rng.integers(2))
    stop = begin + (0.45 if direction == "front" else -0.35)
    for k in range(1, n + 2):
        at = start + min(k, n) * step_m * ahead
        land = stop - (n + 1 - k) * step_s
        plan.stand(side, land - 0.76 * step_s, land, (float(at[0]), float(at[1])), heading_rad)
        side = 1 - side
    gait = follow_feet(figure, plan, t, fps)
    rotations = identity(len(t))
    look_about(gait, rotations, rng=rng, calm=0.5)
    swing_arms(gait, rotations, rng=rng)
    return gait.finish(rotations, slice(None))


def _keyed(
    body: Body,
    keys: tuple[_Key, ...],
    near: str,
    is_on_side: bool,
    since: Array,
    heading_rad: float,
    fps: float,
    rng: np.random.Generator,
) -> Array:
    """Rotations (T, J, 3, 3) of the key postures, a little different each time.

    near : the side of the fall; the tables fall to the right.  since : (T,) s since the fall began.
    """
    pace = rng.uniform(0.94, 1.1)
    table = [_varied(key, 0.07 if i + 1 < len(keys) else 0.03, near, rng) for i, (_, key) in enumerate(keys)]
    _settle(body, table[-1], is_on_side, near)
    names = sorted(set().union(*table))
    times = np.concatenate([[-1.0, 0.0], [pace * time for time, _ in keys], [pace * keys[-1][0] + 60.0]])
    tracks: dict[str, Array] = {}
    for name in names:
        values = np.array([0.0, 0.0, *(row.get(name, 0.0) for row in table), table[-1].get(name, 0.0)])
        tracks[name] = gaussian_filter1d(
            PchipInterpolator(times, values)(np.clip(since, -1.0, times[-1])), 0.03 * fps, mode="nearest"
        )
    lying = np.clip((since - pace * keys[-1][0]) / 0.8, 0, 1)
    n = len(since)
    for name, size in (("chest_flexion", 0.8), ("head_turn", 4.0), ("neck_turn", 3.0)):
        tracks[name] = tracks.get(name, np.zeros(n)) + lying * size * wander(n, fps, slowest_s=3.5, rng=rng)
    pitch, roll = (np.deg2rad(tracks.pop(k, np.zeros(n))) for k in ("pitch", "roll"))
    rotations = pose_of(tracks, n)
    rotations[:, 0] = (
        rotation_about(2, np.full(n, heading_rad)) @ rotation_about(1, pitch) @ rotation_about(0, roll)
    )
    return rotations


def _varied(key: dict[str, float], spread: float, near: str, rng: np.random.Generator) -> dict[str, float]:
    """One key posture for both sides, each angle off by up to the relative `spread`.  near : the side of the fall."""
    row: dict[str, float] = {}
    for name, value in key.items():
        varied = value if name in ("pitch", "roll") else value * rng.uniform(1 - spread, 1 + spread)
        if name in ("pitch", "roll") or name.split("_")[0] in ("spine", "chest", "neck", "head"):
            row[name] = varied
        elif name.startswith(("near_", "far_", "left_", "right_")):
            row[name.replace("near_", "right_").replace("far_", "left_")] = varied
        else:
            for side, _ in SIDES:
                row.setdefault(f"{side}_{name}", varied * rng.uniform(0.96, 1.04))
    return _mirrored(row) if near == "left" else row


def _mirrored(row: dict[str, float]) -> dict[str, float]:
    out = {}
    for name, value in row.items():
        if name.startswith("left_"):
            out["right_" + name.removeprefix("left_")] = value
        elif name.startswith("right_"):
            out["left_" + name.removeprefix("right_")] = value
        else:
            out[name] = -value if name == "roll" or name.endswith(("_side", "_turn")) else value
    return out


def _settle(body: Body, row: dict[str, float], is_on_side: bool, near: str) -> None:
    """Change the lying posture so that arms and legs come down to the floor as the trunk does."""
    bone = body.weights.argmax(axis=1)
    trunk = np.isin(bone, [JOINT[n] for n in ("pelvis", "spine", "chest")])
    limbs = {
        "shoulder": ("shoulder", "elbow", "wrist"),
        "hip": ("hip", "knee", "ankle", "toe"),
    }
    for side in [near] if is_on_side else [s for s, _ in SIDES]:
        for root, joints in limbs.items():
            name = f"{side}_{root}_{'abduction' if is_on_side else 'flexion'}"
            mine = np.isin(bone, [JOINT[f"{side}_{j}"] for j in joints])
            middle = row.get(name, 0.0)
            for span, step in ((24.0, 3.0), (3.0, 0.5)):
                tried = middle + np.arange(-span, span + 0.1, step)
                gaps = []
                for value in tried:
                    z = _vertices(body, _lying({**row, name: float(value)}))[0, :, 2]
                    gaps.append(abs(float(z[mine].min() - z[trunk].min()) - 0.002))
                middle = float(tried[int(np.argmin(gaps))])
            row[name] = middle


def _lying(row: dict[str, float]) -> Array:
    rotations = pose_of({k: v for k, v in row.items() if k not in ("pitch", "roll")}, 1)
    pitch, roll = np.deg2rad(row.get("pitch", 0.0)), np.deg2rad(row.get("roll", 0.0))
    rotations[:, 0] = rotation_about(1, pitch) @ rotation_about(0, roll)
    return rotations


def _vertices(body: Body, rotations: Array) -> Array:
    """Posed vertices (T, V, 3) m with the pelvis at the origin."""
    position, rotation = forward_kinematics(body.figure.offsets, rotations, np.zeros((len(rotations), 3)))
    return np.stack([body.pose(p, r)[0] for p, r in zip(position, rotation, strict=True)])


def _rest_on_floor(body: Body, rotations: Array, upright: Array, share: Array, fps: float) -> Array:
    """Root positions (T, 3) m: the lowest point on the floor, what touches it does not slip.

    upright : (T, 3) m, where the pelvis would be without falling.  share : (T,) of the fall, 0 .. 1.
    """
    vertices = _vertices(body, rotations)
    height = vertices[..., 2] - vertices[..., 2].min(axis=1, keepdims=True)
    touch = np.exp(-(((height[1:] + height[:-1]) / (2 * _TOUCH_M)) ** 2))
    slip = np.einsum("tv,tvk->tk", touch, np.diff(vertices[..., :2], axis=0)) / touch.sum(axis=1)[:, None]
    step = (1 - share[1:, None]) * np.diff(upright[:, :2], axis=0) - share[1:, None] * slip
    step = gaussian_filter1d(step, 0.04 * fps, axis=0, mode="nearest")
    root = np.zeros((len(rotations), 3))
    root[0, :2] = upright[0, :2]
    root[1:, :2] = upright[0, :2] + np.cumsum(step, axis=0)
    lowest = -vertices[..., 2].min(axis=1)
    smooth = gaussian_filter1d(lowest, 0.03 * fps, mode="nearest")
    # Smoothing an impact would sink the body into the floor.
    root[:, 2] = np.maximum(smooth, lowest)
    return root
