"""The report: one file that stands alone, escapes what it is told and says what was found."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import view_world as world

from mocap.errors import MocapError
from mocap.metrics.catalogue import CATALOGUE
from mocap.view import draw_body, draw_hull, draw_mask, plot_landmark_errors
from mocap.view.html import Figure
from mocap.view.report import REPORT_SCORES, FramePanel, ReportData, report_html, verdict, write_report

SECTIONS = ("result", "warnings", "pictures", "accuracy", "tracks", "timing", "settings", "versions")
VOID = {"meta", "img", "input", "br"}


class Checker(HTMLParser):
    """Collects links, ids and pictures, and demands that every element is closed in order."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.links: list[str] = []
        self.ids: list[str] = []
        self.alts: list[str] = []
        self.text = ""

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.links += [values[k] for k in ("src", "href") if values.get(k)]
        self.ids += [values["id"]] if "id" in values else []
        if tag == "img":
            assert "alt" in values
            self.alts.append(values["alt"])
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not self.open or self.open[-1] not in ("style", "script"):
            self.text += data


def parsed(text: str) -> Checker:
    checker = Checker()
    checker.feed(text)
    checker.close()
    assert checker.open == []
    return checker


@pytest.fixture(scope="module")
def full() -> ReportData:
    rng = np.random.default_rng(4)
    panels = []
    for frame in (0, 12):
        parts = world.body(world.pose(frame / 30))
        masks = [world.silhouette(c, parts) for c in world.rig()]
        hull = world.hull(world.rig(), masks, 0.06)
        for camera, mask in zip(world.rig(), masks, strict=True):
            image = world.picture(camera, mask, rng)
            images = (
                ("image", image),
                ("silhouette", draw_mask(image, mask)),
                ("hull", draw_hull(image, camera, hull)),
                ("body", draw_body(image, camera, parts)),
            )
            panels.append(FramePanel(frame, camera.name, images))
    return ReportData(
        title="walk <one>",
        session="sessions/walk & turn",
        status="complete",
        n_persons=1,
        n_frames=120,
        n_cameras=3,
        fps=30.0,
        warnings=('camera "front" sees <too much> foreground. Remedy: record a new background.', "plain"),
        summary=(("Height", "1.78 m"),),
        scores={
            "mean_error_mm": 58.12,
            "mmta_percent": 88.4,
            "mmtp_mm": 49.0,
            "epsilon_mm": 100.0,
            "mota_percent": 99.0,
            "mismatches": 1,
            "angle_mean_deg": None,
            "home_made_score": 3.0,
        },
        per_landmark_mm={"pelvis": 40.0, "left_wrist": 90.0, "head": float("nan"), "neck": None},
        timings={"carve": (1.0, 8.0), "pose": (9.0, 72.0), "report": (2.0, None)},
        figures=(Figure("Time <b>", "per stage", plot_landmark_errors({"head": 72.0}), section="timing"),),
        frames=tuple(panels),
        outputs=(("tracks.csv", "where everybody was"),),
        command="mocap run 'a b' -o out && echo <done>",
        config_text='[pose]\nfilter = "<apf>"\n',
        versions={"mocap": "0.1.0"},
    )


@pytest.fixture(scope="module")
def text(full: ReportData) -> str:
    return report_html(full)


def test_stands_alone(text):
    page = parsed(text)
    assert page.links
    # Only what lies beside the page is linked.
    assert all(link.startswith(("data:image/", "#")) or link == "tracks.csv" for link in page.links)
    without_pictures = re.sub(r"data:image/[a-z]+;base64,[A-Za-z0-9+/=]+", "", text)
    assert not re.search(r"https?:|//[a-z]|@import|url\(", without_pictures)
    assert "default-src 'none'" in text


def test_has_all_sections_and_every_link_leads_somewhere(text):
    page = parsed(text)
    assert set(SECTIONS) <= set(page.ids)
    assert len(page.ids) == len(set(page.ids))
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)


def test_shows_every_picture_with_a_description(text, full):
    page = parsed(text)
    n_pictures = sum(len(panel.images) for panel in full.frames) + len(full.figures)
    described = [alt for alt in page.alts if alt]
    assert len(described) == n_pictures
    assert "hull, corner, frame 12" in described


def test_escapes_what_it_is_told(text):
    page = parsed(text)
    for tag in ("<one>", "<too much>", "<done>", "<apf>", "Time <b>"):
        assert tag in page.text
        assert tag not in text


def test_says_scores_with_units_and_meaning(text):
    page = parsed(text)
    assert "58.1 mm" in page.text
    assert CATALOGUE["mmta_percent"].meaning.replace(" %", "\u00a0%") in page.text
    assert "does not apply" in page.text
    assert "home made score" in page.text
    assert "not scored" in page.text


def test_verdict_in_words(full):
    said = " ".join(verdict(full))
    assert "One person was found in 120 frames of 3 cameras (4.0 s at 30 frames/s)." in said
    assert "58 mm" in said
    assert "limbs are lost at times" in said
    assert "1 identity switch." in said
    assert "12.5 frames per second" in said
    assert "2 warnings" in said
    nobody = " ".join(verdict(replace(full, n_persons=0, scores=None, status="incomplete")))
    assert "No person was found" in nobody
    assert "did not finish" in nobody
    assert "by eye" in nobody


def test_warning_and_remedy_are_told_apart(text):
    assert re.search(r'class="remedy"><strong>What helps:</strong> record a new background\.</p>', text)


@pytest.mark.parametrize("scores", [None, {}, dict.fromkeys(REPORT_SCORES)])
def test_bare_report_has_all_sections(scores):
    text = report_html(ReportData("t", "s", "incomplete", scores=scores))
    page = parsed(text)
    assert set(SECTIONS) <= set(page.ids)
    assert "incomplete" in page.text


def test_pictures_shrink_and_then_drop_out_to_keep_the_file_small(full, text):
    limit = len(text) // 3
    small = report_html(full, max_bytes=limit)
    assert len(small.encode()) <= limit
    assert set(SECTIONS) <= set(parsed(small).ids)
    tiny = report_html(full, max_bytes=50_000)
    assert "to keep this file small" in tiny
    assert len(tiny) < len(small)


def test_bad_picture_is_refused(full):
    panel = FramePanel(0, "a", (("x", np.zeros((4, 5), np.uint8)),))
    with pytest.raises(ValueError, match="picture"):
        report_html(replace(full, frames=(panel,)))


def test_pictures_of_points_speak_of_no_silhouettes(full):
    grey = np.full((30, 40, 3), 90, dtype=np.uint8)
    points = FramePanel(0, "a", (("image", grey), ("detections", grey), ("skeleton and detections", grey)))
    section = (
        report_html(replace(full, frames=(points,))).split('<section id="pictures"')[1].split("</section>")[0]
    )
    assert "points that were detected" in section
    assert "silhouette" not in section
    assert "what was filmed" in section
    assert "volume" not in section
    assert "silhouettes without holes" in report_html(full)


def test_writes_utf8_and_replaces_an_earlier_file(tmp_path: Path, full):
    path = tmp_path / "report.html"
    path.write_text("old")
    write_report(path, replace(full, title="Schrittmaß", frames=()))
    assert "Schrittmaß" in path.read_text(encoding="utf-8")
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


def test_unwritable_folder_is_one_clear_error(tmp_path: Path, full):
    with pytest.raises(MocapError, match="Remedy") as caught:
        write_report(tmp_path / "missing" / "report.html", replace(full, frames=()))
    assert caught.value.path == tmp_path / "missing" / "report.html"


def test_silhouettes_have_a_table_when_they_are_known(full: ReportData) -> None:
    assert "silhouettes" not in parsed(report_html(full)).ids
    numbers = {"cam <a>": {"foreground_share": 0.043, "flicker": 0.0125, "residual": None}}
    page = parsed(report_html(replace(full, silhouettes=numbers)))
    assert "silhouettes" in page.ids
    for text in ("cam <a>", "4.3", "1.2", "Outside the volume"):
        assert text in page.text
