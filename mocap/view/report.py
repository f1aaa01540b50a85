"""The report of a run: one HTML file that stands alone.

Everything is embedded: pictures as JPEG, plots as PNG, a few lines of style and script. Nothing is loaded from
anywhere (a content security policy inside the file forbids it), so the file can be mailed and opened in ten
years. It is written for a person who knows neither this program nor its documentation.
"""

from __future__ import annotations

import base64
import html
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.errors import MocapError
from mocap.view.overlay import MASK_COLOUR, SIDE_COLOURS, Colour

Image = NDArray[np.uint8]
Section = Literal["accuracy", "silhouettes", "tracks", "timing", "other"]

MAX_BYTES = 6_000_000

# (width px, JPEG quality) of the pictures; the first that keeps the file below its limit is used
_PICTURE_SIZES = ((640, 85), (560, 82), (480, 78), (400, 72), (320, 66), (240, 60), (160, 50))


@dataclass(frozen=True)
class Score:
    """What a key of the scores means: name, unit and one line for a reader who never heard of it."""

    name: str
    unit: str
    meaning: str


SCORES: dict[str, Score] = {
    "mean_error_mm": Score(
        "Mean error",
        "mm",
        "Distance between estimated and true landmarks, averaged over landmarks and frames.",
    ),
    "std_error_mm": Score("Spread of the error", "mm", "Standard deviation of those distances."),
    "mean_error_after_offset_mm": Score(
        "Mean error after offsets",
        "mm",
        "The same after one constant offset per landmark (first 10 frames): bodies define joints differently.",
    ),
    "lost_wrist_percent": Score(
        "Frames with a lost wrist", "%", "Frames in which a wrist lies more than 150 mm from the truth."
    ),
    "mmta_percent": Score(
        "MMTA (accuracy)",
        "%",
        "Share of landmarks that lie within epsilon of the truth, i.e. how much was found. 100 % is perfect.",
    ),
    "mmtp_mm": Score(
        "MMTP (precision)",
        "mm",
        "Mean error of only those landmarks that lie within epsilon, i.e. how precise what was found is.",
    ),
    "epsilon_mm": Score("Epsilon", "mm", "Distance up to which a landmark counts as found."),
    "epsilon_opt_mm": Score(
        "Natural epsilon",
        "mm",
        "The epsilon below which errors look like noise; beyond it limbs are lost rather than imprecise.",
    ),
    "angle_mean_deg": Score("Mean angle error", "deg", "Difference of joint angles on one common skeleton."),
    "angle_std_deg": Score("Spread of the angle error", "deg", "Standard deviation of those differences."),
    "mota_percent": Score(
        "MOTA (tracking accuracy)",
        "%",
        "100 % minus the shares of missed persons, false persons and identity switches; can be negative.",
    ),
    "motp_mm": Score(
        "MOTP (tracking precision)", "mm", "Mean distance between a track and the person it follows."
    ),
    "misses": Score("Misses", "", "Times that a person who was there had no track, summed over frames."),
    "false_positives": Score(
        "False positives", "", "Times that a track followed nobody, summed over frames."
    ),
    "mismatches": Score("Identity switches", "", "Times that a track jumped from one person to another."),
    "volume_iou": Score(
        "Volume overlap (IoU)", "", "Shared volume of hull and true body over their union; 1 is identical."
    ),
    "coverage_90_percent": Score(
        "Honesty of the uncertainty",
        "%",
        "Share of true landmarks inside the stated 90 % region. 90 is honest, less is overconfident.",
    ),
    "frames": Score("Frames scored", "", "Frames in which estimate and truth could be compared."),
}
MASK_NUMBERS: dict[str, tuple[str, str]] = {
    "foreground_share": ("Foreground", "share of the picture"),
    "shadow_share": ("Shadow", "share of the picture"),
    "flicker": (
        "Flicker",
        "share of the foreground that goes on or off for one frame while all around stays",
    ),
    "leakage": ("Leakage", "share of the foreground in small pieces apart from the persons"),
    "border_share": ("Cut off", "share of the frames in which a person touches the border of the picture"),
    "residual": (
        "Outside the volume",
        "share of the silhouette that the volume of all cameras does not reach",
    ),
}
_HEADLINE = ("mean_error_mm", "mmta_percent", "mmtp_mm", "mota_percent", "motp_mm", "volume_iou")


@dataclass(frozen=True)
class Figure:
    """One plot: image holds the bytes of a PNG or JPEG file, alt says in words what it shows."""

    title: str
    caption: str
    image: bytes
    mime: str = "image/png"
    section: Section = "other"
    alt: str = ""


@dataclass(frozen=True, eq=False)
class FramePanel:
    """One row of pictures: one camera in one frame.

    images : (label, (H, W, 3) uint8 RGB) from left to right, usually image, silhouette, hull, body.
    """

    frame: int
    title: str
    images: tuple[tuple[str, Image], ...]


@dataclass(frozen=True, eq=False)
class ReportData:
    """All that a report shows. Everything but title, session and status may be left empty.

    warnings : plain sentences; what follows "Remedy:" in one of them is set apart.  scores : keys of SCORES
    -> number or None = does not apply.  per_landmark_mm : landmark -> mean error, mm.
    timings : stage -> (seconds in all, milliseconds per frame or None).
    silhouettes : camera -> keys of MASK_NUMBERS -> share 0..1 or None = not known.
    outputs : (file name, what it is for).  command : how to make this result again.
    """

    title: str
    session: str
    status: Literal["complete", "incomplete"]
    n_persons: int | None = None
    n_frames: int | None = None
    n_cameras: int | None = None
    fps: float | None = None
    warnings: tuple[str, ...] = ()
    summary: tuple[tuple[str, str], ...] = ()
    scores: Mapping[str, float | None] | None = None
    per_landmark_mm: Mapping[str, float | None] | None = None
    timings: Mapping[str, tuple[float, float | None]] = field(default_factory=dict)
    figures: tuple[Figure, ...] = ()
    frames: tuple[FramePanel, ...] = ()
    outputs: tuple[tuple[str, str], ...] = ()
    command: str = ""
    config_text: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    silhouettes: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)


def write_report(path: Path, data: ReportData, *, max_bytes: int = MAX_BYTES) -> None:
    """Write the report as one HTML file; an earlier file is replaced only when the new one is complete.

    Pictures are shrunk, and at the very last left out evenly, until the file is below max_bytes.
    Raises MocapError when the file cannot be written.
    """
    target = Path(path)
    part = target.with_name(target.name + ".part")
    text = report_html(data, max_bytes=max_bytes)
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, target)
    except OSError as error:
        if part.exists():
            part.unlink()
        raise MocapError(
            f"the report cannot be written: {error.strerror or error}",
            remedy="choose an output folder that exists, is writable and has space left",
            path=target,
        ) from error


def report_html(data: ReportData, *, max_bytes: int = MAX_BYTES) -> str:
    """The report as text; see write_report."""
    panels = list(data.frames)
    text = ""
    for width, quality in _PICTURE_SIZES:
        text = _page(data, panels, width, quality)
        if len(text.encode("utf-8")) <= max_bytes:
            return text
    while len(panels) > 1 and len(text.encode("utf-8")) > max_bytes:
        panels = panels[::2]
        text = _page(data, panels, *_PICTURE_SIZES[-1])
    return text


def verdict(data: ReportData) -> tuple[str, ...]:
    """What was found, as plain sentences, the most important first."""
    said = []
    if data.status != "complete":
        said.append("The run did not finish: what follows shows only what was done until it stopped.")
    if data.n_persons is not None:
        who = {0: "No person was found", 1: "One person was found"}.get(
            data.n_persons, f"{data.n_persons} persons were found"
        )
        where = [f"in {data.n_frames} frame{'s' * (data.n_frames != 1)}"] if data.n_frames is not None else []
        if data.n_cameras is not None:
            where.append(f"of {data.n_cameras} camera{'s' * (data.n_cameras != 1)}")
        if data.fps and data.n_frames and data.n_frames > 1:
            where.append(f"({data.n_frames / data.fps:.1f} s at {data.fps:g} frames/s)")
        said.append(" ".join([who, *where]) + ".")
    said += _verdict_on_scores(data.scores)
    per_frame = [ms for _, ms in data.timings.values() if ms]
    if per_frame:
        said.append(f"The computation ran at {1000 / sum(per_frame):.1f} frames per second.")
    if data.warnings:
        n = len(data.warnings)
        said.append(f"There {'is one warning' if n == 1 else f'are {n} warnings'}, explained below.")
    return tuple(said)


def _verdict_on_scores(scores: Mapping[str, float | None] | None) -> list[str]:
    if not scores or all(v is None for v in scores.values()):
        return ["This session has no ground truth, so nothing is scored: judge the pictures by eye."]
    said = []
    mean, share, epsilon = (scores.get(k) for k in ("mean_error_mm", "mmta_percent", "epsilon_mm"))
    if mean is not None:
        sentence = f"Landmarks lie {mean:.0f} mm from the truth on average"
        if share is not None:
            within = f"within {epsilon:g} mm" if epsilon is not None else "close enough"
            sentence += f", and {share:.1f} % of them {within}"
            sentence += (
                ": the body was followed throughout"
                if share >= 95
                else ": mostly right, but limbs are lost at times"
                if share >= 70
                else ": limbs or the whole body are lost for long stretches"
            )
        said.append(sentence + ".")
    mota = scores.get("mota_percent")
    if mota is not None:
        switches = scores.get("mismatches")
        tail = "" if switches is None else f", with {switches:g} identity switch{'es' * (switches != 1)}"
        said.append(f"Tracking of persons is {mota:.1f} % accurate (MOTA){tail}.")
    return said


def _page(data: ReportData, panels: Sequence[FramePanel], width: int, quality: int) -> str:
    sections = [
        ("result", "Result", _result_section(data)),
        ("warnings", "Warnings", _warnings_section(data.warnings)),
        ("pictures", "Pictures", _pictures_section(data, panels, width, quality)),
        ("accuracy", "Accuracy", _accuracy_section(data)),
        *([("silhouettes", "Silhouettes", _silhouettes_section(data))] if data.silhouettes else []),
        ("tracks", "Paths", _figures(data, "tracks") or _none("No map of the paths was made.")),
        ("timing", "Timing", _timing_section(data)),
    ]
    if any(f.section == "other" for f in data.figures):
        sections.append(("more", "More plots", _figures(data, "other")))
    sections.append(("settings", "Settings and files", _settings_section(data)))
    sections.append(("versions", "Versions", _versions_section(data.versions)))
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
        f"<title>{_text(data.title)}</title><style>{_STYLE}</style></head><body>"
        f'<header><p class="kicker">Motion capture report</p><h1>{_text(data.title)}</h1>'
        f'<p class="session">{_text(data.session)} {_badge(data)}</p>'
        f'<nav aria-label="Sections">{navigation}</nav></header><main>{body}</main>'
        '<dialog id="zoom" aria-label="Enlarged picture"><img alt=""><p></p></dialog>'
        f"<script>{_SCRIPT}</script></body></html>\n"
    )


def _badge(data: ReportData) -> str:
    kind = "good" if data.status == "complete" else "bad"
    return f'<span class="badge {kind}">{_text(data.status)}</span>'


def _result_section(data: ReportData) -> str:
    first, *others = verdict(data) or ("",)
    out = f'<p class="lead">{_text(first)}</p>'
    if others:
        out += "<p>" + " ".join(_text(s) for s in others) + "</p>"
    scores = data.scores or {}
    cards = [(SCORES[key], scores[key]) for key in _HEADLINE if scores.get(key) is not None]
    if cards:
        out += '<div class="cards">'
        for score, value in cards:
            unit = f" <small>{_text(score.unit)}</small>" if score.unit else ""
            out += (
                f'<div class="card"><p class="name">{_text(score.name)}</p>'
                f'<p class="value">{_number(value, score.unit)}{unit}</p>'
                f'<p class="hint">{_text(score.meaning)}</p></div>'
            )
        out += "</div>"
    if data.summary:
        rows = "".join(
            f'<tr><th scope="row">{_text(k)}</th><td>{_text(v)}</td></tr>' for k, v in data.summary
        )
        out += f'<div class="scroll"><table class="plain"><tbody>{rows}</tbody></table></div>'
    return out


def _warnings_section(warnings: Sequence[str]) -> str:
    if not warnings:
        return _none("None.")
    out = '<ul class="warnings">'
    for warning in warnings:
        what, _, remedy = str(warning).partition("Remedy:")
        out += f"<li><p>{_text(what.strip())}</p>"
        if remedy.strip():
            out += f'<p class="remedy"><strong>What helps:</strong> {_text(remedy.strip())}</p>'
        out += "</li>"
    return out + "</ul>"


def _pictures_section(data: ReportData, panels: Sequence[FramePanel], width: int, quality: int) -> str:
    if not panels:
        return _none("No pictures were kept of this run.")
    swatches = "".join(
        f'<span><i style="background:{_css(colour)}"></i>{name}</span>'
        for name, colour in (
            ("silhouette", MASK_COLOUR),
            ("left limbs (the person's left)", SIDE_COLOURS["left"]),
            ("right limbs", SIDE_COLOURS["right"]),
            ("trunk and head", SIDE_COLOURS["middle"]),
        )
    )
    if any("skeleton" in label for panel in panels for label, _ in panel.images):
        swatches += "<span>hollow joint: not observed, only inferred</span>"
    out = (
        "<p>The same instant in each camera, from left to right: what was filmed, what was taken for the person, "
        "the volume that all silhouettes agree on, and the body fitted into it. A good run has silhouettes "
        "without holes or shadows, a volume that fills them, and limbs that lie on the person's limbs with "
        "left and right not swapped. Select a picture to enlarge it.</p>"
        f'<p class="legend">{swatches}<span><i class="depth"></i>volume, far to near</span></p>'
    )
    if len(panels) < len(data.frames):
        out += f"<p>{len(panels)} of {len(data.frames)} rows are shown, to keep this file small.</p>"
    numbers = list(dict.fromkeys(panel.frame for panel in panels))
    if len(numbers) > 1:
        ticks = ", ".join(str(n) for n in numbers)
        out += (
            '<div class="slider" hidden><button type="button" data-step="-1" aria-label="Previous">&#9664;</button>'
            f'<input type="range" min="0" max="{len(numbers) - 1}" value="0" aria-label="Frame, one of {ticks}">'
            '<button type="button" data-step="1" aria-label="Next">&#9654;</button><output></output>'
            '<label><input type="checkbox"> show all</label></div>'
        )
    for number in numbers:
        out += f'<div class="frame" data-frame="{number}"><h3>Frame {number}</h3>'
        for panel in panels:
            if panel.frame != number:
                continue
            out += f'<h4>{_text(panel.title)}</h4><div class="strip" style="--n:{len(panel.images)}">'
            for label, image in panel.images:
                alt = f"{label}, {panel.title}, frame {panel.frame}"
                out += _picture(_data_uri(_jpeg(image, width, quality), "image/jpeg"), label, alt)
            out += "</div>"
        out += "</div>"
    return out


def _picture(uri: str, label: str, alt: str) -> str:
    return (
        f'<figure class="shot"><button type="button" class="zoom" title="Enlarge">'
        f'<img src="{uri}" alt="{_text(alt)}" loading="lazy"></button>'
        f"<figcaption>{_text(label)}</figcaption></figure>"
    )


def _accuracy_section(data: ReportData) -> str:
    out = ""
    if data.scores:
        out += (
            '<div class="scroll"><table><thead><tr><th scope="col">Score</th><th scope="col" class="number">Value'
            '</th><th scope="col">What it means</th></tr></thead><tbody>'
        )
        for key in [*(k for k in SCORES if k in data.scores), *(k for k in data.scores if k not in SCORES)]:
            score = SCORES.get(key, Score(key.replace("_", " "), "", ""))
            value = data.scores[key]
            shown = "does not apply" if value is None else f"{_number(value, score.unit)} {_text(score.unit)}"
            style = "number faint" if value is None else "number"
            out += (
                f'<tr><th scope="row">{_text(score.name)}<br><code>{_text(key)}</code></th>'
                f'<td class="{style}">{shown}</td><td>{_text(score.meaning)}</td></tr>'
            )
        out += "</tbody></table></div>"
    else:
        out += _none("No ground truth came with this session, so no score can be given.")
    out += _figures(data, "accuracy")
    if data.per_landmark_mm:
        out += _landmark_table(data.per_landmark_mm)
    return out


def _landmark_table(per_landmark_mm: Mapping[str, float | None]) -> str:
    known = [v for v in per_landmark_mm.values() if v is not None and np.isfinite(v)]
    longest = max([*known, 1e-9])
    rows = ""
    for name, value in per_landmark_mm.items():
        is_known = value is not None and np.isfinite(value)
        share = 100 * float(value or 0) / longest if is_known else 0.0
        shown = f"{value:.0f} mm" if is_known else "not scored"
        rows += (
            f'<tr><th scope="row">{_text(name.replace("_", " "))}</th><td class="number">{shown}</td>'
            f'<td class="bar"><i style="width:{share:.1f}%"></i></td></tr>'
        )
    return (
        "<details><summary>Mean error of each landmark, in numbers</summary><div class='scroll'><table><thead>"
        "<tr><th scope='col'>Landmark</th><th scope='col' class='number'>Mean error</th><th scope='col'>"
        f"<span class='sr'>as a bar</span></th></tr></thead><tbody>{rows}</tbody></table></div></details>"
    )


def _silhouettes_section(data: ReportData) -> str:
    heads = "".join(
        f'<th scope="col" class="number" title="{_text(meaning)}">{_text(name)} (%)</th>'
        for name, meaning in MASK_NUMBERS.values()
    )
    rows = ""
    for camera, numbers in data.silhouettes.items():
        cells = ""
        for key in MASK_NUMBERS:
            value = numbers.get(key)
            cells += f'<td class="number">{"" if value is None else f"{100 * value:.1f}"}</td>'
        rows += f'<tr><th scope="row">{_text(camera)}</th>{cells}</tr>'
    words = "; ".join(f"{name.lower()}: {meaning}" for name, meaning in MASK_NUMBERS.values())
    return (
        f"<p>How good the silhouettes of each camera are, judged without truth. {_text(words.capitalize())}. What is "
        "too large is among the warnings, with what helps.</p>"
        f'<div class="scroll"><table class="narrow"><thead><tr><th scope="col">Camera</th>{heads}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>" + _figures(data, "silhouettes")
    )


def _timing_section(data: ReportData) -> str:
    if not data.timings:
        return _figures(data, "timing") or _none("No stage was timed.")
    rows = ""
    for stage, (seconds, ms) in data.timings.items():
        shown = "" if ms is None else f"{ms:.1f}"
        rows += (
            f'<tr><th scope="row">{_text(stage.replace("_", " "))}</th>'
            f'<td class="number">{seconds:.2f}</td><td class="number">{shown}</td></tr>'
        )
    total = sum(seconds for seconds, _ in data.timings.values())
    per_frame = sum(ms for _, ms in data.timings.values() if ms is not None)
    speed = f"{per_frame:.1f}" if per_frame else ""
    return (
        '<div class="scroll"><table class="narrow"><thead><tr><th scope="col">Stage</th><th scope="col" class="number">'
        'Seconds</th><th scope="col" class="number">Milliseconds per frame</th></tr></thead>'
        f'<tbody>{rows}</tbody><tfoot><tr><th scope="row">all</th><td class="number">{total:.2f}</td>'
        f'<td class="number">{speed}</td></tr></tfoot></table></div>' + _figures(data, "timing")
    )


def _settings_section(data: ReportData) -> str:
    out = ""
    if data.command:
        out += f"<p>This command makes the same result again:</p><pre>{_text(data.command)}</pre>"
    if data.outputs:
        rows = "".join(
            f'<tr><th scope="row"><code>{_text(name)}</code></th><td>{_text(what)}</td></tr>'
            for name, what in data.outputs
        )
        table = f'<table class="plain"><tbody>{rows}</tbody></table>'
        out += f'<p>Files beside this report:</p><div class="scroll">{table}</div>'
    if data.config_text:
        out += f"<details><summary>All settings of the run</summary><pre>{_text(data.config_text)}</pre></details>"
    return out or _none("No settings were recorded.")


def _versions_section(versions: Mapping[str, str]) -> str:
    if not versions:
        return _none("No versions were recorded.")
    rows = "".join(
        f'<tr><th scope="row">{_text(k)}</th><td>{_text(v)}</td></tr>' for k, v in versions.items()
    )
    return f'<div class="scroll"><table class="plain"><tbody>{rows}</tbody></table></div>'


def _figures(data: ReportData, section: Section) -> str:
    out = ""
    for figure in data.figures:
        if figure.section == section:
            alt = figure.alt or f"Plot: {figure.title}. {figure.caption}"
            out += (
                f'<figure class="plot"><button type="button" class="zoom" title="Enlarge">'
                f'<img src="{_data_uri(figure.image, figure.mime)}" alt="{_text(alt)}"></button>'
                f"<figcaption><strong>{_text(figure.title)}</strong> {_text(figure.caption)}</figcaption></figure>"
            )
    return out


def _jpeg(image: Image, width: int, quality: int) -> bytes:
    array = np.asarray(image)
    if array.ndim != 3 or array.shape[2] != 3 or array.dtype != np.uint8 or array.size == 0:
        raise ValueError(f"picture is {array.dtype} {array.shape}, expected uint8 (H, W, 3) RGB")
    h, w = array.shape[:2]
    if w > width:
        size = (width, max(1, round(h * width / w)))
        array = np.asarray(cv2.resize(np.ascontiguousarray(array), size, interpolation=cv2.INTER_AREA))
    ok, coded = cv2.imencode(".jpg", array[..., ::-1].copy(), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not ok:
        raise ValueError(f"picture of shape {array.shape} cannot be coded as JPEG")
    return coded.tobytes()


def _data_uri(content: bytes, mime: str) -> str:
    return f"data:{html.escape(mime)};base64,{base64.b64encode(content).decode('ascii')}"


def _text(value: object) -> str:
    return html.escape(str(value), quote=True).replace(" %", "\u00a0%")


def _none(sentence: str) -> str:
    return f'<p class="faint">{_text(sentence)}</p>'


def _number(value: float | None, unit: str = "") -> str:
    """A score with as many digits as mean something: tenths with a unit, thousandths of a plain ratio."""
    if value is None or not np.isfinite(value):
        return "unknown"
    if unit:
        return f"{value:.1f}"
    return f"{int(value)}" if float(value).is_integer() else f"{value:.3f}"


def _css(colour: Colour) -> str:
    return "rgb({}, {}, {})".format(*colour)


_STYLE = """
:root{color-scheme:light dark;--ground:#f5f6f8;--card:#fff;--ink:#1d2329;--faint:#626c78;--line:#dde1e6;
--accent:#0b63a5;--good:#0a7a55;--bad:#b3400a;--warn:#fff6e3;--warnline:#e6a100}
@media (prefers-color-scheme:dark){:root{--ground:#15181c;--card:#1f2429;--ink:#e8ebee;--faint:#9aa5b1;
--line:#343b43;--accent:#6db8ef;--good:#45c797;--bad:#ff9a5c;--warn:#332a14;--warnline:#c58d08}}
*{box-sizing:border-box}
body{margin:0;background:var(--ground);color:var(--ink);font:16px/1.55 system-ui,-apple-system,"Segoe UI",
Roboto,"Noto Sans","DejaVu Sans",sans-serif}
header,main{max-width:1180px;margin:0 auto;padding:0 24px}
header{padding-top:36px}
.kicker{margin:0;color:var(--faint);font-size:13px;letter-spacing:.08em;text-transform:uppercase}
h1{margin:2px 0 4px;font-size:30px;line-height:1.2;overflow-wrap:anywhere}
h2{margin:0 0 12px;font-size:20px}
h3{margin:18px 0 4px;font-size:17px}
h4{margin:10px 0 6px;font-size:14px;color:var(--faint);font-weight:600}
.session{margin:0 0 14px;color:var(--faint);overflow-wrap:anywhere}
nav{display:flex;flex-wrap:wrap;gap:4px 18px;padding:10px 0;border-top:1px solid var(--line);font-size:15px}
nav a{color:var(--accent);text-decoration:none}
nav a:hover,nav a:focus-visible{text-decoration:underline}
section{background:var(--card);border:1px solid var(--line);border-radius:10px;padding:22px 24px;margin:0 0 18px;
scroll-margin-top:12px}
.lead{font-size:19px;margin:0 0 8px}
p{max-width:86ch;margin:0 0 10px}
.badge{display:inline-block;margin-left:6px;padding:1px 10px;border:1px solid currentColor;border-radius:99px;
font-size:13px;font-weight:600}
.good{color:var(--good)}.bad{color:var(--bad)}.faint{color:var(--faint)}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(165px,1fr));gap:12px;margin:16px 0}
.card{border:1px solid var(--line);border-radius:8px;padding:12px 14px}
.card p{margin:0}.card .name{font-size:13px;color:var(--faint);font-weight:600}
.card .value{font-size:28px;font-weight:650;line-height:1.3;font-variant-numeric:tabular-nums}
.card small{font-size:15px;font-weight:500}.card .hint{font-size:12.5px;line-height:1.4;color:var(--faint)}
.scroll{overflow-x:auto}
table{border-collapse:collapse;width:100%;margin:6px 0 14px;font-size:15px}
table.plain,table.narrow{width:auto;min-width:min(420px,100%)}
th,td{text-align:left;vertical-align:top;padding:6px 14px 6px 0;border-bottom:1px solid var(--line)}
th{font-weight:600}thead th{color:var(--faint);font-size:13px}tfoot th,tfoot td{font-weight:650;border-bottom:0}
td.number,th.number{text-align:right;white-space:nowrap;font-variant-numeric:tabular-nums;padding-right:24px}
.bar{width:50%;vertical-align:middle}.bar i{display:block;height:10px;background:var(--accent);border-radius:2px}
code,pre{font-family:ui-monospace,"DejaVu Sans Mono",Menlo,Consolas,monospace;font-size:13px}
th code{font-weight:400;color:var(--faint)}
pre{background:var(--ground);border:1px solid var(--line);border-radius:6px;padding:12px;overflow-x:auto;
white-space:pre-wrap;overflow-wrap:anywhere}
summary{cursor:pointer;font-weight:600;margin:6px 0}
.warnings{list-style:none;margin:0;padding:0}
.warnings li{background:var(--warn);border-left:4px solid var(--warnline);border-radius:4px;padding:10px 14px;
margin:0 0 10px}
.warnings p{margin:0}.warnings .remedy{margin-top:4px}
.legend{display:flex;flex-wrap:wrap;gap:4px 18px;font-size:14px;color:var(--faint)}
.legend i{display:inline-block;width:14px;height:14px;margin-right:6px;border-radius:3px;vertical-align:-2px;
border:1px solid #0006}
.legend i.depth{width:44px;background:linear-gradient(90deg,#00306f,#7b7b78,#fde737)}
.strip{display:grid;grid-template-columns:repeat(auto-fit,minmax(190px,1fr));gap:10px}
figure{margin:0}.shot figcaption{font-size:13.5px;color:var(--faint);padding:3px 0 6px}
.zoom{display:block;width:100%;padding:0;border:0;background:none;cursor:zoom-in;border-radius:6px}
.zoom:focus-visible{outline:3px solid var(--accent);outline-offset:2px}
.zoom img{display:block;width:100%;height:auto;border-radius:6px}
.plot{margin:14px 0 18px}.plot .zoom{max-width:1000px;background:#fff;border:1px solid var(--line);padding:8px}
.plot .zoom img{width:auto;max-width:100%;margin:0 auto}
.plot figcaption{font-size:14.5px;padding-top:6px;max-width:86ch;color:var(--faint)}
.plot figcaption strong{color:var(--ink)}
.slider{display:flex;flex-wrap:wrap;align-items:center;gap:10px;margin:12px 0;position:sticky;top:0;z-index:2;
background:var(--card);padding:8px 0}
.slider[hidden],.frame[hidden]{display:none}
.slider input[type=range]{flex:1;min-width:160px;accent-color:var(--accent)}
.slider button{font:inherit;padding:2px 12px;border:1px solid var(--line);border-radius:6px;background:var(--ground);
color:var(--ink);cursor:pointer}
.slider output{min-width:8ch;font-weight:600;font-variant-numeric:tabular-nums}
dialog{border:0;padding:12px;border-radius:10px;background:#111;color:#eee;max-width:96vw;max-height:96vh}
dialog::backdrop{background:#000b}
dialog img{display:block;max-width:92vw;max-height:84vh;min-width:min(70vw,720px);margin:0 auto;object-fit:contain}
dialog p{margin:8px 0 0;font-size:14px}
.sr{position:absolute;width:1px;height:1px;overflow:hidden;clip-path:inset(50%)}
@media print{:root{--ground:#fff;--card:#fff;--ink:#000;--faint:#444;--line:#bbb;--accent:#0b63a5;color-scheme:light}
body{font-size:11pt}nav,.slider{display:none!important}.frame[hidden]{display:block!important}
section{border:0;padding:0 0 12pt;margin:0}figure,tr,li,.card{break-inside:avoid}h2,h3,h4{break-after:avoid}
.strip{grid-template-columns:repeat(var(--n,4),1fr)}}
"""

_SCRIPT = """
"use strict";
(function(){
var box=document.getElementById("zoom"),big=box.querySelector("img"),text=box.querySelector("p");
document.querySelectorAll("button.zoom").forEach(function(b){b.addEventListener("click",function(){
var i=b.querySelector("img");big.src=i.src;big.alt=i.alt;text.textContent=i.alt;box.showModal();});});
box.addEventListener("click",function(){box.close();});
var bar=document.querySelector(".slider");if(!bar){return;}
var frames=document.querySelectorAll(".frame"),range=bar.querySelector("input[type=range]");
var all=bar.querySelector("input[type=checkbox]"),out=bar.querySelector("output");
function show(){frames.forEach(function(f,i){f.hidden=!all.checked&&i!==+range.value;});
out.textContent="frame "+frames[+range.value].dataset.frame;}
range.addEventListener("input",show);all.addEventListener("change",show);
bar.querySelectorAll("button").forEach(function(b){b.addEventListener("click",function(){
range.value=+range.value+ +b.dataset.step;show();});});
bar.hidden=false;show();
})();
"""
