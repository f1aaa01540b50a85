"""The report of a run: one HTML file that stands alone.

Everything is embedded: pictures as JPEG, plots as SVG, a few lines of style and script. Nothing is loaded from
anywhere (a content security policy inside the file forbids it), so the file can be mailed and opened in ten
years. It is written for a person who knows neither this program nor its documentation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal
from urllib.parse import quote

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.view.curves import Chart, charts_html
from mocap.view.html import (
    Figure,
    PageSection,
    Section,
    data_uri,
    escaped,
    faint,
    figures_html,
    page_html,
    plain_table,
    score_cards,
    score_table,
    verdict_on_scores,
    warning_list,
    write_html,
)
from mocap.view.overlay import MASK_COLOUR, SIDE_COLOURS, Colour
from mocap.view.replay import Replay, replay_html

Image = NDArray[np.uint8]

MAX_BYTES = 5_000_000

# (width px, JPEG quality) of the pictures; the first that keeps the file below its limit is used
_PICTURE_SIZES = ((640, 85), (560, 82), (480, 78), (400, 72), (320, 66), (240, 60), (160, 50))


# Keys of the scores that a report shows, in its order.
REPORT_SCORES = (
    "mean_error_mm",
    "std_error_mm",
    "mean_error_after_offset_mm",
    "lost_wrist_percent",
    "mmta_percent",
    "mmtp_mm",
    "epsilon_mm",
    "epsilon_opt_mm",
    "angle_mean_deg",
    "angle_std_deg",
    "mota_percent",
    "motp_mm",
    "misses",
    "false_positives",
    "mismatches",
    "volume_iou",
    "coverage_90_percent",
    "silent_errors",
    "frames",
)
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
# More are a matter of the command line; they would be a page of their own.
_MOST_PLACES = 40
_HEADLINE = ("mean_error_mm", "mmta_percent", "mmtp_mm", "mota_percent", "motp_mm", "volume_iou")


@dataclass(frozen=True, eq=False)
class FramePanel:
    """One row of pictures: one camera in one frame.

    images : (label, (H, W, 3) uint8 RGB) from left to right, usually image, silhouette, hull, body.
    """

    frame: int
    title: str
    images: tuple[tuple[str, Image], ...]


@dataclass(frozen=True, eq=False)
class PersonPage:
    """What a report says of one person.  charts : curves over time.  summary : lines to be pasted into a table."""

    name: str
    charts: tuple[Chart, ...]
    summary: str


@dataclass(frozen=True)
class Place:
    """Frames that are worth looking at.  worst : the frame to begin with.  value : how doubtful it is.  why : words."""

    name: str
    frames: range
    worst: int
    value: float
    why: str


@dataclass(frozen=True, eq=False)
class ReportData:
    """All that a report shows. Everything but title, session and status may be left empty.

    warnings : plain sentences; what follows "Remedy:" in one of them is set apart.  scores : keys of REPORT_SCORES
    -> number or None = does not apply.  per_landmark_mm : landmark -> mean error, mm.
    timings : stage -> (seconds in all, milliseconds per frame or None).
    silhouettes : camera -> keys of MASK_NUMBERS -> share 0..1 or None = not known.
    outputs : (file name, what it is for).  command : how to make this result again.  replay : the motion, frame by
    frame.  people : curves and summary of every person.  places : what is worth looking at, most doubtful first; None =
    nobody has looked for it.
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
    charts: tuple[tuple[Section, Chart], ...] = ()
    frames: tuple[FramePanel, ...] = ()
    outputs: tuple[tuple[str, str], ...] = ()
    command: str = ""
    config_text: str = ""
    versions: Mapping[str, str] = field(default_factory=dict)
    silhouettes: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)
    replay: Replay | None = None
    people: tuple[PersonPage, ...] = ()
    places: tuple[Place, ...] | None = None


def write_report(path: Path, data: ReportData, *, max_bytes: int = MAX_BYTES) -> None:
    """Write the report as one HTML file; an earlier file is replaced only when the new one is complete.

    Pictures are shrunk, and at the very last left out evenly, until the file is below max_bytes.
    Raises MocapError when the file cannot be written.
    """
    write_html(Path(path), report_html(data, max_bytes=max_bytes), what="the report")


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
    sentences = []
    if data.status != "complete":
        sentences.append("The run did not finish: what follows shows only what was done until it stopped.")
    if data.n_persons is not None:
        sentences.append(" ".join([_persons_text(data.n_persons), *_clip_words(data)]) + ".")
    sentences += verdict_on_scores(data.scores)
    per_frame = [ms for _, ms in data.timings.values() if ms]
    if per_frame:
        sentences.append(f"The computation ran at {1000 / sum(per_frame):.1f} frames per second.")
    if data.warnings:
        n = len(data.warnings)
        sentences.append(f"There {'is one warning' if n == 1 else f'are {n} warnings'}, explained below.")
    return tuple(sentences)


def _persons_text(n: int) -> str:
    return {0: "No person was found", 1: "One person was found"}.get(n, f"{n} persons were found")


def _clip_words(data: ReportData) -> list[str]:
    """Of how many frames and cameras, and how long, as far as that is known."""
    words = []
    if data.n_frames is not None:
        words.append(f"in {data.n_frames} frame{'s' * (data.n_frames != 1)}")
    if data.n_cameras is not None:
        words.append(f"of {data.n_cameras} camera{'s' * (data.n_cameras != 1)}")
    if data.fps and data.n_frames and data.n_frames > 1:
        words.append(f"({data.n_frames / data.fps:.1f} s at {data.fps:g} frames/s)")
    return words


def _page(data: ReportData, panels: Sequence[FramePanel], width: int, quality: int) -> str:
    sections = [
        PageSection("result", "Result", _result_section(data)),
        *([PageSection("replay", "Replay", replay_html(data.replay))] if data.replay else []),
        *([PageSection("people", "Persons", _people_section(data))] if data.people else []),
        *([] if data.places is None else [PageSection("places", "Frames to look at", _places_section(data))]),
        PageSection("warnings", "Warnings", warning_list(data.warnings)),
        PageSection("files", "Files", _files_section(data)),
        PageSection("pictures", "Pictures", _pictures_section(data, panels, width, quality)),
        PageSection("accuracy", "Accuracy", _accuracy_section(data), is_folded=True),
        *(
            [PageSection("silhouettes", "Silhouettes", _silhouettes_section(data), is_folded=True)]
            if data.silhouettes
            else []
        ),
        PageSection("tracks", "Paths", _figures(data, "tracks") or faint("No map of the paths was made.")),
        PageSection("timing", "Timing", _timing_section(data), is_folded=True),
    ]
    if _figures(data, "other"):
        sections.append(PageSection("more", "More plots", _figures(data, "other"), is_folded=True))
    sections.append(PageSection("settings", "Settings", _settings_section(data), is_folded=True))
    sections.append(PageSection("versions", "Versions", _versions_section(data.versions), is_folded=True))
    subtitle = f'<p class="session">{escaped(data.session)} {_badge(data)}</p>'
    return page_html(data.title, "Motion capture report", sections, subtitle=subtitle)


def _badge(data: ReportData) -> str:
    kind = "good" if data.status == "complete" else "bad"
    return f'<span class="badge {kind}">{escaped(data.status)}</span>'


def _result_section(data: ReportData) -> str:
    first, *others = verdict(data) or ("",)
    out = f'<p class="lead">{escaped(first)}</p>'
    if others:
        out += "<p>" + " ".join(escaped(s) for s in others) + "</p>"
    if cards := score_cards(data.scores or {}, _HEADLINE):
        out += f'<div class="cards">{cards}</div>'
    if data.summary:
        out += plain_table(data.summary)
    return out


def _pictures_section(data: ReportData, panels: Sequence[FramePanel], width: int, quality: int) -> str:
    if not panels:
        return faint("No pictures were kept of this run.")
    has_volume = _has(panels, "hull")
    shown, good = _VOLUME_WORDS if has_volume else _POINT_WORDS
    filmed = "what was filmed, " if _has(panels, "image") else ""
    far = '<span><i class="depth"></i>volume, far to near</span>' if has_volume else ""
    out = (
        f"<p>The same instant in each camera, from left to right: {filmed}{shown}. A good run has {good} "
        "limbs that lie on the person's limbs with left and right not swapped. Select a picture to enlarge it.</p>"
        f'<p class="legend">{_swatches(panels)}{far}</p>'
    )
    if len(panels) < len(data.frames):
        out += f"<p>{len(panels)} of {len(data.frames)} rows are shown, to keep this file small.</p>"
    numbers = list(dict.fromkeys(panel.frame for panel in panels))
    if len(numbers) > 1:
        out += _frame_slider(numbers)
    for number in numbers:
        rows = (_strip(panel, width, quality) for panel in panels if panel.frame == number)
        out += f'<div class="frame" data-frame="{number}"><h3>Frame {number}</h3>{"".join(rows)}</div>'
    return out


_VOLUME_WORDS = (
    "what was taken for the person, the volume that all silhouettes agree on, and the body fitted into it",
    "silhouettes without holes or shadows, a volume that fills them, and",
)
_POINT_WORDS = ("the points that were detected, and the body fitted to them", "points on the person, and")


def _has(panels: Sequence[FramePanel], word: str) -> bool:
    return any(word in label for panel in panels for label, _ in panel.images)


def _swatches(panels: Sequence[FramePanel]) -> str:
    """What the colours of the pictures mean."""
    swatches = "".join(
        f'<span><i style="background:{_css(colour)}"></i>{name}</span>'
        for name, colour in (
            *((("silhouette", MASK_COLOUR),) if _has(panels, "silhouette") else ()),
            ("left limbs (the person's left)", SIDE_COLOURS["left"]),
            ("right limbs", SIDE_COLOURS["right"]),
            ("trunk and head", SIDE_COLOURS["middle"]),
        )
    )
    if _has(panels, "skeleton"):
        swatches += "<span>hollow joint: not observed, only inferred</span>"
    return swatches


def _frame_slider(numbers: Sequence[int]) -> str:
    ticks = ", ".join(str(n) for n in numbers)
    return (
        '<div class="slider" hidden><button type="button" data-step="-1" aria-label="Previous">&#9664;</button>'
        f'<input type="range" min="0" max="{len(numbers) - 1}" value="0" aria-label="Frame, one of {ticks}">'
        '<button type="button" data-step="1" aria-label="Next">&#9654;</button><output></output>'
        '<label><input type="checkbox"> show all</label></div>'
    )


def _strip(panel: FramePanel, width: int, quality: int) -> str:
    """The pictures of one camera in one frame, side by side."""
    pictures = "".join(
        _picture(
            data_uri(_jpeg(image, width, quality), "image/jpeg"),
            label,
            f"{label}, {panel.title}, frame {panel.frame}",
        )
        for label, image in panel.images
    )
    return (
        f'<h4>{escaped(panel.title)}</h4><div class="strip" style="--n:{len(panel.images)}">{pictures}</div>'
    )


def _picture(uri: str, label: str, alt: str) -> str:
    return (
        f'<figure class="shot"><button type="button" class="zoom" title="Enlarge">'
        f'<img src="{uri}" alt="{escaped(alt)}" loading="lazy"></button>'
        f"<figcaption>{escaped(label)}</figcaption></figure>"
    )


def _accuracy_section(data: ReportData) -> str:
    out = ""
    if data.scores:
        known = [k for k in REPORT_SCORES if k in data.scores]
        keys = [*known, *(k for k in data.scores if k not in REPORT_SCORES)]
        out += score_table((key, data.scores[key]) for key in keys)
    else:
        out += faint("No ground truth came with this session, so no score can be given.")
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
            f'<tr><th scope="row">{escaped(name.replace("_", " "))}</th><td class="number">{shown}</td>'
            f'<td class="bar"><i style="width:{share:.1f}%"></i></td></tr>'
        )
    return (
        "<details><summary>Mean error of each landmark, in numbers</summary><div class='scroll'><table><thead>"
        "<tr><th scope='col'>Landmark</th><th scope='col' class='number'>Mean error</th><th scope='col'>"
        f"<span class='sr'>as a bar</span></th></tr></thead><tbody>{rows}</tbody></table></div></details>"
    )


def _silhouettes_section(data: ReportData) -> str:
    heads = "".join(
        f'<th scope="col" class="number" title="{escaped(meaning)}">{escaped(name)} (%)</th>'
        for name, meaning in MASK_NUMBERS.values()
    )
    rows = ""
    for camera, numbers in data.silhouettes.items():
        cells = ""
        for key in MASK_NUMBERS:
            value = numbers.get(key)
            cells += f'<td class="number">{"" if value is None else f"{100 * value:.1f}"}</td>'
        rows += f'<tr><th scope="row">{escaped(camera)}</th>{cells}</tr>'
    words = "; ".join(f"{name.lower()}: {meaning}" for name, meaning in MASK_NUMBERS.values())
    return (
        f"<p>How good the silhouettes of each camera are, judged without truth. {escaped(words.capitalize())}. What is "
        "too large is among the warnings, with what helps.</p>"
        f'<div class="scroll"><table class="narrow"><thead><tr><th scope="col">Camera</th>{heads}</tr></thead>'
        f"<tbody>{rows}</tbody></table></div>" + _figures(data, "silhouettes")
    )


def _timing_section(data: ReportData) -> str:
    if not data.timings:
        return _figures(data, "timing") or faint("No stage was timed.")
    rows = ""
    for stage, (seconds, ms) in data.timings.items():
        shown = "" if ms is None else f"{ms:.1f}"
        rows += (
            f'<tr><th scope="row">{escaped(stage.replace("_", " "))}</th>'
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
        out += f"<p>This command makes the same result again:</p><pre>{escaped(data.command)}</pre>"
    if data.config_text:
        out += f"<details><summary>All settings of the run</summary><pre>{escaped(data.config_text)}</pre></details>"
    return out or faint("No settings were recorded.")


def _people_section(data: ReportData) -> str:
    """Curves and summary of every person."""
    out = ""
    if any(person.charts for person in data.people):
        out = (
            "<p>The band round a curve holds the truth in 90 % of frames; a curve is dashed where the pictures did not "
            "show what it says. Select a place in a curve to see that instant in the replay. Angles and signs are "
            "defined in docs/angles.md; the person's left is blue, the right orange.</p>"
        )
    for i, person in enumerate(data.people):
        rows = person.summary.count("\n") + 1
        out += (
            f"<h3>{escaped(person.name.capitalize())}</h3>{charts_html(person.charts) if person.charts else ''}"
            f'<details><summary>Numbers to copy</summary><p><button type="button" class="copy" '
            f'data-of="summary-{i}">Copy</button></p><textarea class="summary" id="summary-{i}" readonly '
            f'rows="{min(rows, 14)}" aria-label="Numbers of {escaped(person.name)}">{escaped(person.summary)}'
            "</textarea></details>"
        )
    return out


def _files_section(data: ReportData) -> str:
    """Links to what lies beside the page."""
    if not data.outputs:
        return faint("Nothing was written beside this page.")
    rows = "".join(
        f'<tr><th scope="row"><a href="{quote(name)}"><code>{escaped(name)}</code></a></th>'
        f"<td>{escaped(what)}</td></tr>"
        for name, what in data.outputs
    )
    table = f'<table class="plain"><tbody>{rows}</tbody></table>'
    return f'<p>These lie beside this page, in the same folder.</p><div class="scroll">{table}</div>'


def _places_section(data: ReportData) -> str:
    """What is worth looking at, most doubtful first."""
    places = data.places or ()
    if not places:
        return faint("No frame stands out: nothing is uncertain, unseen, jumps or fits worse than usual.")
    rows = "".join(
        f'<tr><td class="number">{place.value:.1f}</td><th scope="row">{escaped(place.name)}</th>'
        f"<td>{_frame_words(place.frames)}</td>"
        f'<td><button type="button" class="seek" data-frame="{place.worst}">{place.worst}</button></td>'
        f"<td>{escaped(place.why)}</td></tr>"
        for place in places[:_MOST_PLACES]
    )
    left = len(places) - _MOST_PLACES
    more = faint(f"And {left} more: mocap edit OUT --doubtful lists them all.") if left > 0 else ""
    return (
        "<p>Most doubtful first, judged without truth by the deviations, by what was not observed, by jumps and by how "
        "well the body explains what was seen. Select a frame to see it in the replay. What is wrong can be mended "
        "with <code>mocap edit</code> (docs/edits.md).</p>"
        '<div class="scroll"><table><thead><tr><th scope="col" class="number">Doubt</th><th scope="col">Who</th>'
        '<th scope="col">Frames</th><th scope="col">Worst</th><th scope="col">Why</th></tr></thead>'
        f"<tbody>{rows}</tbody></table></div>{more}"
    )


def _frame_words(frames: range) -> str:
    return f"{frames.start}" if len(frames) == 1 else f"{frames.start} to {frames.stop - 1}"


def _versions_section(versions: Mapping[str, str]) -> str:
    if not versions:
        return faint("No versions were recorded.")
    return plain_table(versions.items())


def _figures(data: ReportData, section: Section) -> str:
    """Curves, then pictures of a section."""
    own = [chart for of, chart in data.charts if of == section]
    return (charts_html(own) if own else "") + figures_html(f for f in data.figures if f.section == section)


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


def _css(colour: Colour) -> str:
    return "rgb({}, {}, {})".format(*colour)
