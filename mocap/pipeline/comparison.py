"""`mocap eval`: any estimate against any truth, ours or of other tools, with everything that had to be assumed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import LANDMARKS, CameraRig, Motion, Tracks
from mocap.errors import MocapError
from mocap.io.actions import read_actions_csv
from mocap.io.formats import PoseFile, read_poses
from mocap.io.formats.csv import read_csv
from mocap.io.formats.panoptic import panoptic_folder
from mocap.io.poses import Reading, SideMap, read_map, read_motions
from mocap.io.store import StageStore
from mocap.io.tables import read_tracks_csv
from mocap.metrics import (
    Action,
    Pair,
    detailed_scores,
    epsilon_search,
    evaluate,
    length_unit,
    matched_pairs,
    point_errors,
)
from mocap.metrics.detail import LEARN_SHARE
from mocap.metrics.image import EPSILON_PX
from mocap.metrics.volume import VolumeScores
from mocap.pipeline.scoring import frames_of_run, lost_limbs, volume_overlap
from mocap.pipeline.track_comparison import lacks_poses, score_tracks

if TYPE_CHECKING:
    from mocap.view.report import Figure

Array = NDArray[np.float64]

_SAME_RATE = 0.005  # rates this close, relatively, are one: 29.97 is not 30, but 30.00001 of rounded times is
_SAME_INSTANT = 0.05  # of the time between two frames: times in files are rounded
_MAX_LAG = 15
_LAG_GAIN = 0.7  # a shift that takes off less of the error is not worth a warning
_LAG_GAIN_MM = 5.0
_FAR_MM = 500.0
_TRUNK = ("pelvis", "neck", "left_hip", "right_hip", "left_shoulder", "right_shoulder")


@dataclass(frozen=True)
class CompareOptions:
    """What a user may say about a comparison; see `mocap eval --help`.

    estimate, truth : unit, axes, rate and landmarks of a side, before what its file says.  map_path : the same from a
    file, after it.  frame_offset, time_offset_s : added to the estimate's frames and times.
    """

    epsilon_mm: float = 100.0
    epsilon_px: float = EPSILON_PX
    estimate: SideMap = field(default_factory=SideMap)
    truth: SideMap = field(default_factory=SideMap)
    map_path: Path | None = None
    frame_offset: int = 0
    time_offset_s: float = 0.0
    actions_path: Path | None = None
    cameras_path: Path | None = None
    learn_share: float = LEARN_SHARE


@dataclass(frozen=True, eq=False)
class Side:
    """One side, in metres and z up.

    frames : frames that were worked on, None = those with a pose.  folder : of a run, or of a session's truth.
    """

    name: str
    path: Path
    reading: Reading
    tracks: Tracks | None = None
    frames: tuple[int, ...] | None = None
    folder: Path | None = None

    @property
    def motions(self) -> tuple[Motion, ...]:
        return self.reading.motions


@dataclass(frozen=True, eq=False)
class Comparison:
    """scores : ready for JSON.  pairs : the landmarks that were scored.  estimate, truth : as they were read."""

    scores: dict[str, Any]
    pairs: tuple[Pair, ...]
    estimate: Side
    truth: Side
    options: CompareOptions


def compare(estimate: Path, truth: Path, options: CompareOptions | None = None) -> Comparison:
    """Score an estimate against a truth: folders of ours, or files of any format that `read_poses` knows.

    The keys of the scores are those of `mocap.metrics.evaluate`, those of `detailed_scores`, and `estimate`, `truth`,
    `notes` and `warnings`, which say how the two were read and matched.
    Where a folder has tracks.csv and no landmarks.csv, tracks alone are scored, and `tracks_only` is true.
    Raises MocapError for a file that cannot be read, and when the two have no frame or no landmark in common.
    """
    options = CompareOptions() if options is None else options
    if lacks_poses(Path(estimate), Path(truth)):
        scores, found, goal = score_tracks(Path(estimate), Path(truth), options)
        scores["estimate"], scores["truth"] = _said_of(found), _said_of(goal)
        return Comparison(scores, (), found, goal, options)
    sides = _with_map(options)
    goal = _truth_side(Path(truth), sides["truth"])
    found = _estimate_side(Path(estimate), sides["estimate"])
    actions = [] if options.actions_path is None else read_actions_csv(options.actions_path)
    rig = None if options.cameras_path is None else _rig(options.cameras_path)
    notes, warnings = [], []
    for side in (found, goal):
        notes += [f"{side.name}: {text}" for text in side.reading.notes]

    goal, goal_warning = _in_metres(goal, notes)
    found, found_warning = _in_metres(found, notes)
    warnings += [w for w in (found_warning, goal_warning) if w]
    found, goal, fps = _on_one_clock(found, goal, options, notes)
    frames = _frames_to_score(found, goal, notes)
    found, goal, left_out = _common_landmarks(found, goal)
    if left_out:
        notes.append(f"scored without {', '.join(left_out)}: one side does not have them")
    warnings += [w for side in (found, goal) if (w := _lying(side))]

    tracks = _tracks(found, goal, notes)
    hulls = _hulls(found, goal, options)
    scores = evaluate(
        found.motions, goal.motions, *tracks, _volume(goal, hulls), options.epsilon_mm, frames=frames
    )
    pairs = tuple(matched_pairs(found.motions, goal.motions, frames=frames))
    scores |= detailed_scores(
        pairs,
        fps,
        options.epsilon_mm,
        actions=[Action(*a) for a in actions],
        rig=rig,
        epsilon_px=options.epsilon_px,
        learn_share=options.learn_share,
    )
    limbs = None if hulls is None else lost_limbs(found.motions, goal.motions, hulls, frames=frames)
    scores["lost_limbs"] = None if limbs is None else asdict(limbs)
    if fps is None:
        notes.append("no frame rate is known: accelerations are not scored (--estimate-fps, --truth-fps)")
    unit_warnings = [w for w in (found_warning, goal_warning) if w]
    scores["unit_warning"] = "; ".join(unit_warnings) if unit_warnings else scores["unit_warning"]
    if scores["unit_warning"] and not unit_warnings:
        warnings.append(scores["unit_warning"])
    elif not unit_warnings:
        warnings += [w for w in (_lag(pairs, fps, options), _other_world(scores)) if w]
    scores["estimate"], scores["truth"] = _said_of(found), _said_of(goal)
    scores["landmarks_left_out"] = left_out
    scores["notes"], scores["warnings"] = notes, warnings
    return Comparison(scores, pairs, found, goal, options)


def _with_map(options: CompareOptions) -> dict[str, SideMap]:
    mapped = {} if options.map_path is None else read_map(options.map_path)
    out = {}
    for name, told in (("estimate", options.estimate), ("truth", options.truth)):
        base = mapped.get(name, SideMap())
        out[name] = SideMap(
            told.landmarks or base.landmarks, told.unit or base.unit, told.up or base.up, told.fps or base.fps
        )
    return out


def _truth_side(path: Path, told: SideMap) -> Side:
    if path.is_dir():
        for folder in (path / "truth", path):
            if (folder / "landmarks.csv").exists():
                return _own_folder("truth", path, folder, told)
        if panoptic_folder(path) is None:
            raise MocapError(
                "the session has no truth to compare with",
                path=path / "truth" / "landmarks.csv",
                remedy="evaluate only sessions with truth/landmarks.csv (and tracks.csv), as `mocap synth` writes "
                "them, or give a file of poses as the truth",
            )
    return Side("truth", path, read_motions(read_poses(path), told))


def _estimate_side(path: Path, told: SideMap) -> Side:
    if path.is_dir() or not path.suffix:
        for folder in (path, path / "truth"):
            if (folder / "landmarks.csv").exists():
                side = _own_folder("estimate", path, folder, told)
                return replace(side, frames=frames_of_run(folder))
        if not path.is_dir() or panoptic_folder(path) is None:
            raise MocapError(
                "the folder holds no result of a run",
                path=path / "landmarks.csv",
                remedy="run `mocap run SESSION -o OUT` first, or give a file of poses as the estimate",
            )
    return Side("estimate", path, read_motions(read_poses(path), told))


def _own_folder(name: str, path: Path, folder: Path, told: SideMap) -> Side:
    tracks = folder / "tracks.csv"
    poses: PoseFile = read_csv(folder / "landmarks.csv")
    return Side(
        name,
        path,
        read_motions(poses, told),
        read_tracks_csv(tracks) if tracks.exists() else None,
        folder=folder,
    )


def _rig(path: Path) -> CameraRig:
    from mocap.io.calibration import find_calibration, read_calibration

    return read_calibration(find_calibration(path) if path.is_dir() else path).rig


def _in_metres(side: Side, notes: list[str]) -> tuple[Side, str | None]:
    """The side in metres, and a warning when a body of the size it claims does not exist."""
    reading = side.reading
    sizes = {length_unit(m.landmarks) for m in reading.motions} - {"unknown"}
    looks = sizes.pop() if len(sizes) == 1 else "unknown"
    unit = reading.unit
    warning = None
    if unit is None:
        unit = "m" if looks == "unknown" else looks
        how = "by the size of the body" if looks != "unknown" else "for want of a better guess"
        notes.append(f"{side.name}: taken as {unit} {how}; the file does not say (--{side.name}-unit)")
    elif looks not in ("unknown", unit):
        who = "the file says" if reading.unit_from == "file" else "you say"
        warning = (
            f"unit mistake: the {side.name} looks like {looks} read as {unit}; a body of that size does not exist "
            f"({who} {unit}). Remedy: --{side.name}-unit {looks}"
        )
    return replace(side, reading=reading.in_metres(unit)), warning


def _on_one_clock(
    found: Side, goal: Side, options: CompareOptions, notes: list[str]
) -> tuple[Side, Side, float | None]:
    """Both sides numbered by the same frames, and the rate of those; the faster is read at the times of the slower."""
    rate, true_rate = found.reading.fps, goal.reading.fps
    if rate is None or true_rate is None or abs(rate - true_rate) <= _SAME_RATE * true_rate:
        fps = true_rate if true_rate is not None else rate
        shift = options.frame_offset
        if options.time_offset_s:
            if fps is None:
                raise MocapError(
                    "a time offset needs a frame rate, and neither side has one",
                    remedy="use --frame-offset, or say --estimate-fps",
                )
            shift += round(options.time_offset_s * fps)
        if shift:
            notes.append(f"{shift:+d} frames added to the estimate's frame numbers")
        return _shifted(found, shift), goal, fps
    shift_s = options.time_offset_s + options.frame_offset / rate
    motions = tuple(replace(m, time_s=m.time_s + shift_s) for m in found.motions)
    found = replace(found, tracks=None, reading=replace(found.reading, motions=motions))
    goal = replace(goal, tracks=None)
    if shift_s:
        notes.append(f"{shift_s:+.4f} s added to the estimate's times")
    if rate > true_rate:
        found = _resampled(found, goal)
    else:
        goal = _resampled(goal, found)
    fast, slow = (found, goal) if rate > true_rate else (goal, found)
    notes.append(
        f"{max(rate, true_rate):g} and {min(rate, true_rate):g} frames per second: the {fast.name} is interpolated "
        f"at the times of the {slow.name}, whose frame numbers count"
    )
    return found, goal, min(rate, true_rate)


def _shifted(side: Side, shift: int) -> Side:
    if not shift:
        return side
    motions = tuple(replace(m, frames=m.frames + shift) for m in side.motions)
    tracks = side.tracks
    return replace(
        side,
        reading=replace(side.reading, motions=motions),
        tracks=None if tracks is None else replace(tracks, frame=tracks.frame + shift),
        frames=None if side.frames is None else tuple(f + shift for f in side.frames),
    )


def _resampled(fast: Side, slow: Side) -> Side:
    """The fast side at the instants of the slow one, linearly between neighbours that are both known."""
    frames, index = np.unique(np.concatenate([m.frames for m in slow.motions]), return_index=True)
    times = np.concatenate([m.time_s for m in slow.motions])[index]
    step = 1.0 / fast.reading.fps if fast.reading.fps else np.inf
    motions = []
    for m in fast.motions:
        if len(m) < 2:
            continue
        after = np.clip(np.searchsorted(m.time_s, times, side="left"), 1, len(m) - 1)
        before = after - 1
        gap = m.time_s[after] - m.time_s[before]
        share = (times - m.time_s[before]) / gap
        # A frame at this very instant needs no neighbour; a hole in the recording, or its end, stays one.
        snap = np.abs(share - share.round()) * gap < _SAME_INSTANT * step
        share = np.where(snap, share.round(), share)
        usable = (share >= 0.0) & (share <= 1.0) & (snap | (gap < 1.5 * step))
        low, high, weight = before[usable], after[usable], share[usable]
        landmarks = _between(m.landmarks[low], m.landmarks[high], weight)
        std = None if m.std is None else _between(m.std[low], m.std[high], weight)
        motions.append(Motion(m.person, frames[usable], times[usable], landmarks, std))
    return replace(fast, frames=None, reading=replace(fast.reading, motions=tuple(motions)))


def _between(low: Array, high: Array, share: Array) -> Array:
    """(T, M, 3) between two frames; a neighbour of weight zero counts for nothing even where it is unknown."""
    share = share[:, None, None]
    return np.where(share == 0.0, low, np.where(share == 1.0, high, (1 - share) * low + share * high))


def _frames_to_score(found: Side, goal: Side, notes: list[str]) -> list[int]:
    """Frames of the truth that the estimate worked on; a person missing in one of them counts as missed."""
    true_frames = _all_frames(goal)
    if found.frames is not None:
        worked_on = np.array(found.frames, dtype=np.int64)
        common = np.intersect1d(true_frames, worked_on)
    else:
        worked_on = _all_frames(found)
        first, last = (worked_on[0], worked_on[-1]) if len(worked_on) else (1, 0)
        common = true_frames[(true_frames >= first) & (true_frames <= last)]
    if not len(common) and len(worked_on) and len(true_frames):
        raise MocapError(
            f"estimate and truth have no frame in common: frames {worked_on.min()} to {worked_on.max()} of "
            f"{found.path.name}, {true_frames.min()} to {true_frames.max()} of {goal.path.name}",
            remedy="shift the estimate with --frame-offset N or --time-offset S, or check the frame rates "
            "(--estimate-fps, --truth-fps)",
        )
    if len(common) < max(len(true_frames), len(worked_on)):
        notes.append(
            f"{len(common)} common frames are scored; the estimate has {len(worked_on)}, the truth {len(true_frames)}"
        )
    return [int(f) for f in common]


def _all_frames(side: Side) -> NDArray[np.int64]:
    if not side.motions:
        return np.zeros(0, dtype=np.int64)
    return np.unique(np.concatenate([m.frames for m in side.motions]))


def _common_landmarks(found: Side, goal: Side) -> tuple[Side, Side, list[str]]:
    """Both sides with the landmarks that both know at all; the others are unknown, not missed."""
    has = [{n for n in side.reading.landmarks if _ever_known(side, n)} for side in (found, goal)]
    if not found.motions or not goal.motions:
        return found, goal, []
    common = has[0] & has[1]
    if not common:
        raise MocapError(
            f"estimate and truth have no landmark in common: {', '.join(sorted(has[0])) or 'none'} against "
            f"{', '.join(sorted(has[1])) or 'none'}",
            remedy="say with --map FILE which points are which landmarks",
        )
    left_out = [n for n in LANDMARKS if n not in common]
    columns = [LANDMARKS.index(n) for n in left_out]
    return _without(found, columns), _without(goal, columns), left_out


def _ever_known(side: Side, name: str) -> bool:
    m = LANDMARKS.index(name)
    return any(bool(np.isfinite(motion.landmarks[:, m]).any()) for motion in side.motions)


def _without(side: Side, columns: Sequence[int]) -> Side:
    if not columns:
        return side
    motions = []
    for m in side.motions:
        landmarks = m.landmarks.copy()
        landmarks[:, columns] = np.nan
        motions.append(replace(m, landmarks=landmarks))
    return replace(side, reading=replace(side.reading, motions=tuple(motions)))


def _lying(side: Side) -> str | None:
    """A warning when the body's long axis is not upright most of the time: then the axes are probably wrong."""
    legs = [LANDMARKS.index(n) for n in ("left_ankle", "right_ankle", "left_knee", "right_knee")]
    top = [LANDMARKS.index(n) for n in ("head", "neck", "left_shoulder", "right_shoulder")]
    axes = []
    for m in side.motions:
        difference = m.landmarks[:, top][:, :, None] - m.landmarks[:, legs][:, None]
        known = np.all(np.isfinite(difference), axis=3)
        count = known.sum(axis=(1, 2))
        rows = count > 0
        total = np.where(known[..., None], difference, 0.0).sum(axis=(1, 2))[rows]
        axes.append(total / np.linalg.norm(total, axis=1, keepdims=True).clip(1e-12))
    if not axes or not sum(map(len, axes)):
        return None
    up = np.median(np.concatenate(axes), axis=0)
    k = int(np.argmax(np.abs(up)))
    if np.abs(up[k]) < 0.8 or (k == 2 and up[2] > 0):
        return None
    where = ("x", "y", "z")[k] if up[k] > 0 else ("-x", "-y", "-z")[k]
    return (
        f"the bodies of the {side.name} stand along {where} after reading {side.reading.up} as up. "
        f"Remedy: say which axis of the file is up with --{side.name}-up"
    )


def _tracks(found: Side, goal: Side, notes: list[str]) -> tuple[Tracks | None, Tracks | None]:
    """Tracks of both sides; of tracks.csv where both have it, else the middle of the landmarks of the trunk."""
    if found.tracks is not None and goal.tracks is not None:
        return found.tracks, goal.tracks
    if found.folder is not None and goal.folder is not None:
        return found.tracks, goal.tracks
    names = [n for n in _TRUNK if _ever_known(found, n) and _ever_known(goal, n)]
    if not names:
        return None, None
    notes.append(f"tracks are the mean of {', '.join(names)}: one side has no tracks.csv")
    return _middle(found, names), _middle(goal, names)


def _middle(side: Side, names: Sequence[str]) -> Tracks:
    columns = [LANDMARKS.index(n) for n in names]
    rows = []
    for m in side.motions:
        middle = m.landmarks[:, columns].mean(axis=1)
        for i in np.flatnonzero(np.isfinite(middle).all(axis=1)):
            rows.append((int(m.frames[i]), m.person, float(m.time_s[i]), *middle[i]))
    rows.sort()
    table = np.array(rows, dtype=np.float64).reshape(-1, 6)
    return Tracks(table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2], table[:, 3:])


def _hulls(found: Side, goal: Side, options: CompareOptions) -> StageStore | None:
    """The stage products of a run that is scored against a truth of ours frame by frame; else None."""
    if found.folder is None or goal.folder is None or options.frame_offset or options.time_offset_s:
        return None
    return StageStore(found.folder / "store.zarr")


def _volume(goal: Side, hulls: StageStore | None) -> VolumeScores | None:
    return None if hulls is None or goal.folder is None else volume_overlap(goal.folder, hulls)


def _lag(pairs: Sequence[Pair], fps: float | None, options: CompareOptions) -> str | None:
    """A warning when the estimate, shifted by some frames, lies much closer to the truth."""

    def error_at(shift: int) -> float:
        distances = []
        for p in pairs:
            _, rows, source = np.intersect1d(p.frames, p.frames + shift, return_indices=True)
            distances.append(np.linalg.norm(p.estimate[source] - p.truth[rows], axis=2).ravel())
        known = np.concatenate(distances) if distances else np.zeros(0)
        known = known[np.isfinite(known)]
        return 1000.0 * float(known.mean()) if len(known) else np.inf

    n = max((len(p.frames) for p in pairs), default=0)
    shifts = [k for k in range(-_MAX_LAG, _MAX_LAG + 1) if abs(k) < n // 2]
    if not shifts:
        return None
    errors = {k: error_at(k) for k in shifts}
    best = min(errors, key=lambda k: (errors[k], abs(k)))
    now = errors[0]
    if best == 0 or not np.isfinite(now) or errors[best] > min(_LAG_GAIN * now, now - _LAG_GAIN_MM):
        return None
    told = f"--frame-offset {options.frame_offset + best}"
    if options.time_offset_s and fps:
        told = f"--time-offset {options.time_offset_s + best / fps:.3f}"
    return (
        f"shifted by {best:+d} frames the estimate lies {errors[best]:.0f} mm from the truth instead of {now:.0f} mm: "
        f"it lags behind or runs ahead, or the two count frames differently. Remedy: if they do, {told}"
    )


def _other_world(scores: dict[str, Any]) -> str | None:
    here, fitted = scores["mean_error_mm"], scores["aligned"]["rigid"]["mean_error_mm"]
    if here is None or fitted is None or here < _FAR_MM or fitted > 0.3 * here:
        return None
    return (
        f"the estimate lies {here:.0f} mm from the truth, but {fitted:.0f} mm after a rigid fit: the two seem to use "
        "different world frames. Remedy: bring both into one frame, or read the aligned scores only"
    )


def _said_of(side: Side) -> dict[str, Any]:
    reading = side.reading
    frames, n_persons = _all_frames(side), len(side.motions)
    if not side.motions and side.tracks is not None:
        frames, n_persons = np.unique(side.tracks.frame), len(side.tracks.persons)
    return {
        "path": str(side.path),
        "format": reading.format,
        "unit": reading.unit,
        "up": reading.up,
        "fps": None if reading.fps is None else round(reading.fps, 3),
        "skeleton": reading.skeleton,
        "landmarks": list(reading.landmarks),
        "persons": n_persons,
        "frames": len(frames),
        "first_frame": int(frames[0]) if len(frames) else None,
        "last_frame": int(frames[-1]) if len(frames) else None,
    }


def write_page(path: Path, comparison: Comparison, *, command: str = "") -> None:
    """The comparison as one HTML file that stands alone."""
    from mocap.view.eval_page import EvalPage, write_eval_page

    found, goal = comparison.estimate.path.name, comparison.truth.path.name
    page = EvalPage(f"{found} against {goal}", comparison.scores, _figures(comparison), command)
    write_eval_page(path, page)


def _figures(comparison: Comparison) -> dict[str, list[Figure]]:
    from mocap.view.eval_plots import plot_angle_errors, plot_epsilon, plot_reliability, plot_sweep
    from mocap.view.plots import plot_error_over_time, plot_landmark_errors
    from mocap.view.report import Figure

    scores, pairs = comparison.scores, comparison.pairs
    epsilon_mm = scores["epsilon_mm"]
    errors = {p.person: (p.frames, point_errors(p.estimate, p.truth)) for p in pairs}
    table = scores["per_landmark"]
    figures = {
        "points": [
            Figure(
                "Error over time.",
                "Mean and worst landmark of every person; what lies above the dotted line does not count as found.",
                plot_error_over_time(errors, epsilon_mm=epsilon_mm),
            ),
            Figure(
                "Error of each landmark.",
                "Mean with one standard deviation; blue is the person's left, orange the right.",
                plot_landmark_errors(
                    {n: row["mean_mm"] for n, row in table.items()},
                    {n: row["std_mm"] for n, row in table.items()},
                    epsilon_mm=epsilon_mm,
                ),
            ),
        ],
        "epsilon": [],
        "angles": [
            Figure(
                "Error of each angle.",
                "Bars: read from the landmarks. Strokes: after the reference skeleton was fitted to both sides.",
                plot_angle_errors(
                    scores["angles"]["direct"]["per_angle_deg"],
                    scores["angles"]["inverse_kinematics"]["per_angle_deg"],
                ),
            )
        ],
        "uncertainty": [],
    }
    everything = np.concatenate([e.ravel() for _, e in errors.values()]) if errors else np.zeros(0)
    search = epsilon_search(everything)
    if search is not None:
        figures["epsilon"].append(
            Figure(
                "How epsilon was found.",
                "Left: errors, and the Gaussian of those up to epsilon. Middle: their quantiles; a Gaussian is a line. "
                "Right: both tests over epsilon, dotted where they are best.",
                plot_epsilon(
                    everything,
                    search.epsilon_mm,
                    search.lilliefors,
                    search.r2,
                    search.by_lilliefors_mm,
                    search.by_r2_mm,
                ),
            )
        )
    sweep = {k: np.array([np.nan if v is None else v for v in c]) for k, c in scores["sweep"].items()}
    marks = {"epsilon": epsilon_mm} | ({} if search is None else {"natural": search.by_lilliefors_mm})
    figures["epsilon"].append(
        Figure(
            "What epsilon does.",
            "Left: share of landmarks within it, which is also the curve of correct keypoints (PCK). "
            "Right: their error.",
            plot_sweep(**sweep, chosen_mm=marks),
        )
    )
    if (honest := scores["reliability"]) is not None:
        names = ("level_percent", "coverage_percent", "claimed_mm", "found_mm")
        figures["uncertainty"].append(
            Figure(
                "Reliability diagram.",
                "Left: how many true landmarks lie in a region that should hold so many. Right: errors of landmarks "
                "in ten groups, from the surest to the least sure.",
                plot_reliability(*(np.array(honest[n]) for n in names)),
            )
        )
    return figures
