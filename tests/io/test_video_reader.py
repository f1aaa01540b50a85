"""Sequential readers: right frames in right order, right colours, constant memory, and every kind of bad clip."""

from __future__ import annotations

import threading
from pathlib import Path

import cv2
import numpy as np
import pytest
from io_samples import frame_picture, write_picture, write_video

from mocap.data import CameraRig
from mocap.errors import MocapError
from mocap.io.video import FrameReader, MaskReader, clip_info, iter_clip, list_pictures

# mp4v keeps a flat colour to a few levels; neighbouring test frames differ by 16.
COLOUR = 6


def clips(folder: Path, rig: CameraRig, n: int) -> dict[str, Path]:
    sources = {}
    for i, camera in enumerate(rig):
        sources[camera.name] = folder / f"{camera.name}.mp4"
        write_video(sources[camera.name], [frame_picture(camera.size, f, i) for f in range(n)])
    return sources


def chapters(folder: Path, camera: int, rig: CameraRig, lengths: tuple[int, ...]) -> Path:
    """One recording of a camera, cut into clips of so many frames."""
    folder.mkdir(parents=True)
    size, first = rig[camera].size, 0
    for k, n in enumerate(lengths):
        pictures = [frame_picture(size, f, camera) for f in range(first, first + n)]
        write_video(folder / f"GH0{k + 1}0123.MP4", pictures)
        first += n
    return folder


@pytest.mark.parametrize("frames", [range(9), range(4, 9), range(0, 9, 4), range(8, 9)])
def test_chapters_of_a_folder_are_one_clip(tmp_path: Path, rig: CameraRig, frames: range) -> None:
    sources = clips(tmp_path, rig, 9)
    name = rig.names[1]
    sources[name] = chapters(tmp_path / name, 1, rig, (4, 1, 4))
    assert clip_info(sources[name]).n_frames == 9
    assert clip_info(sources[name]).size == rig[name].size
    with FrameReader(sources, rig, frames) as reader:
        for frame, images in reader:
            assert np.abs(images[1].astype(int) - frame_picture(rig[name].size, frame, 1)).max() <= COLOUR
    assert len(list(iter_clip(sources[name]))) == 9


def test_chapters_of_another_recording_are_refused(tmp_path: Path, rig: CameraRig) -> None:
    folder = chapters(tmp_path / "cam", 0, rig, (3, 3))
    write_video(folder / "GH030123.MP4", [frame_picture((64, 64), f, 0) for f in range(3)])
    with pytest.raises(MocapError, match="the picture is 64 x 64") as caught:
        clip_info(folder)
    assert caught.value.path == folder / "GH030123.MP4"
    write_video(folder / "GH030123.MP4", [frame_picture(rig[0].size, f, 0) for f in range(3)], fps=60)
    with pytest.raises(MocapError, match="the chapter has 60 frames per second"):
        clip_info(folder)


@pytest.mark.parametrize("n_workers", [1, 2, 5])
@pytest.mark.parametrize("frames", [range(9), range(3, 7), range(1, 9, 3)])
def test_frames_come_in_order_and_in_rgb(
    tmp_path: Path, rig: CameraRig, frames: range, n_workers: int
) -> None:
    sources = clips(tmp_path, rig, 9)
    with FrameReader(sources, rig, frames, n_workers=n_workers) as reader:
        assert len(reader) == len(frames)
        seen = list(reader)
        again = [frame for frame, _ in reader]
    assert [frame for frame, _ in seen] == list(frames) == again
    for frame, images in seen:
        for i, (camera, image) in enumerate(zip(rig, images, strict=True)):
            expected = frame_picture(camera.size, frame, i)
            assert image.dtype == np.uint8
            assert image.shape == expected.shape
            assert np.abs(image.astype(int) - expected).max() <= COLOUR


def test_leaving_early_stops_the_threads(tmp_path: Path, rig: CameraRig) -> None:
    before = threading.active_count()
    with FrameReader(clips(tmp_path, rig, 30), rig, range(30)) as reader:
        for frame, _ in reader:
            if frame == 2:
                break
    assert threading.active_count() == before


def test_source_missing_for_a_camera_is_the_callers_mistake(tmp_path: Path, rig: CameraRig) -> None:
    with pytest.raises(ValueError, match="cam_10"):
        FrameReader({"back": tmp_path, "cam_2": tmp_path}, rig, range(3))
    with pytest.raises(ValueError, match="ascending"):
        FrameReader(dict.fromkeys(rig.names, tmp_path), rig, range(-1, 3))


def test_clip_shorter_than_asked_names_camera_and_frame(tmp_path: Path, rig: CameraRig) -> None:
    sources = clips(tmp_path, rig, 8)
    write_video(sources["cam_2"], [frame_picture(rig["cam_2"].size, f, 2) for f in range(5)])
    seen = []
    with pytest.raises(MocapError, match="the clip ends here") as caught:  # noqa: PT012  reading raises
        for frame, _ in FrameReader(sources, rig, range(8)):
            seen.append(frame)
    assert seen == [0, 1, 2, 3, 4]
    assert (caught.value.camera, caught.value.frame, caught.value.path) == ("cam_2", 5, sources["cam_2"])
    assert "--frames" in caught.value.remedy


def test_damaged_middle_is_found_when_it_is_read(tmp_path: Path, rig: CameraRig) -> None:
    rng = np.random.default_rng(3)
    path = tmp_path / "noise.mp4"
    size = rig[0].size
    write_video(path, [rng.integers(0, 255, (size[1], size[0], 3), dtype=np.uint8) for _ in range(20)])
    data = bytearray(path.read_bytes())
    start = data.find(b"mdat") + 4
    stop = data.find(b"moov") - 4
    data[start + (stop - start) // 2 : stop] = bytes(stop - start - (stop - start) // 2)
    path.write_bytes(data)
    info = clip_info(path, camera="back")
    assert info.header_frames == 20
    assert info.n_frames < 15
    with pytest.raises(MocapError) as caught:
        list(FrameReader({"back": path}, rig.subset(["back"]), range(20)))
    assert caught.value.camera == "back"
    assert caught.value.frame == info.n_frames


def test_size_is_checked_at_every_frame(tmp_path: Path, rig: CameraRig) -> None:
    camera = rig.subset(["back"])
    for frame in range(4):
        size = (64, 48) if frame < 3 else (48, 64)
        write_picture(tmp_path / "back" / f"{frame}.png", frame_picture(size, frame, 0))
    with pytest.raises(MocapError, match="48 x 64, expected 64 x 48") as caught:
        list(FrameReader({"back": tmp_path / "back"}, camera, range(4)))
    assert caught.value.frame == 3
    assert "side" in caught.value.remedy


def test_pictures_in_natural_order(tmp_path: Path) -> None:
    for i in (10, 9, 1, 100, 2):
        write_picture(tmp_path / f"frame_{i}.png", np.full((4, 6, 3), i, np.uint8))
    (tmp_path / "notes.txt").write_text("")
    (tmp_path / ".frame_0.png").write_text("")
    assert [p.name for p in list_pictures(tmp_path)] == [f"frame_{i}.png" for i in (1, 2, 9, 10, 100)]
    assert [int(image[0, 0, 0]) for image in iter_clip(tmp_path)] == [1, 2, 9, 10, 100]


def test_every_kind_of_picture_becomes_rgb8(tmp_path: Path) -> None:
    grey = np.full((5, 7), 51, np.uint8)
    blue = np.zeros((5, 7, 3), np.uint8)
    blue[..., 0] = 200  # OpenCV writes BGR
    alpha = np.dstack([blue, np.full((5, 7), 9, np.uint8)])
    deep = np.full((5, 7), 51 * 257, np.uint16)
    white = np.full((5, 7, 3), 65535, np.uint16)
    cases = [
        (grey, (51, 51, 51)),
        (blue, (0, 0, 200)),
        (alpha, (0, 0, 200)),
        (deep, (51,) * 3),
        (white, (255,) * 3),
    ]
    for i, (picture, expected) in enumerate(cases):
        write_picture(tmp_path / f"{i}.png", picture)
        (image,) = iter_clip(tmp_path / f"{i}.png")
        assert image.shape == (5, 7, 3)
        assert image.dtype == np.uint8
        assert tuple(image[2, 3]) == expected


def test_iter_clip_of_a_video_and_its_size(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", [frame_picture((32, 24), f, 1) for f in range(6)])
    assert len(list(iter_clip(tmp_path / "a.mp4", size=(32, 24)))) == 6
    with pytest.raises(MocapError, match="32 x 24, expected 64 x 48") as caught:
        list(iter_clip(tmp_path / "a.mp4", size=(64, 48), camera="c"))
    assert caught.value.camera == "c"
    assert "0.5" in caught.value.remedy


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.mp4", b"", "empty"),
        ("a.mp4", b"this is no video at all" * 50, "cannot be read"),
        ("a.mp4", None, "no such video"),
        ("a.txt", b"text", "no video that we know"),
        ("a.png", b"\x89PNG nonsense", "cannot be read"),
        ("a.png", b"", "cannot be read"),
    ],
)
def test_unreadable_files(tmp_path: Path, name: str, content: bytes | None, message: str) -> None:
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    for action in (lambda: clip_info(path, camera="c"), lambda: list(iter_clip(path, camera="c"))):
        with pytest.raises(MocapError, match=message) as caught:
            action()
        assert caught.value.path == path
        assert caught.value.camera == "c"
        assert caught.value.remedy


def test_video_cut_off_in_the_middle(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    write_video(path, [frame_picture((32, 24), f, 1) for f in range(6)])
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(MocapError, match="truncated"):
        clip_info(path)


def test_video_and_folder_without_frames(tmp_path: Path) -> None:
    writer = cv2.VideoWriter(str(tmp_path / "a.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 30, (32, 24))
    writer.release()
    (tmp_path / "folder").mkdir()
    for path in (tmp_path / "a.mp4", tmp_path / "folder"):
        with pytest.raises(MocapError, match="empty"):
            clip_info(path)
        with pytest.raises(MocapError, match="empty"):
            list(iter_clip(path))


def test_clip_info_counts(tmp_path: Path) -> None:
    write_video(tmp_path / "a.mp4", [frame_picture((32, 24), f, 1) for f in range(7)], fps=12.5)
    info = clip_info(tmp_path / "a.mp4")
    assert (info.n_frames, info.header_frames, info.size, info.fps) == (7, 7, (32, 24), 12.5)
    # The answer is kept, but not when the file changes.
    write_video(tmp_path / "a.mp4", [frame_picture((32, 24), f, 1) for f in range(9)], fps=12.5)
    assert clip_info(tmp_path / "a.mp4").n_frames == 9


def mask_of(size: tuple[int, int], frame: int) -> np.ndarray:
    mask = np.zeros((size[1], size[0]), dtype=bool)
    mask[8:24, 8 : 16 + 4 * frame] = True
    return mask


@pytest.mark.parametrize("kind", ["png", "grey 1", "rgba", "mp4", "npz", "packed", "by name"])
def test_masks_from_every_kind_of_source(tmp_path: Path, rig: CameraRig, kind: str) -> None:
    sources = {}
    for camera in rig:
        masks = [mask_of(camera.size, f) for f in range(5)]
        stack = np.stack(masks)
        path = tmp_path / camera.name
        if kind in {"png", "grey 1", "rgba"}:
            for f, mask in enumerate(masks):
                picture = mask.astype(np.uint8) * (1 if kind == "grey 1" else 255)
                if kind == "rgba":
                    picture = np.dstack([picture, picture, picture, np.full_like(picture, 255)])
                write_picture(path / f"{f}.png", picture)
        elif kind == "mp4":
            path = path.with_suffix(".mp4")
            write_video(path, [np.repeat(m[..., None].astype(np.uint8) * 255, 3, axis=2) for m in masks])
        else:
            path = path.with_suffix(".npz")
            if kind == "packed":
                np.savez(path, masks=np.packbits(stack, axis=2), size=camera.size)
            else:
                np.savez(path, **{"masks" if kind == "npz" else camera.name: stack})
        sources[camera.name] = path
        info = clip_info(path, camera=camera.name)
        assert (info.n_frames, info.size) == (5, camera.size)
    with MaskReader(sources, rig, range(1, 5)) as reader:
        for frame, masks in reader:
            for camera, mask in zip(rig, masks, strict=True):
                assert mask.dtype == np.bool_
                wrong = mask != mask_of(camera.size, frame)
                # Lossy video may move an edge by a pixel.
                assert wrong.sum() <= (20 if kind == "mp4" else 0)


def test_mask_archive_without_the_camera(tmp_path: Path, rig: CameraRig) -> None:
    np.savez(tmp_path / "m.npz", other=np.zeros((2, 3, 4), bool))
    with pytest.raises(MocapError, match="other") as caught:
        list(MaskReader({"back": tmp_path / "m.npz"}, rig.subset(["back"]), range(2)))
    assert caught.value.camera == "back"
    (tmp_path / "m.npz").write_bytes(b"nonsense")
    with pytest.raises(MocapError, match="cannot be read"):
        clip_info(tmp_path / "m.npz")
