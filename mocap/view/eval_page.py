"""The page of an evaluation: one HTML file that stands alone, in the looks of a run's report."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mocap.errors import MocapError
from mocap.view.report import (
    _SCRIPT,
    _STYLE,
    SCORES,
    Figure,
    Score,
    _data_uri,
    _none,
    _number,
    _text,
    _verdict_on_scores,
    _warnings_section,
)

_HEADLINE = (
    "mean_error_mm",
    "mmta_percent",
    "mmtp_mm",
    "pck_auc_percent",
    "angle_mean_deg",
    "mota_percent",
    "hota_percent",
    "volume_iou",
)
_MORE_SCORES = {
    "pck_auc_percent": Score(
        "PCK, area under the curve",
        "%",
        "Share of correct landmarks, averaged over thresholds from 0 to 150 mm.",
    ),
    "hota_percent": Score(
        "HOTA (tracking)", "%", "Detection and identity of persons in one number; 100 % is perfect."
    ),
    "acceleration_error_m_s2": Score(
        "Acceleration error", "m/s²", "Difference of the accelerations: trembling shows here."
    ),
    "jitter_estimate_m_s3": Score(
        "Jitter of the estimate", "m/s³", "Mean third derivative of the landmarks."
    ),
    "jitter_truth_m_s3": Score(
        "Jitter of the truth", "m/s³", "The same of the truth: what a perfect one has."
    ),
}
_ALIGNMENTS = {
    "none": ("as it is", "in the world frame"),
    "root": ("root-aligned", "pelvis moved onto the true one in every frame"),
    "rigid": ("rigidly aligned", "rotated and moved onto the truth in every frame"),
    "procrustes": ("Procrustes-aligned (PA)", "rotated, moved and scaled in every frame"),
}
_POINT_COLUMNS = (
    ("mean_error_mm", "Mean (mm)"),
    ("std_error_mm", "Deviation (mm)"),
    ("mmtp_mm", "MMTP (mm)"),
    ("mmtp_std_mm", "its deviation (mm)"),
    ("mmta_percent", "MMTA (%)"),
    ("pck_auc_percent", "PCK area (%)"),
)


@dataclass(frozen=True, eq=False)
class EvalPage:
    """What the page shows.

    scores : the object of `mocap eval --json`.  figures : their `title` says what they show; keyed by section:
    points, epsilon, angles, uncertainty.  command : how to make the page again.
    """

    title: str
    scores: Mapping[str, Any]
    figures: Mapping[str, Sequence[Figure]]
    command: str = ""


def write_eval_page(path: Path, page: EvalPage) -> None:
    """Write the page; an earlier file is replaced only when the new one is complete. MocapError when it cannot be."""
    path = Path(path)
    part = path.with_name(path.name + ".part")
    text = eval_html(page)
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        if part.exists():
            part.unlink()
        raise MocapError(
            f"the page cannot be written: {error.strerror or error}",
            remedy="choose a folder that exists, is writable and has space left",
            path=path,
        ) from error


def eval_html(page: EvalPage) -> str:
    """The page as text. Nothing is loaded from anywhere; a content security policy forbids it."""
    s = page.scores
    sections = [
        ("result", "Result", _result(page)),
        ("warnings", "Warnings", _warnings_section(s.get("warnings") or ())),
        ("inputs", "What was compared", _inputs(s)),
        ("points", "Points", _points(page)),
        ("epsilon", "Epsilon without a parameter", _epsilon(page)),
        ("angles", "Angles", _angles(page)),
        ("offsets", "Different skeletons", _offsets(s)),
    ]
    if s.get("per_action"):
        sections.append(("actions", "Actions", _actions(s)))
    if len(s.get("per_person") or {}) > 1:
        sections.append(("persons", "Persons", _point_table("Person", s["per_person"])))
    if s.get("reliability"):
        sections.append(("uncertainty", "Uncertainty", _uncertainty(page)))
    if s.get("image"):
        sections.append(("image", "In the pictures", _image(s["image"])))
    sections += [
        *([("limbs", "Lost limbs", _limbs(s["lost_limbs"]))] if s.get("lost_limbs") else []),
        ("numbers", "All numbers", _numbers(s)),
        (
            "command",
            "Command",
            f"<pre>{_text(page.command)}</pre>" if page.command else _none("Not recorded."),
        ),
    ]
    navigation = "".join(f'<a href="#{key}">{_text(name)}</a>' for key, name, _ in sections)
    body = "".join(
        f'<section id="{key}" aria-labelledby="h-{key}"><h2 id="h-{key}">{_text(name)}</h2>{content}</section>'
        for key, name, content in sections
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; img-src data:; '
        "style-src 'unsafe-inline'; script-src 'unsafe-inline'\">"
        f"<title>{_text(page.title)}</title><style>{_STYLE}</style></head><body>"
        f'<header><p class="kicker">Evaluation of motion</p><h1>{_text(page.title)}</h1>'
        f'<nav aria-label="Sections">{navigation}</nav></header><main>{body}</main>'
        '<dialog id="zoom" aria-label="Enlarged picture"><img alt=""><p></p></dialog>'
        f"<script>{_SCRIPT}</script></body></html>\n"
    )


def _result(page: EvalPage) -> str:
    s = page.scores
    said = _verdict_on_scores(s) if s.get("mean_error_mm") is not None else []
    if s.get("unit_warning"):
        said = ["A unit is probably wrong, so that the errors below say nothing: see the warnings."]
    lead = said[0] if said else "Nobody of the truth was found in the estimate, so there is no error to give."
    out = f'<p class="lead">{_text(lead)}</p>' + "".join(f"<p>{_text(t)}</p>" for t in said[1:])
    cards = [(_score(key), s[key]) for key in _HEADLINE if s.get(key) is not None]
    out += '<div class="cards">'
    for score, value in cards:
        unit = f" <small>{_text(score.unit)}</small>" if score.unit else ""
        out += (
            f'<div class="card"><p class="name">{_text(score.name)}</p><p class="value">'
            f'{_number(value, score.unit)}{unit}</p><p class="hint">{_text(score.meaning)}</p></div>'
        )
    return out + "</div>"


def _inputs(s: Mapping[str, Any]) -> str:
    rows = (
        ("File", "path"),
        ("Format", "format"),
        ("Skeleton", "skeleton"),
        ("Unit", "unit"),
        ("Up axis", "up"),
        ("Frames per second", "fps"),
        ("Persons", "persons"),
        ("Frames", "frames"),
        ("First frame", "first_frame"),
        ("Last frame", "last_frame"),
    )
    body = ""
    for name, key in rows:
        cells = [s.get(side, {}).get(key) for side in ("estimate", "truth")]
        shown = ["not known" if c is None else _text(c) for c in cells]
        body += f'<tr><th scope="row">{name}</th><td>{shown[0]}</td><td>{shown[1]}</td></tr>'
    out = (
        '<div class="scroll"><table class="narrow"><thead><tr><th></th><th scope="col">Estimate</th>'
        f'<th scope="col">Truth</th></tr></thead><tbody>{body}</tbody></table></div>'
    )
    notes = s.get("notes") or ()
    if notes:
        out += (
            "<p>What had to be assumed or left out:</p><ul>"
            + "".join(f"<li>{_text(n)}</li>" for n in notes)
            + "</ul>"
        )
    return out


def _points(page: EvalPage) -> str:
    s = page.scores
    rows = {
        f"{name}": s["aligned"][key]
        for key, (name, _) in _ALIGNMENTS.items()
        if key in (s.get("aligned") or {})
    }
    words = "; ".join(f"{name}: {what}" for name, what in _ALIGNMENTS.values())
    out = (
        f"<p>{_text(words[0].upper() + words[1:])}. A large difference between the rows says that the body stands or "
        "faces wrongly rather than that its limbs do.</p>" + _point_table("Alignment", rows)
    )
    out += _plots(page, "points")
    table = s.get("per_landmark") or {}
    columns = (
        ("mean_mm", "Mean (mm)"),
        ("std_mm", "Deviation (mm)"),
        ("median_mm", "Median (mm)"),
        ("quantile_90_mm", "90 % below (mm)"),
        ("mmtp_mm", "MMTP (mm)"),
        ("mmta_percent", "MMTA (%)"),
    )
    return (
        out
        + "<details><summary>Every landmark in numbers</summary>"
        + _table("Landmark", columns, table)
        + "</details>"
    )


def _epsilon(page: EvalPage) -> str:
    search = page.scores.get("epsilon_search")
    if not search:
        return _none("Too few errors to say anything about their distribution.") + _plots(page, "epsilon")
    out = (
        f"<p>Up to {search['by_lilliefors_mm']:.1f} mm the errors look most like noise by the Lilliefors statistic, "
        f"up to {search['by_r2_mm']:.1f} mm by the straightness of their quantiles. With the first as epsilon, MMTP is "
        f"{_number(search['mmtp_mm'], 'mm')} ± {_number(search['mmtp_std_mm'], 'mm')} mm and MMTA "
        f"{_number(search['mmta_percent'], '%')} %.</p>"
    )
    if search.get("at_bound"):
        out += (
            "<p>The optimum lies at the smallest epsilon that is searched (half of the errors): these errors have no "
            "Gaussian part that outliers could be told from, and a fixed epsilon says more.</p>"
        )
    return out + _plots(page, "epsilon")


def _angles(page: EvalPage) -> str:
    angles = page.scores.get("angles") or {}
    rows = {
        "read from the landmarks": angles.get("direct", {}),
        "after inverse kinematics on one body": angles.get("inverse_kinematics", {}),
    }
    columns = (("mean_deg", "Mean (deg)"), ("std_deg", "Deviation (deg)"), ("frames", "Frames"))
    return (
        "<p>Both sides are written in the angles of one reference skeleton, whatever made them; differences are "
        "wrapped, and only angles between matched landmarks count.</p>"
        + _table("Angles", columns, rows)
        + _plots(page, "angles")
    )


def _offsets(s: Mapping[str, Any]) -> str:
    found = s.get("offset_calibration")
    if not found:
        return _none("Too few common frames to learn offsets and to hold frames out.")
    rows = {"before": found["before"], "after the offsets": found["after"]}
    offsets = {
        name: dict(zip(("forward", "left", "up"), values, strict=True))
        for name, values in found["offset_forward_left_up_mm"].items()
        if any(v is not None for v in values)
    }
    columns = (("forward", "Forward (mm)"), ("left", "Left (mm)"), ("up", "Up (mm)"))
    return (
        "<p>Skeletons define neck, head and hips differently. One constant offset per landmark, turning with the trunk,"
        f" was learnt on the first {100 * found['learn_share']:.0f} % of the common frames "
        f"({found['frames_learnt']}); both rows score the {found['frames_scored']} frames after them.</p>"
        + _point_table("Held-out frames", rows)
        + "<details><summary>The offsets (truth minus estimate, mean over persons)</summary>"
        + _table("Landmark", columns, offsets)
        + "</details>"
    )


def _actions(s: Mapping[str, Any]) -> str:
    columns = (("frames", "Frames"), *_POINT_COLUMNS, ("angle_mean_deg", "Angles (deg)"))
    return _table("Action", columns, s["per_action"])


def _uncertainty(page: EvalPage) -> str:
    found = page.scores["reliability"]
    factor = found["std_factor"]
    word = "overconfident" if factor > 1.1 else "too cautious" if factor < 0.9 else "about right"
    return (
        f"<p>The reported deviations are {word}: multiplied by {factor:.2f} the 90 % regions would hold 90 % of the "
        "true landmarks. On average over all levels the coverage is off by "
        f"{found['calibration_error_percent']:.1f} points. Landmarks of one body err together, so that small "
        "differences say nothing.</p>" + _plots(page, "uncertainty")
    )


def _image(found: Mapping[str, Any]) -> str:
    columns = tuple(
        (key.replace("_mm", "_px"), name.replace("(mm)", "(px)")) for key, name in _POINT_COLUMNS[:5]
    )
    rows = {"all cameras": found, **found["per_camera"]}
    return (
        f"<p>Both poses projected into the cameras; epsilon is {found['epsilon_px']:g} px, and a landmark counts in "
        "the cameras whose picture holds it.</p>" + _table("Camera", columns, rows)
    )


def _limbs(found: Mapping[str, Any]) -> str:
    if not found["n_lost"] and not found["n_said"]:
        return _none(f"None of {found['n_scored']} limbs was without data, and none was said to be.")
    shares = {
        name: "does not apply" if found[name] is None else f"{100 * found[name]:.0f} %"
        for name in ("precision", "recall", "f1")
    }
    return (
        f"<p>{found['n_lost']} of {found['n_scored']} limbs (arms and legs in two parts, every frame) had no data in "
        f"the hull, and {found['n_said']} were said to have none. Precision {shares['precision']}, recall "
        f"{shares['recall']}, F1 {shares['f1']}.</p>"
    )


def _numbers(s: Mapping[str, Any]) -> str:
    rows = ""
    for key, value in s.items():
        if isinstance(value, dict | list | str) or key in ("estimate", "truth", "unit_warning"):
            continue
        score = _score(key)
        shown = "does not apply" if value is None else f"{_number(value, score.unit)} {_text(score.unit)}"
        style = "number faint" if value is None else "number"
        rows += (
            f'<tr><th scope="row">{_text(score.name)}<br><code>{_text(key)}</code></th>'
            f'<td class="{style}">{shown}</td><td>{_text(score.meaning)}</td></tr>'
        )
    return (
        '<div class="scroll"><table><thead><tr><th scope="col">Score</th><th scope="col" class="number">Value</th>'
        f'<th scope="col">What it means</th></tr></thead><tbody>{rows}</tbody></table></div>'
    )


def _score(key: str) -> Score:
    known = SCORES.get(key) or _MORE_SCORES.get(key)
    if known is not None:
        return known
    units = {"_mm": "mm", "_percent": "%", "_deg": "deg"}
    unit = next((u for end, u in units.items() if key.endswith(end)), "")
    return Score(key.replace("_", " "), unit, "")


def _point_table(first: str, rows: Mapping[str, Mapping[str, Any]]) -> str:
    return _table(first, _POINT_COLUMNS, rows)


def _table(first: str, columns: Sequence[tuple[str, str]], rows: Mapping[str, Mapping[str, Any]]) -> str:
    """A table of numbers; columns that no row has are left out."""
    used = [(key, name) for key, name in columns if any(row.get(key) is not None for row in rows.values())]
    heads = "".join(f'<th scope="col" class="number">{_text(name)}</th>' for _, name in used)
    body = ""
    for name, row in rows.items():
        cells = "".join(
            '<td class="number faint">not scored</td>'
            if row.get(key) is None
            else f'<td class="number">{_number(row[key], "" if key == "frames" else "x")}</td>'
            for key, _ in used
        )
        body += f'<tr><th scope="row">{_text(_row_name(first, name))}</th>{cells}</tr>'
    return (
        f'<div class="scroll"><table class="narrow"><thead><tr><th scope="col">{_text(first)}</th>{heads}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _row_name(first: str, name: str) -> str:
    return name.replace("_", " ") if first == "Landmark" else name


def _plots(page: EvalPage, section: str) -> str:
    out = ""
    for figure in page.figures.get(section, ()):
        alt = figure.alt or f"Plot: {figure.title}. {figure.caption}"
        out += (
            '<figure class="plot"><button type="button" class="zoom" title="Enlarge">'
            f'<img src="{_data_uri(figure.image, figure.mime)}" alt="{_text(alt)}"></button>'
            f"<figcaption><strong>{_text(figure.title)}</strong> {_text(figure.caption)}</figcaption></figure>"
        )
    return out
