"""Captured motion on our figures: bone directions of the source, bone lengths of the figure, feet on the floor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, binary_opening, gaussian_filter1d

from mocap.errors import MocapError
from mocap.files import load_toml
from mocap.synth.capture.asf_amc import read_amc
from mocap.synth.capture.bvh import read_bvh
from mocap.synth.capture.recording import Recording
from mocap.synth.figure import (
    HEEL_BACK,
    JOINT,
    JOINTS,
    PARENTS,
    SIDES,
    Figure,
    forward_kinematics,
    rotation_about,
)
from mocap.synth.motions.kit import MAX_REACH, Pose, blend_rotations, hinged_frames, relative, solve_two_bones

Array = NDArray[np.float64]

MAPS_DIR = Path(__file__).resolve().parent / "maps"
_UP = {"x": 0, "y": 1, "z": 2}
_NEEDED = tuple(j for j in JOINTS if not j.endswith(("clavicle", "toe")))
_STILL_M_S = 0.25  # an ankle slower than this, for a stature of 1.75 m, may bear weight
_LOW_M = 0.03  # an ankle and a toe at most this much higher than when standing
_FLAT_RAD = np.deg2rad(12.0)  # most pitch of a foot that is called flat
_MOST_LEVEL_RAD = np.deg2rad(20.0)  # by which a standing foot of the source may seem to be tilted
_SHORTEST_S = 0.10  # of a stand
_UNEVEN_M, _STEEPEST = 0.15, 0.04  # of the floor of a capture whose axes are not quite upright
_FLOAT_M = 0.04  # largest correction of a stand; higher feet are in flight
_FEWEST_STANDS, _SPREAD_M = 12, 0.8  # frames and metres from which its lean is taken
_EASE_S = 0.08  # into and out of it
_MOST_TOE_RAD = np.deg2rad(65.0)


@dataclass(frozen=True)
class JointMap:
    """How a kind of rig names its joints.

    joints : our joint -> theirs.  unit_m : metres per unit.  up : axis that points up, "x", "y" or "z".
    fps : for files that do not say.  reference : "rest" (all angles zero) or "first_frame" is upright with straight
    legs and feet on the floor; a first frame that serves so is no part of the motion.
    """

    name: str
    joints: dict[str, str]
    unit_m: float
    up: str
    fps: float | None
    reference: str


def read_map(path: Path | str) -> JointMap:
    """A mapping file. Raises MocapError with the key for one that cannot be read or understood."""
    path = Path(path)
    document = load_toml(path, "the joint map")

    mistake = next(_mistakes(document), None)
    if mistake is not None:
        raise MocapError(mistake, path=path, remedy="correct the joint map")
    fps = document.get("fps")
    return JointMap(
        path.stem,
        document["joints"],
        float(document.get("unit_m", 1.0)),
        document.get("up", "y"),
        None if fps is None else float(fps),
        document.get("reference", "rest"),
    )


def _mistakes(document: dict[str, Any]) -> Iterator[str]:
    """What is wrong with a mapping file, each with its key."""
    if unknown := set(document) - {"joints", "unit_m", "up", "fps", "reference"}:
        yield f"{min(unknown)}: unknown key"
    yield from _mistakes_of_joints(document.get("joints"))
    for key in ("unit_m", "fps"):
        value = document.get(key, 1.0)
        if not isinstance(value, (int, float)) or not value > 0:
            yield f"{key}: a positive number is expected, got {value!r}"
    if (up := document.get("up", "y")) not in _UP:
        yield f"up: 'x', 'y' or 'z' is expected, got {up!r}"
    if (reference := document.get("reference", "rest")) not in ("rest", "first_frame"):
        yield f"reference: 'rest' or 'first_frame' is expected, got {reference!r}"


def _mistakes_of_joints(joints: Any) -> Iterator[str]:
    if not isinstance(joints, dict) or not all(isinstance(v, str) for v in joints.values()):
        yield "joints: a table of names is expected"
        return
    if strange := set(joints) - set(JOINTS):
        yield f"joints.{min(strange)}: there is no such joint, take some of {', '.join(JOINTS)}"
    if missing := [j for j in _NEEDED if j not in joints]:
        yield f"joints.{missing[0]}: missing"


def built_in_maps() -> list[JointMap]:
    """The maps that come with the project."""
    return [read_map(p) for p in sorted(MAPS_DIR.glob("*.toml"))]


def read_capture(path: Path | str, joint_map: Path | str | None = None) -> tuple[Recording, JointMap]:
    """A BVH or AMC file and the map of its joints; without one the built-in map whose names the file has.

    Raises MocapError for a file of another kind, without a map that fits, or with joints missing.
    """
    path = Path(path)
    readers = {".bvh": read_bvh, ".amc": read_amc}
    if path.suffix.lower() not in readers:
        raise MocapError("a capture file ends in .bvh or .amc", path=path, remedy="give such a file")
    recording = readers[path.suffix.lower()](path)
    if joint_map is not None:
        chosen = read_map(joint_map)
        if absent := [n for n in chosen.joints.values() if n not in recording.names]:
            raise MocapError(
                f"the capture has no joint {absent[0]!r}", path=path, remedy="correct the joint map"
            )
        return recording, chosen
    for candidate in built_in_maps():
        if set(candidate.joints.values()) <= set(recording.names):
            return recording, candidate
    raise MocapError(
        f"no built-in joint map knows the names {', '.join(recording.names[:6])} ...",
        path=path,
        remedy="write a joint map and give it as map (docs/synthetic.md)",
    )


def retarget(
    clip: Recording,
    reference: Recording,
    joint_map: JointMap,
    figure: Figure,
    fps: float,
    *,
    position: tuple[float, float] | None = None,
    heading_rad: float | None = None,
) -> Pose:
    """The frames of `clip` on a figure.

    reference : one frame of the same rig, upright with straight legs and feet on the floor.
    Bones point as in the source; knees and elbows are hinges. The path of the pelvis is scaled by the length of the
    legs, feet are put on the floor and held still while they bear weight, which turns the legs by a few degrees.
    """
    source, turned, still = _in_our_axes(clip, reference, joint_map)
    rotations = _world_rotations(source, turned, still)
    hips = 0.5 * (source["left_hip"] + source["right_hip"])
    leg = _leg_length({k: v[None] for k, v in still.items()})
    root = hips * (figure.thigh_m + figure.shank_m) / leg
    yaw = np.arctan2(rotations[0, 0, 1, 0], rotations[0, 0, 0, 0])
    turn = rotation_about(2, (0.0 if heading_rad is None else heading_rad) - yaw)
    root = (root - root[0] * np.array([1.0, 1.0, 0.0])) @ turn.T
    root[:, :2] += (0.0, 0.0) if position is None else position
    local = _stiff_toes(_local(turn @ rotations))
    root[:, 2] -= _floor_under(figure, local, root, fps)
    root[:, 2] -= _float(figure, local, root, fps)
    return _plant(figure, local, root, fps)


def _in_our_axes(
    clip: Recording, reference: Recording, joint_map: JointMap
) -> tuple[dict[str, Array], dict[str, Array], dict[str, Array]]:
    """Positions (T, 3) m and turns since the reference (T, 3, 3) of the mapped joints; reference positions (3,) m.

    Our axes: z up, the reference faces +x.
    """
    index = {ours: clip.names.index(theirs) for ours, theirs in joint_map.joints.items()}
    still_at, still_R = (a[0] for a in reference.world())
    at, R = clip.world()
    up = np.eye(3)[_UP[joint_map.up]]
    left = still_at[index["left_hip"]] - still_at[index["right_hip"]]
    left -= (left @ up) * up
    left /= np.linalg.norm(left)
    axes = np.stack([np.cross(left, up), left, up])  # rows: our axes in theirs
    scale = joint_map.unit_m
    source = {ours: scale * at[:, j] @ axes.T for ours, j in index.items()}
    turned = {ours: axes @ R[:, j] @ still_R[j].T @ axes.T for ours, j in index.items()}
    still = {ours: scale * axes @ still_at[j] for ours, j in index.items()}
    return source, turned, still


_NEXT = {
    "spine": "chest",
    "chest": "neck",
    "neck": "head",
    **{f"{s}_{a}": f"{s}_{b}" for s, _ in SIDES for a, b in (("clavicle", "shoulder"),)},
}


def _world_rotations(source: dict[str, Array], turned: dict[str, Array], still: dict[str, Array]) -> Array:
    """World rotations (T, J, 3, 3) of our joints."""
    n = len(source["pelvis"])
    out = np.zeros((n, len(JOINTS), 3, 3))
    for joint in turned:
        out[:, JOINT[joint]] = _trunk_rotations(joint, source, turned, still)
    for side, _ in SIDES:
        for first, second, tip, hinge in (
            ("shoulder", "elbow", "wrist", -1.0),
            ("hip", "knee", "ankle", 1.0),
        ):
            a, b, c = (f"{side}_{x}" for x in (first, second, tip))
            bone = source[b] - source[a], source[c] - source[b]
            align = _swing(_DOWN, (still[b] - still[a])[None])[0]
            out[:, JOINT[a]], out[:, JOINT[b]] = hinged_frames(*bone, (turned[a] @ align)[:, :, 1], hinge)
        wrist, ankle, toe = (f"{side}_{x}" for x in ("wrist", "ankle", "toe"))
        align = _swing(_DOWN, (still[wrist] - still[f"{side}_elbow"])[None])[0]
        out[:, JOINT[wrist]] = turned[wrist] @ align
        toes = still[toe] - still[ankle] if toe in still else np.array([1.0, 0.0, 0.0])
        align = rotation_about(2, np.arctan2(toes[1], toes[0]))  # feet stand flat in the reference
        out[:, JOINT[ankle]] = turned[ankle] @ align
        out[:, JOINT[toe]] = turned[toe] @ align if toe in turned else out[:, JOINT[ankle]]
        clavicle = f"{side}_clavicle"
        if clavicle not in turned:
            out[:, JOINT[clavicle]] = out[:, JOINT["chest"]]
    return out


_DOWN = np.array([[0.0, 0.0, -1.0]])  # where the bones of a limb point when our skeleton is at rest


def _trunk_rotations(
    joint: str, source: dict[str, Array], turned: dict[str, Array], still: dict[str, Array]
) -> Array:
    """World rotations (T, 3, 3) of a joint; in the trunk corrected so that the bone points as the source's does."""
    after = _NEXT.get(joint)
    if after is None or after not in source:
        return turned[joint]
    was = still[after] - still[joint]
    now = source[after] - source[joint]
    return _swing(turned[joint] @ was, now) @ turned[joint]


def _swing(was: Array, now: Array) -> Array:
    """Smallest rotations (T, 3, 3) that turn the directions `was` (T, 3) into `now` (T, 3)."""
    a = was / np.linalg.norm(was, axis=1, keepdims=True)
    b = now / np.linalg.norm(now, axis=1, keepdims=True)
    v = np.cross(a, b)
    c = np.sum(a * b, axis=1)
    K = np.zeros((len(v), 3, 3))
    K[:, 0, 1], K[:, 0, 2], K[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    K -= K.transpose(0, 2, 1)
    # Opposite directions have no smallest rotation; half a turn about x is taken.
    safe = np.maximum(1 + c, 1e-9)
    out = np.eye(3) + K + K @ K / safe[:, None, None]
    out[c < -1 + 1e-8] = np.diag([1.0, -1.0, -1.0])
    return out


def _local(world: Array) -> Array:
    out = world.copy()
    for j in range(1, len(JOINTS)):
        out[:, j] = relative(world[:, PARENTS[j]], world[:, j])
    return out


def _stiff_toes(local: Array) -> Array:
    """Toes that bend upwards only, as in shoes; captures know little about them."""
    local = local.copy()
    for side, _ in SIDES:
        toe = JOINT[f"{side}_toe"]
        bend = np.arctan2(local[:, toe, 0, 2], local[:, toe, 0, 0])
        local[:, toe] = rotation_about(1, np.clip(bend, -_MOST_TOE_RAD, 0.0))
    return local


def _leg_length(at: dict[str, Array]) -> float:
    lengths = [
        np.linalg.norm(at[f"{s}_{b}"] - at[f"{s}_{a}"], axis=1)
        for s, _ in SIDES
        for a, b in (("hip", "knee"), ("knee", "ankle"))
    ]
    return float(0.5 * np.sum(lengths, axis=0)[0])


def _soles(figure: Figure, position: Array, rotation: Array) -> Array:
    """Places (T, 2, 3, 3) m of heel, ball and tip of both soles."""
    H = figure.stature_m
    out = np.zeros((len(position), 2, 3, 3))
    for i, (side, _) in enumerate(SIDES):
        ankle, toe = JOINT[f"{side}_ankle"], JOINT[f"{side}_toe"]
        ball = figure.offsets[toe]
        for k, x in enumerate((-HEEL_BACK * H, ball[0])):
            point = np.array([x, 0.0, -figure.ankle_height_m])
            out[:, i, k] = position[:, ankle] + rotation[:, ankle] @ point
        tip = np.array([0.040 * H, 0.0, -figure.ankle_height_m - ball[2]])
        out[:, i, 2] = position[:, toe] + rotation[:, toe] @ tip
    return out


def _floor_under(figure: Figure, rotations: Array, root: Array, fps: float) -> Array:
    """Height (T,) m of the floor that the feet stand on, below the pelvis: a plane that may lean a little.

    The axes of a capture are not always upright: over a few metres that makes centimetres.
    """
    soles = _soles(figure, *forward_kinematics(figure.offsets, rotations, root))
    lowest = soles[..., 2].min(axis=2)
    speed = np.linalg.norm(np.gradient(soles.mean(axis=2), 1 / fps, axis=0), axis=2)
    level = float(np.percentile(lowest.min(axis=1), 20.0))  # most of the time a foot is down
    stands = (speed < _STILL_M_S * figure.stature_m / 1.75) & (lowest < level + _UNEVEN_M)
    at = soles.mean(axis=2)[stands]
    height = lowest[stands]
    if len(at) < _FEWEST_STANDS or np.ptp(at[:, :2], axis=0).max() < _SPREAD_M:
        return np.full(len(root), level)
    rows = np.column_stack([np.ones(len(at)), at[:, :2] - at[:, :2].mean(axis=0)])
    keep = np.ones(len(at), dtype=bool)
    plane = np.array([level, 0.0, 0.0])
    for _ in range(5):
        # A small ridge keeps the plane level across a straight walk.
        weighted = rows[keep]
        gram = weighted.T @ weighted + np.diag([0.0, 1.0, 1.0]) * 0.05 * keep.sum()
        plane = np.linalg.solve(gram, weighted.T @ height[keep])
        off = height - rows @ plane
        keep = np.abs(off) < max(2.0 * float(np.median(np.abs(off[keep]))), 0.01)
    slope = plane[1:] * min(1.0, _STEEPEST / max(float(np.linalg.norm(plane[1:])), 1e-9))
    return plane[0] + (root[:, :2] - at[:, :2].mean(axis=0)) @ slope


def _float(figure: Figure, rotations: Array, root: Array, fps: float) -> Array:
    """How much too high (T,) m the lower foot stands, smoothly; nothing where both feet are in the air.

    Bones of other proportions end a little above or below the floor; moving the whole body keeps their directions.
    """
    soles = _soles(figure, *forward_kinematics(figure.offsets, rotations, root))
    lowest = soles[..., 2].min(axis=(1, 2))
    frames = np.arange(len(root))
    stands = np.abs(lowest) < _FLOAT_M
    if not stands.any():
        return np.zeros(len(root))
    return gaussian_filter1d(np.interp(frames, frames[stands], lowest[stands]), 0.04 * fps, mode="nearest")


def _plant(figure: Figure, rotations: Array, root: Array, fps: float) -> Pose:
    """Hold feet that bear weight still and flat on the floor, lift those that would sink into it."""
    position, rotation = forward_kinematics(figure.offsets, rotations, root)
    held = [_held_foot(figure, side, position, rotation, rotations, fps) for side, _ in SIDES]
    ankles, feet, toes = [h[0] for h in held], [h[1] for h in held], [h[2] for h in held]
    for i, (side, _) in enumerate(SIDES):
        # What would still be under the floor is lifted with its foot.
        ankle, toe = JOINT[f"{side}_ankle"], JOINT[f"{side}_toe"]
        at, turned = position.copy(), rotation.copy()
        at[:, ankle], turned[:, ankle] = ankles[i], feet[i]
        at[:, toe], turned[:, toe] = ankles[i] + feet[i] @ figure.offsets[toe], feet[i] @ toes[i]
        ankles[i][:, 2] += np.maximum(-_soles(figure, at, turned)[:, i, :, 2].min(axis=1), 0.0)
    reach = MAX_REACH * (figure.thigh_m + figure.shank_m)
    sink = np.zeros(len(root))
    for i, (side, _) in enumerate(SIDES):
        hip = position[:, JOINT[f"{side}_hip"]]
        across = np.linalg.norm((ankles[i] - hip)[:, :2], axis=1)
        highest = ankles[i][:, 2] + np.sqrt(np.maximum(reach**2 - across**2, (0.3 * reach) ** 2))
        sink = np.maximum(sink, hip[:, 2] - highest)
    root = root - gaussian_filter1d(sink, 0.03 * fps, mode="nearest")[:, None] * np.array([0.0, 0.0, 1.0])
    position, rotation = forward_kinematics(figure.offsets, rotations, root)
    rotations = rotations.copy()
    for i, (side, _) in enumerate(SIDES):
        hip, knee = position[:, JOINT[f"{side}_hip"]], position[:, JOINT[f"{side}_knee"]]
        # The knee stays on its side; when the leg is straight, in front.
        pole = (knee - 0.5 * (hip + ankles[i])) + 0.15 * rotation[:, JOINT[f"{side}_hip"], :, 0]
        thigh, shank = solve_two_bones(hip, ankles[i], figure.thigh_m, figure.shank_m, pole, hinge=1.0)
        rotations[:, JOINT[f"{side}_hip"]] = relative(rotation[:, 0], thigh)
        rotations[:, JOINT[f"{side}_knee"]] = relative(thigh, shank)
        rotations[:, JOINT[f"{side}_ankle"]] = relative(shank, feet[i])
        rotations[:, JOINT[f"{side}_toe"]] = toes[i]
    return Pose(root, rotations, np.stack([h[3] for h in held], axis=1))


def _held_foot(
    figure: Figure, side: str, position: Array, rotation: Array, local: Array, fps: float
) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
    """Ankle (T, 3), foot (T, 3, 3) and toe rotations (T, 3, 3) with every stand held, and when it stands (T,)."""
    size = figure.stature_m / 1.75
    ankle_h = figure.ankle_height_m
    at = position[:, JOINT[f"{side}_ankle"]]
    foot = rotation[:, JOINT[f"{side}_ankle"]]
    n = len(at)
    speed = np.linalg.norm(np.gradient(gaussian_filter1d(at, 0.02 * fps, axis=0), 1 / fps, axis=0), axis=1)
    pitch = np.arcsin(np.clip(-foot[:, 2, 0], -1, 1))
    stands = (speed < _STILL_M_S * size) & (at[:, 2] < ankle_h + _LOW_M * size)
    if stands.sum() >= _FEWEST_STANDS:
        # The foot of the reference may not have been flat: what it does while standing is.
        level = float(np.clip(np.median(pitch[stands]), -_MOST_LEVEL_RAD, _MOST_LEVEL_RAD))
        foot, pitch = foot @ rotation_about(1, -level), pitch - level
    stands &= np.abs(pitch) < _FLAT_RAD
    stands = binary_opening(binary_closing(stands, np.ones(2)), np.ones(max(round(_SHORTEST_S * fps), 2)))
    ease = max(round(_EASE_S * fps), 1)
    pull, place, flat = np.zeros(n), at.copy(), foot.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[0], stands.astype(int), [0]])))
    for start, stop in edges.reshape(-1, 2):
        where = np.array([*np.median(at[start:stop, :2], axis=0), ankle_h])
        ahead = foot[start:stop, :, 0].mean(axis=0)
        standing = rotation_about(2, np.arctan2(ahead[1], ahead[0]))
        for frame in range(max(start - ease, 0), min(stop + ease, n)):
            outside = max(start - frame, frame - stop + 1, 0) / (ease + 1)
            share = (1 - outside) ** 2 * (1 + 2 * outside)
            if share > pull[frame]:
                pull[frame], place[frame], flat[frame] = share, where, standing
    toes = blend_rotations(local[:, JOINT[f"{side}_toe"]], np.tile(np.eye(3), (n, 1, 1)), pull)
    return at + pull[:, None] * (place - at), blend_rotations(foot, flat, pull), toes, stands
