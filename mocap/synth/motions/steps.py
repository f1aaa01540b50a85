"""From footsteps to a moving person: feet that swing between plants, a pelvis that follows them, legs solved between.

A plan of plants (when and where each foot stands) says everything about locomotion: walking, stepping back, turning on
the spot, dancing. The pelvis rides over the loaded foot, as high as the legs allow.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator
from scipy.ndimage import gaussian_filter1d, minimum_filter1d

from mocap.synth.figure import HEEL_BACK, JOINT, SIDES, Figure, rotation_about
from mocap.synth.motions.kit import (
    MAX_REACH,
    Array,
    Pose,
    hang_arm,
    highest_pelvis,
    set_trunk,
    solve_legs,
    wander,
)

TOE_OUT_RAD = np.deg2rad(7.0)
_STRIKE_RAD, _PUSH_RAD = np.deg2rad(20.0), np.deg2rad(58.0)
_ROCKER, _PUSH = 0.21, 0.63  # heel rocker and push-off as shares of the neighbouring swing
_SETTLE_S = 0.4  # shift of the weight to or from one leg when standing
_FOLLOW_S = 0.24  # the pelvis follows the loaded foot, smoothed by this
_BEFORE_S = 3.0  # standing still before the first and after the last moment, for the filters


@dataclass(frozen=True)
class Plant:
    """One foot on the floor from heel contact to toe-off.

    at : ankle (x, y) m, world.  yaw_rad : direction of the toes, continuous from plant to plant.
    height_m : of what it stands on.
    """

    start_s: float
    end_s: float
    at: tuple[float, float]
    yaw_rad: float
    height_m: float = 0.0


class Footsteps:
    """A plan under construction: both feet on the floor, then one step after the other."""

    def __init__(self, figure: Figure, position: tuple[float, float], heading_rad: float) -> None:
        self.half_m = 0.050 * figure.stature_m
        self.plants: tuple[list[Plant], list[Plant]] = ([], [])
        for side in range(2):
            at, yaw = self.beside(side, position, heading_rad)
            self.plants[side].append(Plant(-np.inf, np.inf, at, yaw))

    def beside(
        self, side: int, center: tuple[float, float], heading_rad: float, half_m: float | None = None
    ) -> tuple[tuple[float, float], float]:
        """Where a foot stands when the person is at `center`: ankle (x, y) and direction of the toes."""
        half = self.half_m if half_m is None else half_m
        sign = SIDES[side][1]
        at = (
            center[0] - sign * half * float(np.sin(heading_rad)),
            center[1] + sign * half * float(np.cos(heading_rad)),
        )
        return at, heading_rad + sign * float(TOE_OUT_RAD)

    def step(
        self,
        side: int,
        lift_s: float,
        land_s: float,
        at: tuple[float, float],
        yaw_rad: float,
        height_m: float = 0.0,
    ) -> None:
        """Lift one foot and plant it elsewhere. Raises ValueError when it lifts before it has landed."""
        old = self.plants[side][-1]
        if not old.start_s < lift_s < land_s:
            raise ValueError(f"a step must lift after landing, got {old.start_s}, {lift_s}, {land_s}")
        self.plants[side][-1] = replace(old, end_s=lift_s)
        self.plants[side].append(Plant(land_s, np.inf, at, yaw_rad, height_m))

    def stand(
        self, side: int, lift_s: float, land_s: float, center: tuple[float, float], heading_rad: float
    ) -> None:
        """A step to the place beside `center`."""
        at, yaw = self.beside(side, center, heading_rad)
        self.step(side, lift_s, land_s, at, yaw)

    def turn(
        self,
        center: tuple[float, float],
        from_rad: float,
        to_rad: float,
        start_s: float,
        *,
        step_s: float = 0.32,
    ) -> float:
        """Turn on the spot from one heading to another (continuous angles); returns the time of the last landing."""
        n = int(np.ceil(abs(to_rad - from_rad) / np.deg2rad(50.0)))
        first = 0 if to_rad > from_rad else 1  # the inner foot opens
        land = start_s + 0.25
        for i in range(1, n + 1):
            heading = from_rad + (to_rad - from_rad) * i / n
            for side in (first, 1 - first):
                land += step_s
                self.stand(side, land - 0.74 * step_s, land, center, heading)
        return land if n else start_s


@dataclass(eq=False)
class Gait:
    """A person on planned feet; a motion bends trunk and arms and may move the pelvis before `finish`.

    t : (T,) s.  root : (T, 3) m, world.  yaw : (T,) rad, heading of the pelvis without its own rotation.
    pelvis_yaw, roll, tilt : (T,) rad of the pelvis against the heading.  stride : (T,) m, left ankle before right.
    speed : (T,) m/s of the pelvis along the floor.  load : (T, 2) share of the weight on each foot.
    ankles, feet, toes : per side (T, 3) m, (T, 3, 3), (T,) rad.  contact : (T, 2) bool.
    ground : (T, 2) m, height of what each foot stands on or comes to.
    """

    figure: Figure
    t: Array
    fps: float
    root: Array
    yaw: Array
    pelvis_yaw: Array
    roll: Array
    tilt: Array
    stride: Array
    speed: Array
    load: Array
    ankles: list[Array]
    feet: list[Array]
    toes: list[Array]
    contact: NDArray[np.bool_]
    ground: Array

    @property
    def pelvis(self) -> Array:
        """World rotation (T, 3, 3) of the pelvis."""
        return (
            rotation_about(2, self.yaw + self.pelvis_yaw)
            @ rotation_about(0, self.roll)
            @ rotation_about(1, self.tilt)
        )

    def highest(self, straight: float = MAX_REACH) -> Array:
        """Height (T,) m up to which both legs reach their feet."""
        reach = straight * (self.figure.thigh_m + self.figure.shank_m)
        return highest_pelvis(self.figure, self.pelvis, self.root, self.ankles, reach)

    def ride(self, crouch_m: Array | float = 0.0) -> None:
        """Put the pelvis as high as the legs allow, smoothly, less `crouch_m`."""
        half = int(np.ceil(0.09 * self.fps))
        lowest = minimum_filter1d(self.highest(), 2 * half + 1, mode="nearest")
        self.root[:, 2] = gaussian_filter1d(lowest, half / 2.5, mode="nearest", truncate=2.5) - crouch_m

    def finish(self, rotations: Array, keep: slice) -> Pose:
        """Set the pelvis, solve the legs and cut out the wanted frames."""
        rotations[:, 0] = self.pelvis
        solve_legs(self.figure, rotations, self.root, self.ankles, self.feet, self.toes)
        return Pose(self.root[keep], rotations[keep], self.contact[keep], self.ground[keep])


def timeline(n_frames: int, fps: float) -> tuple[Array, slice]:
    """Times (T,) s with a margin on both sides, and the slice of the wanted frames."""
    margin = int(np.ceil(_BEFORE_S * fps))
    return (np.arange(n_frames + 2 * margin) - margin) / fps, slice(margin, margin + n_frames)


def follow_feet(
    figure: Figure,
    plan: Footsteps,
    t: Array,
    fps: float,
    *,
    follow_s: float = _FOLLOW_S,
    liveliness: float = 1.0,
) -> Gait:
    """Feet and pelvis of a plan at times t (T,) s.

    follow_s : how slowly the pelvis follows the loaded foot.  liveliness : scale of the pelvis' own rotations.
    """
    sigma = follow_s * fps
    ankles, feet, toes, contact, yaws = [], [], [], [], []
    for plants in plan.plants:
        ankle, foot, toe, flat, yaw = _foot(figure, plants, t)
        ankles.append(ankle)
        feet.append(foot)
        toes.append(toe)
        contact.append(flat)
        yaws.append(yaw)
    load = _loads(plan, t)
    support = load[:, :1] * _standing_at(plan.plants[0], t) + load[:, 1:] * _standing_at(plan.plants[1], t)
    root = np.zeros((len(t), 3))
    root[:, :2] = gaussian_filter1d(support, sigma, axis=0, mode="nearest")
    yaw = gaussian_filter1d(0.5 * (yaws[0] + yaws[1]), 0.12 * fps, mode="nearest")
    forward = np.column_stack([np.cos(yaw), np.sin(yaw)])
    stride = np.sum((ankles[0] - ankles[1])[:, :2] * forward, axis=1)
    stride = gaussian_filter1d(stride, 0.05 * fps, mode="nearest")
    speed = np.linalg.norm(np.gradient(root[:, :2], 1 / fps, axis=0), axis=1)
    shift = gaussian_filter1d(load[:, 0] - load[:, 1], 0.09 * fps, mode="nearest")
    size = figure.stature_m / 1.75
    gait = Gait(
        figure,
        t,
        fps,
        root,
        yaw,
        # The hip of the leading leg leads; the pelvis drops on the side that swings.
        pelvis_yaw=-liveliness * 0.15 * stride / size,
        roll=liveliness * np.deg2rad(3.0) * shift * np.tanh(3 * speed),
        tilt=np.full(len(t), np.deg2rad(4.0)),
        stride=stride,
        speed=speed,
        load=load,
        ankles=ankles,
        feet=feet,
        toes=toes,
        contact=np.stack(contact, axis=1),
        ground=np.stack([_height_at(plants, t) for plants in plan.plants], axis=1),
    )
    gait.ride(0.003 * figure.stature_m)
    return gait


def swing_arms(gait: Gait, rotations: Array, *, rng: np.random.Generator, lean: Array | float = 0.0) -> None:
    """Arms that hang and swing against the legs.  lean : (T,) rad, how far the chest leans forward."""
    size = gait.figure.stature_m / 1.75
    n = len(gait.t)
    moving = np.clip(gait.speed / 0.8, 0, 1)
    spread = np.deg2rad(8.0 + 30.0 * max(gait.figure.build - 1.0, 0.0))
    amplitude = rng.uniform(0.40, 0.55)
    lively = rng.uniform(0.8, 1.2)
    for side, sign in SIDES:
        drift = np.deg2rad(2.0) * wander(n, gait.fps, slowest_s=4.0, rng=rng)
        ahead = -sign * gait.stride / size  # of the other foot
        flexion = np.deg2rad(1.0) + amplitude * ahead + drift + 0.8 * lean
        elbow = 0.28 + drift + moving * (0.10 + lively * 0.16 * (1 + np.tanh(3 * ahead)))
        hang_arm(rotations, side, sign, flexion, spread + 0.4 * drift, np.deg2rad(13.0), elbow)


def look_about(
    gait: Gait,
    rotations: Array,
    *,
    rng: np.random.Generator,
    bend: Array | float = 0.0,
    gaze_yaw: Array | float = 0.0,
    gaze_down: Array | float = 0.0,
    twist: Array | float = 0.0,
    calm: Array | float = 1.0,
) -> None:
    """Trunk against the pelvis, and a head that leads the turns and wanders.

    bend, gaze_yaw, gaze_down, twist : (T,) rad on top.  calm : scale of the wandering.
    """
    n = len(gait.t)

    def noise(slowest_s: float) -> Array:
        return wander(n, gait.fps, slowest_s=slowest_s, rng=rng)

    ahead = round(0.45 * gait.fps)
    coming = np.concatenate([gait.yaw[ahead:], np.full(ahead, gait.yaw[-1])])
    lead = gaussian_filter1d(np.clip(0.7 * (coming - gait.yaw), -0.9, 0.9), 0.1 * gait.fps, mode="nearest")
    still = 1 - np.clip(gait.speed / 0.8, 0, 1)
    set_trunk(
        rotations,
        yaw=-1.6 * gait.pelvis_yaw + 0.25 * lead + 0.02 * noise(4.0) + twist,
        roll=-0.9 * gait.roll,
        bend=bend - 0.04 + 0.012 * noise(3.0),
        gaze_yaw=0.6 * gait.pelvis_yaw + lead + gaze_yaw + calm * (0.06 + 0.22 * still) * noise(3.2),
        gaze_down=0.05 + gaze_down + calm * 0.05 * noise(2.6),
    )


def _standing_at(plants: list[Plant], t: Array) -> Array:
    """Place (T, 2) m where the foot stands; in the swing the place it comes to."""
    at = np.array([p.at for p in plants])
    ends = np.array([p.end_s for p in plants[:-1]])
    return at[np.searchsorted(ends, t, side="right")]


def _height_at(plants: list[Plant], t: Array) -> Array:
    """Height (T,) m of what the foot stands on; in the swing of what it comes to."""
    ends = np.array([p.end_s for p in plants[:-1]])
    return np.array([p.height_m for p in plants])[np.searchsorted(ends, t, side="right")]


def _loads(plan: Footsteps, t: Array) -> Array:
    """Share of the weight on each foot, (T, 2): all on one while the other swings, even when standing long."""
    alone: list[tuple[float, float, float]] = []  # from, to, share of the left foot
    for side in range(2):
        other = plan.plants[1 - side]
        alone += [(a.end_s, b.start_s, 1.0 - side) for a, b in itertools.pairwise(other)]
    alone.sort()
    times: list[float] = []
    left: list[float] = []
    for i, (start, end, share) in enumerate(alone):
        before = alone[i - 1] if i else (-np.inf, -np.inf, 0.5)
        if start - before[1] > 2 * _SETTLE_S:
            if i:
                times.append(before[1] + _SETTLE_S)
                left.append(0.5)
            times.append(start - _SETTLE_S)
            left.append(0.5)
        times += [start, end]
        left += [share, share]
    if not times:
        return np.full((len(t), 2), 0.5)
    times.append(times[-1] + _SETTLE_S)
    left.append(0.5)
    share_left = np.interp(t, times, left)
    return np.column_stack([share_left, 1 - share_left])


def _pitch_knots(plants: list[Plant], swing: Array, push: Array, strike: Array) -> list[tuple[float, float]]:
    """Moments, s, and pitch of a foot, rad: it strikes with the heel, rolls flat, and pushes off over the ball.

    swing, push, strike : (n - 1,) s in the air, and the angles of leaving and landing, of each step.
    """
    n = len(plants)
    knots: list[tuple[float, float]] = []
    for i, p in enumerate(plants):
        if i > 0:
            rocker = _ROCKER * swing[i - 1]
            knots += [
                (p.start_s, -strike[i - 1]),
                (p.start_s + 0.5 * rocker, -0.55 * strike[i - 1]),
                (p.start_s + rocker, 0.0),
            ]
        if i < n - 1:
            q, s = _PUSH * swing[i], swing[i]
            # A short stance (a quick step) pushes off as soon as it is flat.
            begin = max(p.end_s - q, p.start_s + (_ROCKER * swing[i - 1] + 0.01 if i else 0.0))
            q = p.end_s - begin
            knots += [
                (begin, 0.0),
                (p.end_s - 0.5 * q, 0.30 * push[i]),
                (p.end_s - 0.21 * q, 0.66 * push[i]),
                (p.end_s, push[i]),
                (p.end_s + 0.16 * s, 0.85 * push[i]),
                (p.end_s + 0.42 * s, 0.30 * push[i]),
                (p.end_s + 0.68 * s, -0.25 * strike[i]),
                (p.end_s + 0.895 * s, -0.95 * strike[i]),
            ]
    return knots


def _foot(
    figure: Figure, plants: list[Plant], t: Array
) -> tuple[Array, Array, Array, NDArray[np.bool_], Array]:
    """Ankle (T, 3), foot rotation (T, 3, 3), toe angle (T,), flat on the floor (T,) and yaw (T,) of one foot."""
    H = figure.stature_m
    ankle_h = figure.ankle_height_m
    heel = np.array([-HEEL_BACK * H, 0.0, -ankle_h])
    ball = figure.offsets[JOINT["left_toe"]]
    n = len(plants)
    swing = np.array([b.start_s - a.end_s for a, b in itertools.pairwise(plants)])
    move = np.array([np.subtract(b.at, a.at) for a, b in itertools.pairwise(plants)]).reshape(-1, 2)
    length = np.linalg.norm(move, axis=1)
    size = np.clip(length / (0.71 * H), 0, 1.1)  # of the step, against a normal stride
    toes_to = np.array([[np.cos(p.yaw_rad), np.sin(p.yaw_rad)] for p in plants])
    onward = np.clip(np.sum(move * toes_to[:-1], axis=1) / (0.71 * H), 0, 1.1)
    inward = np.clip(np.sum(move * toes_to[1:], axis=1) / (0.71 * H), 0, 1.1)
    push = _PUSH_RAD * np.maximum(onward, 0.12)
    strike = _STRIKE_RAD * inward
    knots = _pitch_knots(plants, swing, push, strike)
    ankle = np.zeros((len(t), 3))
    yaw = np.zeros(len(t))
    flat = np.zeros(len(t), dtype=bool)
    fade = np.ones(len(t))
    droop = np.zeros(len(t))  # of the toes of a foot that is lifted high
    if not knots:
        ankle[:] = (*plants[0].at, ankle_h + plants[0].height_m)
        yaw[:] = plants[0].yaw_rad
        turn = rotation_about(2, yaw)
        return ankle, turn, np.zeros(len(t)), np.ones(len(t), dtype=bool), yaw
    curve = PchipInterpolator(*np.array(knots).T)

    def pitch_at(time: Array) -> Array:
        return np.where(
            (time < knots[0][0]) | (time > knots[-1][0]), 0.0, curve(np.clip(time, knots[0][0], knots[-1][0]))
        )

    def planted(i: int, time: Array) -> Array:
        """Ankle (N, 3) of plant i: rolls over the heel, stands, rolls over the ball."""
        p = plants[i]
        pitch = pitch_at(time)
        pivot = np.where((pitch < 0)[:, None], heel, ball)
        rolled = np.einsum("nab,nb->na", rotation_about(1, pitch), -pivot)
        return np.array([*p.at, ankle_h + p.height_m]) + (rolled + pivot) @ rotation_about(2, p.yaw_rad).T

    for i, p in enumerate(plants):
        mine = (t >= p.start_s) & (t <= p.end_s)
        ankle[mine] = planted(i, t[mine])
        yaw[mine] = p.yaw_rad
        flat |= mine & (np.abs(pitch_at(t)) < 1e-9)
        if i == n - 1:
            break
        s = swing[i]
        fly = (t > p.end_s) & (t < plants[i + 1].start_s)
        if not fly.any():
            continue
        h = 1e-3
        lift = planted(i, np.array([p.end_s - h, p.end_s]))
        land = planted(i + 1, np.array([p.end_s + s, p.end_s + s + h]))
        # The foot still travels forward when the heel strikes; a foot that waits would stretch the leg.
        flat_move = (land[0] - lift[1]) * np.array([1.0, 1.0, 0.0])
        leave = (lift[1] - lift[0]) / h * s
        arrive = 0.15 * flat_move * inward[i] + np.array([0.0, 0.0, -0.05 * min(size[i], 1.0)])
        middle = 0.5 * (lift[1] + land[0])
        middle[2] = ankle_h + (0.016 + 0.024 * min(size[i], 1.0)) * H
        middle[2] += max(p.height_m, plants[i + 1].height_m)
        slope = 1.25 * (land[0] - lift[1])
        slope[2] = -0.12 * H * onward[i]
        u = (t[fly] - p.end_s) / s
        at = CubicHermiteSpline([0, 0.5, 1], [lift[1], middle, land[0]], [leave, slope, arrive])(u)
        at[:, 2] += (
            0.010 * H * onward[i] * np.sin(np.pi * np.minimum(u / 0.4, 1.0)) ** 2
        )  # toes clear the floor
        if plants[i + 1].height_m > p.height_m:  # first up, past the edge of the stair, then ahead
            over = ankle_h + plants[i + 1].height_m
            knots_z = [lift[1][2], over + 0.038 * H, over + 0.034 * H, land[0][2]]
            at[:, 2] = PchipInterpolator([0.0, 0.45, 0.7, 1.0], knots_z)(u)
            droop[fly] = np.deg2rad(11.0) * np.sin(np.pi * u) ** 2
            at[:, :2] = lift[1][:2] + (u**2 * (3 - 2 * u))[:, None] ** 1.25 * (land[0] - lift[1])[:2]
        ankle[fly] = at
        yaw[fly] = p.yaw_rad + u * u * (3 - 2 * u) * (plants[i + 1].yaw_rad - p.yaw_rad)
        fade[fly] = 1 - np.clip(u / 0.32, 0, 1)
    pitch = pitch_at(t)
    return (
        ankle,
        rotation_about(2, yaw) @ rotation_about(1, pitch + droop),
        -np.maximum(pitch, 0) * fade,
        flat,
        yaw,
    )
