"""Steps: foot contacts of a walk or run, what they say of the gait, and what they say of the floor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mocap.data.motion import ALL_LANDMARKS, LANDMARKS
from mocap.pose.contacts import SOLE_POINTS, Contacts, contacts_of, unbroken_runs
from mocap.pose.method import ContactSettings
from mocap.pose.result import PersonPoses

Array = NDArray[np.float64]

SIDES = ("left", "right")
_QUANTISED_STD = 1.0 / np.sqrt(12.0)  # of a moment that is told to a whole frame


@dataclass(frozen=True)
class Stance:
    """One foot on the floor.

    strike, off : rows of its first frame and of the first one after it; None where the clip begins or ends in it.
    strike_std, off_std : frames.  place : (x, y) m, where the heel stood; of a foot
    that never put it down, the toe.
    """

    side: str
    strike: int | None
    off: int | None
    strike_std: float
    off_std: float
    place: tuple[float, float]


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
    """contacts : None where they cannot be told, and `why_not` says why.  stances, steps : by time."""

    person: int
    contacts: Contacts | None
    stances: tuple[Stance, ...] = ()
    steps: tuple[Step, ...] = ()
    why_not: str = ""


def gait_of(poses: PersonPoses, fps: float, settings: ContactSettings) -> Gait:
    """Contacts, stances and steps of one person."""
    if poses.landmarks.shape[1] == len(LANDMARKS) or not len(poses.frames):
        return Gait(poses.person, None, why_not="the body has no feet")
    if why_not := _why_not(poses, settings):
        return Gait(poses.person, None, why_not=why_not)
    sole = list(SOLE_POINTS)
    points = poses.landmarks[:, sole]
    contacts = contacts_of(points, np.zeros(points.shape[:2]), fps, settings)
    stances = stances_of(points, contacts, settings.least_stance_s * fps)
    pelvis = poses.landmarks[:, ALL_LANDMARKS.index("pelvis"), :2]
    return Gait(poses.person, contacts, tuple(stances), tuple(_steps(stances, pelvis, fps)))


def _why_not(poses: PersonPoses, settings: ContactSettings) -> str:
    """Why no contact can be told, "" = it can."""
    if (np.diff(poses.frames) > 1).any():
        return "the person was away for a while: export the stretches one by one with --frames"
    for side in SIDES:
        columns = [ALL_LANDMARKS.index(f"{side}_{name}") for name in ("ankle", "heel", "toe")]
        share = float(poses.observed[:, columns].all(axis=1).mean())
        if share < settings.least_observed:
            return (
                f"the {side} foot was observed in {100 * share:.0f} % of the frames only (hidden, cut off by the "
                "pictures, or of the colour of the background); its contacts would be guessed"
            )
    low = float(np.quantile(poses.landmarks[:, list(SOLE_POINTS), 2].min(axis=1), settings.low_quantile))
    if abs(low) > settings.most_level_m:
        return (
            f"the feet come down to {1000 * low:.0f} mm over the calibration's floor: there is no floor at z = 0, or "
            "the person does not stand on it. Remedy: put the world's origin on the floor (docs/calibrate.md)"
        )
    return ""


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


def warnings_of_gait(poses: PersonPoses, gait: Gait, settings: ContactSettings) -> list[str]:
    """What the user has to know of contacts: why there are none, a floor that moves, and one that is not where it was
    measured."""
    who = f"person {poses.person}"
    if gait.contacts is None:
        is_footless = poses.landmarks.shape[1] == len(LANDMARKS)
        return [] if is_footless else [f"{who}: foot contacts are not told: {gait.why_not}"]
    points = poses.landmarks[:, list(SOLE_POINTS)]
    found = []
    if floor_moves(points, gait.contacts, settings):
        found.append(
            f"{who}: heels go on moving while they are down, as on a treadmill: contacts and steps need a floor that "
            "rests and are not to be trusted here"
        )
    check = check_floor(points, gait.contacts, settings)
    if check is not None and (text := floor_warning(check, settings)):
        found.append(f"{who}: {text}")
    return found


def floor_moves(points: Array, contacts: Contacts, settings: ContactSettings) -> bool:
    """Whether heels of sole points (T, 4, 3) move in most of the frames in which they are down."""
    is_down = points[:, ::2, 2] - contacts.level_m[::2] < settings.down_m
    return bool(is_down.any() and (contacts.probability[:, ::2][is_down] < 0.5).mean() > 0.5)


def gait_numbers(gait: Gait) -> dict[str, float | None]:
    """Means over the steps: cadence, lengths, widths, stance and swing, speed, and how much the sides differ, %.

    Nothing of a person without contacts.
    """
    if gait.contacts is None:
        return {}
    steps = gait.steps
    stances, swings = (
        [v for s in steps if (v := getattr(s, name)) is not None] for name in ("stance_s", "swing_s")
    )
    time_s = _mean([s.time_s for s in steps])
    stance_s, swing_s = _mean(stances), _mean(swings)
    cycle_s = None if stance_s is None or swing_s is None else stance_s + swing_s
    by_side = [_mean([s.length_m for s in steps if s.stance.side == side]) for side in SIDES]
    left, right = by_side
    middle = None if left is None or right is None else 0.5 * (abs(left) + abs(right))
    return {
        "steps": float(len(steps)),
        "cadence_per_min": None if time_s is None else 60.0 / time_s,
        "step_length_m": _mean([s.length_m for s in steps]),
        "step_width_m": _mean([s.width_m for s in steps]),
        "speed_m_s": _mean([s.speed_m_s for s in steps]),
        "stance_s": stance_s,
        "swing_s": swing_s,
        "stance_percent": None if not cycle_s or stance_s is None else 100.0 * stance_s / cycle_s,
        "step_length_asymmetry_percent": None
        if not middle or left is None or right is None
        else 100.0 * abs(left - right) / middle,
    }


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
    spread = np.linalg.svd(flat, compute_uv=False) / np.sqrt(len(at))
    if len(at) < 4 or spread[-1] < settings.tilt_spread_m:
        return FloorCheck(height, None, None, len(at))
    slope = np.linalg.lstsq(flat, at[:, 2] - middle[2], rcond=None)[0]
    tilt = float(np.rad2deg(np.arctan(np.linalg.norm(slope))))
    return FloorCheck(height, tilt, float(np.rad2deg(np.arctan2(-slope[1], -slope[0]))), len(at))


def floor_warning(check: FloorCheck, settings: ContactSettings) -> str:
    """What is wrong with the floor of the calibration, "" = nothing."""
    if abs(check.height_m) > settings.floor_off_m:
        return (
            f"the feet stand {1000 * check.height_m:+.0f} mm from the calibration's floor ({check.n_contacts} "
            f"contacts). Remedy: shift the world by {-1000 * check.height_m:+.0f} mm along z"
        )
    if (
        check.tilt_deg is not None
        and check.downhill_deg is not None
        and check.tilt_deg > settings.floor_tilt_deg
    ):
        return (
            f"the floor on which the feet stand falls by {check.tilt_deg:.1f} degrees towards "
            f"{check.downhill_deg:.0f} degrees from x ({check.n_contacts} contacts). Remedy: calibrate the floor again"
        )
    return ""
