"""`mocap sync`: clips of one recording that began at different moments, from the command line to the run's frames."""

from __future__ import annotations

import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from small_session import mocap

from eval.bench.scene import person_mask, ring
from mocap.io import open_session
from mocap.io.calibration import write_calibration

SIZE, FPS, N = (320, 240), 30.0, 90
RIG = ring(4, SIZE)
LATE = {RIG.names[1]: 4, RIG.names[3]: 9}
MakeSession = Callable[[dict[str, int]], Path]


@pytest.fixture(scope="module")
def films() -> dict[str, list[np.ndarray]]:
    """True silhouettes of somebody who walks a curve."""
    angles = np.arange(N) / FPS * 1.1
    return {
        c.name: [
            person_mask(c, np.array([0.7 * np.cos(a), 0.5 * np.sin(2 * a)]), a + np.pi / 2) for a in angles
        ]
        for c in RIG
    }


@pytest.fixture
def make_session(tmp_path: Path, films: dict[str, list[np.ndarray]]) -> MakeSession:
    """A session of masks in which some cameras began late, by frames."""

    def make(late: dict[str, int]) -> Path:
        root = tmp_path / "session"
        for name, masks in films.items():
            folder = root / "masks" / name
            folder.mkdir(parents=True)
            for k, mask in enumerate(masks[late.get(name, 0) :]):
                cv2.imwrite(str(folder / f"{k:04d}.png"), mask.astype(np.uint8) * 255)
        write_calibration(root / "calibration.toml", RIG)
        text = f'# ours\nfps = {FPS}\n\n[offset_s]\n"{RIG.names[0]}" = 1.0\n\n[camera_map]\n'
        (root / "session.toml").write_text(text, encoding="utf-8")
        return root

    return make


def test_offsets_are_found_written_and_applied(make_session: MakeSession, tmp_path: Path) -> None:
    session = make_session(LATE)
    done = mocap("sync", session, "--picture", tmp_path / "proof.png")
    assert done.code == 0, done.err
    assert "later" in done.out
    assert "the reference" in done.out
    assert cv2.imread(str(tmp_path / "proof.png")) is not None
    text = (session / "session.toml").read_text(encoding="utf-8")
    assert text.startswith(f"# ours\nfps = {FPS}\n")
    assert "[camera_map]" in text
    assert text.count("[offset_s]") == 1
    opened = open_session(session)
    for k in opened.frames:
        shown = {name: int(opened.clip_frames[name][k]) + LATE.get(name, 0) for name in RIG.names}
        assert len(set(shown.values())) == 1, shown
    # The second time nothing changes.
    assert mocap("sync", session).code == 0
    assert (session / "session.toml").read_text(encoding="utf-8") == text


def test_a_dry_run_writes_nothing(make_session: MakeSession) -> None:
    session = make_session(LATE)
    before = (session / "session.toml").read_bytes()
    assert mocap("sync", session, "--dry-run").code == 0
    assert (session / "session.toml").read_bytes() == before


def test_clocks_that_agree_leave_no_table(make_session: MakeSession) -> None:
    session = make_session({})
    assert mocap("sync", session).code == 0
    assert "offset_s" not in (session / "session.toml").read_text(encoding="utf-8")
    assert open_session(session).clip_frames == {}


def test_frames_are_counted_on_the_clock_of_a_chosen_camera(make_session: MakeSession) -> None:
    session = make_session(LATE)
    late = RIG.names[3]
    done = mocap("sync", session, "--reference", late)
    assert done.code == 0, done.err
    opened = open_session(session)
    assert opened.clip_frames[late].tolist() == list(range(opened.frames.stop))
    done = mocap("sync", session, "--reference", "nobody")
    assert done.code == 2
    assert "no camera nobody" in done.err


def test_nobody_moves(make_session: MakeSession) -> None:
    session = make_session({})
    for name in RIG.names:
        files = sorted((session / "masks" / name).iterdir())
        for file in files[1:]:
            shutil.copyfile(files[0], file)
    done = mocap("sync", session)
    assert done.code == 2
    assert "nobody moves" in done.err
    assert "offset_s" in done.err


def test_a_reference_that_sees_nobody_move_is_refused(make_session: MakeSession) -> None:
    session = make_session(LATE)
    still = RIG.names[2]
    files = sorted((session / "masks" / still).iterdir())
    for file in files[1:]:
        shutil.copyfile(files[0], file)
    before = (session / "session.toml").read_bytes()
    done = mocap("sync", session, "--reference", still)
    assert done.code == 2
    assert f"camera {still}" in done.err
    assert "cannot be the reference" in done.err
    assert (session / "session.toml").read_bytes() == before
    assert mocap("sync", session, "--dry-run").code == 0


LATE_S = {RIG.names[1]: 0.4, RIG.names[2]: 1.1, RIG.names[3]: -0.3}
FLASHES_S = ((2.0, 2.3), (3.1, 3.2))


def write_clips(
    root: Path,
    *,
    with_sound: bool = True,
    flashes: tuple[tuple[float, float], ...] = FLASHES_S,
    chapters: str = "",
) -> Path:
    """A session of short videos whose cameras began at different times, with a torch, and a clap at each flash.

    chapters : camera that has cut its recording in two.
    """
    for n, camera in enumerate(RIG):
        noise, begins = np.random.default_rng(n), LATE_S.get(camera.name, 0.0)
        path = root / "videos" / f"{camera.name}.mp4"
        if camera.name != chapters:
            write_clip(path, noise, begins, range(150), flashes, with_sound=with_sound)
            continue
        for k, part in enumerate((range(60), range(60, 150))):
            chapter = path.with_suffix("") / f"GX0{k + 1}0007.MP4"
            write_clip(chapter, noise, begins, part, flashes, with_sound=with_sound)
    write_calibration(root / "calibration.toml", RIG)
    (root / "session.toml").write_text(f"fps = {FPS}\n", encoding="utf-8")
    return root


def write_clip(
    path: Path,
    noise: np.random.Generator,
    begins: float,
    pictures: range,
    flashes: tuple[tuple[float, float], ...],
    *,
    with_sound: bool,
) -> None:
    av = pytest.importorskip("av")
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        video = container.add_stream("mpeg4", rate=int(FPS))
        video.width, video.height = SIZE
        sound = container.add_stream("aac", rate=16000, layout="mono") if with_sound else None
        for k in pictures:
            time = begins + k / FPS
            level = 60 + 80 * any(a <= time < b for a, b in flashes)
            picture = noise.integers(level - 3, level + 4, (SIZE[1], SIZE[0], 3)).astype(np.uint8)
            container.mux(video.encode(av.VideoFrame.from_ndarray(picture)))
        container.mux(video.encode())
        if sound is None:
            return
        times = begins + pictures[0] / FPS + np.arange(round(len(pictures) / FPS * 16000)) / 16000
        wave = noise.normal(0, 1e-3, len(times))
        for a, _ in flashes:
            since = times - a
            decay = np.where(since > 0, np.exp(-np.clip(since, 0, 1) / 0.03), 0)
            wave += decay * noise.normal(0, 0.2, len(times))
        frame = av.AudioFrame.from_ndarray(wave[None].astype(np.float32), format="fltp", layout="mono")
        frame.sample_rate = 16000
        container.mux(sound.encode(frame))
        container.mux(sound.encode())


def written_offsets(root: Path) -> dict[str, float]:
    return tomllib.loads((root / "session.toml").read_text(encoding="utf-8"))["offset_s"]


@pytest.mark.parametrize(("by", "within_s"), [("light", 0.02), ("sound", 0.003)])
def test_a_torch_and_a_clap_tell_clocks(by: str, within_s: float, tmp_path: Path) -> None:
    session = write_clips(tmp_path / "session")
    done = mocap(
        "sync", session, "--by", by, "--reference", RIG.names[0], "--picture", tmp_path / "proof.png"
    )
    assert done.code == 0, done.err
    assert cv2.imread(str(tmp_path / "proof.png")) is not None
    assert written_offsets(session) == pytest.approx(LATE_S, abs=within_s)


@pytest.mark.parametrize(("by", "within_s"), [("light", 0.02), ("sound", 0.003)])
def test_the_chapters_of_a_camera_have_one_clock(by: str, within_s: float, tmp_path: Path) -> None:
    session = write_clips(tmp_path / "session", chapters=RIG.names[2])
    done = mocap("sync", session, "--by", by, "--reference", RIG.names[0])
    assert done.code == 0, done.err
    assert written_offsets(session) == pytest.approx(LATE_S, abs=within_s)


def test_clips_that_share_nothing_tell_no_clocks(tmp_path: Path) -> None:
    session = write_clips(tmp_path / "session", with_sound=False, flashes=())
    dark = mocap("sync", session, "--by", "light")
    assert dark.code == 2
    assert "no flash or lamp stands out" in dark.err
    mute = mocap("sync", session, "--by", "sound")
    assert mute.code == 2
    assert "the clip has no sound" in mute.err
    assert f"camera {RIG.names[0]}" in mute.err
    unknown = mocap("sync", session, "--by", "smell")
    assert unknown.code == 2
    assert "people, light, sound" in unknown.err


def test_masks_have_neither_light_nor_sound(make_session: MakeSession) -> None:
    session = make_session(LATE)
    for by in ("light", "sound"):
        done = mocap("sync", session, "--by", by)
        assert done.code == 2
        assert "--by" in done.err
