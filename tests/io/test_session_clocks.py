"""Clips that begin at different moments or run at different rates: each frame is shown by the nearest pictures."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from io_samples import frame_picture

import mocap as library
from mocap.data import CameraRig
from mocap.errors import MocapError
from mocap.io import open_session
from mocap.io.clip_frames import shown_rows
from mocap.io.session.reading import clip_of, detections_of, pictures_of
from mocap.io.session.timeline import nearest
from mocap.io.tables import read_timestamps_csv, write_detections_csv, write_timestamps_csv

MakeSession = Callable[..., Path]
LOSSY = 6  # levels that the codec may change; frames differ by 16


def say(root: Path, text: str) -> Path:
    (root / "session.toml").write_text(text, encoding="utf-8")
    return root


def shown(root: Path, camera: str, rig: CameraRig) -> list[int]:
    """The pictures of a camera's clip that a session shows, told from their colour."""
    session = open_session(root)
    c = rig.names.index(camera)
    out = []
    with pictures_of(session) as reader:
        for _, pictures in reader:
            red = float(np.median(pictures[c][..., 0]))
            levels = [frame_picture((2, 2), k, c)[0, 0, 0] for k in range(12)]
            k = int(np.abs(np.array(levels, dtype=float) - red).argmin())
            assert abs(levels[k] - red) < LOSSY
            out.append(k)
    return out


def test_a_clip_that_begins_late_is_shown_later(make_session: MakeSession, rig: CameraRig) -> None:
    root = say(make_session(12), "[offset_s]\ncam_2 = 0.12\n")  # three frames of 25 per second
    session = open_session(root)
    assert session.frames == range(3, 12)
    assert shown(root, "cam_2", rig) == list(range(9))
    assert shown(root, "back", rig) == list(range(3, 12))


def test_a_clip_that_begins_early_ends_early(make_session: MakeSession, rig: CameraRig) -> None:
    root = say(make_session(12), "[offset_s]\nback = -0.085\n")  # nearest: two pictures
    assert open_session(root).frames == range(10)
    assert shown(root, "back", rig) == list(range(2, 12))


def test_clips_of_one_camera_alone_follow_the_clock(make_session: MakeSession, rig: CameraRig) -> None:
    session = open_session(say(make_session(12), "[offset_s]\ncam_2 = 0.12\n"))
    assert sum(1 for _ in clip_of(session, rig["cam_2"])) == 9


def test_a_clip_of_half_the_rate_shows_pictures_twice(make_session: MakeSession, rig: CameraRig) -> None:
    root = make_session(12, fps={"cam_2": 12.5}, counts={"cam_2": 6})
    assert open_session(root).fps == 25.0
    # A frame between two pictures takes the earlier; the last frame is half a picture after the last one.
    assert shown(root, "cam_2", rig) == [0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5]


def test_a_clock_of_its_own_rate(make_session: MakeSession, rig: CameraRig) -> None:
    root = say(make_session(12, counts={"cam_2": 10}), "[clip_fps]\ncam_2 = 20.0\n")
    frames = open_session(root).clip_frames["cam_2"]
    np.testing.assert_array_equal(frames, nearest(np.arange(10) / 20.0, np.arange(len(frames)) / 25.0))
    assert frames.tolist()[:6] == [0, 1, 2, 2, 3, 4]


def test_time_stamps_count(make_session: MakeSession, rig: CameraRig) -> None:
    root = make_session(12, counts={"cam_2": 8})
    stamps = {name: 1.7e9 + np.arange(12) / 25 for name in rig.names}
    # Four pictures were dropped in the middle.
    stamps["cam_2"] = np.delete(stamps["cam_2"], [3, 4, 5, 6])
    write_timestamps_csv(root / "timestamps.csv", stamps)
    assert open_session(root).frames == range(12)
    assert shown(root, "cam_2", rig) == [0, 1, 2, 2, 2, 3, 3, 3, 4, 5, 6, 7]


def test_detections_and_keypoints_count_pictures_of_their_clip(
    make_session: MakeSession, rig: CameraRig
) -> None:
    root = make_session(12)
    for name in rig.names:
        write_detections_csv(
            root / "detections" / f"{name}.csv", np.arange(12), np.tile(np.arange(12.0)[:, None], 2)
        )
    session = open_session(say(root, "[offset_s]\ncam_2 = 0.12\n"))
    found = detections_of(session)
    of = dict(zip(found.names, zip(found.frame, found.uv, strict=True), strict=True))
    assert of["cam_2"][0].tolist() == list(range(3, 12))
    assert of["cam_2"][1][:, 0].tolist() == list(range(9))
    assert of["back"][1][:, 0].tolist() == list(range(3, 12))


def test_rows_of_a_table() -> None:
    pictures = np.array([0, 0, 2, 3, 3, 3])
    frames, rows = shown_rows(pictures, range(1, 5), np.array([9, 0, 0, 3, 2]))
    assert frames.tolist() == [1, 1, 2, 2, 3, 3, 3, 4]
    assert rows.tolist() == [0, 1, 0, 1, 3, 4, 5, 2]
    frames, rows = shown_rows(pictures, range(1, 3), None)
    assert (frames.tolist(), rows.tolist()) == ([2], [2])
    assert shown_rows(np.zeros(0, np.int64), range(4), None)[0].size == 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[offset_s]\nnobody = 0.1\n", r"offset_s\.nobody names no camera with a clip"),
        ("[offset_s]\ncam_2 = 'late'\n", r"offset_s\.cam_2 is 'late'"),
        (
            "[offset_s]\ncam_2 = 1e9\n",
            r"offset_s\.cam_2 is 1000000000\.0, expected a number from -3600 to 3600",
        ),
        ("[clip_fps]\ncam_2 = 0\n", r"clip_fps\.cam_2 is 0"),
        ("offset_s = 3\n", r"offset_s is no table"),
        ("[offset_s]\ncam_2 = 7.0\n", "no moment is in all clips: .* camera cam_2"),
    ],
)
def test_clocks_that_cannot_be(make_session: MakeSession, text: str, message: str) -> None:
    root = say(make_session(12), text)
    with pytest.raises(MocapError) as caught:
        open_session(root)
    assert re.search(message, str(caught.value)), str(caught.value)


def test_a_range_outside_of_what_all_clips_show(make_session: MakeSession) -> None:
    root = say(make_session(12), "[offset_s]\ncam_2 = 0.12\n")
    with pytest.raises(MocapError, match=r"--frames 3:12"):
        open_session(root, frames=(0, 12))
    assert open_session(root, frames=(4, 8)).frames == range(4, 8)


def test_time_stamps_that_do_not_fit(make_session: MakeSession, rig: CameraRig) -> None:
    root = make_session(12)
    path = root / "timestamps.csv"
    write_timestamps_csv(path, {name: np.arange(12) / 25 for name in rig.names[:2]})
    with pytest.raises(MocapError, match="no time stamps for it"):
        open_session(root)
    write_timestamps_csv(path, {name: np.arange(11) / 25 for name in rig.names})
    with pytest.raises(MocapError, match="11 time stamps for a clip of 12 frames"):
        open_session(root)
    path.write_text("cam_id,frame_time\n0,1.0\n0,1.0\n")
    with pytest.raises(MocapError, match="does not come after"):
        read_timestamps_csv(path)
    path.write_text("cam_id,frame_time\n")
    with pytest.raises(MocapError, match="no time stamps"):
        read_timestamps_csv(path)


def test_stages_and_views_read_pictures_by_the_clock() -> None:
    """Only `mocap sync` reads clips as they were filmed: whoever else makes a reader of his own forgets the clocks."""
    pipeline = Path(library.__file__).parent / "pipeline"
    own = [
        p.name
        for p in sorted(pipeline.rglob("*.py"))
        if re.search(r"(Frame|Mask)Reader\(", p.read_text("utf-8"))
    ]
    assert own == ["sync.py"]
