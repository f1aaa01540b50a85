"""Bodies from the package anny (MakeHuman shapes) on our skeleton: a second source of people, never required."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.errors import MissingExtra
from mocap.synth.body import Body
from mocap.synth.figure import JOINT, JOINTS, PARENTS, SIDES, Figure, check_person, rotation_about
from mocap.synth.motions.kit import hinged_frames

Array = NDArray[np.float64]

_ADULT_AGE = 2 / 3  # of anny's scale: 0 baby, 1/3 child, 2/3 adult, 1 old
_N_BONES = 4  # largest number of bones per vertex, as in our own bodies
_AXES = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # theirs: forward -y, left +x
# Their bone that begins at our joint. A bone that is not listed belongs to the one above it.
_TRUNK = {"spine": "spine04", "chest": "spine02", "neck": "neck01", "head": "neck02"}
_LIMBS = {
    "clavicle": "clavicle",
    "shoulder": "upperarm01",
    "elbow": "lowerarm01",
    "wrist": "wrist",
    "hip": "upperleg01",
    "knee": "lowerleg01",
    "ankle": "foot",
}


def build_anny_body(
    stature_m: float,
    sex: str,
    build: float,
    *,
    rng: np.random.Generator,
    is_child: bool = False,
    hair: str = "short",
) -> Body:
    """A body in tight clothes; hair is painted: "short" or "bald".

    stature_m, sex, build, is_child : as of `make_figure`; muscles and proportions vary by rng.
    The joint centres are the heads of anny's bones; the skin is cut into our bones by anny's weights.
    Raises MocapError without the package, ValueError for impossible people.
    """
    check_person(stature_m, sex, build, is_child)
    model = _model()
    shape = {
        "gender": 0.0 if sex == "male" else 1.0,
        "age": _ADULT_AGE,
        "height": 0.5,
        "weight": float(np.clip(0.45 + 1.1 * (build - 1.0), 0.0, 1.0)),
        "muscle": float(np.clip(0.5 + 0.4 * (build - 1.0) + 0.06 * rng.standard_normal(), 0.0, 1.0)),
        "proportions": float(np.clip(0.6 + 0.12 * rng.standard_normal(), 0.0, 1.0)),
    }
    _fit_stature(model, shape, stature_m, "age" if is_child else "height")
    vertices, heads = _rest(model, shape)
    return _on_our_skeleton(model, vertices, heads, stature_m, sex, build, is_child, hair)


@lru_cache(maxsize=1)
def _model() -> Any:
    try:
        import anny
    except ImportError as error:
        raise MissingExtra("bodies of the kind anny need the optional package anny", "anny") from error
    return anny.Anny(rig="anny", topology="anny")


def _rest(model: Any, shape: dict[str, float]) -> tuple[Array, dict[str, Array]]:
    """Vertices (V, 3) m and heads (3,) m of the bones in our axes, at rest, floor at any height."""
    import torch

    with torch.no_grad():
        pose = torch.eye(4, dtype=model.dtype)[None, None].repeat(1, model.bone_count, 1, 1)
        out = model(pose_parameters=pose, phenotype_kwargs=shape)
    vertices = out["rest_vertices"][0].numpy().astype(np.float64) @ _AXES.T
    heads = out["rest_bone_heads"][0].numpy().astype(np.float64) @ _AXES.T
    return vertices, dict(zip(model.bone_labels, heads, strict=True))


def _fit_stature(model: Any, shape: dict[str, float], stature_m: float, by: str) -> None:
    """Change one number of the shape until the person is as tall as wanted, by halving intervals."""
    lower, upper = 0.0, _ADULT_AGE if by == "age" else 1.0
    for _ in range(18):
        shape[by] = 0.5 * (lower + upper)
        if np.ptp(_rest(model, shape)[0][:, 2]) < stature_m:
            lower = shape[by]
        else:
            upper = shape[by]


def _on_our_skeleton(
    model: Any,
    vertices: Array,
    heads: dict[str, Array],
    stature_m: float,
    sex: str,
    build: float,
    is_child: bool,
    hair: str,
) -> Body:
    position, rotation = _joints(heads)
    # The pelvis of our figures stands at the origin of the modelling pose.
    vertices = vertices - position[0]
    position = position - position[0]
    offsets = np.zeros((len(JOINTS), 3))
    for j in range(1, len(JOINTS)):
        offsets[j] = rotation[PARENTS[j]].T @ (position[j] - position[PARENTS[j]])
    weights = _weights(model)
    faces = np.asarray(model.faces, dtype=np.int64)
    head = JOINT["head"]
    near = np.linalg.norm(vertices[:, :2] - position[head, :2], axis=1) < 0.06
    top = np.array([-0.005, 0.0, float(vertices[near, 2].max() - position[head, 2])])
    ankle_m = float(position[JOINT["left_ankle"], 2] - vertices[:, 2].min())
    figure = Figure(stature_m, sex, build, offsets, np.full(len(JOINTS), build), top, is_child)
    return Body(
        replace(figure, hair=hair, ankle_m=ankle_m),
        vertices,
        faces,
        _normals(vertices, faces),
        weights,
        position,
        rotation,
        (),
    )


def _joints(heads: dict[str, Array]) -> tuple[Array, Array]:
    """Positions (J, 3) m and rotations (J, 3, 3) of our joints in their rest pose; symmetric up to rounding."""
    position = np.zeros((len(JOINTS), 3))
    rotation = np.tile(np.eye(3), (len(JOINTS), 1, 1))
    for ours, theirs in _TRUNK.items():
        position[JOINT[ours]] = heads[theirs]
    for side, _ in SIDES:
        letter = side[0].upper()
        for ours, theirs in _LIMBS.items():
            position[JOINT[f"{side}_{ours}"]] = heads[f"{theirs}.{letter}"]
        toes = [heads[f"toe{k}-1.{letter}"] for k in (2, 3, 4)]
        position[JOINT[f"{side}_toe"]] = np.mean(toes, axis=0)
    position[0] = 0.5 * (position[JOINT["left_hip"]] + position[JOINT["right_hip"]])
    for side, _sign in SIDES:
        letter = side[0].upper()

        def bone(a: str, b: str, side: str = side) -> Array:
            return (position[JOINT[f"{side}_{b}"]] - position[JOINT[f"{side}_{a}"]])[None]

        left = np.array([[0.0, 1.0, 0.0]])
        for a, b, c, hinge in (("shoulder", "elbow", "wrist", -1.0), ("hip", "knee", "ankle", 1.0)):
            frames = hinged_frames(bone(a, b), bone(b, c), left, hinge)
            rotation[JOINT[f"{side}_{a}"]], rotation[JOINT[f"{side}_{b}"]] = frames[0][0], frames[1][0]
        wrist = position[JOINT[f"{side}_wrist"]]
        down = -(heads[f"finger3-1.{letter}"] - wrist)
        down /= np.linalg.norm(down)
        thumb = heads[f"finger1-1.{letter}"] - wrist
        thumb -= (thumb @ down) * down
        thumb /= np.linalg.norm(thumb)
        rotation[JOINT[f"{side}_wrist"]] = np.column_stack([thumb, np.cross(down, thumb), down])
        ahead = bone("ankle", "toe")[0]
        foot = rotation_about(2, float(np.arctan2(ahead[1], ahead[0])))
        rotation[JOINT[f"{side}_ankle"]] = rotation[JOINT[f"{side}_toe"]] = foot
    return position, rotation


def _weights(model: Any) -> Array:
    """Skinning weights (V, J) of our joints."""
    labels, parents = list(model.bone_labels), [int(p) for p in model.bone_parents]
    ours = {theirs: JOINT[joint] for joint, theirs in _TRUNK.items()}
    for side, _ in SIDES:
        letter = side[0].upper()
        ours |= {f"{theirs}.{letter}": JOINT[f"{side}_{joint}"] for joint, theirs in _LIMBS.items()}
        ours |= {f"toe{k}-1.{letter}": JOINT[f"{side}_toe"] for k in range(1, 6)}
    owner = np.zeros(len(labels), dtype=np.int64)
    for b, label in enumerate(labels):
        owner[b] = ours.get(label, owner[parents[b]] if parents[b] >= 0 else 0)
    index = model.vertex_bone_indices.numpy()
    share = model.vertex_bone_weights.detach().numpy().astype(np.float64)
    weights = np.zeros((len(index), len(JOINTS)))
    np.add.at(weights, (np.arange(len(index))[:, None], owner[index]), share)
    smallest = np.sort(weights, axis=1)[:, -_N_BONES][:, None]
    weights = np.where(weights >= smallest, weights, 0.0)
    return weights / weights.sum(axis=1, keepdims=True)


def _normals(vertices: Array, faces: NDArray[np.int64]) -> Array:
    """Unit normals (V, 3), the mean of the faces round each vertex by area."""
    corner = vertices[faces]
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    out = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(out, faces[:, k], across)
    return out / np.maximum(np.linalg.norm(out, axis=1, keepdims=True), 1e-12)
