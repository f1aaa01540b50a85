"""Replay and curves of the report: what the page holds, and what a browser makes of it."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import view_world as world
from test_report import parsed

from mocap.data import LANDMARKS, AngleSeries
from mocap.view.curves import Chart, Curve, charts_html
from mocap.view.overlay import draw_body, draw_limbs
from mocap.view.replay import Replay, ReplayPerson, replay_html, webp
from mocap.view.report import FramePanel, PersonPage, Place, ReportData, report_html

T = 12
FRAMES = np.arange(5, 5 + T)
LONG = "Walking of a participant whose name is so long that no line of a small telephone could ever hold it"


def a_replay() -> Replay:
    rng = np.random.default_rng(3)
    rig = world.rig()
    places = np.cumsum(rng.normal(0, 0.01, (T, len(LANDMARKS), 3)), axis=0) + rng.uniform(
        0, 1.7, (len(LANDMARKS), 3)
    )
    places[4] = np.nan
    tiles = tuple((40 * i, 0, 40, 30) for i in range(len(rig)))
    sheets = tuple(webp(np.full((30, 40 * len(rig), 3), 20 * i, dtype=np.uint8), 40) for i in range(0, T, 2))
    return Replay(
        rig,
        30.0,
        FRAMES,
        (ReplayPerson(2, places),),
        ((-1.5, -1.5, 0.0), (1.5, 1.5, 2.2)),
        FRAMES[::2],
        sheets,
        tiles,
    )


def a_chart() -> Chart:
    t = np.linspace(0, 6, T)
    seen = np.ones(T, dtype=bool)
    seen[6:] = False
    left = Curve("left <b>", "left", 30 * np.sin(t), np.full(T, 2.0), seen)
    right = Curve("right", "right", np.where(np.arange(T) == 3, np.nan, 20 * np.cos(t)))
    return Chart("Knee <flexion>", "degrees", FRAMES, 30.0, (left, right))


@pytest.fixture(scope="module")
def page() -> str:
    return report_html(the_report())


def the_report() -> ReportData:
    """Every section that a report may have."""
    contact = Chart(
        "Foot on the floor", "probability", FRAMES, 30.0, (Curve("left", "left", np.linspace(0, 1, T)),)
    )
    charts = (a_chart(), replace(a_chart(), title="Hip flexion"), contact)
    person = PersonPage("person 2", charts, "person\t2\nheight\t1.70 m")
    grey = np.full((60, 80, 3), 90, dtype=np.uint8)
    return ReportData(
        title=LONG,
        session="s",
        status="complete",
        n_persons=1,
        warnings=("person 2: left_wrist is hidden from all cameras. Remedy: add a camera",),
        summary=(("Markers found by", "detections/" + "a_long_name_of_a_file" * 4),),
        scores={"mean_error_mm": 12.9, "mmta_percent": 100.0},
        per_landmark_mm={"left_wrist": 21.0, "head": None},
        timings={"pose": (3.2, 40.0)},
        frames=(FramePanel(6, "cam_0", (("image", grey), ("detections", grey), ("fitted body", grey))),),
        outputs=(("person_1.bvh", "a skeleton"), ("odd name&.csv", "a table")),
        command="mocap run session -o result --set " + "pose.n_particles=200," * 8,
        config_text="{}",
        silhouettes={"cam_0": {"foreground_share": 0.04}},
        replay=a_replay(),
        people=(person,),
        places=(Place("person 2", range(6, 9), 7, 2.5, "left wrist and others uncertain; jumps"),),
        versions={"mocap": "1"},
    )


def data_of(page: str) -> dict:
    return json.loads(re.search(r'id="replay-data">(.*?)</script>', page, re.DOTALL).group(1))


def test_the_page_holds_every_frame_camera_and_person(page):
    data = data_of(page)
    assert data["frames"] == FRAMES.tolist()
    assert [c["name"] for c in data["cameras"]] == list(world.rig().names)
    (person,) = data["persons"]
    assert person["points"][4] is None
    expected = a_replay().persons[0].landmarks[0].ravel() * 1000
    assert person["points"][0] == pytest.approx(expected, abs=0.5)
    assert {tuple(b[:2]) for b in person["bones"]} >= {
        (LANDMARKS.index("left_hip"), LANDMARKS.index("left_knee"))
    }
    assert len(data["pictures"]) == len(data["picture_frames"]) == T // 2
    assert base64.b64decode(data["pictures"][0])[8:12] == b"WEBP"


def test_a_camera_is_a_pyramid_that_looks_where_it_looks(page):
    for camera, drawn in zip(world.rig(), data_of(page)["cameras"], strict=True):
        assert drawn["centre"] == pytest.approx(camera.center.tolist(), abs=1e-3)
        forward = np.mean(drawn["corners"], axis=0) - camera.center
        assert forward @ camera.R[2] > 0.1


def test_no_text_can_leave_the_data():
    text = replay_html(replace(a_replay(), rig=world.rig(), mime="</script><b>"))
    assert "</script><b>" not in text
    assert parsed(text).open == []


def test_curves_have_bands_gaps_and_dashes():
    text = charts_html([a_chart()])
    assert "Knee &lt;flexion&gt;" in text
    assert "left &lt;b&gt;" in text
    assert text.count('class="band left"') == 1
    assert 'class="band right"' not in text  # no deviation is known
    assert text.count('class="line right"') == 2  # the gap cuts it in two
    assert text.count('class="line left unseen"') == 1
    numbers = [float(v) for v in re.findall(r"[ML](-?[\d.]+) ", text)]
    assert min(numbers) >= 44
    assert max(numbers) <= 410


def test_a_band_is_shown_whole_and_never_leaves_the_picture():
    t = np.linspace(0, 6, 40)
    frames = np.arange(40)
    calm = Curve("trunk", "middle", 0.3 * np.sin(t), np.full(40, 5.0))
    lost = Curve("trunk", "middle", 20 * np.sin(t), np.where(frames > 35, 104.0, 2.0))
    for curve in (calm, lost):
        text = charts_html([Chart("Trunk flexion", "degrees", frames, 30.0, (curve,))])
        (band,) = re.findall(r'class="band middle" d="([^"]+)"', text)
        heights = np.array([float(y) for y in re.findall(r"[ML]-?[\d.]+ (-?[\d.]+)", band)])
        assert heights.min() >= 12.0
        assert heights.max() <= 164.0
        if curve is calm:  # wider than the curve moves, and yet within the axis
            assert heights.min() > 13.0
            assert heights.max() < 163.0


def test_a_curve_of_one_frame_or_nothing_is_drawn():
    one = Chart("a", "m", FRAMES[:1], 30.0, (Curve("x", "middle", np.array([1.0])),))
    none = Chart("a", "m", FRAMES, 30.0, (Curve("x", "middle", np.full(T, np.nan)),))
    assert charts_html([one, none]).count("<svg") == 2


def test_long_curves_stay_small():
    n = 100_000
    long = Chart("a", "m", np.arange(n), 30.0, (Curve("x", "left", np.sin(np.arange(n)), np.ones(n)),))
    assert len(charts_html([long])) < 30_000


def test_outputs_are_links(page):
    links = parsed(page).links
    assert "person_1.bvh" in links
    assert "odd%20name%26.csv" in links


def test_tables_of_researchers_are_folded(page):
    for key in ("accuracy", "timing", "settings", "versions"):
        assert re.search(rf'<section id="{key}"[^>]*><details><summary>', page), key
    for key in ("result", "replay", "people", "warnings", "files"):
        assert re.search(rf'<section id="{key}"[^>]*><h2', page), key


def test_limbs_in_small_pictures_lie_on_the_body():
    camera = world.rig()[0]
    parts = world.body(world.pose(0.3))
    black = np.zeros((camera.size[1], camera.size[0], 3), dtype=np.uint8)
    exact = draw_body(black, camera, parts, alpha=1.0).any(axis=2)
    quick = draw_limbs(black, camera, parts).any(axis=2)
    assert (exact & quick).sum() / (exact | quick).sum() > 0.7
    assert (draw_limbs(black, camera, []) == black).all()


def test_angles_know_their_names():
    series = AngleSeries(1, ("a",), FRAMES, FRAMES / 30.0, np.zeros((T, 1)))
    assert len(series.of("a")) == len(series) == T
    with pytest.raises(ValueError, match="values has shape"):
        AngleSeries(1, ("a", "b"), FRAMES, FRAMES / 30.0, np.zeros((T, 1)))


BROWSERS = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome")
PROBE = """<script>
window.addEventListener("error",function(e){document.body.dataset.wrong=e.message;});
window.addEventListener("load",function(){
 var b=document.body.dataset,player=document.getElementById("replay-player"),range=player.querySelector("input");
 function ink(c){var d=c.getContext("2d").getImageData(0,0,c.width,c.height).data,n=0;
  for(var i=3;i<d.length;i+=4){n+=d[i]>0;}return n;}
 b.first=player.querySelector("output").textContent;b.scene=ink(player.querySelector("canvas.scene"));
 range.value=3;range.dispatchEvent(new Event("input"));b.third=player.querySelector("output").textContent;
 b.cursor=document.querySelector("svg.chart .cursor").getAttribute("x1");
 document.dispatchEvent(new KeyboardEvent("keydown",{key:" ",bubbles:true}));
 b.playing=player.querySelector(".play").textContent;
 document.body.dispatchEvent(new KeyboardEvent("keydown",{key:" ",bubbles:true}));
 b.playing=player.querySelector(".play").textContent;
 b.wide=document.documentElement.scrollWidth;b.room=window.innerWidth;
 var cut=0;document.querySelectorAll("h1,h2,h3,figcaption").forEach(function(h){
  if(h.scrollWidth>h.clientWidth+1&&getComputedStyle(h).display!=="inline"){cut+=1;}});b.cut=cut;
 document.querySelectorAll("details").forEach(function(d){d.open=true;});
 function scrolls(e){for(;e;e=e.parentElement){var o=getComputedStyle(e).overflowX;
  if(o==="auto"||o==="scroll"||o==="hidden"){return true;}}return false;}
 var out=[];document.querySelectorAll("main *").forEach(function(e){
  if(e.getBoundingClientRect().right>window.innerWidth+1&&!scrolls(e)){out.push(e.tagName+"."+e.className);}});
 b.out=out.slice(0,3).join(" ");b.sections=document.querySelectorAll("section").length;
 setTimeout(function(){b.tile=ink(player.querySelector("canvas.tile"));b.done="yes";},400);
});</script>"""


@pytest.mark.slow
@pytest.mark.parametrize("width", [1200, 400])
def test_a_browser_plays_it(tmp_path: Path, page: str, width: int):
    browser = next((b for b in BROWSERS if shutil.which(b)), None)
    if browser is None:
        pytest.skip(f"no browser: one of {', '.join(BROWSERS)}")
    path = tmp_path / "report.html"
    path.write_text(page.replace("</body>", PROBE + "</body>"), encoding="utf-8")
    said = subprocess.run(
        [
            *(browser, "--headless", "--no-sandbox", "--disable-gpu", f"--window-size={width},900"),
            *("--virtual-time-budget=6000", "--enable-logging=stderr", "--dump-dom", path.as_uri()),
        ],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    assert "CONSOLE" not in said.stderr, said.stderr
    found = dict(re.findall(r'data-(\w+)="([^"]*)"', re.search(r"<body[^>]*>", said.stdout).group(0)))
    assert found.get("done") == "yes", found
    assert "wrong" not in found
    assert found["first"] == "0.17 s, frame 5"
    assert found["third"] == "0.27 s, frame 8"
    assert found["playing"] == "Play"  # space twice: on and off again
    assert float(found["cursor"]) > 60.0
    assert int(found["scene"]) > 500
    assert int(found["tile"]) > 500
    assert int(found["room"]) == width
    assert int(found["wide"]) <= width, "the page is wider than the window"
    assert found["out"] == "", "with everything unfolded nothing sticks out"
    assert int(found["sections"]) >= 12
    assert found["cut"] == "0"
