"""Pieces of a recording, run apart and joined: the whole run but for the smoothing window, and who is who."""

from __future__ import annotations

import csv
import json
import shutil
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from small_session import PLAIN, copy_session, mocap, set_options
from two_persons import BODY, exchange_tracks, two_persons_session

from mocap.body import landmarks_of, load_body_model, neutral_state, scale_body
from mocap.body.stretch import standing_height
from mocap.errors import MocapError
from mocap.io.store import StageStore
from mocap.pipeline.config import load_config
from mocap.pipeline.edits.model import Edits
from mocap.pipeline.finished import check_edits, open_run, run_again
from mocap.pipeline.join import join_runs, piece_frames
from mocap.pipeline.record import RunResult
from mocap.pipeline.run import run_session
from mocap.pipeline.stages import pose as pose_stage
from mocap.pose.join import mean_body
from mocap.pose.method import Method
from mocap.pose.smooth import carried_over
from mocap.products.hulls import hull_at
from mocap.products.owners import owners_at
from mocap.products.poses import stored_poses

N_FRAMES, LAG = 22, 3
EARLY, LATE = range(14), range(8, 22)
# A height that is given: pieces that measure it for themselves differ by what they measure.
SETTINGS = (
    *PLAIN,
    "output.formats=[]",
    "pose.look_again=false",
    f"pose.smooth_lag_frames={LAG}",
    "body.height_m=1.68",
    *BODY,
    # Feet are held on the floor by what the whole clip says of their contacts, and pieces are not the whole.
    "method.contact.hold=0",
)
CONFIG = load_config("default", SETTINGS)
# What the filters of the pieces find is as good as that of the whole run, and not the same: with three seeds the whole
# run differs from itself by 36 to 69 mm (person 1) and 12 to 29 mm (person 2) on this session of small pictures, with
# a body of feet and hands.
SAME_AS_ANOTHER_SEED_MM = 69.0


@cache
def walkers(base: Path) -> Path:
    """Two people who walk in circles beside each other, as true silhouettes. Never change it: copy it."""
    return two_persons_session(base, N_FRAMES)


@cache
def whole_run(base: Path) -> RunResult:
    return run_session(walkers(base), base / "joined" / "whole", config=CONFIG)


@cache
def pieces(base: Path) -> tuple[Path, Path]:
    """Runs of both pieces; the later one calls the persons the other way round."""
    early, late = base / "joined" / "early", base / "joined" / "late"
    run_session(walkers(base), early, config=CONFIG, frames=(EARLY.start, EARLY.stop), until="pose")
    run_session(walkers(base), late, config=CONFIG, frames=(LATE.start, LATE.stop), until="track")
    exchange_tracks(late, LATE)
    run_session(walkers(base), late, config=CONFIG, frames=(LATE.start, LATE.stop), until="pose", resume=True)
    return early, late


@cache
def joined_run(base: Path) -> RunResult:
    return join_runs(walkers(base), pieces(base)[::-1], base / "joined" / "out")


@pytest.fixture
def base(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.getbasetemp()


def test_joined_is_the_earlier_piece_but_for_the_smoothing_window(base: Path) -> None:
    joined, (early, _) = joined_run(base), pieces(base)
    (seam,) = joined.record.numbers["join"]["seams"]
    # The smoother passes twice: the second time with weights of points that look ahead themselves. The later piece is
    # not the same anywhere: a smoother forgets nothing of what was before.
    own = stored_poses(StageStore(early / "store.zarr"))
    for a, b in zip(own, joined.poses, strict=True):
        before = int(np.searchsorted(a.frames, seam["frame"] - 2 * LAG))
        assert before > 0
        np.testing.assert_allclose(b.landmarks[:before], a.landmarks[:before], atol=1e-9)


def test_joined_is_as_near_to_the_whole_run_as_another_seed(base: Path) -> None:
    whole, joined = whole_run(base), joined_run(base)
    (seam,) = joined.record.numbers["join"]["seams"]
    assert EARLY.stop > seam["frame"] > LATE.start
    assert [p.person for p in joined.poses] == [p.person for p in whole.poses] == [1, 2]
    for a, b in zip(whole.poses, joined.poses, strict=True):
        np.testing.assert_array_equal(a.frames, b.frames)
        far = np.linalg.norm(a.landmarks - b.landmarks, axis=2)
        assert 1000 * far.mean() < SAME_AS_ANOTHER_SEED_MM
        # No seam: from frame to frame nobody moves further than anywhere else.
        step = np.linalg.norm(np.diff(b.landmarks, axis=0), axis=2).mean(axis=1)
        at = int(np.searchsorted(b.frames, seam["frame"])) - 1
        assert step[at] <= 1.5 * step.max(where=np.arange(len(step)) != at, initial=0.0)
    assert all(gap < 100 for gap in seam["gap_mm"].values())
    assert joined.record.is_joined
    assert joined.scores is not None
    assert joined.status == "complete"


def test_persons_have_one_name_in_all_products(base: Path) -> None:
    joined = joined_run(base)
    assert joined.tracks is not None
    store = joined.found.store
    hulls, owners = store.reader("carve"), store.reader("track-owners")
    for frame in joined.session.frames:
        hull, owner = hull_at(hulls, frame), owners_at(owners, frame)
        for p in joined.poses:
            own = hull.grid.centers(hull.voxels[owner == p.person])
            track = joined.tracks.of(p.person)
            place = track.xyz[track.frame == frame][0]
            root = p.landmarks[p.frames == frame][0].mean(axis=0)
            assert np.linalg.norm((own.mean(axis=0) - place)[:2]) < 0.2
            assert np.linalg.norm((root - place)[:2]) < 0.3


def test_things_of_the_pieces_are_in_none_of_the_whole(
    base: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    copies = [Path(shutil.copytree(piece, tmp_path / piece.name)) for piece in pieces(base)]
    # Person 1, whom the later piece calls 2.
    monkeypatch.setattr(pose_stage, "is_like_nobody", lambda xyz, *_: xyz[:, 0].mean() > 0)
    monkeypatch.setattr(pose_stage, "is_thing", lambda *_: True)
    for copy, frames in zip(copies, (EARLY, LATE), strict=True):
        for product in (copy / "store.zarr").glob("pose*"):
            shutil.rmtree(product)
        run_session(
            walkers(base), copy, config=CONFIG, frames=(frames.start, frames.stop), until="pose", resume=True
        )
    joined = join_runs(walkers(base), copies, tmp_path / "out")
    assert joined.tracks is not None
    assert joined.tracks.persons == (2,)
    assert [p.person for p in joined.poses] == [2]
    told = [words for words in joined.record.warnings if "is left out" in words]
    for number, words in zip((1, 2), told, strict=True):
        assert f"was tracked as person {number} and" in words


def test_the_folder_is_that_of_one_run(base: Path) -> None:
    joined, (early, _) = joined_run(base), pieces(base)
    opened = open_run(joined.out, walkers(base))
    assert [p.person for p in opened.poses] == [1, 2]
    assert opened.record.numbers["join"]["pieces"] == [[0, 14], [8, 22]]
    about = json.loads((joined.out / "run.json").read_text())
    assert about["stage_keys"]["pose"] != json.loads((early / "run.json").read_text())["stage_keys"]["pose"]
    with pytest.raises(MocapError, match="joined from pieces, and is edited in them"):
        check_edits(joined.out, Edits())
    with pytest.raises(MocapError, match="joined from pieces"):
        run_again(joined.out, walkers(base))
    with pytest.raises(MocapError, match="joined itself"):
        join_runs(walkers(base), [joined.out, early], base / "joined" / "again")


def test_the_command_and_what_it_refuses(base: Path, tmp_path: Path) -> None:
    session, (early, late) = walkers(base), pieces(base)
    out = tmp_path / "out"

    def said(*found: object, to: Path = out, of: Path = session) -> str:
        answer = mocap("join", of, *found, "-o", to)
        assert answer.code == 2, answer.out
        return answer.err

    assert "one piece alone" in said(early)
    assert "lie in each other" in said(early, early)
    assert "cannot take the place of one of its pieces" in said(early, late, to=late)
    assert "do not belong into the session" in said(early, late, to=session / "out")
    assert "holds no result of a run" in said(early, tmp_path)

    short = tmp_path / "short"
    for stop, words in ((8, "share no frames"), (7, "frames 7 to 7 are in no piece")):
        run_session(session, short, config=CONFIG, frames=(0, stop), until="pose")
        assert words in said(short, late)
    other = load_config("default", (*SETTINGS, "pose.n_particles=40"))
    run_session(session, short, config=other, frames=(0, 10), until="pose")
    assert "different settings: pose.n_particles is 50, and 40" in said(short, late)
    run_session(session, short, config=CONFIG, frames=(0, 10), until="track")
    assert "ended before there was a product" in said(short, late)

    moved = copy_session(session, tmp_path / "moved")
    picture = sorted((moved / "masks").glob("*/*.png"))[0]
    shutil.copy(sorted((moved / "masks").glob("*/*.png"))[3], picture)
    assert "was made from other files, cameras or frames" in said(early, late, of=moved)
    assert not out.exists() or not (out / "run.json").exists()

    assert mocap("join", session, late, early, "-o", out).code == 0
    assert (out / "landmarks.csv").read_bytes() == (joined_run(base).out / "landmarks.csv").read_bytes()


@pytest.mark.slow
def test_workers_of_their_own_join_to_the_same_bytes(base: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed", reason="needs the extra cluster")
    rows = []
    for n_workers in (0, 2):
        out = tmp_path / str(n_workers)
        words = ("--workers", n_workers, "--pieces", 2, "--overlap", 0.6)
        said = mocap("batch", walkers(base), "-o", out, *words, *set_options(SETTINGS))
        assert said.code == 0, said.err
        (run,) = out.glob("runs/*")
        rows.append([(run / name).read_bytes() for name in ("landmarks.csv", "tracks.csv", "angles.csv")])
    assert rows[0] == rows[1]


def test_pieces_without_volumes_are_refused_before_they_are_run(base: Path, tmp_path: Path) -> None:
    session = copy_session(walkers(base), tmp_path / "session")
    names = [path.name for path in (session / "masks").iterdir()]
    shutil.rmtree(session / "masks")
    (session / "detections").mkdir()
    lines = ["frame,u_px,v_px", *(f"{f},10.0,10.0" for f in range(N_FRAMES))]
    for name in names:
        (session / "detections" / f"{Path(name).stem}.csv").write_text("\n".join(lines) + "\n")
    said = mocap("batch", session, "-o", tmp_path / "out", "--workers", 0, "--pieces", 2)
    assert said.code == 1
    assert "only runs on volumes can be joined, and this one is on markers" in said.out + said.err
    assert not (tmp_path / "out" / "pieces").exists()


def test_a_batch_cuts_and_joins(base: Path, tmp_path: Path) -> None:
    command = ("batch", walkers(base), "-o", tmp_path, "--workers", 0, "--pieces", 2, "--overlap", 0.6)
    command += tuple(set_options(SETTINGS))
    said = mocap(*command)
    assert said.code == 0, said.err
    with (tmp_path / "table.csv").open(encoding="utf-8", newline="") as stream:
        (row,) = csv.DictReader(stream)
    assert (row["status"], row["n_frames"], row["n_persons"]) == ("done", "22", "2")
    (run,) = tmp_path.glob("runs/*/run.json")
    assert json.loads(run.read_text())["numbers"]["join"]["pieces"] == [[0, 14], [8, 22]]
    assert sorted(path.name for path in tmp_path.glob("pieces/*/*")) == ["0-14", "8-22"]
    made = run.stat().st_mtime_ns
    assert mocap(*command).code == 0
    assert run.stat().st_mtime_ns == made
    assert mocap(*command[:4], "--pieces", 9, "--workers", 0).code == 1


@pytest.mark.parametrize("n_pieces", [1, 2, 3, 7])
def test_pieces_cover_a_recording(n_pieces: int) -> None:
    frames, n_shared = range(30, 530), 20
    found = piece_frames(frames, n_pieces, n_shared)
    assert (found[0].start, found[-1].stop, len(found)) == (30, 530, n_pieces)
    for early, late in pairwise(found):
        assert early.stop - late.start == n_shared
    assert max(map(len, found)) - min(map(len, found)) <= n_pieces
    with pytest.raises(MocapError, match="cannot be cut into 30 pieces"):
        piece_frames(frames, 30, n_shared)
    with pytest.raises(MocapError, match="share 0 frames"):
        piece_frames(frames, 2, 0)


def test_sizes_are_reconciled_and_poses_carried_over() -> None:
    model = load_body_model("girdle")
    small, large = scale_body(model, 1.68), scale_body(model, 1.72)
    body = mean_body([small, large], [3.0, 1.0])
    assert body.height_m == pytest.approx(1.69)
    assert standing_height(body) == pytest.approx(
        0.75 * standing_height(small) + 0.25 * standing_height(large)
    )
    assert mean_body([small, small], [1.0, 5.0]) is small
    states = np.stack([neutral_state(large), neutral_state(large)])
    states[1, :3] += 0.4
    states[1, 6:] += 0.2
    carried = carried_over(states, large, body, Method())
    far = np.linalg.norm(landmarks_of(large, states) - landmarks_of(body, carried), axis=2)
    # Nobody's landmarks can all stay where they were in a body that is 3 cm shorter.
    assert far.max() < 0.02
    assert far.mean() < 0.01
