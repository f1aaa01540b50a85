"""Comparison of any estimate with any truth, ours or of other tools, and what had to be assumed for it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from mocap.compare.checks import axis_warning, lag_warning, order_warning, world_warning
from mocap.compare.clock import OnOneClock, frames_to_score, on_one_clock
from mocap.compare.detail import Action, detailed_scores
from mocap.compare.hulls import lost_limbs, volume_overlap
from mocap.compare.match import Pair, matched_pairs
from mocap.compare.options import CompareOptions, side_maps
from mocap.compare.scores import evaluate
from mocap.compare.side import Side, common_landmarks, description, in_metres, read_estimate, read_truth
from mocap.compare.tracks import lacks_poses, score_tracks, tracks_of
from mocap.data import CameraRig
from mocap.io.actions import read_actions_csv
from mocap.io.store import StageStore
from mocap.products.one_run import check_one_run


@dataclass(frozen=True, eq=False)
class Comparison:
    """scores : ready for JSON.  pairs : the landmarks that were scored.  estimate, truth : as they were read."""

    scores: dict[str, Any]
    pairs: tuple[Pair, ...]
    estimate: Side
    truth: Side
    options: CompareOptions


@dataclass(frozen=True, eq=False)
class _Prepared:
    """Both sides in metres, on one clock, with the landmarks that both know.

    frames : to be scored.  unit_warnings : of the two.  warnings : the others.
    """

    sides: OnOneClock
    frames: list[int]
    landmarks_left_out: list[str]
    notes: list[str]
    unit_warnings: list[str]
    warnings: list[str]


def compare(estimate: Path, truth: Path, options: CompareOptions | None = None) -> Comparison:
    """Score an estimate against a truth: folders of ours, or files of any format that `read_poses` knows.

    The keys of the scores are those of `evaluate`, those of `detailed_scores`, and `estimate`, `truth`, `notes` and
    `warnings`, which say how the two were read and matched.
    Where a folder has tracks.csv and no landmarks.csv, tracks alone are scored, and `tracks_only` is true.
    Raises MocapError for a file that cannot be read, and when the two have no frame or no landmark in common.
    """
    options = CompareOptions() if options is None else options
    if lacks_poses(Path(estimate), Path(truth)):
        scores, side, true_side = score_tracks(Path(estimate), Path(truth), options)
        scores["estimate"], scores["truth"] = description(side), description(true_side)
        return Comparison(scores, (), side, true_side, options)
    prepared = _prepared(Path(estimate), Path(truth), options)
    side, true_side = prepared.sides.estimate, prepared.sides.truth
    pairs = tuple(matched_pairs(side.motions, true_side.motions, frames=prepared.frames))
    scores, notes = _scored(prepared, pairs, options)
    scores["estimate"], scores["truth"] = description(side), description(true_side)
    scores["landmarks_left_out"] = prepared.landmarks_left_out
    scores["notes"] = prepared.notes + notes
    scores["warnings"] = _all_warnings(prepared, scores, pairs, options)
    return Comparison(scores, pairs, side, true_side, options)


def _prepared(estimate: Path, truth: Path, options: CompareOptions) -> _Prepared:
    estimate_map, truth_map = side_maps(options)
    true_side = read_truth(truth, truth_map)
    side = read_estimate(estimate, estimate_map)
    notes = [f"{s.name}: {text}" for s in (side, true_side) for text in s.reading.notes]
    true_side, true_note, true_warning = in_metres(true_side)
    side, note, warning = in_metres(side)
    sides = on_one_clock(side, true_side, options)
    frames, frames_note = frames_to_score(sides.estimate, sides.truth)
    side, true_side, left_out = common_landmarks(sides.estimate, sides.truth)
    left_note = f"scored without {', '.join(left_out)}: one side does not have them" if left_out else None
    found = (true_note, note, *sides.notes, frames_note, left_note)
    return _Prepared(
        OnOneClock(side, true_side, sides.fps),
        frames,
        left_out,
        notes + _said(found),
        _said((warning, true_warning)),
        _said((order_warning(side, true_side), axis_warning(side), axis_warning(true_side))),
    )


def _scored(
    prepared: _Prepared, pairs: Sequence[Pair], options: CompareOptions
) -> tuple[dict[str, Any], list[str]]:
    """Every score, and notes of what was assumed for them."""
    actions = [] if options.actions_path is None else read_actions_csv(options.actions_path)
    rig = None if options.cameras_path is None else _rig(options.cameras_path)
    side, true_side, fps = prepared.sides.estimate, prepared.sides.truth, prepared.sides.fps
    tracks, true_tracks, note = tracks_of(side, true_side)
    hulls = _hulls(side, true_side, options)
    volume = limbs = None
    if hulls is not None and true_side.folder is not None:
        volume = volume_overlap(true_side.folder, hulls)
        limbs = lost_limbs(side.motions, true_side.motions, hulls, frames=prepared.frames)
    scores = evaluate(
        side.motions,
        true_side.motions,
        tracks,
        true_tracks,
        volume,
        options.epsilon_mm,
        frames=prepared.frames,
    )
    scores |= detailed_scores(
        pairs,
        fps,
        options.epsilon_mm,
        actions=[Action(*a) for a in actions],
        rig=rig,
        epsilon_px=options.epsilon_px,
        learn_share=options.learn_share,
    )
    scores["lost_limbs"] = None if limbs is None else asdict(limbs)
    if prepared.unit_warnings:
        scores["unit_warning"] = "; ".join(prepared.unit_warnings)
    rate_note = "no frame rate is known: accelerations are not scored (--estimate-fps, --truth-fps)"
    return scores, _said((note, rate_note if fps is None else None))


def _all_warnings(
    prepared: _Prepared, scores: Mapping[str, Any], pairs: Sequence[Pair], options: CompareOptions
) -> list[str]:
    """Warnings in the order of their weight; a wrong unit explains away what else looks wrong."""
    warnings = prepared.unit_warnings + prepared.warnings
    if prepared.unit_warnings:
        return warnings
    if scores["unit_warning"]:
        return [*warnings, scores["unit_warning"]]
    return warnings + _said((lag_warning(pairs, prepared.sides.fps, options), world_warning(scores)))


def _said(texts: Sequence[str | None]) -> list[str]:
    return [text for text in texts if text]


def _rig(path: Path) -> CameraRig:
    from mocap.io.calibration import find_calibration, read_calibration

    return read_calibration(find_calibration(path) if path.is_dir() else path).rig


def _hulls(estimate: Side, truth: Side, options: CompareOptions) -> StageStore | None:
    """The stage products of a run that is scored against a truth of ours frame by frame; else None.

    Raises MocapError where a side is a folder with store or tables of another run.
    """
    for side in (estimate, truth):
        if side.folder is not None:
            check_one_run(side.folder)
    if estimate.folder is None or truth.folder is None or options.frame_offset or options.time_offset_s:
        return None
    return StageStore(estimate.folder / "store.zarr")
