"""USD read back by UsdSkel's own evaluation of skeletons and skins, which shares no code with the writer."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from marker_world import marching

from mocap.body import body_skin, landmarks_of, load_body_model, scale_body, skeleton_of
from mocap.errors import MocapError
from mocap.io.formats import renamed, write_usd

FPS = 25.0
T = 6
TOLERANCE_M = 1e-4
BODY = scale_body(load_body_model("girdle"), 1.75)


def a_march():
    states = marching(BODY, T, FPS)
    states[:, 0] += 0.7
    states[:, 3] = np.linspace(0.3, 0.9, T)
    return states, skeleton_of(BODY, states, 3)


def world(points):
    """File (x, y, z) back to the scene's (x, -z, y)."""
    return np.asarray(points)[..., [0, 2, 1]] * [1, -1, 1]


def test_without_its_package_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    with pytest.raises(MocapError, match=r"\[usd\]"):
        write_usd(tmp_path / "a.usd", a_march()[1], FPS, body_skin(BODY))
    assert not list(tmp_path.iterdir())


@pytest.fixture
def pxr():
    return pytest.importorskip("pxr", reason="usd-core: the extra `usd`")


def test_joints_and_skin_are_where_the_body_is(tmp_path: Path, pxr) -> None:
    from pxr import Usd, UsdGeom, UsdSkel

    states, skeleton = a_march()
    write_usd(tmp_path / "a.usd", skeleton, FPS, body_skin(BODY))
    stage = Usd.Stage.Open(str(tmp_path / "a.usd"))
    assert (stage.GetTimeCodesPerSecond(), stage.GetEndTimeCode()) == (FPS, T - 1)
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Y", 1.0)
    root = UsdSkel.Root(stage.GetDefaultPrim())
    cache = UsdSkel.Cache()
    cache.Populate(root, Usd.TraverseInstanceProxies())
    (binding,) = cache.ComputeSkelBindings(root, Usd.TraverseInstanceProxies())
    query = cache.GetSkelQuery(binding.GetSkeleton())
    names = [path.split("/")[-1] for path in query.GetJointOrder()]
    assert sorted(names) == sorted(skeleton.names)
    expected = skeleton.global_positions()
    for t in range(T):
        found = world([m.ExtractTranslation() for m in query.ComputeJointSkelTransforms(t)])
        for name, place in zip(names, found, strict=True):
            assert np.linalg.norm(place - expected[t, skeleton.names.index(name)]) < TOLERANCE_M
    # A landmark is where landmarks.csv says: the left knee.
    knee = landmarks_of(BODY, states)[T - 1, 10]
    assert np.linalg.norm(found[names.index("left_knee")] - knee) < TOLERANCE_M
    # The skin, as UsdSkel bends it, lies about the bones: every ankle is inside its bounds, and feet on the floor.
    (skinning,) = binding.GetSkinningTargets()
    points = UsdGeom.Mesh(skinning.GetPrim()).GetPointsAttr().Get()
    assert skinning.ComputeSkinnedPoints(query.ComputeSkinningTransforms(T - 1), points, T - 1)
    flesh = world(np.array(points))
    low, high = flesh.min(axis=0), flesh.max(axis=0)
    assert ((found > low) & (found < high)).all()
    assert 1.5 < high[2] - low[2] < 1.9


def test_what_usd_checks_is_in_order(tmp_path: Path, pxr) -> None:
    from pxr import Usd, UsdSkel

    _, skeleton = a_march()
    for names in ("mocap", "mixamo", "unreal"):
        path = tmp_path / f"{names}.usd"
        write_usd(path, renamed(skeleton, names), FPS, body_skin(BODY))
        stage = Usd.Stage.Open(str(path))
        (armature,) = [UsdSkel.Skeleton(p) for p in stage.Traverse() if p.IsA(UsdSkel.Skeleton)]
        valid, why = UsdSkel.Topology(armature.GetJointsAttr().Get()).Validate()
        assert valid, why
        again = tmp_path / "again.usd"
        write_usd(again, renamed(skeleton, names), FPS, body_skin(BODY))
        assert again.read_bytes() == path.read_bytes()


def test_without_frames_it_stands_at_rest(tmp_path: Path, pxr) -> None:
    from pxr import Usd, UsdSkel

    write_usd(tmp_path / "a.usd", skeleton_of(BODY, a_march()[0][:0], 3), FPS, body_skin(BODY))
    stage = Usd.Stage.Open(str(tmp_path / "a.usd"))
    assert not [p for p in stage.Traverse() if p.IsA(UsdSkel.Animation)]


def test_places_that_cannot_be_written_and_wrong_rates_are_refused(tmp_path: Path, pxr) -> None:
    _, skeleton = a_march()
    with pytest.raises(MocapError, match="Remedy"):
        write_usd(tmp_path / "missing" / "a.usd", skeleton, FPS, body_skin(BODY))
    with pytest.raises(ValueError, match="fps"):
        write_usd(tmp_path / "a.usd", skeleton, 0.0, body_skin(BODY))
    assert not list(tmp_path.iterdir())


BLENDER = """
import json, sys
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
path = sys.argv[1]
bpy.ops.wm.usd_import(filepath=path)
(armature,) = [o for o in bpy.data.objects if o.type == "ARMATURE"]
bpy.context.scene.frame_set(0)
found = {b.name: list(armature.matrix_world @ b.head) for b in armature.pose.bones}
print("FOUND" + json.dumps(found))
"""


@pytest.mark.slow
def test_blender_shows_the_joints_where_they_were(tmp_path: Path, pxr) -> None:
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("bpy is not installed: the extra `blender`")
    _, skeleton = a_march()
    path = tmp_path / "a.usd"
    write_usd(path, skeleton, FPS, body_skin(BODY))
    said = subprocess.run(
        [sys.executable, "-c", BLENDER, str(path)], capture_output=True, text=True, timeout=300, check=True
    )
    found = json.loads(said.stdout.split("FOUND")[1].splitlines()[0])
    expected = skeleton.global_positions()[0]
    for name, place in zip(skeleton.names, expected, strict=True):
        assert np.linalg.norm(np.array(found[name]) - place) < TOLERANCE_M
