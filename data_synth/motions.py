"""Motions of one figure: joint rotations over time, with feet that stand still while they bear weight.

Joint curves follow the published shapes of normal gait (Perry, Gait Analysis; Winter, The Biomechanics and
Motor Control of Human Gait): the feet and the pelvis are given, the legs are solved to the planted feet.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from data_synth.figure import JOINT, JOINTS, SIDES, Figure, forward_kinematics, rotation_about

Array = NDArray[np.float64]

_STANCE = 0.62  # share of the gait cycle with the foot on the floor
_MIDSTANCE = 0.275  # phase at which the pelvis passes over the planted ankle
_MAX_REACH = 0.998  # longest hip-ankle distance as a share of the straight leg


@dataclass(frozen=True, eq=False)
class Pose:
    """Joint rotations of a figure over time.

    root_position : (T, 3) m, world.  rotations : (T, J, 3, 3) local.
    contact : (T, 2) bool, left and right foot flat on the floor and bearing weight.
    """

    root_position: Array
    rotations: Array
    contact: NDArray[np.bool_]


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


def wander(n_frames: int, fps: float, *, slowest_s: float, rng: np.random.Generator) -> Array:
    """Smooth random variation about zero, (n_frames,), of about unit size."""
    t = np.arange(n_frames) / fps
    out = np.zeros(n_frames)
    for k in range(4):
        period = slowest_s / (1 + 0.9 * k) * rng.uniform(0.8, 1.25)
        out += np.sin(2 * np.pi * (t / period + rng.uniform())) / (1 + k)
    return out * 0.8


def walk(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    path: Path,
    speed_m_s: float,
    rng: np.random.Generator,
) -> Pose:
    """Normal walking along a path.

    speed_m_s : 0.5 .. 1.8. Stride length and cadence follow from speed and stature.
    """
    H = figure.stature_m
    stride = 0.71 * H * (speed_m_s / 1.2) ** 0.5 * rng.uniform(0.96, 1.04)
    first_phase = rng.uniform()
    n_wanted = n_frames
    n_frames = max(n_frames, int(np.ceil(2 * stride / speed_m_s * fps)))  # whole cycles, to fit the pelvis to
    t = np.arange(n_frames) / fps
    s = speed_m_s * t
    phase = first_phase + s / stride  # of the left leg; integer = left heel strike
    scale = rng.uniform(0.9, 1.1, size=6)
    xy, heading = path.at(s)
    # Into the curve, positive = to the left; in tight turns people step round rather than lean.
    lean = 0.10 * np.tanh(5.0 * np.arctan(speed_m_s**2 * path.curvature(s) / 9.81))
    wave = 2 * np.pi * phase
    left_of = np.column_stack([-np.sin(heading), np.cos(heading)])
    # Pelvis: the left side leads at left heel strike, drops on the swing side, and rides over the stance leg.
    sway = 0.018 * scale[0] * np.sin(wave + 0.15)
    centripetal = -np.sin(lean) * 0.45 * figure.standing_height_m
    root = np.zeros((n_frames, 3))
    root[:, :2] = xy + left_of * (sway - centripetal)[:, None]
    yaw = -np.deg2rad(6.0) * scale[1] * np.cos(wave - 0.1)
    roll = np.deg2rad(4.0) * scale[2] * np.sin(wave + 0.1)
    tilt = np.deg2rad(5.0 + 1.0 * np.cos(2 * wave))
    R_pelvis = (
        rotation_about(2, heading + yaw)
        @ rotation_about(0, -lean * 0.6 + roll * 0.9)
        @ rotation_about(1, tilt)
    )
    ankles, feet, toes, contact = _walking_feet(figure, path, stride, phase, s, first_phase)
    offsets = figure.offsets
    limit = np.full(n_frames, np.inf)
    reach = _MAX_REACH * (figure.thigh_m + figure.shank_m)
    for i, (side, _) in enumerate(SIDES):
        hip = np.einsum("tab,b->ta", R_pelvis, offsets[JOINT[f"{side}_hip"]])
        across = np.linalg.norm(ankles[i][:, :2] - root[:, :2] - hip[:, :2], axis=1)
        limit = np.minimum(
            limit, ankles[i][:, 2] + np.sqrt(np.maximum(reach**2 - across**2, 0.01)) - hip[:, 2]
        )
    # The pelvis rises and falls twice per cycle as far as the planted legs ask for.
    harmonics = np.column_stack([np.cos(2 * wave), np.sin(2 * wave)])
    fitted = np.linalg.lstsq(np.column_stack([np.ones(n_frames), harmonics]), limit, rcond=None)[0][1:]
    rise = harmonics @ fitted * (0.95 + 0.2 * (scale[3] - 1))
    # Between, it stays as high as the legs allow over half a stride: knees are nearly straight at midstance.
    half = int(np.ceil(0.5 * stride / speed_m_s * fps))
    lowest = minimum_filter1d(limit - rise, 2 * half + 1, mode="nearest")
    root[:, 2] = rise + gaussian_filter1d(lowest, 0.4 * half, mode="nearest", truncate=2.5)
    rotations = _identity(n_frames)
    rotations[:, 0] = R_pelvis
    _trunk(
        rotations,
        yaw=-1.75 * yaw + np.deg2rad(1.0) * wander(n_frames, fps, slowest_s=4.0, rng=rng),
        roll=-0.9 * roll,
        bend=np.deg2rad(-3.0 + 1.5 * np.cos(2 * wave + 0.6)),
        gaze_yaw=0.6 * yaw + np.deg2rad(4.0) * wander(n_frames, fps, slowest_s=3.5, rng=rng),
        gaze_down=np.deg2rad(3.0) + np.deg2rad(2.0) * wander(n_frames, fps, slowest_s=3.0, rng=rng),
    )
    swing = np.deg2rad(20.0) * scale[4] * np.clip(speed_m_s / 1.2, 0.5, 1.4)
    for i, (side, sign) in enumerate(SIDES):
        own = wave + np.pi * i
        flexion = np.deg2rad(3.0) - swing * np.cos(own - 0.1)
        elbow = np.deg2rad(22.0) + np.deg2rad(13.0) * scale[5] * (0.5 - 0.5 * np.cos(own - 0.45))
        abduction = np.deg2rad(8.0 + 3.0 * max(figure.build - 1.0, 0.0) * 10) + np.deg2rad(1.5) * np.cos(own)
        _hang_arm(rotations, side, sign, flexion, abduction, np.deg2rad(12.0), elbow)
    _solve_legs(figure, rotations, root, ankles, feet, toes)
    return Pose(root[:n_wanted], rotations[:n_wanted], contact[:n_wanted])


def _walking_feet(
    figure: Figure, path: Path, stride: float, phase: Array, s: Array, first_phase: float
) -> tuple[list[Array], list[Array], list[Array], NDArray[np.bool_]]:
    """Ankle positions, foot rotations and toe angles of both feet, and which of them stand flat."""
    H = figure.stature_m
    ankle_h = figure.ankle_height_m
    heel = np.array([-0.038 * H, 0.0, -ankle_h])
    ball = figure.offsets[
        JOINT["left_toe"]
    ]  # the toes stay on the floor and the foot turns about their joint
    toe_out = np.deg2rad(6.0)
    half_width = 0.030 * H
    flat_from, flat_to = 0.08, 0.38
    strike, push = np.deg2rad(20.0), np.deg2rad(58.0)
    # Foot pitch over the cycle, positive = toes down.
    knots = np.array([0.0, 0.04, flat_from, flat_to, 0.50, 0.57, _STANCE, 0.68, 0.78, 0.88, 0.96, 1.0])
    pitches = np.concatenate(
        [
            strike * np.array([-1.0, -0.55, 0, 0]),
            push * np.array([0.30, 0.66, 1.0, 0.85, 0.30]),
            strike * np.array([-0.25, -0.95, -1.0]),
        ]
    )
    pitch_at = PchipInterpolator(knots, pitches)

    def planted(step_s: float, sign: float, p: Array) -> Array:
        """Ankle (N, 3) of a foot in stance: rolls over the heel, stands, rolls over the ball."""
        point, heading = path.at(np.array([step_s]))
        yaw = heading[0] + sign * toe_out
        side = np.array([-np.sin(heading[0]), np.cos(heading[0])]) * sign * half_width
        base = np.array([point[0, 0] + side[0], point[0, 1] + side[1], ankle_h])
        turn = rotation_about(2, yaw)
        pitch = pitch_at(p)
        pivot = np.where((p < 0.2)[:, None], heel, ball)
        rolled = np.einsum("nab,nb->na", rotation_about(1, pitch), -pivot)
        return base + (rolled + pivot) @ turn.T

    ankles, feet, toes = [], [], []
    contact = np.zeros((len(phase), 2), dtype=bool)
    for i, (_, sign) in enumerate(SIDES):
        own = phase + 0.5 * i
        step = np.floor(own)
        p = own - step
        start = (step - 0.5 * i - first_phase) * stride  # path position of the pelvis at this heel strike
        ankle = np.zeros((len(p), 3))
        yaw = np.zeros(len(p))
        for k in np.unique(step):
            mine = step == k
            here = start[mine][0] + _MIDSTANCE * stride
            there = here + stride
            yaw_here = path.at(np.array([here, there]))[1] + sign * toe_out
            pm = p[mine]
            stance = pm <= _STANCE
            u = np.clip((pm - _STANCE) / (1 - _STANCE), 0, 1)
            ends = np.concatenate(
                [
                    planted(here, sign, np.array([_STANCE - 0.01, _STANCE])),
                    planted(there, sign, np.array([0.0, 0.01])),
                ]
            )
            span = 1 - _STANCE
            speed0 = (ends[1] - ends[0]) / 0.01 * span
            # The foot still travels forward when the heel strikes; a foot that waits would stretch the leg.
            onward = (ends[2] - ends[1]) * np.array([1.0, 1.0, 0.0])
            speed1 = 0.40 * stride * span * onward / np.linalg.norm(onward) + np.array([0, 0, -0.05])
            # Mid-swing: the ankle is halfway and still high, so that knee and toes clear the floor.
            middle = 0.5 * (ends[1] + ends[2])
            middle[2] = ankle_h + 0.040 * H
            slope = 1.25 * (ends[2] - ends[1])
            slope[2] = -0.12 * H
            fly = CubicHermiteSpline([0, 0.5, 1], [ends[1], middle, ends[2]], [speed0, slope, speed1])(u)
            fly[:, 2] += 0.010 * H * np.sin(np.pi * np.minimum(u / 0.4, 1.0)) ** 2  # toes clear the floor
            ankle[mine] = np.where(stance[:, None], planted(here, sign, pm), fly)
            blend = u * u * (3 - 2 * u)
            yaw[mine] = yaw_here[0] + blend * (yaw_here[1] - yaw_here[0])
        pitch = pitch_at(p)
        ankles.append(ankle)
        feet.append(rotation_about(2, yaw) @ rotation_about(1, pitch))
        # Toes stay flat while the heel rises, and straighten in early swing.
        fade = np.clip((p - _STANCE) / 0.12, 0, 1)
        toes.append(-np.maximum(pitch, 0) * np.where(p <= _STANCE, 1.0, 1 - fade))
        contact[:, i] = (p >= flat_from + 1e-9) & (p <= flat_to)
    return ankles, feet, toes, contact


def stand(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
) -> Pose:
    """Standing upright, looking about, shifting the weight a little."""
    rotations, root, _ = _standing(figure, n_frames, fps, position, heading_rad, rng, sway=1.0)
    for side, sign in SIDES:
        drift = np.deg2rad(2.5) * wander(n_frames, fps, slowest_s=4.0, rng=rng)
        _hang_arm(
            rotations, side, sign, drift + 0.03, np.deg2rad(9.0) + 0.4 * drift, np.deg2rad(15.0), 0.28 + drift
        )
    return Pose(root, rotations, np.ones((n_frames, 2), dtype=bool))


def gesture(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
) -> Pose:
    """Standing with arm gestures in turn: wave, point, beckon, arms out, alternating between the arms."""
    rotations, root, _ = _standing(figure, n_frames, fps, position, heading_rad, rng, sway=1.3)
    reach = figure.upper_arm_m + figure.forearm_m
    rest = np.array([0.10, 0.12, -0.93])
    # Wrist targets relative to the shoulder, in arm lengths: forward, outward, up.
    shapes: dict[str, list[tuple[float, float, float]]] = {
        "wave": [
            (0.35, 0.35, 0.30),
            (0.30, 0.60, 0.42),
            (0.32, 0.22, 0.44),
            (0.30, 0.60, 0.42),
            (0.35, 0.3, 0.4),
        ],
        "point": [(0.80, 0.20, 0.05), (0.93, 0.18, 0.12), (0.92, 0.32, 0.14), (0.92, 0.05, 0.12)],
        "beckon": [(0.75, 0.10, 0.00), (0.42, 0.08, 0.12), (0.75, 0.10, 0.02), (0.42, 0.08, 0.12)],
        "wide": [(0.30, 0.80, -0.05), (0.25, 0.90, 0.10), (0.30, 0.85, 0.0)],
        "raise": [(0.45, 0.35, 0.55), (0.20, 0.25, 0.90), (0.15, 0.25, 0.92)],
    }
    names = list(shapes)
    duration = n_frames / fps
    knots: list[list[tuple[float, Array]]] = [[(0.0, rest)], [(0.0, rest)]]
    clock, turn = 0.15, int(rng.integers(2))
    order = [names[k] for k in rng.permutation(len(names))]
    for n in range(50):
        if clock > duration:
            break
        name = order[n % len(order)]
        arms = (0, 1) if name == "wide" else (turn,)
        turn = 1 - turn
        pause = rng.uniform(0.42, 0.55)
        moments = clock + pause * (1.6 + np.arange(len(shapes[name])))
        for arm in arms:
            knots[arm].append((clock, rest))
            jitter = rng.normal(0, 0.03, size=(len(moments), 3))
            knots[arm] += [
                (float(m), np.array(w) + j) for m, w, j in zip(moments, shapes[name], jitter, strict=True)
            ]
            knots[arm].append((float(moments[-1] + 1.7 * pause), rest))
        # The next gesture, with the other arm, begins while this one ends.
        clock = float(moments[-1]) + (1.75 * pause if name == "wide" else 0.7 * pause)
    knots = [sorted(k, key=lambda item: item[0]) for k in knots]
    goals = [_swing(k, n_frames, fps) * reach for k in knots]
    poles = [np.tile([-0.75, 0.55, -0.75], (n_frames, 1)) for _ in SIDES]
    _solve_arms(figure, rotations, root, goals, poles)
    return Pose(root, rotations, np.ones((n_frames, 2), dtype=bool))


def box(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
) -> Pose:
    """Shadow boxing from a guard with one foot in front: jabs and crosses with the trunk behind them."""
    duration = n_frames / fps
    lead = 0 if rng.uniform() < 0.7 else 1  # the arm and leg in front: left for most people
    reach = figure.upper_arm_m + figure.forearm_m
    guard = [np.array([0.50, -0.05, 0.02]), np.array([0.40, -0.06, -0.02])]
    if lead == 1:
        guard = guard[::-1]
    knots: list[list[tuple[float, Array]]] = [[(0.0, g)] for g in guard]
    turn_knots: list[tuple[float, Array]] = [(0.0, np.zeros(3))]
    clock = 0.2 + rng.uniform(0, 0.2)
    while clock < duration:
        arm = lead if rng.uniform() < 0.6 else 1 - lead
        out = rng.uniform(0.17, 0.24)
        target = np.array([0.95, -0.12, 0.04]) + rng.normal(0, [0.02, 0.03, 0.06])
        knots[arm] += [
            (clock, guard[arm]),
            (clock + out, target),
            (clock + out + 0.05, target),
            (clock + 2.3 * out, guard[arm]),
        ]
        power = 0.25 if arm == lead else 0.55
        twist = np.array([power * (-1.0 if arm == 0 else 1.0), 0.05 + 0.12 * power, 0.0])
        turn_knots += [(clock, np.zeros(3)), (clock + out, twist), (clock + 2.3 * out, np.zeros(3))]
        clock += 2.3 * out + rng.uniform(0.08, 0.45)
    turn = _follow(turn_knots, n_frames, fps)
    stance_turn = np.deg2rad(-28.0) * (1 if lead == 0 else -1)  # side-on: the lead shoulder in front
    rotations, root, _ = _standing(
        figure,
        n_frames,
        fps,
        position,
        heading_rad,
        rng,
        sway=1.5,
        stagger=0.34 if lead == 0 else -0.34,
        width=0.27,
        crouch=0.035,
        bounce=0.012,
        turn=stance_turn + 0.45 * turn[:, 0],
        trunk_turn=0.55 * turn[:, 0],
        bend=0.16 + turn[:, 1],
        gaze_yaw=-(stance_turn + turn[:, 0]),
    )
    goals = [_follow(k, n_frames, fps) * reach for k in knots]
    poles = [np.tile([-0.35, 0.45, -0.9], (n_frames, 1)) for _ in SIDES]
    # Targets are meant along the line of sight, not along the turned chest.
    _solve_arms(figure, rotations, root, goals, poles, heading=np.full(n_frames, heading_rad))
    return Pose(root, rotations, np.ones((n_frames, 2), dtype=bool))


def pick_up(
    figure: Figure,
    n_frames: int,
    fps: float,
    *,
    position: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
) -> Pose:
    """Crouching to the floor with both arms and rising again, over and over, a little different each time."""
    clock = 0.3 + rng.uniform(0, 0.3)
    low: list[tuple[float, Array]] = [(0.0, np.zeros(3))]
    while clock < n_frames / fps:
        down, hold, up = rng.uniform(1.0, 1.3), rng.uniform(0.2, 0.5), rng.uniform(1.0, 1.3)
        # Depth of the knees, bend of the trunk, and how far to the front the hands go.
        deep = np.array([1.0, 1.0, 1.0]) * rng.uniform(0.8, 1.0, 3)
        low += [(clock, np.zeros(3)), (clock + down, deep), (clock + down + hold, deep)]
        clock += down + hold + up
        low.append((clock, np.zeros(3)))
        clock += rng.uniform(0.3, 0.8)
    depth, bend, front = _follow(low, n_frames, fps).T
    rotations, root, _ = _standing(
        figure,
        n_frames,
        fps,
        position,
        heading_rad,
        rng,
        sway=0.8,
        width=0.26,
        crouch=0.003 + 0.23 * depth,
        back=0.055 * figure.stature_m * depth,
        bend=0.95 * bend,
        gaze_yaw=0.0,
    )
    reach = figure.upper_arm_m + figure.forearm_m
    hang = np.column_stack([0.08 + 0.30 * front, 0.12 - 0.10 * front, -0.95 + 0.09 * front])
    goals = [hang * reach] * 2
    poles = [np.tile([-0.8, 0.5, -0.3], (n_frames, 1)) for _ in SIDES]
    _solve_arms(figure, rotations, root, goals, poles, heading=np.full(n_frames, heading_rad))
    return Pose(root, rotations, np.ones((n_frames, 2), dtype=bool))


def _follow(knots: list[tuple[float, Array]], n_frames: int, fps: float) -> Array:
    """Smooth curve (n_frames, 3) through timed points, at rest in each of them; a later entry at one time wins."""
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
    t = np.clip(np.arange(n_frames) / fps, times[0], times[-1])
    return curve(t)


def _swing(knots: list[tuple[float, Array]], n_frames: int, fps: float) -> Array:
    """As `_follow`, but the hand goes round the shoulder: azimuth, elevation and distance are interpolated."""
    polar = [
        (t, np.array([np.arctan2(p[1], p[0]), np.arctan2(p[2], np.hypot(p[0], p[1])), np.linalg.norm(p)]))
        for t, p in knots
    ]
    azimuth, elevation, distance = _follow(polar, n_frames, fps).T
    across = distance * np.cos(elevation)
    return np.column_stack([across * np.cos(azimuth), across * np.sin(azimuth), distance * np.sin(elevation)])


def _identity(n_frames: int) -> Array:
    return np.tile(np.eye(3), (n_frames, len(JOINTS), 1, 1))


def _trunk(
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


def _hang_arm(
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


def _solve_legs(
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
        rotations[:, JOINT[f"{side}_hip"]] = _relative(R_pelvis, thigh)
        rotations[:, JOINT[f"{side}_knee"]] = _relative(thigh, shank)
        rotations[:, JOINT[f"{side}_ankle"]] = _relative(shank, foot)
        rotations[:, JOINT[f"{side}_toe"]] = rotation_about(1, toe)


def _solve_arms(
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
        rotations[:, JOINT[f"{side}_shoulder"]] = _relative(rotation[:, clavicle], upper)
        rotations[:, JOINT[f"{side}_elbow"]] = _relative(upper, fore)


def _relative(parent: Array, child: Array) -> Array:
    return parent.transpose(0, 2, 1) @ child


def _standing(
    figure: Figure,
    n_frames: int,
    fps: float,
    position: tuple[float, float],
    heading_rad: float,
    rng: np.random.Generator,
    *,
    sway: float,
    stagger: float = 0.0,
    width: float | None = None,
    crouch: Array | float = 0.003,
    back: Array | float = 0.0,
    bounce: float = 0.0,
    turn: Array | float = 0.0,
    trunk_turn: Array | float = 0.0,
    bend: Array | float = 0.0,
    gaze_yaw: Array | float | None = None,
) -> tuple[Array, Array, Array]:
    """Rotations, root and ankles of a person with both feet planted; pelvis sways, head looks about."""
    ankle_h = figure.ankle_height_m
    half = 0.5 * (0.125 * figure.stature_m if width is None else width)
    forward = np.array([np.cos(heading_rad), np.sin(heading_rad), 0.0])
    left = np.array([-forward[1], forward[0], 0.0])
    base = np.array([position[0], position[1], 0.0])

    def noise(slowest_s: float) -> Array:
        return wander(n_frames, fps, slowest_s=slowest_s, rng=rng)

    t = np.arange(n_frames) / fps
    root = (
        base
        + sway * 0.012 * noise(4.0)[:, None] * left
        + (sway * 0.006 * noise(5.0) - 0.012)[:, None] * forward
    )
    root = root - np.broadcast_to(np.asarray(back), (n_frames,))[:, None] * forward
    turning = np.broadcast_to(np.asarray(turn, dtype=np.float64), (n_frames,)) + sway * 0.02 * noise(5.0)
    roll = sway * 0.012 * noise(4.0)
    rotations = _identity(n_frames)
    rotations[:, 0] = (
        rotation_about(2, heading_rad + turning) @ rotation_about(0, roll) @ rotation_about(1, 0.06 + 0 * t)
    )
    _trunk(
        rotations,
        yaw=trunk_turn + sway * 0.03 * noise(4.0),
        roll=-roll,
        bend=bend - 0.04 + sway * 0.012 * noise(3.0),
        gaze_yaw=0.35 * noise(3.2) if gaze_yaw is None else gaze_yaw + 0.04 * noise(2.0),
        gaze_down=0.06 + 0.06 * noise(2.6),
    )
    ankles, feet, toes = [], [], []
    for _, sign in SIDES:
        ankle = base + sign * half * left + sign * 0.5 * stagger * forward + np.array([0, 0, ankle_h])
        toe_out = np.deg2rad(9.0) + (np.deg2rad(22.0) if stagger * sign < 0 else 0.0)
        yaw = heading_rad + sign * toe_out
        ankles.append(np.tile(ankle, (n_frames, 1)))
        feet.append(np.tile(rotation_about(2, yaw), (n_frames, 1, 1)))
        toes.append(np.zeros(n_frames))
    reach = _MAX_REACH * (figure.thigh_m + figure.shank_m)
    limit = np.full(n_frames, np.inf)
    for (side, _), ankle in zip(SIDES, ankles, strict=True):
        hip = np.einsum("tab,b->ta", rotations[:, 0], figure.offsets[JOINT[f"{side}_hip"]])
        across = np.linalg.norm(ankle[:, :2] - root[:, :2] - hip[:, :2], axis=1)
        limit = np.minimum(limit, ankle[:, 2] + np.sqrt(reach**2 - across**2) - hip[:, 2])
    root[:, 2] = limit.min() - crouch * figure.stature_m + bounce * (np.cos(2 * np.pi * 1.9 * t) - 1)
    _solve_legs(figure, rotations, root, ankles, feet, toes)
    return rotations, root, np.stack(ankles, axis=1)


MOTIONS: dict[str, Callable[..., Pose]] = {
    "walk": walk,
    "stand": stand,
    "gesture": gesture,
    "box": box,
    "pick_up": pick_up,
}
