"""Steps: foot contacts of a walk or run, what they say of the gait, and what they say of the floor."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from mocap.data.motion import ALL_LANDMARKS, LANDMARKS
from mocap.pose.contacts import SOLE_POINTS, Contacts, contacts_of, lowest_level, unbroken_runs
from mocap.pose.method import ContactSettings
from mocap.pose.result import PersonPoses

Array = NDArray[np.float64]

SIDES = ("left", "right")
_QUANTISED_STD = 1.0 / np.sqrt(12.0)  # of a moment that is told to a whole frame
# Who takes longer for a step has stood; so has who takes so many times as long as he usually does.
_MOST_STEP_S, _MOST_OF_USUAL = 2.0, 2.0
# A floor that falls more steeply is no floor; places on it lie so near to a plane; and a foot in the air is so high.
_STEEPEST_DEG, _FLAT_STD_M, _IN_AIR_M = 12.0, 0.02, 0.03
# What rests on a slope must be so much more than what rests on z = 0, for a slope to be believed.
_GAIN_OF_SLOPE = 1.1


@dataclass(frozen=True)
class Stance:
    """One foot on the floor.

    strike, off : rows of its first frame and of the first one after it; None where the clip begins or ends in it.
    strike_std, off_std : frames.  place : (x, y) m, where the heel stood; of a foot
    that never put it down, the toe.  is_observed : whether the foot was seen in most of it, and of what is beside it.
    """

    side: str
    strike: int | None
    off: int | None
    strike_std: float
    off_std: float
    place: tuple[float, float]
    is_observed: bool = True


@dataclass(frozen=True)
class Step:
    """From one foot's strike to the next strike of the other: `stance` is that of the foot that lands.

    length_m : along the way that the pelvis goes, width_m : across it, to the left foot from the right.  time_s :
    since the other foot's strike.  stance_s, swing_s : of the landing foot after and before it, None where the clip
    cuts them.  speed_m_s : of the pelvis over the floor.
    """

    stance: Stance
    length_m: float
    width_m: float
    time_s: float
    stance_s: float | None
    swing_s: float | None
    speed_m_s: float


@dataclass(frozen=True, eq=False)
class Gait:
    """contacts : None where they cannot be told, and `why_not` says why.  stances, steps : by time.

    slope : (rise along x, rise along y, height at the world's origin m) of the floor on which contacts are told; None =
    that of the calibration.
    """

    person: int
    contacts: Contacts | None
    stances: tuple[Stance, ...] = ()
    steps: tuple[Step, ...] = ()
    why_not: str = ""
    slope: tuple[float, float, float] | None = None


def gait_of(poses: PersonPoses, fps: float, settings: ContactSettings) -> Gait:
    """Contacts, stances and steps of one person; every stretch between two absences is judged by itself."""
    if poses.landmarks.shape[1] == len(LANDMARKS) or not len(poses.frames):
        return Gait(poses.person, None, why_not="the body has no feet")
    if (poses.frames[-1] - poses.frames[0]) / fps < settings.least_stance_s:
        return Gait(poses.person, None, why_not="the person is followed for less time than a foot stands")
    if why_not := _hidden_foot(poses, settings):
        return Gait(poses.person, None, why_not=why_not)
    raw = poses.landmarks[:, list(SOLE_POINTS)]
    stretches = unbroken_stretches(poses.frames)
    slope = slope_of_floor(raw, stretches, fps, settings)
    points = over_floor(raw, slope)
    if why_not := _no_floor(points, settings):
        return Gait(poses.person, None, why_not=why_not)
    contacts = contacts_over(points, stretches, fps, settings)
    seen = np.asarray(poses.observed[:, list(SOLE_POINTS)].reshape(len(raw), 2, 2).all(axis=2))
    pelvis = poses.landmarks[:, ALL_LANDMARKS.index("pelvis"), :2]
    stances: list[Stance] = []
    steps: list[Step] = []
    for rows in stretches:
        own = replace(contacts, probability=contacts.probability[rows], hold=contacts.hold[rows])
        found = [
            _later(s, rows.start, seen) for s in stances_of(points[rows], own, settings.least_stance_s * fps)
        ]
        stances += found
        steps += _steps(found, pelvis, fps)
    return Gait(poses.person, contacts, tuple(stances), tuple(steps), slope=slope)


def unbroken_stretches(frames: NDArray[np.int64]) -> list[slice]:
    """Rows of the stretches of frames (T,) between which a person was away."""
    cuts = [0, *(np.flatnonzero(np.diff(frames) > 1) + 1).tolist(), len(frames)]
    return [slice(a, b) for a, b in pairwise(cuts) if b > a]


def contacts_over(points: Array, stretches: list[slice], fps: float, settings: ContactSettings) -> Contacts:
    """Contacts of sole points (T, 4, 3), stretch by stretch, at the heights that are the lowest ones of all."""
    level = lowest_level(points, settings)
    variance = np.zeros(points.shape[:2])
    found = [contacts_of(points[rows], variance[rows], fps, settings, level) for rows in stretches]
    probability, hold = (np.concatenate([getattr(c, n) for c in found]) for n in ("probability", "hold"))
    return Contacts(probability, level, hold)


def _later(stance: Stance, start: int, seen: NDArray[np.bool_]) -> Stance:
    """A stance of a stretch that begins in row `start`.  seen : (T, 2), which foot was observed."""
    strike, off = (None if row is None else row + start for row in (stance.strike, stance.off))
    first, last = (start if strike is None else strike, len(seen) if off is None else off)
    near = seen[max(first - 2, 0) : last + 2, SIDES.index(stance.side)]
    return replace(stance, strike=strike, off=off, is_observed=bool(near.mean() >= 0.5))


def _hidden_foot(poses: PersonPoses, settings: ContactSettings) -> str:
    """Which foot is too rarely seen for contacts to be told, "" = none."""
    for side in SIDES:
        columns = [ALL_LANDMARKS.index(f"{side}_{name}") for name in ("ankle", "heel", "toe")]
        share = float(poses.observed[:, columns].all(axis=1).mean())
        if share < settings.least_observed:
            return (
                f"the {side} foot was observed in {100 * share:.0f} % of the frames only (hidden, cut off by the "
                "pictures, or of the colour of the background); its contacts would be guessed"
            )
    return ""


def _no_floor(points: Array, settings: ContactSettings) -> str:
    """Why sole points (T, 4, 3) m do not stand on the floor, "" = they do."""
    low = float(np.quantile(points[..., 2].min(axis=1), settings.low_quantile))
    each = np.quantile(points[..., 2], settings.low_quantile, axis=0)
    if abs(low) <= settings.most_level_m and (np.abs(each) <= settings.most_level_m).any():
        return ""
    stand = 1000 * float(np.median(each))
    return (
        f"the feet come down to {stand:.0f} mm over the calibration's floor: there is no floor at z = 0, or "
        f"the person does not stand on it. Remedy: put the world's origin on the floor (docs/calibrate.md); if they "
        f"stand on a floor, shift the world by {-stand:+.0f} mm along z"
    )


def over_floor(points: Array, slope: tuple[float, float, float] | None) -> Array:
    """Points (T, K, 3) m with heights over a floor that is not z = 0; None = it is."""
    if slope is None:
        return points
    out = points.copy()
    out[..., 2] -= points[..., 0] * slope[0] + points[..., 1] * slope[1] + slope[2]
    return out


def slope_of_floor(
    points: Array, stretches: list[slice], fps: float, settings: ContactSettings
) -> tuple[float, float, float] | None:
    """The plane on which feet stand, where it falls so much that contacts over z = 0 would be missed; None otherwise.

    points : (T, 4, 3) m, heels and toes, world.  Told from the places where one of them hardly moves, whatever their
    heights; believed when they lie in a plane, and more rests on it than on z = 0.
    """
    places = []
    for rows in stretches:
        if rows.stop - rows.start < 2:
            continue
        speed = np.linalg.norm(np.gradient(points[rows], axis=0), axis=2) * fps
        for k in range(points.shape[1]):
            runs = unbroken_runs(speed[:, k] < 2.0 * settings.speed_std_m_s)
            places += [
                np.median(points[rows][run, k], axis=0)
                for run in runs
                if len(run) >= max(3.0, settings.least_stance_s * fps)
            ]
    at = np.array(places).reshape(-1, 3)
    for _ in range(5):  # a foot that rests in the air is left out
        if len(at) < 4 or _spread(at) < settings.tilt_spread_m:
            return None
        plane = np.linalg.lstsq(np.column_stack([at[:, :2], np.ones(len(at))]), at[:, 2], rcond=None)[0]
        over = at[:, 2] - at[:, :2] @ plane[:2] - plane[2]
        if (over <= _IN_AIR_M).all():
            break
        at = at[over <= _IN_AIR_M]
    tilt = float(np.rad2deg(np.arctan(np.linalg.norm(plane[:2]))))
    if not settings.floor_tilt_deg < tilt < _STEEPEST_DEG or float(over.std()) > _FLAT_STD_M:
        return None
    slope = (float(plane[0]), float(plane[1]), float(plane[2]))
    rests = [
        contacts_over(p, stretches, fps, settings).probability for p in (points, over_floor(points, slope))
    ]
    return slope if rests[1].sum() > _GAIN_OF_SLOPE * rests[0].sum() else None


def _spread(places: Array) -> float:
    """How far places (N, 3) m lie from each other over the floor, across the way along which they lie farthest."""
    flat = places[:, :2] - places[:, :2].mean(axis=0)
    return float(np.linalg.svd(flat, compute_uv=False)[-1] / np.sqrt(len(places)))


def stances_of(points: Array, contacts: Contacts, least_frames: float) -> list[Stance]:
    """The stances of both feet by time.

    points : (T, 4, 3) m, heels and toes as in `SOLE_POINTS`.  least_frames : shorter ones are none, but at
    the clip's ends.
    """
    stances = [
        s for k, side in enumerate(SIDES) for s in _stances(side, 2 * k, points, contacts, least_frames)
    ]
    return sorted(stances, key=lambda s: -1 if s.strike is None else s.strike)


def _stances(side: str, first: int, points: Array, contacts: Contacts, least_frames: float) -> list[Stance]:
    """The stances of one foot, whose heel is column `first` of the sole points and whose toe the next."""
    heel, toe = contacts.probability[:, first], contacts.probability[:, first + 1]
    either = 1.0 - (1.0 - heel) * (1.0 - toe)
    found, T = [], len(points)
    for run in unbroken_runs(either > 0.5):
        is_whole = run[0] > 0 and run[-1] + 1 < T
        if is_whole and len(run) < least_frames:
            continue
        own = heel[run] > 0.5
        place = points[run][own, first] if own.any() else points[run, first + 1]
        x, y = np.median(place[:, :2], axis=0)
        begin, end = int(run[0]), int(run[-1]) + 1
        found.append(
            Stance(
                side,
                begin if begin > 0 else None,
                end if end < T else None,
                _moment_std(either, begin),
                _moment_std(either, end),
                (float(x), float(y)),
            )
        )
    return found


def _moment_std(probability: Array, row: int) -> float:
    """Standard deviation, frames, of the moment near `row` at which a contact begins or ends."""
    near = probability[max(row - 3, 0) : row + 3]
    return float(np.hypot(_QUANTISED_STD, np.sqrt((near * (1.0 - near)).sum())))


def _steps(stances: list[Stance], pelvis: Array, fps: float) -> list[Step]:
    landed = [s for s in stances if s.strike is not None]
    steps = []
    for i, now in enumerate(landed[1:], start=1):
        before = landed[i - 1]
        assert now.strike is not None
        assert before.strike is not None
        if before.side == now.side or now.strike <= before.strike:
            continue
        time_s = (now.strike - before.strike) / fps
        way = pelvis[now.strike] - pelvis[before.strike]
        distance = float(np.linalg.norm(way))
        ahead = way / distance if distance > 0 else np.array([1.0, 0.0])
        move = np.subtract(now.place, before.place)
        across = float(ahead[0] * move[1] - ahead[1] * move[0])
        earlier = [s for s in stances if s.side == now.side and s.off is not None and s.off <= now.strike]
        steps.append(
            Step(
                stance=now,
                length_m=float(move @ ahead),
                width_m=across if now.side == "left" else -across,
                time_s=time_s,
                stance_s=None if now.off is None else (now.off - now.strike) / fps,
                swing_s=(now.strike - max(s.off or 0 for s in earlier)) / fps if earlier else None,
                speed_m_s=distance / time_s,
            )
        )
    return steps


def warnings_of_gait(poses: PersonPoses, gait: Gait, fps: float, settings: ContactSettings) -> list[str]:
    """What the user has to know of contacts: why there are none, a floor that moves, feet that rest above it, and one
    that is not where it was measured."""
    who = f"person {poses.person}"
    if gait.contacts is None:
        is_footless = poses.landmarks.shape[1] == len(LANDMARKS)
        return [] if is_footless else [f"{who}: foot contacts are not told: {gait.why_not}"]
    points = poses.landmarks[:, list(SOLE_POINTS)]
    found = []
    over = over_floor(points, gait.slope)
    high_m = rests_above(over, gait.contacts, fps, settings)
    if high_m is not None:
        found.append(
            f"{who}: a foot rests {100 * high_m:.0f} cm over the floor (stairs, a step, a seat): contacts and steps "
            "are told on the floor alone"
        )
    if floor_moves(over, gait.contacts, settings):
        found.append(
            f"{who}: heels go on moving while they are down, as on a treadmill: contacts and steps need a floor that "
            "rests and are not to be trusted here"
        )
    check = check_floor(points, gait.contacts, settings)
    if check is not None and (text := floor_warning(check, settings)):
        found.append(f"{who}: {text}")
    return found


def rests_above(points: Array, contacts: Contacts, fps: float, settings: ContactSettings) -> float | None:
    """How high above the floor, m, a whole foot of sole points (T, 4, 3) rests for a while at most; None = it does not.

    On stairs and steps feet rest where no contact is told.
    """
    if len(points) < 2:
        return None
    speed = np.linalg.norm(np.gradient(points, axis=0), axis=2) * fps
    over = points[..., 2] - contacts.level_m
    is_still = (speed < settings.speed_std_m_s) & (over > settings.most_level_m)
    heights = [
        float(np.median(over[run, 2 * k : 2 * k + 2]))
        for k in range(2)
        for run in unbroken_runs(np.asarray(is_still[:, 2 * k : 2 * k + 2].all(axis=1)))
        if len(run) >= settings.usual_s * fps
    ]
    return max(heights, default=None)


def floor_moves(points: Array, contacts: Contacts, settings: ContactSettings) -> bool:
    """Whether heels of sole points (T, 4, 3) move in most of the frames in which they are down."""
    is_down = points[:, ::2, 2] - contacts.level_m[::2] < settings.down_m
    return bool(is_down.any() and (contacts.probability[:, ::2][is_down] < 0.5).mean() > 0.5)


def gait_numbers(gait: Gait) -> dict[str, float | None]:
    """Means over the steps: cadence, lengths, widths, stance and swing, speed, and how much the sides differ, %.

    A step before which somebody stood, and a stance in which he did, count in no mean; nor does what was not observed.
    Nothing of a person without contacts.
    """
    if gait.contacts is None:
        return {}
    taken = [s for s in gait.steps if s.time_s <= _MOST_STEP_S and s.stance.is_observed]
    most_s = _MOST_OF_USUAL * float(np.median([s.time_s for s in taken])) if taken else 0.0
    steps = [s for s in taken if s.time_s <= most_s]
    stances, swings = (
        [v for s in steps if (v := getattr(s, name)) is not None and v <= most_s]
        for name in ("stance_s", "swing_s")
    )
    time_s = _mean([s.time_s for s in steps])
    stance_s, swing_s = _mean(stances), _mean(swings)
    cycle_s = None if stance_s is None or swing_s is None else stance_s + swing_s
    return {
        "steps": float(len(gait.steps)),
        "cadence_per_min": None if time_s is None else 60.0 / time_s,
        "step_length_m": _mean([s.length_m for s in steps]),
        "step_width_m": _mean([s.width_m for s in steps]),
        "speed_m_s": _mean([s.speed_m_s for s in steps]),
        "stance_s": stance_s,
        "swing_s": swing_s,
        "stance_percent": None if not cycle_s or stance_s is None else 100.0 * stance_s / cycle_s,
        "step_length_asymmetry_percent": _asymmetry(steps, "length_m"),
        "step_time_asymmetry_percent": _asymmetry(steps, "time_s"),
    }


def _asymmetry(steps: list[Step], name: str) -> float | None:
    """How far the means of both sides are from each other, in percent of their middle."""
    left, right = (_mean([getattr(s, name) for s in steps if s.stance.side == side]) for side in SIDES)
    if left is None or right is None:
        return None
    middle = 0.5 * (abs(left) + abs(right))
    return 100.0 * abs(left - right) / middle if middle else None


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None


@dataclass(frozen=True)
class FloorCheck:
    """The floor on which feet stand, against z = 0 of the calibration.

    height_m : of the floor under the contacts.  tilt_deg : of its normal from the vertical, falling towards
    `downhill_deg`, from x to y; None where the contacts lie too near each other to tell.  n_contacts : of how many.
    """

    height_m: float
    tilt_deg: float | None
    downhill_deg: float | None
    n_contacts: int


def check_floor(points: Array, contacts: Contacts, settings: ContactSettings) -> FloorCheck | None:
    """A plane through the places where sole points (T, 4, 3) m rest; None without a contact."""
    places = [
        np.median(points[run, k], axis=0)
        for k, runs in enumerate(contacts.runs)
        for run in runs
        if len(run) > 2
    ]
    if not places:
        return None
    at = np.array(places)
    middle = at.mean(axis=0)
    height, flat = float(np.median(at[:, 2])), at[:, :2] - middle[:2]
    if len(at) < 4 or _spread(at) < settings.tilt_spread_m:
        return FloorCheck(height, None, None, len(at))
    slope = np.linalg.lstsq(flat, at[:, 2] - middle[2], rcond=None)[0]
    tilt = float(np.rad2deg(np.arctan(np.linalg.norm(slope))))
    return FloorCheck(height, tilt, float(np.rad2deg(np.arctan2(-slope[1], -slope[0]))), len(at))


def floor_warning(check: FloorCheck, settings: ContactSettings) -> str:
    """What is wrong with the floor of the calibration, "" = nothing."""
    found = []
    if abs(check.height_m) > settings.floor_off_m:
        found.append(
            f"the feet stand {1000 * check.height_m:+.0f} mm from the calibration's floor ({check.n_contacts} "
            f"contacts). Remedy: shift the world by {-1000 * check.height_m:+.0f} mm along z"
        )
    if (
        check.tilt_deg is not None
        and check.downhill_deg is not None
        and check.tilt_deg > settings.floor_tilt_deg
    ):
        found.append(
            f"the floor on which the feet stand falls by {check.tilt_deg:.1f} degrees towards "
            f"{check.downhill_deg:.0f} degrees from x ({check.n_contacts} contacts). Remedy: calibrate the floor again"
        )
    return "; ".join(found)
