"""The page of an evaluation: one HTML file that stands alone, in the looks of a run's report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mocap.metrics.catalogue import heading
from mocap.view.html import (
    Figure,
    PageSection,
    escaped,
    faint,
    figures_html,
    number_text,
    page_html,
    score_cards,
    score_table,
    verdict_on_scores,
    warning_list,
    write_html,
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
_ALIGNMENTS = {
    "none": ("as it is", "in the world frame"),
    "root": ("root-aligned", "pelvis moved onto the true one in every frame"),
    "rigid": ("rigidly aligned", "rotated and moved onto the truth in every frame"),
    "procrustes": ("Procrustes-aligned (PA)", "rotated, moved and scaled in every frame"),
}
_POINT_COLUMNS = tuple(
    (key, heading(key))
    for key in (
        "mean_error_mm",
        "std_error_mm",
        "mmtp_mm",
        "mmtp_std_mm",
        "mmta_percent",
        "pck_auc_percent",
    )
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
    write_html(Path(path), eval_html(page), what="the page")


def eval_html(page: EvalPage) -> str:
    """The page as text. Nothing is loaded from anywhere; a content security policy forbids it."""
    s = page.scores
    sections = [
        PageSection("result", "Result", _result(page)),
        PageSection("warnings", "Warnings", warning_list(s.get("warnings") or ())),
        PageSection("inputs", "What was compared", _inputs(s)),
        PageSection("points", "Points", _points(page)),
        PageSection("epsilon", "Epsilon without a parameter", _epsilon(page)),
        PageSection("angles", "Angles", _angles(page)),
        PageSection("offsets", "Different skeletons", _offsets(s)),
    ]
    if s.get("per_action"):
        sections.append(PageSection("actions", "Actions", _actions(s)))
    if len(s.get("per_person") or {}) > 1:
        sections.append(PageSection("persons", "Persons", _point_table("Person", s["per_person"])))
    if s.get("reliability"):
        sections.append(PageSection("uncertainty", "Uncertainty", _uncertainty(page)))
    if s.get("image"):
        sections.append(PageSection("image", "In the pictures", _image(s["image"])))
    sections += [
        *([PageSection("limbs", "Lost limbs", _limbs(s["lost_limbs"]))] if s.get("lost_limbs") else []),
        PageSection("numbers", "All numbers", _numbers(s)),
        PageSection(
            "command",
            "Command",
            f"<pre>{escaped(page.command)}</pre>" if page.command else faint("Not recorded."),
        ),
    ]
    return page_html(page.title, "Evaluation of motion", sections)


def _result(page: EvalPage) -> str:
    s = page.scores
    said = verdict_on_scores(s) if s.get("mean_error_mm") is not None else []
    if s.get("unit_warning"):
        said = ["A unit is probably wrong, so that the errors below say nothing: see the warnings."]
    lead = said[0] if said else "Nobody of the truth was found in the estimate, so there is no error to give."
    out = f'<p class="lead">{escaped(lead)}</p>' + "".join(f"<p>{escaped(t)}</p>" for t in said[1:])
    return f'{out}<div class="cards">{score_cards(s, _HEADLINE)}</div>'


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
        shown = ["not known" if c is None else escaped(c) for c in cells]
        body += f'<tr><th scope="row">{name}</th><td>{shown[0]}</td><td>{shown[1]}</td></tr>'
    out = (
        '<div class="scroll"><table class="narrow"><thead><tr><th></th><th scope="col">Estimate</th>'
        f'<th scope="col">Truth</th></tr></thead><tbody>{body}</tbody></table></div>'
    )
    notes = s.get("notes") or ()
    if notes:
        out += (
            "<p>What had to be assumed or left out:</p><ul>"
            + "".join(f"<li>{escaped(n)}</li>" for n in notes)
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
        f"<p>{escaped(words[0].upper() + words[1:])}. A large difference between the rows says that the body stands or "
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
        return faint("Too few errors to say anything about their distribution.") + _plots(page, "epsilon")
    out = (
        f"<p>Up to {search['by_lilliefors_mm']:.1f} mm the errors look most like noise by the Lilliefors statistic, "
        f"up to {search['by_r2_mm']:.1f} mm by the straightness of their quantiles. With the first as epsilon, MMTP is "
        f"{number_text(search['mmtp_mm'], 'mm')} ± {number_text(search['mmtp_std_mm'], 'mm')} mm and MMTA "
        f"{number_text(search['mmta_percent'], '%')} %.</p>"
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
        return faint("Too few common frames to learn offsets and to hold frames out.")
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
        return faint(f"None of {found['n_scored']} limbs was without data, and none was said to be.")
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
    return score_table(
        (key, value)
        for key, value in s.items()
        if not isinstance(value, dict | list | str) and key not in ("estimate", "truth", "unit_warning")
    )


def _point_table(first: str, rows: Mapping[str, Mapping[str, Any]]) -> str:
    return _table(first, _POINT_COLUMNS, rows)


def _table(first: str, columns: Sequence[tuple[str, str]], rows: Mapping[str, Mapping[str, Any]]) -> str:
    """A table of numbers; columns that no row has are left out."""
    used = [(key, name) for key, name in columns if any(row.get(key) is not None for row in rows.values())]
    heads = "".join(f'<th scope="col" class="number">{escaped(name)}</th>' for _, name in used)
    body = ""
    for name, row in rows.items():
        cells = "".join(
            '<td class="number faint">not scored</td>'
            if row.get(key) is None
            else f'<td class="number">{number_text(row[key], "" if key == "frames" else "x")}</td>'
            for key, _ in used
        )
        body += f'<tr><th scope="row">{escaped(_row_name(first, name))}</th>{cells}</tr>'
    return (
        '<div class="scroll"><table class="narrow"><thead><tr>'
        f'<th scope="col">{escaped(first)}</th>{heads}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _row_name(first: str, name: str) -> str:
    return name.replace("_", " ") if first == "Landmark" else name


def _plots(page: EvalPage, section: str) -> str:
    return figures_html(page.figures.get(section, ()))
