"""Kit of the motions: curves through knots, legs solved to planted feet, arms solved to targets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from mocap.synth.figure import JOINT, JOINTS, SIDES, Figure, forward_kinematics, rotation_about

Array = NDArray[np.float64]

MAX_REACH = 0.998  # longest hip-ankle distance as a share of the straight leg
_HINGE_FROM, _HINGE_TO = (
    np.sin(np.deg2rad(8.0)),
    np.sin(np.deg2rad(25.0)),
)  # a limb bent by this knows its hinge
_TOE_OUT_RAD = np.deg2rad(9.0)  # of feet on which somebody rises


@dataclass(frozen=True, eq=False)
class Pose:
    """Joint rotations of a figure over time.

    root_position : (T, 3) m, world.  rotations : (T, J, 3, 3) local.
    contact : (T, 2) bool, left and right foot flat on the floor and bearing weight.
    ground_m : (T, 2), height of what each foot stands on or comes to; None = the floor.
    """

    root_position: Array
    rotations: Array
    contact: NDArray[np.bool_]
    ground_m: Array | None = None


@dataclass(frozen=True)
class Path:
    """A closed ellipse or a straight line on the floor, run at constant speed.

    center : (x, y) m.  radii : (a, b) m; (0, 0) makes a straight line through `center`.
    start_rad : position on the ellipse, or heading of the line.  clockwise : sense on the ellipse.
    """

    center: tuple[float, float]
    radii: tuple[float, float]
    start_rad: float
    clockwise: bool

    def at(self, s: Array) -> tuple[Array, Array]:
        """Points (N, 2) m and headings (N,) rad at arc lengths s (N,) m from the start."""
        s = np.asarray(s, dtype=np.float64)
        a, b = self.radii
        if a <= 0 or b <= 0:
            direction = np.array([np.cos(self.start_rad), np.sin(self.start_rad)])
            return np.array(self.center) + s[:, None] * direction, np.full(len(s), self.start_rad)
        turn = -1.0 if self.clockwise else 1.0
        angle = np.linspace(0, 2 * np.pi, 4001)
        theta = self.start_rad + turn * angle
        xy = np.column_stack([a * np.cos(theta), b * np.sin(theta)])
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(xy, axis=0), axis=1))])
        lap = np.floor_divide(s, length[-1])
        angle_s = np.interp(s - lap * length[-1], length, angle)
        theta_s = self.start_rad + turn * angle_s
        point = np.array(self.center) + np.column_stack([a * np.cos(theta_s), b * np.sin(theta_s)])
        heading = np.arctan2(turn * b * np.cos(theta_s), -turn * a * np.sin(theta_s))
        return point, np.unwrap(heading)

    def curvature(self, s: Array) -> Array:
        """Signed curvature (N,) 1/m, positive to the left."""
        h = 0.02
        return (self.at(s + h)[1] - self.at(s - h)[1]) / (2 * h)


def solve_two_bones(
    root: Array, target: Array, first_m: float, second_m: float, pole: Array, *, hinge: float
) -> tuple[Array, Array]:
    """World rotations (T, 3, 3) of the two bones that reach from root to target.

    root, target, pole : (T, 3), m and direction, world. Both bones point along their -z; the hinge is +y for
    hinge = +1 (knee: bends backwards, middle joint towards the pole) and -y for hinge = -1 (elbow). A target
    out of reach is approached along its direction.
    """
    reach = target - root
    distance = np.linalg.norm(reach, axis=1, keepdims=True)
    direction = reach / distance
    distance = np.clip(distance, abs(first_m - second_m) + 1e-4, (first_m + second_m) * 0.99995)
    normal = np.cross(pole, direction)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    towards = np.cross(direction, normal)  # unit, in the plane, on the pole's side
    cosine = (first_m**2 + distance**2 - second_m**2) / (2 * first_m * distance)
    sine = np.sqrt(np.clip(1 - cosine**2, 0, 1))
    first = cosine * direction + sine * towards
    second = (distance * direction - first_m * first) / second_m
    y = hinge * normal

    def frame(bone: Array) -> Array:
        z = -bone / np.linalg.norm(bone, axis=1, keepdims=True)
        return np.stack([np.cross(y, z), y, z], axis=-1)

    return frame(first), frame(second)


def hinged_frames(first: Array, second: Array, axis: Array, hinge: float) -> tuple[Array, Array]:
    """Frames of two bones (T, 3) that share a hinge; a nearly straight limb takes its axis from (T, 3) `axis`."""
    a = first / np.linalg.norm(first, axis=1, keepdims=True)
    b = second / np.linalg.norm(second, axis=1, keepdims=True)
    axis = axis - np.sum(axis * a, axis=1, keepdims=True) * a
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    across = hinge * np.cross(a, b)
    size = np.linalg.norm(across, axis=1, keepdims=True)
    share = np.clip((size - _HINGE_FROM) / (_HINGE_TO - _HINGE_FROM), 0, 1)
    y = share * across / np.maximum(size, 1e-9) + (1 - share) * axis
    y -= np.sum(y * a, axis=1, keepdims=True) * a
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    frames = []
    for bone in (a, b):
        side = y - np.sum(y * bone, axis=1, keepdims=True) * bone
        side /= np.linalg.norm(side, axis=1, keepdims=True)
        frames.append(np.stack([np.cross(side, -bone), side, -bone], axis=-1))
    return frames[0], frames[1]


def wander(n_frames: int, fps: float, *, slowest_s: float, rng: np.random.Generator) -> Array:
    """Smooth random variation about zero, (n_frames,), of about unit size."""
    t = np.arange(n_frames) / fps
    out = np.zeros(n_frames)
    for k in range(4):
        period = slowest_s / (1 + 0.9 * k) * rng.uniform(0.8, 1.25)
        out += np.sin(2 * np.pi * (t / period + rng.uniform())) / (1 + k)
    return out * 0.8


def follow(knots: list[tuple[float, Array]], n_frames: int, fps: float, *, start_s: float = 0.0) -> Array:
    """Smooth curve (n_frames, 3) through timed points that never goes beyond its neighbours.

    knots : (time in s, point) in the order of time; of points closer than 1 ms the first counts.
    start_s : time of the first frame.
    """
    times: list[float] = []
    points: list[Array] = []
    for time, point in knots:
        if times and time <= times[-1] + 1e-3:
            continue
        times.append(time)
        points.append(point)
    if len(times) == 1:
        return np.tile(points[0], (n_frames, 1))
    curve = PchipInterpolator(times, np.array(points), axis=0)
    t = np.clip(start_s + np.arange(n_frames) / fps, times[0], times[-1])
    return curve(t)


def swing_round(
    knots: list[tuple[float, Array]], n_frames: int, fps: float, *, start_s: float = 0.0
) -> Array:
    """As `follow`, but the hand goes round the shoulder: azimuth, elevation and distance are interpolated."""
    polar = [
        (t, np.array([np.arctan2(p[1], p[0]), np.arctan2(p[2], np.hypot(p[0], p[1])), np.linalg.norm(p)]))
        for t, p in knots
    ]
    azimuth, elevation, distance = follow(polar, n_frames, fps, start_s=start_s).T
    across = distance * np.cos(elevation)
    return np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), distance * np.sin(elevation)])


def identity(n_frames: int) -> Array:
    return np.tile(np.eye(3), (n_frames, len(JOINTS), 1, 1))


def set_trunk(
    rotations: Array,
    *,
    yaw: Array | float,
    roll: Array | float,
    bend: Array | float,
    gaze_yaw: Array | float,
    gaze_down: Array | float,
) -> None:
    """Share trunk angles (rad, relative to the pelvis) between spine and chest, gaze between neck and head."""
    n = len(rotations)
    yaw, roll, bend, gaze_yaw, gaze_down = (
        np.broadcast_to(np.asarray(a, dtype=np.float64), (n,)) for a in (yaw, roll, bend, gaze_yaw, gaze_down)
    )
    for joint, share in (("spine", 0.45), ("chest", 0.55)):
        rotations[:, JOINT[joint]] = (
            rotation_about(2, share * yaw) @ rotation_about(0, share * roll) @ rotation_about(1, share * bend)
        )
    for joint, share in (("neck", 0.5), ("head", 0.5)):
        rotations[:, JOINT[joint]] = rotation_about(2, share * gaze_yaw) @ rotation_about(
            1, share * (gaze_down - 0.8 * bend)
        )


def hang_arm(
    rotations: Array,
    side: str,
    sign: float,
    flexion: Array,
    abduction: Array | float,
    inward: float,
    elbow: Array | float,
) -> None:
    rotations[:, JOINT[f"{side}_shoulder"]] = (
        rotation_about(0, sign * np.asarray(abduction) * np.ones(len(rotations)))
        @ rotation_about(1, -flexion)
        @ rotation_about(2, -sign * inward * np.ones(len(rotations)))
    )
    rotations[:, JOINT[f"{side}_elbow"]] = rotation_about(1, -np.asarray(elbow) * np.ones(len(rotations)))


def solve_legs(
    figure: Figure, rotations: Array, root: Array, ankles: list[Array], feet: list[Array], toes: list[Array]
) -> None:
    """Fill hip, knee, ankle and toe rotations so that the ankles are at `ankles` and the feet turned as `feet`."""
    R_pelvis = rotations[:, 0]
    for (side, sign), ankle, foot, toe in zip(SIDES, ankles, feet, toes, strict=True):
        hip = root + np.einsum("tab,b->ta", R_pelvis, figure.offsets[JOINT[f"{side}_hip"]])
        forward_foot = foot[:, :, 0] * np.array([1.0, 1.0, 0.0])
        forward_foot /= np.linalg.norm(forward_foot, axis=1, keepdims=True)
        pole = 0.5 * R_pelvis[:, :, 0] + 0.5 * forward_foot + sign * 0.03 * R_pelvis[:, :, 1]
        thigh, shank = solve_two_bones(hip, ankle, figure.thigh_m, figure.shank_m, pole, hinge=1.0)
        rotations[:, JOINT[f"{side}_hip"]] = relative(R_pelvis, thigh)
        rotations[:, JOINT[f"{side}_knee"]] = relative(thigh, shank)
        rotations[:, JOINT[f"{side}_ankle"]] = relative(shank, foot)
        rotations[:, JOINT[f"{side}_toe"]] = rotation_about(1, toe)


def on_toes(
    figure: Figure, position: tuple[float, float], heading_rad: float, width_m: float, pitch: Array
) -> tuple[list[Array], list[Array]]:
    """Ankles (T, 3) m and feet (T, 3, 3), world, of both sides beside a place on the floor; feet that are pitched by
    (T,) rad turn about the joints of the toes, which stay flat."""
    base = np.array([*position, figure.ankle_height_m])
    left = np.array([-np.sin(heading_rad), np.cos(heading_rad), 0.0])
    ball = figure.offsets[JOINT["left_toe"]]
    tilt = rotation_about(1, pitch)
    rolled = ball - tilt @ ball  # the ankle about the joint of the toes
    ankles, feet = [], []
    for _, sign in SIDES:
        turn = rotation_about(2, heading_rad + sign * _TOE_OUT_RAD)
        ankles.append(base + 0.5 * sign * width_m * left + rolled @ turn.T)
        feet.append(turn @ tilt)
    return ankles, feet


def highest_pelvis(
    figure: Figure, R_pelvis: Array, root: Array, ankles: list[Array], reach_m: float
) -> Array:
    """Height (T,) m of the pelvis up to which both legs reach the ankles.

    R_pelvis : (T, 3, 3), root : (T, 3) m, world; its height does not count.  reach_m : longest hip-ankle distance.
    """
    limit = np.full(len(root), np.inf)
    for (side, _), ankle in zip(SIDES, ankles, strict=True):
        hip = R_pelvis @ figure.offsets[JOINT[f"{side}_hip"]]
        across = np.linalg.norm(ankle[:, :2] - root[:, :2] - hip[:, :2], axis=1)
        room = np.sqrt(np.maximum(reach_m**2 - across**2, (0.3 * reach_m) ** 2))
        limit = np.minimum(limit, ankle[:, 2] + room - hip[:, 2])
    return limit


def solve_arms(
    figure: Figure,
    rotations: Array,
    root: Array,
    goals: list[Array],
    poles: list[Array],
    *,
    heading: Array | None = None,
) -> None:
    """Fill shoulder and elbow rotations; goals (T, 3) m from the shoulder as (forward, outward, up).

    The goal axes are the chest's, or those of `heading` (T,) rad with a vertical up. The shoulder girdle rises
    and moves forward with the arm by a quarter of the motion.
    """
    for (side, sign), goal, pole in zip(SIDES, goals, poles, strict=True):
        mirrored = goal * np.array([1.0, sign, 1.0])
        elevation = np.arctan2(goal[:, 2], np.hypot(goal[:, 0], goal[:, 1])) + np.pi / 2
        lift = 0.22 * np.clip(elevation - 0.6, 0, None)
        clavicle = JOINT[f"{side}_clavicle"]
        protract = 0.12 * np.clip(goal[:, 0] / 0.5, 0, 1)
        rotations[:, clavicle] = rotation_about(0, sign * lift) @ rotation_about(2, -sign * protract)
        position, rotation = forward_kinematics(figure.offsets, rotations, root)
        shoulder = position[:, JOINT[f"{side}_shoulder"]]
        frame = rotation[:, JOINT["chest"]] if heading is None else rotation_about(2, heading)
        target = shoulder + np.einsum("tab,tb->ta", frame, mirrored)
        pole_world = np.einsum("tab,tb->ta", frame, pole * np.array([1.0, sign, 1.0]))
        upper, fore = solve_two_bones(
            shoulder, target, figure.upper_arm_m, figure.forearm_m, pole_world, hinge=-1.0
        )
        rotations[:, JOINT[f"{side}_shoulder"]] = relative(rotation[:, clavicle], upper)
        rotations[:, JOINT[f"{side}_elbow"]] = relative(upper, fore)


def relative(parent: Array, child: Array) -> Array:
    return parent.transpose(0, 2, 1) @ child


@dataclass(frozen=True, eq=False)
class Stance:
    """How somebody stands; what may change over time is a number or an array (T,).

    sway : size of the slow noise, 1 = usual.  stagger, width : distance of the feet along and across, m; the width is
    usual when not given.  crouch : lowering of the pelvis, of the stature.  back : shift of the pelvis backwards, m.
    bounce : of the pelvis, m.  turn, trunk_turn : of the pelvis and of the trunk on it, rad.  bend : of the trunk,
    rad.  gaze_yaw : of the head, rad; it looks about when not given.
    """

    sway: float = 1.0
    stagger: float = 0.0
    width: float | None = None
    crouch: Array | float = 0.003
    back: Array | float = 0.0
    bounce: float = 0.0
    turn: Array | float = 0.0
    trunk_turn: Array | float = 0.0
    bend: Array | float = 0.0
    gaze_yaw: Array | float | None = None


def standing(
    figure: Figure,
    n_frames: int,
    fps: float,
    position: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
    stance: Stance,
) -> tuple[Array, Array]:
    """Rotations and root of a person with both feet planted; pelvis sways, head looks about."""
    forward = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    left = np.array([-forward[1], forward[0], 0.0])
    base = np.array([position[0], position[1], 0.0])
    sway = stance.sway

    def noise(slowest_s: float) -> Array:
        return wander(n_frames, fps, slowest_s=slowest_s, rng=rng)

    t = np.arange(n_frames) / fps
    root = (
        base
        + sway * 0.012 * noise(4.0)[:, None] * left
        + (sway * 0.006 * noise(5.0) - 0.012)[:, None] * forward
    )
    root = root - np.broadcast_to(np.asarray(stance.back), (n_frames,))[:, None] * forward
    turning = np.broadcast_to(np.asarray(stance.turn, dtype=np.float64), (n_frames,)) + sway * 0.02 * noise(
        5.0
    )
    roll = sway * 0.012 * noise(4.0)
    rotations = identity(n_frames)
    rotations[:, 0] = (
        rotation_about(2, heading_rad + turning) @ rotation_about(0, roll) @ rotation_about(1, 0.06 + 0 * t)
    )
    set_trunk(
        rotations,
        yaw=stance.trunk_turn + sway * 0.03 * noise(4.0),
        roll=-roll,
        bend=stance.bend - 0.04 + sway * 0.012 * noise(3.0),
        gaze_yaw=0.35 * noise(3.2) if stance.gaze_yaw is None else stance.gaze_yaw + 0.04 * noise(2.0),
        gaze_down=0.06 + 0.06 * noise(2.6),
    )
    half = 0.5 * (0.125 * figure.stature_m if stance.width is None else stance.width)
    ankles, feet, toes = [], [], []
    for _, sign in SIDES:
        ankle = base + sign * half * left + sign * 0.5 * stance.stagger * forward
        ankle = ankle + np.array([0, 0, figure.ankle_height_m])
        toe_out = np.deg2rad(9.0) + (np.deg2rad(22.0) if stance.stagger * sign < 0 else 0.0)
        ankles.append(np.tile(ankle, (n_frames, 1)))
        feet.append(np.tile(rotation_about(2, heading_rad + sign * toe_out), (n_frames, 1, 1)))
        toes.append(np.zeros(n_frames))
    lowest = _highest_root(figure, rotations, root, ankles).min()
    bounce = stance.bounce * (np.cos(2 * np.pi * 1.9 * t) - 1)
    root[:, 2] = lowest - stance.crouch * figure.stature_m + bounce
    solve_legs(figure, rotations, root, ankles, feet, toes)
    return rotations, root


def _highest_root(figure: Figure, rotations: Array, root: Array, ankles: list[Array]) -> Array:
    """Height (T,) m of the pelvis at which one leg is as straight as it gets over its ankle, (T, 3)."""
    reach = MAX_REACH * (figure.thigh_m + figure.shank_m)
    limit = np.full(len(root), np.inf)
    for (side, _), ankle in zip(SIDES, ankles, strict=True):
        hip = np.einsum("tab,b->ta", rotations[:, 0], figure.offsets[JOINT[f"{side}_hip"]])
        across = np.linalg.norm(ankle[:, :2] - root[:, :2] - hip[:, :2], axis=1)
        limit = np.minimum(limit, ankle[:, 2] + np.sqrt(reach**2 - across**2) - hip[:, 2])
    return limit


def blend_rotations(a: Array, b: Array, share: Array) -> Array:
    """Rotations (..., 3, 3) on the shortest way from a to b.  share : broadcasts to (...,), 0 = a, 1 = b."""
    between = Rotation.from_matrix((a.swapaxes(-1, -2) @ b).reshape(-1, 3, 3)).as_rotvec()
    scaled = between.reshape(*a.shape[:-2], 3) * np.broadcast_to(share, a.shape[:-2])[..., None]
    return a @ Rotation.from_rotvec(scaled.reshape(-1, 3)).as_matrix().reshape(a.shape)
