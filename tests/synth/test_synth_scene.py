"""Scene files: what is accepted, what is refused and how it is said."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from mocap.errors import MocapError
from mocap.synth import list_scenes, load_scene, synthesise
from mocap.synth.scene import SCENES_DIR

GOOD = """
seed = 1
n_frames = 3
[[persons]]
seed = 2
motion = { kind = "stand" }
"""


def _write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "odd.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_every_scene_of_the_project_loads() -> None:
    names = list_scenes()
    assert {"demo", "walk", "gesture", "box", "stand", "two_persons", "four_cameras"} <= set(names)
    assert {"walk_test", "box_test", "gesture_test"} <= set(names)
    assert names == sorted(names)
    for name in names:
        assert load_scene(name).name == name
    assert load_scene("demo").n_frames == 60
    assert load_scene("demo").rig.n_cameras == 7
    assert load_scene("four_cameras").rig.n_cameras == 4
    assert len(load_scene("two_persons").persons) == 2


def test_folders_and_names_of_scenes_agree() -> None:
    folder_of = {path.stem: path.parent.name for path in SCENES_DIR.rglob("*.toml")}
    assert len(folder_of) == len(list(SCENES_DIR.rglob("*.toml"))), "a name stands for two scenes"
    assert set(folder_of.values()) == {"demo", "development", "test", "faults", "meetings"}
    for name, folder in folder_of.items():
        if folder in ("demo", "development"):
            assert not name.endswith(("_test", "_final"))
        elif folder == "test":
            assert name.endswith(("_test", "_final"))
        else:
            assert name.startswith({"faults": "fault_", "meetings": ("meeting_", "crossing_")}[folder])


def test_held_out_scenes_share_no_seed_with_development() -> None:
    def seeds(name: str) -> set[int]:
        scene = load_scene(name)
        return {scene.seed, *(p.seed for p in scene.persons)}

    development = set().union(
        *(seeds(n) for n in list_scenes() if "_test" not in n and not n.endswith("_final"))
    )
    held_out = set().union(*(seeds(n) for n in list_scenes() if "_test" in n or n.endswith("_final")))
    assert not development & held_out


def test_a_file_is_named_after_itself(tmp_path: Path) -> None:
    scene = load_scene(_write(tmp_path, GOOD))
    assert (scene.name, scene.n_frames) == ("odd", 3)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ("frames = 4", "frames: unknown key"),
        ("[rig]\nradius = 3", "rig.radius: unknown key"),
        ("[picture]\nnoise_levels = -1", "picture.noise_levels"),
        ("[rig]\nsize_px = [641, 480]", "rig: Value error, size_px"),
        ("[[room.furniture]]\nlower_m = [0, 0, 1]\nupper_m = [1, 1, 0]", "room.furniture.0"),
        ('[[persons]]\nseed = 1\nmotion = { kind = "fly" }', "persons.1.motion"),
        (
            '[[persons]]\nseed = 1\nmotion = { kind = "walk", speed = 1 }',
            "persons.1.motion.speed: unknown key",
        ),
    ],
)
def test_bad_keys_are_named_by_their_path(tmp_path: Path, change: str, expected: str) -> None:
    text = f"{change}\n{GOOD}" if "[" not in change.splitlines()[0] else f"{GOOD}\n{change}\n"
    path = _write(tmp_path, text)
    with pytest.raises(MocapError) as caught:
        load_scene(path)
    assert expected in str(caught.value)
    assert caught.value.path == path


def test_unknown_scene_and_broken_file(tmp_path: Path) -> None:
    with pytest.raises(MocapError, match="no scene named 'nowhere'"):
        load_scene("nowhere")
    with pytest.raises(MocapError, match="cannot be read"):
        load_scene(tmp_path / "absent.toml")
    with pytest.raises(MocapError, match="cannot be read"):
        load_scene(_write(tmp_path, "seed = = 1"))


def test_workers_must_be_positive(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="workers"):
        synthesise("demo", tmp_path / "s", workers=0)


def test_the_page_names_every_switch() -> None:
    from mocap.synth import faults, furniture, markers, rigs, scene

    text = (Path(__file__).resolve().parents[2] / "docs" / "synthetic.md").read_text(encoding="utf-8")
    sections = [
        scene.Scene,
        scene.RoomConfig,
        scene.PictureConfig,
        markers.MarkerConfig,
        rigs.RingRig,
        rigs.CornersRig,
        rigs.GivenRig,
        rigs.GivenCamera,
        furniture.Box,
        furniture.Table,
        furniture.Chair,
        faults.DroppedFrames,
        faults.FrozenPicture,
        faults.MovedCamera,
        faults.LaggingCamera,
        faults.ClockOffset,
        faults.OtherRate,
        faults.CameraOff,
        faults.LightSwitch,
        faults.Exposure,
        faults.NewObstacle,
    ]
    words = {key for section in sections for key in section.model_fields}
    words |= {*faults.KINDS, *rigs.KINDS, *furniture.KINDS}
    assert sorted(w for w in words if not re.search(rf"\b{w}\b", text)) == []
