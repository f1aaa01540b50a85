"""USD with UsdSkel: an armature with its animation and a skin that moves with it, through the package usd-core."""

from __future__ import annotations

import errno
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import Skeleton, Skin
from mocap.errors import MissingExtra
from mocap.io.formats._writing import Y_UP_FROM_WORLD, animated, check_fps, replacing, root_and_order
from mocap.io.formats.gltf import quaternions_of

Array = NDArray[np.float64]

_SKIN_RGB = (0.85, 0.55, 0.2)


def write_usd(path: Path, skeleton: Skeleton, fps: float, skin: Skin) -> None:
    """Write an animated person as USD: a UsdSkel root with skeleton, animation and skin; metres, Y up.

    Places, rest pose (T pose, facing +Z, the left side at +X) and frames without a pose are those of `write_glb`. Time
    code t is the t-th frame, `fps` of them a second. The root joint's translation and all rotations are animated; a
    skeleton without frames is the rest pose without animation. Characters of joint names that USD does not know in a
    name become _.
    Raises ValueError for fps <= 0 or joints that are not one tree, MissingExtra without usd-core, MocapError when the
    file cannot be written.
    """
    check_fps(fps)
    order = root_and_order(skeleton)
    try:
        from pxr import Tf, Usd, UsdGeom
    except ImportError as error:
        raise MissingExtra(
            "writing USD needs the package usd-core, which is not installed", "usd", path=path
        ) from error
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetTimeCodesPerSecond(float(fps))
    stage.SetFramesPerSecond(float(fps))
    stage.SetStartTimeCode(0)
    stage.SetEndTimeCode(max(len(skeleton.root_position) - 1, 0))
    person = f"/person_{skeleton.person}"
    joints = _joint_paths(skeleton, order)
    _define_skeleton(stage, person, skeleton, order, joints)
    _define_skin(stage, person, skin, order)
    stage.SetDefaultPrim(stage.GetPrimAtPath(person))
    with replacing(path) as temporary:
        if not temporary.parent.is_dir():  # USD would make it
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))
        try:
            stage.GetRootLayer().Export(str(temporary), args={"format": "usdc"})
        except Tf.ErrorException as error:
            raise OSError(str(error).strip().splitlines()[0]) from error
        if not temporary.is_file():
            raise OSError("USD did not say why")


def _joint_paths(skeleton: Skeleton, order: list[int]) -> list[str]:
    """The joints as UsdSkel wants them, parents before children: `pelvis/left_hip/left_knee`."""
    paths: dict[int, str] = {}
    for j in order:
        name = re.sub(r"\W", "_", skeleton.names[j])
        parent = int(skeleton.parents[j])
        paths[j] = name if parent < 0 else f"{paths[parent]}/{name}"
    return [paths[j] for j in order]


def _define_skeleton(
    stage: Any, person: str, skeleton: Skeleton, order: list[int], joints: list[str]
) -> None:
    from pxr import Gf, UsdSkel, Vt

    rotations, root, offsets = animated(skeleton)
    UsdSkel.Root.Define(stage, person)
    armature = UsdSkel.Skeleton.Define(stage, f"{person}/skeleton")
    armature.CreateJointsAttr(joints)
    places = np.zeros_like(offsets)
    for j in order[1:]:
        places[j] = places[int(skeleton.parents[j])] + offsets[j]
    at_rest = offsets.copy()
    at_rest[order[0]] = 0.0
    armature.CreateRestTransformsAttr(Vt.Matrix4dArray([_translation(at_rest[j]) for j in order]))
    armature.CreateBindTransformsAttr(Vt.Matrix4dArray([_translation(places[j]) for j in order]))
    binding = UsdSkel.BindingAPI.Apply(armature.GetPrim())
    if not len(root):
        return
    animation = UsdSkel.Animation.Define(stage, f"{person}/skeleton/animation")
    animation.CreateJointsAttr(joints)
    animation.CreateScalesAttr(Vt.Vec3hArray(len(order), Gf.Vec3h(1.0)))
    translations, turns = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    quaternions = quaternions_of(rotations)
    for t in range(len(root)):
        at_rest[order[0]] = root[t]
        translations.Set(Vt.Vec3fArray.FromNumpy(at_rest[order].astype(np.float32)), t)
        turns.Set(
            Vt.QuatfArray(
                [Gf.Quatf(float(w), float(x), float(y), float(z)) for x, y, z, w in quaternions[t, order]]
            ),
            t,
        )
    binding.CreateAnimationSourceRel().SetTargets([animation.GetPath()])


def _define_skin(stage: Any, person: str, skin: Skin, order: list[int]) -> None:
    from pxr import Gf, Sdf, UsdGeom, UsdSkel, Vt

    mesh = UsdGeom.Mesh.Define(stage, f"{person}/skin")
    turn = Y_UP_FROM_WORLD.T
    vertices = (skin.vertices @ turn).astype(np.float32)
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(vertices))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy((skin.normals @ turn).astype(np.float32)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray(len(skin.faces), 3))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(skin.faces.astype(np.int32).ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateDisplayColorAttr(Vt.Vec3fArray([Gf.Vec3f(*_SKIN_RGB)]))
    row_of_joint = np.argsort(order)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    joints = np.where(skin.weights > 0, row_of_joint[skin.joints], 0).astype(np.int32)
    binding.CreateJointIndicesPrimvar(False, skin.joints.shape[1]).Set(Vt.IntArray.FromNumpy(joints.ravel()))
    binding.CreateJointWeightsPrimvar(False, skin.joints.shape[1]).Set(
        Vt.FloatArray.FromNumpy(skin.weights.astype(np.float32).ravel())
    )
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0))
    binding.CreateSkeletonRel().SetTargets([Sdf.Path(f"{person}/skeleton")])


def _translation(offset: Array) -> Any:
    from pxr import Gf

    return Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*(float(v) for v in offset)))
