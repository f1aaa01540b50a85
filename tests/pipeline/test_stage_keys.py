"""Keys of stages: everything that decides a product is in its key, and nothing that does not."""

from __future__ import annotations

import ast
import os
import time
from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from keypoint_world import keypoint_world, write_keypoint_session
from marker_world import marker_world, write_marker_session
from small_session import PLAIN, copy_session, small_session
from test_architecture import ROOT, imports_of, mocap_files

from mocap.data import Camera, CameraRig
from mocap.io.calibration import write_calibration
from mocap.io.session import Session, open_session
from mocap.io.store import StageStore
from mocap.pipeline import inputs, keys, reach
from mocap.pipeline.chains import CHAINS
from mocap.pipeline.config import Config, load_config
from mocap.pipeline.inputs import FileHashes
from mocap.pipeline.keys import stage_keys
from mocap.pipeline.reach import code_hash_of, imported_by, reached_from
from mocap.pipeline.stage import ClipWork, Job, Stage, StageReport, is_done
from mocap.pipeline.stages.pose import POSE
from mocap.pipeline.stages.track import TRACK
from mocap.pipeline.walk import run_stage

K = np.array([[90.0, 0.0, 47.5], [0.0, 90.0, 39.5], [0.0, 0.0, 1.0]])
R = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
NAMES = ("left", "right")
# What a product may depend on without naming it: cameras, frames and files are in every first key as they are.
ALWAYS_IN_THE_KEY = {
    *(
        "rig",
        "frames",
        "clip_frames",
        "image_sources",
        "background_sources",
        "mask_sources",
        "detection_sources",
    ),
    *("keypoint_sources", "depth_sources"),
    *("roi_sources", "clips", "root", "later_calibrations"),
}


def camera(name: str, y: float) -> Camera:
    return Camera(name, (96, 80), K, np.zeros(4), R, -R @ [3.0, y, 1.2])


@pytest.fixture
def session(tmp_path: Path) -> Session:
    rig = CameraRig(tuple(camera(n, y) for n, y in zip(NAMES, (0.0, 0.5), strict=True)))
    write_calibration(tmp_path / "calibration.toml", rig)
    (tmp_path / "detections").mkdir()
    for name in NAMES:
        (tmp_path / "detections" / f"{name}.csv").write_text("frame,u_px,v_px\n0,20.0,30.0\n1,21.0,31.0\n")
    (tmp_path / "session.toml").write_text("fps = 10\n")
    return open_session(tmp_path)


# --- settings ---


def settings() -> Iterator[tuple[str, str, str, str]]:
    """Every setting of every section of every stage."""
    for kind, chain in CHAINS.items():
        for stage in chain:
            for section in stage.sections:
                for name in names_of(getattr(Config(), section)):
                    yield kind, stage.name, section, name


def names_of(section: Any) -> list[str]:
    return [f.name for f in fields(section)] if is_dataclass(section) else list(type(section).model_fields)


def with_other(section: Any, name: str) -> Any:
    """A section with another value of one setting."""
    value = other(getattr(section, name))
    return (
        replace(section, **{name: value})
        if is_dataclass(section)
        else section.model_copy(update={name: value})
    )


def other(value: Any) -> Any:
    if is_dataclass(value):
        return with_other(value, fields(value)[-1].name)
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    if isinstance(value, str):
        return value + "_other"
    return (5,) if value == () else 3


def with_those_after(kind: str, stages: set[str]) -> list[str]:
    """Some stages of a chain and all that need one of them, in order."""
    found = set(stages)
    for stage in CHAINS[kind]:
        if found & set(stage.needs):
            found.add(stage.name)
    return [stage.name for stage in CHAINS[kind] if stage.name in found]


@pytest.mark.filterwarnings("ignore:Pydantic serializer warnings")
@pytest.mark.parametrize(("kind", "stage", "section", "name"), list(settings()))
def test_a_setting_changes_the_key_of_its_stage_and_of_those_after(
    session: Session, kind: str, stage: str, section: str, name: str
) -> None:
    plain = Config()
    changed = with_other(getattr(plain, section), name)
    before = stage_keys(session, plain, 0, kind)
    after = stage_keys(session, plain.model_copy(update={section: changed}), 0, kind)
    shown = {s.name for s in CHAINS[kind] if section in s.sections}
    changed_stages = [s for s in before if before[s] != after[s]]
    assert changed_stages == with_those_after(kind, shown)
    assert stage in changed_stages


def test_a_stage_sees_what_its_key_holds_and_nothing_else(session: Session, tmp_path: Path) -> None:
    seen = []

    def work(job: Job) -> None:
        seen.append(job.config.body)
        seen.append(job.config.likelihood)

    stage = Stage(
        "x", "pose", ("x",), ClipWork(work), lambda job: StageReport(), sections=("body", "likelihood")
    )
    job = Job(session, Config(), StageStore(tmp_path / "store.zarr"), "key")
    run_stage(stage, job)
    assert len(seen) == 2
    with pytest.raises(AttributeError, match="likelihood"):
        run_stage(replace(stage, sections=("body",)), job)


@pytest.mark.parametrize("fact", ["fps", "person_height_m"])
def test_a_fact_of_the_session_is_in_the_key_of_the_pose(session: Session, fact: str) -> None:
    before = stage_keys(session, Config(), 0)
    after = stage_keys(replace(session, **{fact: 1.5}), Config(), 0)
    assert before["pose"] != after["pose"]


def test_the_seed_is_in_the_key_where_it_decides(session: Session) -> None:
    for kind, expected in (("voxels", ["pose"]), ("markers", ["pose"]), ("keypoints", ["pose"])):
        one, other_seed = (stage_keys(session, Config(), seed, kind) for seed in (0, 1))
        assert [name for name in one if one[name] != other_seed[name]] == expected
    drawn = load_config("default", ("tracking.tracker=particle",))
    one, other_seed = (stage_keys(session, drawn, seed) for seed in (0, 1))
    assert [name for name in one if one[name] != other_seed[name]] == ["track", "pose"]


class Watched:
    """A session that remembers what is asked of it."""

    def __init__(self, session: Session) -> None:
        self.session, self.asked = session, set()

    def __getattr__(self, name: str) -> Any:
        self.asked.add(name)
        return getattr(self.session, name)


@pytest.mark.parametrize("kind", ["voxels", "markers", "keypoints"])
def test_stages_ask_the_session_for_nothing_that_their_keys_do_not_hold(
    kind: str, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    if kind == "voxels":
        root = copy_session(
            small_session(tmp_path_factory.getbasetemp()), tmp_path / "session", masks=True, n_frames=3
        )
    elif kind == "markers":
        root = write_marker_session(marker_world(6), tmp_path / "session")
    else:
        root = write_keypoint_session(keypoint_world(6), tmp_path / "session")
    config = load_config("default", (*PLAIN, "volume.voxel_size_m=0.06"))
    store = StageStore(tmp_path / "store.zarr")
    known = set(ALWAYS_IN_THE_KEY)
    for stage in CHAINS[kind]:
        watched = Watched(open_session(root))
        run_stage(stage, Job(watched, config, store, "key"))  # type: ignore[arg-type]
        known |= set(stage.facts)
        assert watched.asked <= known, stage.name


# --- code ---


@pytest.mark.parametrize("path", mocap_files(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_imports_are_read_as_python_reads_them(path: Path) -> None:
    relative = path.relative_to(ROOT).with_suffix("")
    module = ".".join(relative.parts).removesuffix(".__init__")
    package = ".".join(path.parent.relative_to(ROOT).parts)
    expected = set()
    for item in imports_of(ast.parse(path.read_text("utf-8")), package):
        parts = item.module.split(".")
        # `from a.b import c`: a.b, and a.b.c where that is a module.
        for name in (item.module, ".".join(parts[:-1])):
            file = ROOT.joinpath(*name.split("."))
            if name.startswith("mocap.") and (
                file.with_suffix(".py").is_file() or (file / "__init__.py").is_file()
            ):
                expected.add(name)
    found = set(imported_by(module))
    assert expected - found == set()
    # A docstring may read like an import; that costs a reuse, not a wrong one.
    assert found - expected <= {"mocap.pipeline.run", "mocap.io.store"}


def test_no_module_takes_a_name_that_its_package_looks_up_when_it_is_used() -> None:
    """Such an import could not be followed by reading."""
    for path in mocap_files():
        for item in imports_of(
            ast.parse(path.read_text("utf-8")), ".".join(path.parent.relative_to(ROOT).parts)
        ):
            package, _, name = item.module.rpartition(".")
            if package in ("mocap", "mocap.io"):
                file = ROOT.joinpath(*item.module.split("."))
                assert file.with_suffix(".py").is_file() or file.is_dir(), (path, name)


ROOMS = {
    # A scene that is learnt from the recording itself has the volume as its witness.
    "segment": ("foreground", ("likelihood", "tracking", "body", "filters", "view", "cli")),
    "detect": ("foreground", ("likelihood", "tracking", "volume", "body", "filters", "view", "cli")),
    "occluders": ("volume", ("tracking", "body", "filters", "view", "cli")),
    "carve": ("volume", ("tracking", "body", "filters", "view", "cli")),
    # Keypoints are asked whether they are of these pictures.
    "fused_carve": ("volume", ("filters", "view", "cli")),
    "track": ("tracking", ("body", "filters", "view", "cli")),
    "keypoints": ("tracking", ("filters", "view", "cli")),
    "pose": ("filters", ("view", "cli", "compare", "synth")),
}


@pytest.mark.parametrize("stage", [s for chain in CHAINS.values() for s in chain], ids=lambda s: s.module)
def test_a_stage_reaches_its_own_room_and_not_those_of_others(stage: Stage) -> None:
    own, others = ROOMS.get(stage.module.rpartition(".")[2], ROOMS[stage.name])
    rooms = {name.split(".")[1] for name in reached_from(stage.module)}
    assert own in rooms
    assert not rooms & set(others)
    assert {stage.module, "mocap.pipeline.stage", "mocap.io.store"} <= reached_from(stage.module)


def test_only_reached_code_and_its_data_are_in_the_hash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    root = tmp_path / "mocap"
    files = {
        "a/one.py": "def f():\n    from mocap.b import two\n",
        "a/other.py": "",
        "b/__init__.py": "",
        "b/two.py": "import mocap.c as c  # for later\n",
        "b/table.toml": "x = 1\n",
        "c.py": "",
        "d.py": "",
    }
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    monkeypatch.setattr("mocap.pipeline.reach.ROOT", root)

    def digest() -> str:
        for cached in (reached_from, code_hash_of, reach.imported_by, reach.file_of, reach._file_hash):
            cached.cache_clear()
        return code_hash_of("mocap.a.one")

    try:
        before = digest()
        for name in files:
            (root / name).write_text(files[name] + "# a comment\n")
            is_reached = name in ("a/one.py", "b/__init__.py", "b/two.py", "b/table.toml", "c.py")
            assert (digest() != before) == is_reached, name
            (root / name).write_text(files[name])
    finally:
        monkeypatch.undo()
        digest()


@pytest.mark.parametrize("kind", CHAINS)
def test_the_code_of_a_stage_is_in_its_key(
    session: Session, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = stage_keys(session, Config(), 0, kind)
    names = [stage.name for stage in CHAINS[kind]]
    for stage in CHAINS[kind]:
        with monkeypatch.context() as patch:
            edited = stage.module
            patch.setattr(
                keys, "code_hash_of", lambda m, edited=edited: "edited" if m == edited else code_hash_of(m)
            )
            after = stage_keys(session, Config(), 0, kind)
        assert [name for name in names if before[name] != after[name]] == with_those_after(kind, {stage.name})


# --- inputs ---


@pytest.mark.parametrize("kind", ["voxels", "markers"])
@pytest.mark.parametrize("field", [f.name for f in fields(Camera)])
def test_everything_about_a_camera_is_in_the_key(session: Session, field: str, kind: str) -> None:
    turned = R @ np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    values: dict[str, Any] = {
        "name": "other",
        "size": (96, 81),
        "K": 1.5 * K + np.diag([0, 0, -0.5]),
        "dist": np.array([0.1, 0, 0, 0]),
        "R": turned,
        "t": np.ones(3),
        "is_fisheye": True,
        "filmed_size": (288, 240),
    }
    changed = CameraRig((replace(session.rig["left"], **{field: values[field]}), session.rig["right"]))
    before, after = (stage_keys(s, Config(), 0, kind) for s in (session, replace(session, rig=changed)))
    assert all(before[name] != after[name] for name in before)


@pytest.mark.parametrize(
    "sources",
    [
        *("image_sources", "background_sources", "mask_sources", "roi_sources"),
        *("detection_sources", "keypoint_sources"),
    ],
)
@pytest.mark.parametrize("is_folder", [False, True])
def test_every_kind_of_file_is_in_the_key(
    session: Session, tmp_path: Path, sources: str, is_folder: bool
) -> None:
    place = tmp_path / "deep" / "source"
    file = place / "b.png" if is_folder else place
    file.parent.mkdir(parents=True)
    file.write_bytes(b"one")
    with_file = replace(session, **{sources: {"left": place}})
    before = stage_keys(with_file, Config(), 0)["segment"]
    assert before == stage_keys(with_file, Config(), 0)["segment"]
    assert before != stage_keys(session, Config(), 0)["segment"]
    file.write_bytes(b"two")
    changed = stage_keys(with_file, Config(), 0)["segment"]
    assert changed != before
    assert changed != stage_keys(replace(session, **{sources: {"right": place}}), Config(), 0)["segment"]
    if is_folder:
        file.rename(place / "c.png")
        assert stage_keys(with_file, Config(), 0)["segment"] != changed


def test_frames_are_in_the_key(session: Session) -> None:
    assert (
        stage_keys(session, Config(), 0)["segment"]
        != stage_keys(replace(session, frames=range(1)), Config(), 0)["segment"]
    )


def test_clocks_are_in_the_key(session: Session) -> None:
    late, later = ({"left": np.arange(session.frames.stop) + k} for k in (1, 2))
    keys = {
        stage_keys(replace(session, clip_frames=clocks), Config(), 0)["segment"]
        for clocks in ({}, late, later)
    }
    assert len(keys) == 3


def test_a_change_in_the_middle_of_a_file_is_seen(session: Session) -> None:
    """Same size, same time, same beginning and end: a hash of the whole tells."""
    path = session.detection_sources["left"]
    content = bytearray(path.read_bytes() + b" " * 400_000)
    path.write_bytes(content)
    before, stat = stage_keys(session, Config(), 0, "markers"), path.stat()
    content[200_000] = ord("\n")
    path.write_bytes(content)
    os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))
    assert stage_keys(session, Config(), 0, "markers") != before


class TestFileHashes:
    """What is remembered of files, and when it is not believed."""

    @pytest.fixture
    def file(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
        path = tmp_path / "clip.bin"
        path.write_bytes(b"one")
        monkeypatch.setattr(inputs, "_OF_THIS_PROCESS", {})
        return path

    @pytest.fixture
    def later(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """The clock of this process runs ahead: files are old."""
        monkeypatch.setattr(inputs, "time", SimpleNamespace(time=lambda: time.time() + 60))

    def reads(self, monkeypatch: pytest.MonkeyPatch) -> list[str]:
        found: list[str] = []
        real = inputs.hashlib.file_digest

        def counted(stream: Any, name: str) -> Any:
            found.append(stream.name)
            return real(stream, name)

        monkeypatch.setattr(inputs.hashlib, "file_digest", counted)
        return found

    def test_an_old_file_is_read_once(
        self, file: Path, tmp_path: Path, later: None, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        reads = self.reads(monkeypatch)
        first = FileHashes(tmp_path / "kept.json")
        digest = first.of(file)
        first.keep()
        inputs._OF_THIS_PROCESS.clear()
        assert FileHashes(tmp_path / "kept.json").of(file) == digest
        assert len(reads) == 1
        assert FileHashes(tmp_path / "kept.json", is_trusted=False).of(file) == digest
        assert len(reads) == 2

    def test_a_file_that_was_written_a_moment_ago_is_read_again(
        self, file: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        reads = self.reads(monkeypatch)
        hashes = FileHashes()
        hashes.of(file)
        hashes.of(file)
        assert len(reads) == 2

    @pytest.mark.parametrize("change", ["size", "time", "content", "place"])
    def test_a_change_is_seen(self, file: Path, change: str, later: None) -> None:
        hashes = FileHashes()
        before, stat = hashes.of(file), file.stat()
        if change == "place":
            other_file = file.with_name("other.bin")
            other_file.write_bytes(b"two")
            os.utime(other_file, ns=(stat.st_atime_ns, stat.st_mtime_ns))
            other_file.replace(file)
        else:
            file.write_bytes(b"longer" if change == "size" else b"two")
            if change == "content":
                os.utime(file, ns=(stat.st_atime_ns, stat.st_mtime_ns))
        assert hashes.of(file) != before

    @pytest.mark.parametrize(
        "text", ["", "[]", '{"format": 1}', '{"format": 1, "files": {"a": [1]}}', "\x00"]
    )
    def test_damaged_notes_are_as_good_as_none(self, file: Path, tmp_path: Path, text: str) -> None:
        (tmp_path / "kept.json").write_text(text)
        hashes = FileHashes(tmp_path / "kept.json")
        assert hashes.of(file) == FileHashes().of(file)
        hashes.keep()


# --- products ---


def test_a_stage_is_done_when_all_its_products_have_its_key(tmp_path: Path) -> None:
    """Owners of one run and tracks of another would be mixed by whoever looks at one of them."""
    store = StageStore(tmp_path / "store.zarr")
    for product in TRACK.products:
        assert not is_done(TRACK, store, "new")
        with store.writer(product, "new", {}) as out:
            out.append(0, x=np.zeros(1))
    assert is_done(TRACK, store, "new")
    for product in TRACK.products:
        with store.writer(product, "old", {}) as out:
            out.append(0, x=np.zeros(1))
        assert not is_done(TRACK, store, "new")
        with store.writer(product, "new", {}) as out:
            out.append(0, x=np.zeros(1))
    assert "track-owners" in TRACK.products
    assert POSE.needs == ("track",)
