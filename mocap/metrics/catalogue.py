"""Catalogue of scores: key -> name, unit, direction, meaning and decimals, once for every place that shows a score.

The command line, the report, the page of `mocap eval`, the tables of sweeps and the scripts in eval/ read it. A key
with dots is a path into the object of `mocap eval --json`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Better = Literal["lower", "higher", ""]


@dataclass(frozen=True)
class Score:
    """What a key of the scores means, for a reader who never heard of it.

    better : which values are good, "" = neither.  label : the head of a narrow column, without its unit.
    decimals : None = a number of which nothing is known but its key.
    """

    name: str
    unit: str
    better: Better
    meaning: str
    label: str = ""
    decimals: int | None = 1


CATALOGUE: dict[str, Score] = {
    "mean_error_mm": Score(
        "Mean error",
        "mm",
        "lower",
        "Distance between estimated and true landmarks, averaged over landmarks and frames.",
        "Mean",
    ),
    "std_error_mm": Score(
        "Spread of the error", "mm", "lower", "Standard deviation of those distances.", "Deviation"
    ),
    "mean_error_after_offset_mm": Score(
        "Mean error after offsets",
        "mm",
        "lower",
        "The same after one constant offset per landmark (first 10 frames): bodies define joints differently.",
        "After offset",
    ),
    "lost_wrist_percent": Score(
        "Frames with a lost wrist",
        "%",
        "lower",
        "Frames in which a wrist lies more than 150 mm from the truth.",
        "Lost wrist",
    ),
    "mmta_percent": Score(
        "MMTA (accuracy)",
        "%",
        "higher",
        "Share of landmarks that lie within epsilon of the truth, i.e. how much was found. 100 % is perfect.",
        "MMTA",
    ),
    "mmtp_mm": Score(
        "MMTP (precision)",
        "mm",
        "lower",
        "Mean error of only those landmarks that lie within epsilon, i.e. how precise what was found is.",
        "MMTP",
    ),
    "epsilon_mm": Score("Epsilon", "mm", "", "Distance up to which a landmark counts as found.", "Epsilon"),
    "epsilon_opt_mm": Score(
        "Natural epsilon",
        "mm",
        "lower",
        "The epsilon below which errors look like noise; beyond it limbs are lost rather than imprecise.",
        "Natural epsilon",
    ),
    "angle_mean_deg": Score(
        "Mean angle error", "deg", "lower", "Difference of joint angles on one common skeleton.", "Angle"
    ),
    "angle_std_deg": Score(
        "Spread of the angle error",
        "deg",
        "lower",
        "Standard deviation of those differences.",
        "Angle deviation",
    ),
    "mota_percent": Score(
        "MOTA (tracking accuracy)",
        "%",
        "higher",
        "100 % minus the shares of missed persons, false persons and identity switches; can be negative.",
        "MOTA",
    ),
    "motp_mm": Score(
        "MOTP (tracking precision)",
        "mm",
        "lower",
        "Mean distance between a track and the person it follows.",
        "MOTP",
    ),
    "misses": Score(
        "Misses",
        "",
        "lower",
        "Times that a person who was there had no track, summed over frames.",
        "Misses",
        decimals=0,
    ),
    "false_positives": Score(
        "False positives",
        "",
        "lower",
        "Times that a track followed nobody, summed over frames.",
        "False positives",
        decimals=0,
    ),
    "mismatches": Score(
        "Identity switches",
        "",
        "lower",
        "Times that a track jumped from one person to another.",
        "Mismatches",
        decimals=0,
    ),
    "volume_iou": Score(
        "Volume overlap (IoU)",
        "",
        "higher",
        "Shared volume of hull and true body over their union; 1 is identical.",
        "Hull IoU",
        decimals=3,
    ),
    "coverage_90_percent": Score(
        "Honesty of the uncertainty",
        "%",
        "",
        "Share of true landmarks inside the stated 90 % region. 90 is honest, less is overconfident.",
        "90 % coverage",
    ),
    "silent_error_percent": Score(
        "Silent errors",
        "%",
        "lower",
        "Share of the landmarks more than 100 mm off that are called observed and lie outside their own 90 % region.",
        "Silent errors",
    ),
    "silent_errors": Score(
        "Landmarks silently wrong",
        "",
        "lower",
        "Landmarks more than 100 mm off that are called observed and lie outside their own 90 % region.",
        "Silently wrong",
        decimals=0,
    ),
    "frames": Score(
        "Frames scored",
        "",
        "",
        "Frames in which estimate and truth could be compared.",
        "Frames",
        decimals=0,
    ),
    "mmtp_std_mm": Score(
        "Spread of MMTP", "mm", "lower", "Standard deviation of the errors within epsilon.", "its deviation"
    ),
    "epsilon_qq_mm": Score(
        "Natural epsilon (Q-Q line)",
        "mm",
        "lower",
        "The same by the straightest line of the errors' quantiles.",
        "By Q-Q line",
    ),
    "mean_error_after_world_offset_mm": Score(
        "Mean error after fixed offsets",
        "mm",
        "lower",
        "After one constant offset per landmark that does not turn with the body.",
        "After fixed offset",
    ),
    "motp_xyz_mm": Score(
        "MOTP in space", "mm", "lower", "MOTP with the height, not on the floor alone.", "MOTP in space"
    ),
    "deta_percent": Score(
        "DetA (detection)",
        "%",
        "higher",
        "The part of HOTA that counts persons found, whoever they are.",
        "DetA",
    ),
    "assa_percent": Score(
        "AssA (association)", "%", "higher", "The part of HOTA that counts persons kept apart.", "AssA"
    ),
    "sharpness_90_mm": Score(
        "Size of the uncertainty",
        "mm",
        "lower",
        "Mean radius of the stated 90 % regions; small is worth something only where they are honest.",
        "90 % radius",
    ),
    "landmarks_missing": Score(
        "Landmarks missing",
        "",
        "lower",
        "True landmarks without an estimate; they count as not found.",
        "Missing",
        decimals=0,
    ),
    "landmarks_scored": Score(
        "Landmarks scored", "", "", "True landmarks that are known.", "Scored", decimals=0
    ),
    "persons_truth": Score("Persons in the truth", "", "", "Who was there.", "True persons", decimals=0),
    "persons_matched": Score(
        "Persons matched", "", "higher", "True persons with an estimate.", "Matched persons", decimals=0
    ),
    "extra_persons": Score(
        "Extra persons",
        "",
        "lower",
        "Estimated persons whom the truth does not know.",
        "Extra persons",
        decimals=0,
    ),
    "pck_auc_limit_mm": Score(
        "Limit of the PCK area", "mm", "", "Threshold up to which the area is taken.", "PCK limit"
    ),
    "pck_auc_percent": Score(
        "PCK, area under the curve",
        "%",
        "higher",
        "Share of correct landmarks, averaged over thresholds from 0 to 150 mm.",
        "PCK area",
    ),
    "hota_percent": Score(
        "HOTA (tracking)",
        "%",
        "higher",
        "Detection and identity of persons in one number; 100 % is perfect.",
        "HOTA",
    ),
    "acceleration_error_m_s2": Score(
        "Acceleration error",
        "m/s²",
        "lower",
        "Difference of the accelerations: trembling shows here.",
        "Acceleration",
    ),
    "jitter_estimate_m_s3": Score(
        "Jitter of the estimate", "m/s³", "lower", "Mean third derivative of the landmarks.", "Jitter"
    ),
    "jitter_truth_m_s3": Score(
        "Jitter of the truth", "m/s³", "", "The same of the truth: what a perfect one has.", "True jitter"
    ),
    "aligned.root.mean_error_mm": Score(
        "Mean error, root-aligned", "mm", "lower", "With the pelvis on the true one.", "Root-aligned"
    ),
    "aligned.procrustes.mean_error_mm": Score(
        "Mean error, Procrustes-aligned (PA)",
        "mm",
        "lower",
        "After the best rotation, translation and scale, frame by frame.",
        "Procrustes-aligned",
    ),
    "offset_calibration.after.mean_error_mm": Score(
        "Mean error after offsets, held out",
        "mm",
        "lower",
        "Offsets learnt on the first frames and scored on those after them.",
        "Held out",
    ),
    "angles.inverse_kinematics.mean_deg": Score(
        "Mean angle error after IK",
        "deg",
        "lower",
        "After one body of constant size was fitted to both sides.",
        "Angle after IK",
    ),
    "epsilon_search.by_lilliefors_mm": Score(
        "Natural epsilon (Lilliefors)", "mm", "lower", "By the least Lilliefors statistic.", "By Lilliefors"
    ),
    "epsilon_search.by_r2_mm": Score(
        "Natural epsilon (Q-Q line)",
        "mm",
        "lower",
        "By the straightest quantile-quantile line.",
        "By Q-Q line",
    ),
    "idf1_percent": Score(
        "IDF1 (identities)",
        "%",
        "higher",
        "How long persons keep their number: F1 of frames under one assignment of numbers.",
        "IDF1",
    ),
    "lost_limbs.f1": Score(
        "F1 of lost limbs",
        "",
        "higher",
        "How well `observed` tells limbs without data from limbs with data; 1 is perfect.",
        "Lost limbs F1",
        decimals=2,
    ),
    "image.mean_error_px": Score(
        "Mean error in the pictures", "px", "lower", "Of both poses projected into the cameras.", "Mean"
    ),
    "image.mmta_percent": Score(
        "MMTA in the pictures", "%", "higher", "Share of landmarks within epsilon, in pixels.", "MMTA"
    ),
}

_UNIT_OF_ENDING = {"_mm": "mm", "_px": "px", "_percent": "%", "_deg": "deg"}


def score_of(key: str) -> Score:
    """The entry of a key; for an unknown one what the key itself says: its words, and its unit by its ending."""
    if key in CATALOGUE:
        return CATALOGUE[key]
    unit = next((u for ending, u in _UNIT_OF_ENDING.items() if key.endswith(ending)), "")
    words = key.replace("_", " ")
    return Score(words, unit, "", "", words, decimals=1 if unit else None)


def heading(key: str) -> str:
    """The head of a column: label and unit."""
    score = score_of(key)
    return f"{score.label} ({score.unit})" if score.unit else score.label


def score_hint(key: str) -> str:
    """The score in one line: name, what it means, and which values are good."""
    score = score_of(key)
    direction = f" {score.better.capitalize()} is better." if score.better else ""
    return f"{score.name}. {score.meaning}{direction}".strip() if score.meaning else score.name


def score_text(value: float | None, score: Score) -> str:
    """The number alone, with the decimals of its score; "unknown" for None, NaN and infinity."""
    if value is None or not np.isfinite(value):
        return "unknown"
    if score.decimals is not None:
        return f"{value:.{score.decimals}f}"
    return f"{int(value)}" if float(value).is_integer() else f"{value:.3f}"


def score_at(scores: Mapping[str, Any], key: str) -> float | None:
    """The value at a key of the catalogue; None where a step of its path is missing."""
    value: Any = scores
    for step in key.split("."):
        value = None if value is None else value.get(step)
    return value
