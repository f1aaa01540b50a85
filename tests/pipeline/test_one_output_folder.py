"""One output folder, one truth: what lies in it is of one run, and only one command works in it."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from small_session import PLAIN, copy_session, mocap, set_options, small_session

from mocap.compare import compare
from mocap.errors import MocapError
from mocap.io.store import StageStore
from mocap.pipeline import inputs, lock, scene_frames
from mocap.pipeline.config import Config, load_config
from mocap.pipeline.export import export_run
from mocap.pipeline.finished import open_run, read_record, rewrite_report, rewrite_scene, write_overlays
from mocap.pipeline.inputs import FileHashes
from mocap.pipeline.lock import LOCK_NAME, sole_use
from mocap.pipeline.publish import published
from mocap.pipeline.record import record_to_json
from mocap.pipeline.run import run_session
from mocap.products.hulls import read_hulls

WITH_POSES = {
    *("run.json", "tracks.csv", "landmarks.csv", "angles.csv"),
    *("contacts.csv", "steps.csv", "cycles.csv", "moves.csv"),
    *("pose.npz", "body.toml"),
}
SMALL = (*PLAIN, "volume.voxel_size_m=0.05")


def config(*formats: str, more: tuple[str, ...] = ()) -> Config:
    listed = ", ".join(f'"{name}"' for name in formats)
    return load_config("default", (*SMALL, f"output.formats=[{listed}]", *more))


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    base = small_session(tmp_path_factory.getbasetemp())
    return copy_session(base, tmp_path_factory.mktemp("one") / "session", masks=True, n_frames=4)


@pytest.fixture(scope="module")
def finished(session: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("one") / "out"
    run_session(session, out, config=config("bvh", "trc", "report"))
    return out


@pytest.fixture
def out(finished: Path, tmp_path: Path) -> Path:
    """A copy of a finished run with every output."""
    return Path(shutil.copytree(finished, tmp_path / "out"))


def names(out: Path) -> set[str]:
    return {p.name for p in out.iterdir()}


def test_the_record_is_what_run_json_holds(finished: Path) -> None:
    about = json.loads((finished / "run.json").read_text())
    assert record_to_json(read_record(finished)) == about
    assert about["kind"] == "voxels"
    assert about["product_keys"].keys() == {
        *("segment", "empty", "occluders", "carve", "track", "track-owners", "pose-frames", "pose")
    }


def test_rehash_distrusts_what_is_remembered_of_files(
    session: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file system that does not tell that a file has changed."""
    copied, out = Path(shutil.copytree(session, tmp_path / "session")), tmp_path / "out"
    options = ["run", copied, "-o", out, "--until", "segment", *set_options(SMALL)]
    assert mocap(*options).code == 0
    changed = copied / "masks" / "cam_0" / "0000.png"
    changed.write_bytes((copied / "masks" / "cam_3" / "0003.png").read_bytes())
    notes = out / "store.zarr" / ".inputs.json"
    document = json.loads(notes.read_text()) if notes.exists() else {"format": 1, "files": {}}
    monkeypatch.setattr(inputs, "_OF_THIS_PROCESS", {})
    stat = changed.stat()
    marks = [stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_dev, stat.st_ino]
    original = session / "masks" / "cam_0" / "0000.png"
    document["files"][str(changed.resolve())] = [*marks, FileHashes().of(original)]
    notes.write_text(json.dumps(document))
    assert "reused" in mocap(*options, "--resume").out
    monkeypatch.setattr(inputs, "_OF_THIS_PROCESS", {})
    assert "reused" not in mocap(*options, "--resume", "--rehash").out


# --- what a run does not write anew is not left behind ---


def test_formats_that_are_left_out_are_removed(session: Path, out: Path) -> None:
    (out / "scores.json").write_text("{}")
    (out / "mine.txt").write_text("of the user")
    result = run_session(session, out, config=config("trc"), resume=True)
    assert result.reused == ("segment", "occluders", "carve", "track", "pose")
    assert names(out) == {
        *WITH_POSES,
        *("person_1.trc", "store.zarr", "mine.txt"),
    }
    assert result.record.removed == ("person_1.bvh", "report.html", "scores.json")
    about = json.loads((out / "run.json").read_text())
    assert about["removed"] == list(result.record.removed)
    assert set(about["files"]) == names(out) - {"store.zarr", "mine.txt"}


@pytest.mark.parametrize(
    ("until", "left"),
    [
        ("segment", {"run.json"}),
        ("track", {"run.json", "tracks.csv"}),
        ("pose", WITH_POSES),
    ],
)
def test_a_run_that_ends_earlier_leaves_what_it_wrote(
    session: Path, out: Path, until: str, left: set[str]
) -> None:
    run_session(session, out, config=config("bvh"), until=until, resume=True)
    assert names(out) == left | {"store.zarr"}


def test_of_a_long_recording_the_scene_shows_every_so_many_frames(
    session: Path, out: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert scene_frames.shown_frames(range(10, 14)) == range(10, 14)
    monkeypatch.setattr(scene_frames, "_MOST_FRAMES", 2)
    shown = list(scene_frames.scene_frames(open_run(out, session).found))
    hulls = dict(read_hulls(StageStore(out / "store.zarr")))
    assert [item.frame for item in shown] == [0, 2]
    for item in shown:
        assert item.hull is not None
        np.testing.assert_array_equal(item.hull.voxels, hulls[item.frame].voxels)


def test_the_last_line_names_a_report_of_this_run_only(session: Path, out: Path) -> None:
    options = set_options((*SMALL, 'output.formats=["trc"]'))
    said = mocap("run", session, "-o", out, "--resume", *options)
    assert said.code == 0, said.err
    assert "report.html, of an earlier run" in said.out
    assert said.out.splitlines()[-1] == f"Written to {out}"


def test_a_publication_that_fails_leaves_the_earlier_outputs(out: Path) -> None:
    before = {p.name: p.read_bytes() for p in out.iterdir() if p.is_file()}

    def fail() -> None:
        with published(out) as folder:
            (folder / "tracks.csv").write_text("new")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()
    assert {p.name: p.read_bytes() for p in out.iterdir() if p.is_file()} == before
    assert not (out / ".outputs.partial").exists()


def test_a_kill_among_the_files_leaves_no_run_json(out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Killed(BaseException):
        pass

    moved: list[str] = []
    real = os.replace

    def replace(source: Path, target: Path) -> None:
        if len(moved) == 2:
            raise Killed
        moved.append(Path(target).name)
        real(source, target)

    def publish() -> None:
        with published(out) as folder:
            for name in ("landmarks.csv", "run.json", "tracks.csv"):
                (folder / name).write_text("new")
            monkeypatch.setattr(os, "replace", replace)

    with pytest.raises(Killed):
        publish()
    assert moved == ["landmarks.csv", "tracks.csv"]
    assert "run.json" not in names(out)


def test_a_folder_in_the_place_of_an_output_is_found_before_the_first_stage(
    session: Path, tmp_path: Path
) -> None:
    (tmp_path / "out" / "landmarks.csv").mkdir(parents=True)
    with pytest.raises(MocapError, match=r"a folder where landmarks\.csv is to be written"):
        run_session(session, tmp_path / "out", config=config("bvh"))
    assert names(tmp_path / "out") == {"landmarks.csv"}


# --- store and tables of one run ---


def mixed(session: Path, out: Path) -> None:
    """Another run begins in the folder and does not end."""

    class Killed(Exception):
        pass

    def stop(stage: str, done: int, total: int) -> None:
        if stage == "pose":
            raise Killed

    with pytest.raises(Killed):
        run_session(session, out, config=config("bvh", more=("volume.voxel_size_m=0.045",)), progress=stop)


COMMANDS: dict[str, Callable[[Path, Path, Path], object]] = {
    "report": lambda out, session, folder: rewrite_report(out, session),
    "scene": lambda out, session, folder: rewrite_scene(out, session, folder / "scene.rrd"),
    "voxels": lambda out, session, folder: export_run(out, folder, what="voxels"),
    "motion": lambda out, session, folder: export_run(out, folder, what="motion"),
    "eval": lambda out, session, folder: compare(out, session),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_store_and_tables_of_different_runs_are_not_mixed(
    session: Path, out: Path, tmp_path: Path, command: str
) -> None:
    if command == "scene":
        pytest.importorskip("rerun")
    COMMANDS[command](out, session, tmp_path)
    mixed(session, out)
    with pytest.raises(
        MocapError, match="not that of the tables beside it: occluders, carve, track, track-owners of"
    ) as caught:
        COMMANDS[command](out, session, tmp_path)
    assert "--resume" in caught.value.remedy
    run_session(session, out, config=config("bvh", "report"), resume=True)
    COMMANDS[command](out, session, tmp_path)


def test_a_table_that_the_run_has_not_written_is_not_scored(session: Path, out: Path) -> None:
    path = out / "landmarks.csv"
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)
    for estimate, truth in ((out, session), (session, out)):
        with pytest.raises(MocapError, match=r"landmarks\.csv: not what the run in run\.json has written"):
            compare(estimate, truth)
    run_session(session, out, config=config("bvh", "report"), resume=True)
    compare(out, session)


def test_products_of_a_run_before_are_not_exported_after_a_shorter_one(
    session: Path, out: Path, tmp_path: Path
) -> None:
    run_session(session, out, config=config(), until="segment")
    with pytest.raises(MocapError, match="ended before there was a product carve"):
        export_run(out, tmp_path / "voxels", what="voxels")


@pytest.mark.parametrize(
    ("keep", "kept"),
    [("masks", {"segment", "empty", "occluders", "track", "pose-frames", "pose"}), ("nothing", set())],
)
def test_results_do_not_depend_on_what_is_kept(
    session: Path, finished: Path, tmp_path: Path, keep: str, kept: set[str]
) -> None:
    out = tmp_path / "out"
    run_session(session, out, config=config("bvh", "report", more=(f"output.keep={keep}",)))
    for name in ("landmarks.csv", "tracks.csv", "pose.npz"):
        assert (out / name).read_bytes() == (finished / name).read_bytes()
    assert (out / "report.html").exists()
    stored = {p.name for p in (out / "store.zarr").iterdir() if p.is_dir()}
    assert stored == kept
    assert set(json.loads((out / "run.json").read_text())["product_keys"]) == kept
    with pytest.raises(MocapError, match="product carve, or did not keep it"):
        export_run(out, tmp_path / "voxels", what="voxels")


# --- one command at a time ---


def test_a_second_command_is_told_who_works_there(session: Path, out: Path) -> None:
    before = names(out)
    with sole_use(out, "mocap run X -o Y"):
        for work in (
            lambda: run_session(session, out, config=config("bvh")),
            lambda: rewrite_report(out, session),
        ):
            with pytest.raises(MocapError, match="`mocap run X -o Y`, process") as caught:
                work()
            assert f"process {os.getpid()} on" in caught.value.message
    assert names(out) == before
    run_session(session, out, config=config("bvh"), resume=True)


@pytest.mark.parametrize("again", [rewrite_report, rewrite_scene, write_overlays])
def test_a_folder_that_is_not_there_holds_no_run(
    again: Callable[[Path, Path], object], session: Path, tmp_path: Path
) -> None:
    with pytest.raises(MocapError, match="holds no result of a run"):
        again(tmp_path / "nothere", session)
    assert not (tmp_path / "nothere").exists()


def test_another_process_is_kept_out_until_it_ends_and_its_file_is_taken_over(tmp_path: Path) -> None:
    code = (
        "import sys, time\nfrom pathlib import Path\nfrom mocap.pipeline.lock import sole_use\n"
        "with sole_use(Path(sys.argv[1]), 'the other'):\n    print('in', flush=True)\n    time.sleep(60)\n"
    )
    command = [sys.executable, "-c", code, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as other:
        try:
            assert other.stdout is not None
            assert other.stdout.readline() == "in\n"
            with (
                pytest.raises(MocapError, match=f"`the other`, process {other.pid} on"),
                sole_use(tmp_path, "me"),
            ):
                pass
        finally:
            other.kill()
    assert (tmp_path / LOCK_NAME).exists(), "a killed process leaves its file"
    with sole_use(tmp_path, "me"):
        assert json.loads((tmp_path / LOCK_NAME).read_text())["command"] == "me"
    assert names(tmp_path) == set()


@pytest.mark.parametrize(
    ("about", "is_free"),
    [
        ({"pid": 2**22 + 1, "host": "here"}, True),
        ({"pid": 1, "host": "here"}, False),
        ({"pid": 2**22 + 1, "host": "elsewhere"}, False),
        ({"pid": "x", "host": "here"}, True),
        ({}, True),
    ],
)
def test_without_locks_the_process_named_in_the_file_counts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, about: dict[str, object], is_free: bool
) -> None:
    monkeypatch.setattr(lock, "lock_file", lambda stream: None)
    monkeypatch.setattr(lock.platform, "node", lambda: "here")
    (tmp_path / LOCK_NAME).write_text(json.dumps(about))
    if is_free:
        with sole_use(tmp_path, "me"):
            pass
        assert names(tmp_path) == set()
    else:
        with pytest.raises(MocapError, match="another command is working"), sole_use(tmp_path, "me"):
            pass


@pytest.mark.parametrize("text", ["", "no json", "[1]", '{"pid": null}', "\x00\xff"])
def test_whatever_lies_in_the_lock_file_is_taken_over(tmp_path: Path, text: str) -> None:
    (tmp_path / LOCK_NAME).write_text(text)
    with sole_use(tmp_path, "me"):
        pass
    assert names(tmp_path) == set()


def test_what_stopped_writers_have_left_is_cleared_away(session: Path, tmp_path: Path) -> None:
    left = tmp_path / "out" / "store.zarr" / ".pose.partial"
    left.mkdir(parents=True)
    (left / "data").write_bytes(b"x")
    run_session(session, tmp_path / "out", config=config(), until="segment")
    assert not left.exists()
    assert StageStore(tmp_path / "out" / "store.zarr").reader("segment").frames.tolist() == [0, 1, 2, 3]
