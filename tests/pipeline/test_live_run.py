"""Live runs on a small session: the engine equals the stages, cameras stall and die, a recording is run again."""

from __future__ import annotations

import http.server
import itertools
import json
import os
import threading
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from small_session import (
    CAMERAS,
    FPS,
    PLAIN,
    copy_session,
    mocap,
    read_clip,
    set_options,
    small_session,
)

from mocap.data import LANDMARKS, Camera, Occluders
from mocap.errors import MocapError
from mocap.io.session import Session, open_session
from mocap.io.store import StageStore
from mocap.io.tables import read_landmarks_csv, read_timestamps_csv, read_tracks_csv
from mocap.io.video import FrameReader
from mocap.pipeline.chains import CHAINS
from mocap.pipeline.config import Config, load_config
from mocap.pipeline.live.capture import CameraThread, Pace, Shot
from mocap.pipeline.live.engine import Engine, FrameResult
from mocap.pipeline.live.pairing import Pairing, PictureSet
from mocap.pipeline.live.persons import Following, _Persons
from mocap.pipeline.live.room import Recording
from mocap.pipeline.live.run import LIVE_DEFAULTS, LIVE_SETTINGS, LiveOrder, LiveStatus, run_live
from mocap.pipeline.run import run_session
from mocap.pose import forward, thing
from mocap.pose.forward import ForwardSettings, Sighting
from mocap.pose.person import VolumeClip
from mocap.pose.volume import PersonHull
from mocap.products import empty

SETTINGS = (*LIVE_DEFAULTS, *PLAIN, "tracking.confirm_frames=2", *LIVE_SETTINGS)
SOON = ForwardSettings(watched_s=0.5, least_frames=4)  # the clip has a second
THOROUGH = ("pose.n_layers=4", "pose.n_particles=200", "pose.n_start_frames=2", "pose.n_first_poses=8")
# Those that have a row per frame.
PRODUCTS = [
    product
    for stage in CHAINS["voxels"]
    if stage.name in ("segment", "carve")
    for product in stage.products
    if product != empty.PRODUCT
]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_session(tmp_path_factory.getbasetemp())


@pytest.fixture
def session(root: Path) -> Session:
    return open_session(root)


def sets_of(session: Session, *, without: tuple[str, ...] = ()) -> Iterator[PictureSet]:
    """The session's pictures as sets, at their own times."""
    with FrameReader(session.image_sources, session.rig, session.frames) as reader:
        for frame, pictures in reader:
            yield PictureSet(
                tuple(
                    None if name in without else Shot(frame / session.fps, time.monotonic(), picture)
                    for name, picture in zip(session.rig.names, pictures, strict=True)
                )
            )


def engine(session: Session, tmp_path: Path, config: Config | None = None, n_threads: int = 1) -> Engine:
    store = StageStore(tmp_path / f"live-{n_threads}.zarr")
    config = config or load_config("live", SETTINGS)
    return Engine(session, config, store, Occluders({}, 1), n_threads=n_threads, forward=SOON)


@pytest.mark.parametrize("n_threads", [1, 2])
def test_the_engine_makes_what_the_stages_store(session: Session, tmp_path: Path, n_threads: int) -> None:
    """Masks, hulls and owners are the same to the last bit, though nothing is stored."""
    config = load_config("live", SETTINGS)
    run_session(session, tmp_path / "out", config=config, until="track")
    store = StageStore(tmp_path / "out" / "store.zarr")
    n = 0
    with engine(session, tmp_path, config, n_threads) as live:
        for found in live._tracked(sets_of(session)):
            for product in PRODUCTS:
                stored = store.reader(product).read(found.seen.frame)
                assert stored.keys() == found.rows[product].keys()
                for name, values in found.rows[product].items():
                    np.testing.assert_array_equal(stored[name], values, err_msg=f"{product} {name}")
            owner = store.reader("track-owners").read(found.seen.frame)["owner"]
            np.testing.assert_array_equal(owner > 0, found.seen.owner > 0)
            n += 1
    assert n == len(session.frames)


def test_the_search_for_a_first_pose_forks_nothing(session: Session, monkeypatch: pytest.MonkeyPatch) -> None:
    """It has a thread of its own beside others that are at work."""
    threads = []

    def start(clip: VolumeClip, *_: object, **options: object) -> None:
        threads.append(clip.observation.tools.n_threads)
        raise ValueError("no hull")

    monkeypatch.setattr(forward, "start_person", start)
    config = load_config("live", SETTINGS)
    following = Following(session, config, Occluders({}, 1), seed=0, n_threads=2, forward=SOON)
    hull = PersonHull(np.arange(2000, dtype=np.int32), np.ones(2000, dtype=np.bool_))
    with ThreadPoolExecutor(1) as searches:
        follower = _Persons(following, searches)._follower(1)
        for k in range(9):
            follower.see(Sighting(0.1 * k, np.zeros(3), hull))
    assert threads == [1] * len(threads) != []


@pytest.fixture(scope="module")
def results(root: Path, tmp_path_factory: pytest.TempPathFactory) -> list[FrameResult]:
    """Of the session's clip, without threads."""
    session = open_session(root)
    config = load_config("live", (*SETTINGS, *THOROUGH))
    with engine(session, tmp_path_factory.mktemp("live"), config) as live:
        return list(live.results(sets_of(session)))


def test_a_person_is_looked_at_sized_and_followed(results: list[FrameResult], root: Path) -> None:
    assert [r.frame for r in results] == list(range(len(results)))
    (truth,) = read_landmarks_csv(root / "truth" / "landmarks.csv")
    errors = [
        np.linalg.norm(p.pose.landmarks[: len(LANDMARKS)] - truth.landmarks[r.frame], axis=1).mean()
        for r in results
        for p in r.persons
        if p.pose is not None
    ]
    assert len(errors) >= 5
    assert np.mean(errors) < 0.08  # voxels of 4 cm; who faces the other way is off by 0.15 m or more
    heights = [p.height_m for r in results for p in r.persons]
    assert heights[0] is None
    assert heights == sorted(heights, key=lambda h: h is not None)  # what is known stays known
    assert all(1.5 < h < 2.0 for h in heights if h is not None)
    deviations = [p.deviation_m for r in results for p in r.persons if p.deviation_m is not None]
    assert all((d > 0).all() and (d < 0.5).all() for d in deviations)


def test_results_are_the_same_every_time(
    results: list[FrameResult], session: Session, tmp_path: Path
) -> None:
    with engine(session, tmp_path, load_config("live", (*SETTINGS, *THOROUGH))) as live:
        again = list(live.results(sets_of(session)))
    for one, other in zip(results, again, strict=True):
        for p, q in zip(one.persons, other.persons, strict=True):
            assert (p.person, p.height_m) == (q.person, q.height_m)
            if p.pose is not None and q.pose is not None:
                np.testing.assert_array_equal(p.pose.state, q.pose.state)


def test_a_thing_is_no_person_and_is_not_followed(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What keeps still and has no pose, as far as anybody asks here."""
    monkeypatch.setattr(thing, "is_like_nobody", lambda *_: True)
    monkeypatch.setattr(thing, "is_thing", lambda looks, *_: all(len(look.surface) > 20 for look in looks))
    numbers = ("method.thing.watched_s=0.3", "method.thing.n_looks=4", "method.thing.stays_m=9")
    config = load_config("live", (*SETTINGS, *THOROUGH, *numbers))
    with engine(session, tmp_path, config) as live:
        found = list(live.results(sets_of(session)))
    first = next(k for k, r in enumerate(found) if r.things)
    assert any(p.pose is not None for r in found[:first] for p in r.persons)
    assert not any(r.persons for r in found[first:])
    left_out = {(one.person, one.pose, one.height_m) for r in found[first:] for one in r.things}
    assert left_out == {(1, None, None)}
    assert len(found[first:]) > 1


@pytest.mark.slow
@pytest.mark.timeout(0)  # as long as it was asked to play
def test_memory_is_flat(session: Session, tmp_path: Path) -> None:
    """Somebody goes to and fro for two minutes of pictures, or as many as `MOCAP_LIVE_MINUTES` says."""
    statm = Path("/proc/self/statm")
    if not statm.exists():
        pytest.skip("memory is read from /proc")
    clip = list(sets_of(session))
    there_and_back = [*range(len(clip)), *range(len(clip) - 2, 0, -1)]
    n_frames = round(60 * float(os.environ.get("MOCAP_LIVE_MINUTES", "2")) * session.fps)

    def sets() -> Iterator[PictureSet]:
        for i in range(n_frames):
            found = clip[there_and_back[i % len(there_and_back)]]
            shots = [shot for shot in found.shots if shot is not None]
            yield PictureSet(tuple(replace(shot, time_s=i / session.fps) for shot in shots))

    used_mb: list[float] = []
    with engine(session, tmp_path) as live:
        for result in live.results(sets()):
            used_mb.append(int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 2**20)
            assert len(result.persons) == 1
    settled = used_mb[len(used_mb) // 3 :]
    assert settled[-1] - settled[0] < 2.0


@pytest.mark.slow
def test_who_comes_back_is_known(session: Session, root: Path, tmp_path: Path) -> None:
    """He is away for three seconds; his number and size are those of before, his pose is looked for anew."""
    empty = [read_clip(root / "background" / f"{name}.mp4")[0][:, :, ::-1] for name in session.rig.names]
    away_s = 3.0

    def sets() -> Iterator[PictureSet]:
        clip = list(sets_of(session))
        yield from clip
        for i in range(round(away_s * session.fps)):
            t = (len(clip) + i) / session.fps
            yield PictureSet(tuple(Shot(t, 0.0, np.ascontiguousarray(picture)) for picture in empty))
        later_s = away_s + len(clip) / session.fps
        for found in clip:
            shots = [shot for shot in found.shots if shot is not None]
            yield PictureSet(tuple(replace(shot, time_s=shot.time_s + later_s) for shot in shots))

    config = load_config("live", (*SETTINGS, *THOROUGH, "tracking.lost_frames=5"))
    with engine(session, tmp_path, config) as live:
        results = list(live.results(sets()))
    n = len(session.frames)
    before, after = results[:n], results[-n:]
    assert not any(r.persons for r in results[n + 8 : -n])
    height = before[-1].persons[0].height_m
    returned = [p for r in after for p in r.persons]
    assert {p.person for p in returned} == {1}
    assert {p.height_m for p in returned} == {height}
    assert returned[0].pose is None
    assert returned[-1].pose is not None


def test_a_camera_without_a_picture_takes_part_in_nothing(session: Session, tmp_path: Path) -> None:
    with engine(session, tmp_path) as live:
        found = list(live._tracked(sets_of(session, without=("cam_2",))))
    for frame in found:
        assert frame.rows["carve"]["used"].tolist() == [True, True, False, True]
        assert frame.rows["segment"]["usable"].tolist() == [True, True, False, True]
    assert any(len(frame.rows["carve"]["voxels"]) for frame in found)


# --- cameras by HTTP, on this machine ---


def jpegs_of(path: Path) -> list[bytes]:
    """The pictures of a video, one by one."""
    good = [cv2.IMWRITE_JPEG_QUALITY, 95]
    return [cv2.imencode(".jpg", picture, good)[1].tobytes() for picture in read_clip(path)]


class Film(http.server.ThreadingHTTPServer):
    """MJPEG streams /CAMERA of the session's pictures, there and back, with jitter; what a camera does is set from
    outside.  stalled : cameras that keep still.  dead : cameras that hang up.  lost : share of pictures that do not
    arrive."""

    daemon_threads = True

    def __init__(self, root: Path) -> None:
        super().__init__(("127.0.0.1", 0), _Stream)
        self.clips = {}
        for name in CAMERAS:
            jpegs = jpegs_of(root / "videos" / f"{name}.mp4")
            self.clips[name] = jpegs + jpegs[-2:0:-1]
        self.stalled: set[str] = set()
        self.dead: set[str] = set()
        self.lost = 0.0
        self.is_over = False
        self.start_s = time.monotonic()

    def url(self, name: str) -> str:
        return f"http://127.0.0.1:{self.server_address[1]}/{name}"


class _Stream(http.server.BaseHTTPRequestHandler):
    server: Film

    def do_GET(self) -> None:
        name = self.path.strip("/")
        film, rng = self.server, np.random.default_rng(len(self.path))
        if name in film.dead:
            self.send_error(503)
            return
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        clip = film.clips[name]
        while not film.is_over and name not in film.dead:
            n = int((time.monotonic() - film.start_s) * FPS) + 1
            due_s = film.start_s + n / FPS + rng.uniform(0.0, 0.1) / FPS
            time.sleep(max(0.0, due_s - time.monotonic()))
            if name in film.stalled or rng.random() < film.lost:
                continue
            jpeg = clip[n % len(clip)]
            head = b"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n" % len(jpeg)
            try:
                self.wfile.write(head + jpeg + b"\r\n")
            except OSError:
                return

    def log_message(self, *_: Any) -> None:
        """Nothing is logged."""


@pytest.fixture
def film(root: Path) -> Iterator[Film]:
    server = Film(root)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield server
    server.is_over = True
    server.shutdown()
    server.server_close()


def wait_until(is_so: Any, seconds: float = 15.0) -> None:
    until_s = time.monotonic() + seconds
    while not is_so():
        assert time.monotonic() < until_s, "waited in vain"
        time.sleep(0.02)


def test_a_camera_that_stalls_or_dies_stops_no_other_and_comes_back(session: Session, film: Film) -> None:
    film.lost = 0.05
    pairs = Pairing(CAMERAS, 0.6 / FPS, stalled_s=3 / FPS, min_cameras=3)
    start_s = time.monotonic()
    threads = [
        CameraThread(camera, film.url(camera.name), pairs.add, pace=Pace(FPS), start_s=start_s)
        for camera in session.rig
    ]
    for thread in threads:
        thread.start()

    def takes(n_cameras: int) -> bool:
        found = pairs.take(0.2)
        return found is not None and sum(s is not None for s in found.shots) == n_cameras

    try:
        wait_until(lambda: takes(4))
        film.stalled.add("cam_1")
        wait_until(lambda: takes(3))
        film.stalled.clear()
        wait_until(lambda: takes(4))
        film.dead.add("cam_3")
        wait_until(lambda: takes(3))
        wait_until(lambda: threads[3].n_failures > 0)
        film.dead.clear()
        wait_until(lambda: takes(4))
    finally:
        film.is_over = True
        for thread in threads:
            thread.stop()
    assert pairs.counts.n_partial > 0


def live_words(film: Film, root: Path, out: Path, *more: object) -> tuple[object, ...]:
    """`mocap live` on the streams, with voxels that a busy machine can follow."""
    cameras = [word for name in CAMERAS for word in ("--camera", f"{name}={film.url(name)}")]
    settings = set_options((*PLAIN, "volume.voxel_size_m=0.06"))
    return ("live", root / "calibration.toml", "-o", out, *cameras, "--fps", FPS, *more, *settings)


def lines_of(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_live_cameras_are_followed_and_recorded(film: Film, root: Path, tmp_path: Path) -> None:
    """From streams that lose pictures to lines of JSON, and the recording is a session that can be run."""
    film.lost = 0.05
    out = tmp_path / "room"
    words = live_words(
        film, root, out, "--background", root, "--record", "--seconds", 4, "--json", tmp_path / "out.jsonl"
    )
    said = mocap(*words)
    assert said.code == 0, said.err
    assert "results/s" in said.err
    lines = lines_of(tmp_path / "out.jsonl")
    assert any(line["persons"] for line in lines)
    assert all(a["frame"] < b["frame"] for a, b in itertools.pairwise(lines))
    recorded = open_session(out)
    assert recorded.rig.names == CAMERAS
    # Whatever the engine had time for, all pictures are there, each at its time.
    assert len(recorded.frames) >= lines[-1]["frame"] - lines[0]["frame"]
    stamps = read_timestamps_csv(out / "timestamps.csv")
    assert {name: len(read_clip(out / "videos" / f"{name}.mp4")) for name in CAMERAS} == {
        name: len(times) for name, times in stamps.items()
    }
    config = load_config("default", (*PLAIN, "volume.voxel_size_m=0.06", *LIVE_SETTINGS))
    run_session(recorded, tmp_path / "again", config=config, until="track")
    assert len(read_tracks_csv(tmp_path / "again" / "tracks.csv")) > len(recorded.frames) // 2
    kept = {path: path.read_bytes() for path in out.glob("*.toml")}
    again = mocap(*live_words(film, root, out, "--fps", 2 * FPS, "--seconds", 1))
    assert again.code == 2
    assert "recording already" in again.err
    assert kept == {path: path.read_bytes() for path in out.glob("*.toml")}
    assert len(read_timestamps_csv(out / "timestamps.csv")["cam_0"]) == len(stamps["cam_0"])


def test_a_camera_that_never_films_is_recorded_without_a_clip(session: Session, tmp_path: Path) -> None:
    with Recording(replace(session, root=tmp_path)) as recording:
        for k in range(3):
            recording.put(
                "cam_1", Shot(k / FPS, 0.0, np.zeros((*session.rig["cam_1"].size[::-1], 3), np.uint8))
            )
    recording.put("cam_1", Shot(1.0, 0.0, np.zeros((*session.rig["cam_1"].size[::-1], 3), np.uint8)))
    assert [p.name for p in (tmp_path / "videos").iterdir()] == ["cam_1.mp4"]
    assert len(read_clip(tmp_path / "videos" / "cam_1.mp4")) == 3
    with Recording(replace(session, root=tmp_path / "other")):
        """Nobody films."""
    assert not any(path.is_file() for path in (tmp_path / "other").rglob("*"))


def test_the_empty_room_is_filmed_first(film: Film, root: Path, tmp_path: Path) -> None:
    for name in CAMERAS:
        film.clips[name] = jpegs_of(root / "background" / f"{name}.mp4")
    room, json_to = tmp_path / "room", tmp_path / "out.jsonl"
    said = mocap(*live_words(film, root, room, "--background-s", 1, "--seconds", 1, "--json", json_to))
    assert said.code == 0, said.err
    assert all(len(list((tmp_path / "room" / "background" / name).glob("*.png"))) >= 10 for name in CAMERAS)
    assert "Filming the empty room for 1 s" in said.err
    assert all(not line["persons"] for line in lines_of(json_to))


# --- files, and what is refused ---


class Results:
    def __init__(self) -> None:
        self.results: list[FrameResult] = []

    def put(self, result: FrameResult) -> None:
        self.results.append(result)

    def close(self) -> None:
        """Nothing to close."""


def run(order: LiveOrder) -> tuple[list[FrameResult], LiveStatus]:
    sink = Results()
    status = run_live(order, [sink], show=lambda status: None, count_down=lambda left_s: None)
    return sink.results, status


def order(session: Session, **more: Any) -> LiveOrder:
    sources = {name: str(path) for name, path in session.image_sources.items()}
    return LiveOrder(session, sources, load_config("live", SETTINGS), **more)


@pytest.mark.parametrize("rate", [0.5, 4.0])
def test_a_session_is_played_at_a_pace(session: Session, rate: float) -> None:
    """At any pace the frames are the session's; what could not be kept up with is counted."""
    results, status = run(order(session, rate=rate, tolerance_s=0.01))
    frames = [r.frame for r in results]
    assert frames == sorted(set(frames))
    assert set(frames) <= set(session.frames)
    assert status.n_results == len(frames)
    assert len(frames) + status.counts.n_dropped >= len(session.frames) - 1
    assert all(r.latency_s > 0 for r in results)


def test_it_stops_after_some_seconds(session: Session) -> None:
    started = time.monotonic()
    run(order(session, rate=0.05, seconds=1.0))
    assert time.monotonic() - started < 20.0


def test_a_source_of_another_size_is_refused(session: Session) -> None:
    wider = replace(session, rig=session.rig.subset(CAMERAS))
    camera = session.rig["cam_0"]
    other = Camera("cam_0", (camera.size[0] + 8, camera.size[1]), camera.K, camera.dist, camera.R, camera.t)
    said: list[Shot] = []
    path = str(wider.image_sources["cam_0"])
    thread = CameraThread(other, path, lambda n, s: said.append(s), pace=Pace(FPS), start_s=0.0)
    thread.start()
    wait_until(lambda: thread.is_over)
    assert not said
    assert isinstance(thread.error, MocapError)
    assert "cam_0" in str(thread.error)


def test_a_file_is_played_by_its_clock(session: Session) -> None:
    camera, source = session.rig["cam_0"], session.image_sources["cam_0"]
    pictures = read_clip(source)
    said: list[Shot] = []
    # The clip began one frame late and loses a picture in every second; the session begins at frame 1.
    pace = Pace(FPS, rate=50.0, clip_frames=np.array([0, 0, 1, 3, 4]), first=1)
    thread = CameraThread(camera, str(source), lambda n, s: said.append(s), pace=pace, start_s=0.0)
    thread.start()
    wait_until(lambda: thread.is_over)
    assert thread.error is None
    assert [shot.time_s for shot in said] == pytest.approx([k / FPS for k in range(4)])
    for shot, k in zip(said, (0, 1, 3, 4), strict=True):
        np.testing.assert_array_equal(shot.picture[:, :, ::-1], pictures[k])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ([], "no cameras"),
        (["CALIBRATION", "--camera", "cam_0=0"], "at least 3"),
        (["CALIBRATION", "--camera", "cam_0"], "CAMERA=SOURCE"),
        (["CALIBRATION", "--camera", "cam_9=0"], "no camera 'cam_9'"),
        (["--replay", "SESSION", "--udp", "nowhere"], "--udp"),
        (["--replay", "SESSION", "--record"], "recording already"),
        (["--replay", "SESSION", "--view", "webb"], "'web'"),
    ],
)
def test_what_is_mistyped_is_answered(root: Path, tmp_path: Path, options: list[str], words: str) -> None:
    real = {"CALIBRATION": root / "calibration.toml", "SESSION": root}
    said = mocap("live", "-o", tmp_path / "room", *(real.get(word, word) for word in options))
    assert said.code == 2
    assert words in said.err


def test_a_session_without_pictures_is_not_played(root: Path, tmp_path: Path) -> None:
    masks = copy_session(root, tmp_path / "masks", masks=True, n_frames=3)
    said = mocap("live", "--replay", masks)
    assert said.code == 2
    assert "pictures" in said.err
