"""Scores on standard output, in the words of the catalogue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import typer

RUN_SCORES = (
    "mean_error_mm",
    "std_error_mm",
    "mmtp_mm",
    "mmta_percent",
    "epsilon_mm",
    "mean_error_after_offset_mm",
    "angle_mean_deg",
    "motp_mm",
    "mota_percent",
    "volume_iou",
    "coverage_90_percent",
    "silent_errors",
)
MORE_SCORES = (
    "pck_auc_percent",
    "aligned.root.mean_error_mm",
    "aligned.procrustes.mean_error_mm",
    "offset_calibration.after.mean_error_mm",
    "angles.inverse_kinematics.mean_deg",
    "epsilon_search.by_lilliefors_mm",
    "epsilon_search.by_r2_mm",
    "acceleration_error_m_s2",
    "hota_percent",
    "idf1_percent",
    "image.mean_error_px",
    "image.mmta_percent",
    "lost_limbs.f1",
)
_TRACK_COUNTS = ("misses", "false_positives", "mismatches")


def echo_scores(scores: Mapping[str, Any]) -> None:
    """The scores of a run, one line each; what does not apply is left out."""
    tracks_only = scores.get("tracks_only")
    if tracks_only:
        typer.echo("Scores against the truth, of the tracks alone:")
    elif scores.get("mean_error_mm") is None:
        typer.echo("Scores against the truth: nobody of the truth was found, so there is no error to give.")
    else:
        typer.echo("Scores against the truth:")
    _echo_lines(scores, [key for key in RUN_SCORES if not (tracks_only and key == "epsilon_mm")])
    if scores.get("unit_warning"):
        typer.echo(f"  warning: {scores['unit_warning']}")


def echo_comparison(scores: Mapping[str, Any]) -> None:
    """The scores of a comparison, of each action, and what was assumed."""
    echo_scores(scores)
    _echo_lines(scores, MORE_SCORES)
    if scores.get("tracks_only"):
        _echo_lines(scores, _TRACK_COUNTS)
    for label, row in (scores["per_action"] or {}).items():
        typer.echo(f"  {label} ({row['frames']} frames): {_action_text(row)}")
    for note in scores["notes"]:
        typer.echo(f"  note: {note}")
    for warning in scores["warnings"]:
        if warning != scores["unit_warning"]:
            typer.echo(f"  warning: {warning}")


def _echo_lines(scores: Mapping[str, Any], keys: Sequence[str]) -> None:
    from mocap.metrics.catalogue import score_at, score_of, score_text

    for key in keys:
        value = score_at(scores, key)
        if value is not None:
            score = score_of(key)
            typer.echo(f"  {score.name:<36} {score_text(value, score):>8} {score.unit}".rstrip())


def _action_text(row: Mapping[str, Any]) -> str:
    if row["mean_error_mm"] is None:
        return "nothing scored"
    return f"{row['mean_error_mm']:.1f} mm, MMTA {row['mmta_percent']:.1f} %"
