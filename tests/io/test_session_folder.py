"""Opening a session: matching by name, common frames, and one clear message for every kind of bad folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from io_samples import frame_picture, write_picture, write_video

from mocap.data import CameraRig
from mocap.errors import MocapError
from mocap.io import FrameReader, MaskReader, open_session
from mocap.io.calibration import write_calibration
from mocap.io.session import read_session_settings

SHARED = Path(__file__).resolve().parents[3] / "shared"
MakeSession = Callable[..., Path]


def test_plain_session(make_session: MakeSession, rig: CameraRig) -> None:
    session = open_session(make_session(12))
    assert session.rig.names == rig.names  # the order of the calibration, not of the file names
    assert (session.fps, session.frames, session.name) == (25.0, range(12), "session")
    assert list(session.image_sources) == list(rig.names)
    assert session.mask_sources == session.background_sources == session.detection_sources == {}
    assert session.warnings == ()
    assert session.truth_dir is None
    with FrameReader(session.image_sources, session.rig, session.frames) as reader:
        assert sum(1 for _ in reader) == 12


def test_regions_of_interest_from_pictures_and_polygons(make_session: MakeSession, rig: CameraRig) -> None:
    root = make_session(5)
    first, second = rig.names[:2]
    (root / "roi").mkdir()
    write_picture(root / "roi" / f"{first}.png", np.full((*rig[0].size[::-1], 3), 255, np.uint8))
    (root / "session.toml").write_text(f"[roi_px]\n{second} = [[0, 0], [20.5, 0], [3, 9]]\n")
    session = open_session(root)
    assert list(session.roi_sources) == [first]
    assert session.roi_px == {second: ((0.0, 0.0), (20.5, 0.0), (3.0, 9.0))}
    (root / "session.toml").write_text("[roi_px]\nnobody = [[0, 0], [20, 0], [3, 9]]\n")
    with pytest.raises(MocapError, match=r"roi_px\.nobody names a camera"):
        open_session(root)


def test_settings_and_range(make_session: MakeSession) -> None:
    root = make_session(12)
    (root / "truth").mkdir()
    (root / "session.toml").write_text(
        "fps = 50\nframes = [2, 9]\nroom_bounds_m = [[-1, -2, 0], [1, 2, 2.5]]\nperson_height_m = 1.8\n"
        'marker_colour = "#ff8000"\ncheckerboard = [8, 6]\ncheckerboard_square_m = 0.115\n'
    )
    session = open_session(root)
    assert (session.fps, session.frames, session.person_height_m) == (50.0, range(2, 9), 1.8)
    assert session.room_bounds_m == ((-1.0, -2.0, 0.0), (1.0, 2.0, 2.5))
    assert session.marker_colour == (255, 128, 0)
    assert session.checkerboard == (8, 6)
    assert session.truth_dir == root / "truth"
    assert open_session(root, frames=(None, 5)).frames == range(5)
    assert open_session(root, frames=(4, None)).frames == range(4, 12)


@pytest.mark.parametrize("frames", [(3, 3), (12, None), (5, 2), (0, 13), (-1, 5), (None, 0)])
def test_range_outside_the_clips(make_session: MakeSession, frames: tuple[int | None, int | None]) -> None:
    with pytest.raises(MocapError, match="the frame range") as caught:
        open_session(make_session(12), frames=frames)
    assert "--frames 0:12" in caught.value.remedy


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("fsp = 30", "fsp is not known"),
        ("fps = 0", "fps"),
        ("fps = nan", "fps"),
        ("fps = true", "fps"),
        ("frames = [5]", "frames"),
        ("roi_px = 3", "roi_px"),
        ("[roi_px]\ncam = [[0, 0], [1, 1]]", "roi_px.cam"),
        ("[roi_px]\ncam = [[0, 0], [1, 1], [nan, 2]]", "roi_px.cam"),
        ("frames = [9, 5]", "frames"),
        ("room_bounds_m = [[0, 0, 0], [1, 1]]", "room_bounds_m"),
        ("room_bounds_m = [[0, 0, 0], [1, -1, 1]]", "room_bounds_m"),
        ("person_height_m = 180", "person_height_m"),
        ('marker_colour = "blurple"', "marker_colour"),
        ("marker_colour = [1, 2, 300]", "marker_colour"),
        ('calibration_units = "inch"', "calibration_units"),
        ('calibration_up = "up"', "calibration_up"),
        ("checkerboard = [8]", "checkerboard"),
        ("cameras = []", "cameras"),
        ('cameras = "cam_2"', "cameras"),
        ("camera_map = 3", "camera_map"),
        ("[camera_map]\na = 3", "camera_map.a"),
        ('[camera_map]\na = "x"\nb = "x"', "more than one file"),
        ("fps = ", "cannot be read"),
    ],
)
def test_bad_settings_name_the_key(tmp_path: Path, text: str, key: str) -> None:
    (tmp_path / "session.toml").write_text(text)
    with pytest.raises(MocapError) as caught:
        read_session_settings(tmp_path / "session.toml")
    assert key in str(caught.value)
    assert caught.value.path == tmp_path / "session.toml"


def test_calibrated_camera_without_video(make_session: MakeSession) -> None:
    root = make_session(12, skip=("cam_10",))
    with pytest.raises(MocapError, match="cam_10 is calibrated but has no video") as caught:
        open_session(root)
    assert caught.value.camera == "cam_10"
    assert 'cameras = ["back", "cam_2"]' in caught.value.remedy
    (root / "session.toml").write_text('cameras = ["cam_2", "back"]\n')
    assert open_session(root).rig.names == ("back", "cam_2")


def test_cameras_by_choice(make_session: MakeSession) -> None:
    root = make_session(12)
    (root / "session.toml").write_text('cameras = ["cam_2", "cam_10"]\n')
    session = open_session(root)
    assert session.rig.names == tuple(session.image_sources) == ("cam_10", "cam_2")
    (root / "session.toml").write_text('cameras = ["cam_2", "cam_3"]\n')
    with pytest.raises(MocapError, match="cameras names cam_3"):
        open_session(root)
    (root / "session.toml").write_text('cameras = ["cam_2"]\n')
    (root / "videos" / "cam_2.mp4").unlink()
    with pytest.raises(MocapError, match="no pictures and no masks of camera cam_2"):
        open_session(root)


def test_one_camera_is_not_enough(make_session: MakeSession) -> None:
    with pytest.raises(MocapError, match="only camera back") as caught:
        open_session(make_session(12, skip=("cam_10", "cam_2")))
    assert caught.value.camera == "cam_10"


@pytest.mark.parametrize("folder", ["videos", "background"])
def test_video_without_calibration_lists_both_sides(make_session: MakeSession, folder: str) -> None:
    root = make_session(12)
    (root / folder).mkdir(exist_ok=True)
    (root / "videos" / "cam_2.mp4").rename(root / folder / "Cam2.mp4")
    with pytest.raises(MocapError, match="which the calibration does not know") as caught:
        open_session(root)
    for name in ("Cam2", "back", "cam_10", "cam_2", folder):
        assert name in str(caught.value)
    assert '[camera_map] "Cam2"' in caught.value.remedy
    assert caught.value.camera == "Cam2"


def test_camera_map_joins_names(make_session: MakeSession) -> None:
    root = make_session(12)
    (root / "videos" / "cam_2.mp4").rename(root / "videos" / "GoPro 3.mp4")
    (root / "session.toml").write_text('[camera_map]\n"GoPro 3" = "cam_2"\n')
    assert open_session(root).image_sources["cam_2"].name == "GoPro 3.mp4"
    (root / "session.toml").write_text('[camera_map]\n"GoPro 3" = "cam_3"\n')
    with pytest.raises(MocapError, match=r"camera_map\.GoPro 3 names camera 'cam_3'"):
        open_session(root)
    (root / "session.toml").write_text('[camera_map]\n"GoPro 4" = "cam_2"\n')
    with pytest.raises(MocapError, match="is no file of the session"):
        open_session(root)


def test_two_videos_for_one_camera(make_session: MakeSession) -> None:
    root = make_session(12)
    (root / "videos" / "back.avi").write_bytes(b"x")
    with pytest.raises(MocapError, match="two sources for one camera") as caught:
        open_session(root)
    assert caught.value.camera == "back"


def test_nothing_to_open(tmp_path: Path, rig: CameraRig) -> None:
    with pytest.raises(MocapError, match="no such session"):
        open_session(tmp_path / "none")
    with pytest.raises(MocapError, match="no calibration"):
        open_session(tmp_path)
    write_calibration(tmp_path / "calibration.toml", rig)
    with pytest.raises(MocapError, match="no pictures and no masks"):
        open_session(tmp_path)
    (tmp_path / "calibration.toml").write_text("")
    with pytest.raises(MocapError, match="no camera"):
        open_session(tmp_path)


@pytest.mark.parametrize("n", [11, 13, 30])
def test_clips_of_different_length(make_session: MakeSession, n: int) -> None:
    root = make_session(12, counts={"cam_10": n})
    with pytest.raises(MocapError, match="different numbers of frames") as caught:
        open_session(root)
    assert f"back: 12, cam_10: {n}, cam_2: 12" in str(caught.value)
    assert caught.value.camera == ("cam_10" if n < 12 else "back")
    common = min(n, 12)
    assert f"--frames 0:{common}" in caught.value.remedy
    assert open_session(root, frames=(0, common)).frames == range(common)


def test_size_differs_from_calibration(make_session: MakeSession) -> None:
    with pytest.raises(MocapError, match="48 x 64, expected 64 x 48") as caught:
        open_session(make_session(12, sizes={"back": (48, 64)}))
    assert caught.value.camera == "back"
    root = make_session(12, name="other")
    write_picture(root / "background" / "cam_2.png", frame_picture((64, 64), 0, 0))
    with pytest.raises(MocapError, match="64 x 64, expected 56 x 32") as caught:
        open_session(root)
    assert caught.value.path == root / "background" / "cam_2.png"


@pytest.mark.parametrize("size", [(64, 46), (60, 48), (50, 34)])
def test_pictures_that_were_padded_when_they_were_calibrated(
    make_session: MakeSession, size: tuple[int, int]
) -> None:
    """Codecs store whole blocks of 16 pixels: 64 x 48 for 60 x 48."""
    session = open_session(make_session(12, sizes={"back": size}))
    calibrated = open_session(make_session(12, name="whole")).rig["back"]
    assert session.rig["back"].size == size
    np.testing.assert_array_equal(session.rig["back"].K, calibrated.K)
    assert [w for w in session.warnings if "64 x 48" in w and "camera back" in w and "upper left" in w]
    assert not [w for w in open_session(make_session(12, name="again")).warnings if "upper left" in w]


@pytest.mark.parametrize("size", [(64, 32), (48, 48), (66, 48)])
def test_pictures_that_lack_or_exceed_a_block_are_others(
    make_session: MakeSession, size: tuple[int, int]
) -> None:
    with pytest.raises(MocapError, match="expected 64 x 48"):
        open_session(make_session(12, sizes={"back": size}))


def test_size_that_the_calibration_does_not_know_comes_from_the_video(make_session: MakeSession) -> None:
    root = make_session(12)
    text = (root / "calibration.toml").read_text()
    text = "\n".join(line for line in text.split("\n") if not line.startswith("size"))
    (root / "calibration.toml").write_text(text)
    session = open_session(root)
    assert [c.size for c in session.rig] == [(64, 48), (48, 40), (56, 32)]
    assert any("picture size" in w for w in session.warnings)


def test_unreadable_truncated_and_empty_clips(make_session: MakeSession) -> None:
    root = make_session(12)
    path = root / "videos" / "cam_2.mp4"
    whole = path.read_bytes()
    for content, message in ((b"junk" * 99, "cannot be read"), (whole[:-150], "truncated"), (b"", "empty")):
        path.write_bytes(content)
        with pytest.raises(MocapError, match=message) as caught:
            open_session(root)
        assert (caught.value.camera, caught.value.path) == ("cam_2", path)


def test_video_that_ends_before_its_header_says(make_session: MakeSession, rig: CameraRig) -> None:
    root = make_session(40)
    path = root / "videos" / "back.mp4"
    rng = np.random.default_rng(3)
    write_video(path, [rng.integers(0, 255, (48, 64, 3), dtype=np.uint8) for _ in range(40)])
    data = bytearray(path.read_bytes())
    start, stop = data.find(b"mdat") + 4, data.find(b"moov") - 4
    half = start + (stop - start) // 2
    data[half:stop] = bytes(stop - half)
    path.write_bytes(data)
    with pytest.raises(MocapError, match="40 frames are promised") as caught:
        open_session(root)
    good = caught.value.frame
    assert good is not None
    assert (caught.value.camera, f"--frames 0:{good}" in caught.value.remedy) == ("back", True)
    session = open_session(root, frames=(0, good))
    with FrameReader(session.image_sources, session.rig, session.frames) as reader:
        assert sum(1 for _ in reader) == good


def test_frame_rates(make_session: MakeSession) -> None:
    session = open_session(make_session(12, fps={"cam_2": 50.0}, counts={"cam_2": 24}))
    assert session.fps == 25.0
    assert any("different frame rates" in w for w in session.warnings)
    assert session.clip_frames["cam_2"].tolist() == list(range(0, 24, 2))
    with pytest.raises(MocapError, match="mocap sync"):
        open_session(make_session(12, name="of_other_length", fps={"cam_2": 50.0}))


@pytest.mark.parametrize(("fps", "is_warned"), [(0.9, True), (0.5, True), (1.0, False)])
def test_pictures_too_far_apart_to_tell_people_apart(
    make_session: MakeSession, rig: CameraRig, fps: float, is_warned: bool
) -> None:
    root = make_session(3)
    (root / "session.toml").write_text(f"fps = {fps}\n")
    told = [w for w in open_session(root).warnings if "s apart: of several people it is not sure" in w]
    assert len(told) == is_warned
    assert all("--frames 3:4" in w and f"{1 / fps:.2g} s" in w for w in told)
    for clip in (root / "videos").iterdir():
        clip.unlink()
    write_folders(root, "images", rig, 1)  # a single instant is followed to nowhere
    assert not any("it is not sure" in w for w in open_session(root).warnings)


def write_folders(root: Path, kind: str, rig: CameraRig, n: int) -> None:
    for i, camera in enumerate(rig):
        for f in range(n):
            picture = frame_picture(camera.size, f, i)
            write_picture(
                root / kind / camera.name / f"{f:06d}.png", picture if kind == "images" else picture[..., 0]
            )


def test_picture_folders_and_masks(tmp_path: Path, rig: CameraRig) -> None:
    write_calibration(tmp_path / "calibration.toml", rig)
    write_folders(tmp_path, "masks", rig, 4)
    only_masks = open_session(tmp_path)
    assert only_masks.image_sources == {}
    assert (only_masks.frames, only_masks.fps) == (range(4), 30.0)
    assert any("30 per second assumed" in w for w in only_masks.warnings)
    write_folders(tmp_path, "images", rig, 4)
    both = open_session(tmp_path)
    assert list(both.image_sources) == list(both.mask_sources) == list(rig.names)
    with MaskReader(both.mask_sources, both.rig, both.frames) as reader:
        assert all(masks[0].all() for _, masks in reader)


def test_incomplete_masks_and_pictures(tmp_path: Path, rig: CameraRig) -> None:
    write_calibration(tmp_path / "calibration.toml", rig)
    write_folders(tmp_path, "images", rig, 2)
    write_folders(tmp_path, "masks", rig.subset(["back", "cam_2"]), 2)
    session = open_session(tmp_path)
    assert session.mask_sources == {}
    assert any("masks/ lacks camera cam_10" in w for w in session.warnings)
    for path in (tmp_path / "images" / "back").iterdir():
        path.unlink()
    (tmp_path / "images" / "back").rmdir()
    with pytest.raises(MocapError, match="has masks but no pictures"):
        open_session(tmp_path)


def test_detections_alone_make_a_session(tmp_path: Path, rig: CameraRig) -> None:
    write_calibration(tmp_path / "calibration.toml", rig)
    (tmp_path / "detections").mkdir()
    for i, camera in enumerate(rig):
        (tmp_path / "detections" / f"{camera.name}.csv").write_text(f"frame,u_px,v_px\n0,1,2\n{5 + i},3,4\n")
    session = open_session(tmp_path)
    assert session.frames == range(8)
    assert list(session.detection_sources) == list(rig.names)
    assert session.clips == {}


def test_background_video_before_picture(make_session: MakeSession, rig: CameraRig) -> None:
    root = make_session(12)
    for i, camera in enumerate(rig):
        write_picture(root / "background" / f"{camera.name}.png", frame_picture(camera.size, 0, i))
    write_video(root / "background" / "back.mp4", [frame_picture((64, 48), 0, 0)] * 3)
    session = open_session(root)
    assert [session.background_sources[n].suffix for n in rig.names] == [".mp4", ".png", ".png"]
    (root / "background" / "cam_2.png").unlink()
    assert any("no background/ for camera cam_2" in w for w in open_session(root).warnings)


def test_calibration_by_option(make_session: MakeSession, tmp_path: Path, rig: CameraRig) -> None:
    root = make_session(12)
    write_calibration(tmp_path / "other.toml", rig.subset(["cam_2", "back"]))
    with pytest.raises(MocapError, match=r"other\.toml has cam_2, back"):
        open_session(root, calibration=tmp_path / "other.toml")


@pytest.mark.shared
def test_shared_sessions_open() -> None:
    if not SHARED.is_dir():
        pytest.skip("the reference material is not beside the checkout")
    walk = open_session(SHARED / "dev_sessions" / "walk")
    assert (len(walk.rig), walk.fps, walk.frames) == (7, 30.0, range(120))
    seated = open_session(SHARED / "real" / "seated")
    # Its headers promise two frames more than can be decoded.
    assert (len(seated.rig), seated.fps, seated.frames) == (4, 50.0, range(426))
    assert {p.suffix for p in seated.background_sources.values()} == {".avi"}
    dancer = open_session(SHARED / "real" / "dancer")
    assert (len(dancer.rig), dancer.frames) == (8, range(1))
    ((frame, masks),) = MaskReader(dancer.mask_sources, dancer.rig, dancer.frames)
    assert frame == 0
    assert all(0.01 < mask.mean() < 0.3 for mask in masks)


def test_opencv_is_quiet_about_bad_files(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], make_session: MakeSession
) -> None:
    root = make_session(12)
    (root / "videos" / "back.mp4").write_bytes(b"junk" * 99)
    with pytest.raises(MocapError):
        open_session(root)
    assert capfd.readouterr().err == ""
    assert cv2.utils.logging.getLogLevel() <= cv2.utils.logging.LOG_LEVEL_ERROR
