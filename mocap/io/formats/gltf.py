"""glTF 2.0 binary (.glb): an armature with its animation, and a skin that moves with it."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import Skeleton, Skin
from mocap.io.formats._writing import Y_UP_FROM_WORLD, animated, check_fps, root_and_order, write_bytes

Array = NDArray[np.float64]

_FLOAT, _USHORT, _UINT = 5126, 5123, 5125
_ARRAY_BUFFER, _INDEX_BUFFER = 34962, 34963
_DTYPES = {_FLOAT: "<f4", _USHORT: "<u2", _UINT: "<u4"}
_WIDTH_SHARE, _MIN_WIDTH_M, _MAX_WIDTH_M = 0.12, 0.012, 0.045  # half width of a bone against its length


def write_glb(path: Path, skeleton: Skeleton, fps: float, skin: Skin | None = None) -> None:
    """Write an animated person as binary glTF in metres, Y up.

    One node per joint under a node of the person; the root's translation and all rotations are animated (linear, one
    key per frame). A mesh is bound to the joints at rest (T pose, facing +Z, the left side at +X), so that importers
    make an armature: `skin`, or a stick figure when there is none. Places are those of our world with Y up: Blender
    shows them where they were (file x, -z, y are scene x, y, z). Nodes stand in the pose of the first frame. A frame
    with a NaN holds the last known pose; a skeleton without frames gives the rest pose and no animation.
    Raises ValueError for fps <= 0 or joints that are not one tree, MocapError when the file cannot be written.
    """
    check_fps(fps)
    order = root_and_order(skeleton)
    rotations, root, offsets = animated(skeleton)
    quaternions = quaternions_of(rotations)
    name = f"person_{skeleton.person}"
    binary = _Binary()
    n_joints = len(skeleton.names)
    document: dict[str, Any] = {
        "asset": {
            "version": "2.0",
            "generator": "mocap",
            "extras": {"units": "m", "up_axis": "y", "person": int(skeleton.person), "fps": float(fps)},
        },
        "scene": 0,
        "scenes": [{"nodes": [n_joints + 1]}],
        "nodes": [
            *_joint_nodes(skeleton, order, quaternions, root, offsets),
            {"name": f"{name}_skin", "mesh": 0, "skin": 0},
            {"name": name, "children": [order[0], n_joints]},
        ],
        "meshes": [_mesh(binary, _stick_figure(skeleton, order) if skin is None else skin)],
        "skins": [_bound(binary, skeleton, order)],
        "materials": [
            {
                "name": "skin",
                "pbrMetallicRoughness": {
                    "baseColorFactor": [0.85, 0.55, 0.2, 1.0],
                    "metallicFactor": 0.0,
                    "roughnessFactor": 0.8,
                },
            }
        ],
    }
    if len(root):
        time = binary.add(np.arange(len(root))[:, None] / fps, "SCALAR", bounds=True)
        outputs = [(order[0], "translation", binary.add(root, "VEC3"))]
        outputs += [(j, "rotation", binary.add(quaternions[:, j], "VEC4")) for j in order]
        document["animations"] = [_animation(name, time, outputs)]
    document["accessors"] = binary.accessors
    document["bufferViews"] = binary.views
    document["buffers"] = [{"byteLength": len(binary.data)}]
    write_bytes(path, glb_container(document, bytes(binary.data)))


def _joint_nodes(
    skeleton: Skeleton, order: list[int], quaternions: Array, root: Array, offsets: Array
) -> list[dict[str, Any]]:
    """The joints of a skeleton as nodes in its own order.

    order : joints depth first from the root.  quaternions : (T, J, 4).  root : (T, 3) m.  offsets : (J, 3) m.
    """
    nodes: list[dict[str, Any]] = []
    for j, name in enumerate(skeleton.names):
        children = [k for k in order if int(skeleton.parents[k]) == j]
        node: dict[str, Any] = {"name": name, "translation": floats(offsets[j])}
        if len(quaternions):
            node["rotation"] = floats(quaternions[0, j])
        # glTF knows no empty list of children.
        nodes.append(node | ({"children": children} if children else {}))
    nodes[order[0]]["translation"] = floats(root[0]) if len(root) else [0.0, 0.0, 0.0]
    return nodes


def _rest_positions(skeleton: Skeleton, order: list[int]) -> Array:
    """Joints at rest with the root at the origin, (J, 3) m, body axes."""
    places = np.zeros((len(skeleton.names), 3))
    for j in order[1:]:
        places[j] = places[int(skeleton.parents[j])] + skeleton.offsets[j]
    return places


def _bound(binary: _Binary, skeleton: Skeleton, order: list[int]) -> dict[str, Any]:
    """The joints as a skin; a vertex at rest is seen from each joint by its inverse bind matrix."""
    matrices = np.tile(np.eye(4), (len(skeleton.names), 1, 1))
    matrices[:, :3, 3] = -_rest_positions(skeleton, order) @ Y_UP_FROM_WORLD.T
    # glTF stores matrices by columns.
    inverse = binary.add(matrices.transpose(0, 2, 1).reshape(-1, 16), "MAT4")
    return {
        "joints": list(range(len(skeleton.names))),
        "skeleton": order[0],
        "inverseBindMatrices": inverse,
    }


def _stick_figure(skeleton: Skeleton, order: list[int]) -> Skin:
    """An octahedron along every bone, each moved by the joint that it hangs on; ends of limbs last."""
    bones = [(int(skeleton.parents[j]), skeleton.offsets[j]) for j in order[1:]]
    bones += sorted(skeleton.end_offsets.items(), key=lambda end: end[0])
    places = _rest_positions(skeleton, order)
    shape, shape_normals = _octahedron()
    vertices, normals, joints = [np.zeros((0, 3))], [np.zeros((0, 3))], [np.zeros(0, dtype=np.int64)]
    for joint, bone in bones:
        length = float(np.linalg.norm(bone))
        if length < 1e-6:
            continue
        R = _turn_from_y(bone / length)
        width = float(np.clip(_WIDTH_SHARE * length, _MIN_WIDTH_M, _MAX_WIDTH_M))
        vertices.append(places[joint] + (shape * [width, length, width]) @ R.T)
        normals.append(shape_normals @ R.T)
        joints.append(np.full(len(shape), joint))
    n = sum(map(len, joints))
    held = np.zeros((n, 4), dtype=np.int64)
    held[:, 0] = np.concatenate(joints)
    weights = np.zeros((n, 4))
    weights[:, 0] = 1.0
    faces = np.arange(n).reshape(-1, 3)
    return Skin(np.concatenate(vertices), np.concatenate(normals), faces, held, weights)


def _turn_from_y(direction: Array) -> Array:
    """A rotation (3, 3) that takes +y to a direction."""
    across = np.cross(direction, [0.0, 0.0, 1.0] if abs(direction[2]) < 0.9 else [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    return np.column_stack([across, direction, np.cross(across, direction)])


def _mesh(binary: _Binary, skin: Skin) -> dict[str, Any]:
    P = Y_UP_FROM_WORLD
    # glTF wants joint 0 where there is no weight.
    used = np.where(skin.weights.astype(np.float32) > 0, skin.joints, 0)
    return {
        "name": "skin",
        "primitives": [
            {
                "attributes": {
                    "POSITION": binary.add(skin.vertices @ P.T, "VEC3", target=_ARRAY_BUFFER, bounds=True),
                    "NORMAL": binary.add(skin.normals @ P.T, "VEC3", target=_ARRAY_BUFFER),
                    "JOINTS_0": binary.add(used, "VEC4", target=_ARRAY_BUFFER, component=_USHORT),
                    "WEIGHTS_0": binary.add(skin.weights, "VEC4", target=_ARRAY_BUFFER),
                },
                "indices": binary.add(
                    skin.faces.reshape(-1, 1), "SCALAR", target=_INDEX_BUFFER, component=_UINT
                ),
                "material": 0,
                "mode": 4,
            }
        ],
    }


def _animation(name: str, time: int, outputs: list[tuple[int, str, int]]) -> dict[str, Any]:
    """time : accessor of the keys.  outputs : node, what is animated, accessor of its values."""
    return {
        "name": name,
        "samplers": [
            {"input": time, "output": output, "interpolation": "LINEAR"} for _, _, output in outputs
        ],
        "channels": [
            {"sampler": i, "target": {"node": node, "path": target}}
            for i, (node, target, _) in enumerate(outputs)
        ],
    }


class _Binary:
    """The binary chunk while it grows, with its accessors and views."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.accessors: list[dict[str, Any]] = []
        self.views: list[dict[str, Any]] = []

    def add(
        self,
        values: NDArray[Any],
        kind: str,
        *,
        target: int | None = None,
        bounds: bool = False,
        component: int = _FLOAT,
    ) -> int:
        """Append rows (N, width) of one type of number; returns the accessor's index."""
        rows = np.ascontiguousarray(values, dtype=_DTYPES[component])
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.data), "byteLength": rows.nbytes}
        if target is not None:
            view["target"] = target
        accessor = {
            "bufferView": len(self.views),
            "componentType": component,
            "count": len(rows),
            "type": kind,
        }
        if bounds:
            accessor |= {"min": floats(rows.min(axis=0)), "max": floats(rows.max(axis=0))}
        self.data += rows.tobytes()
        self.views.append(view)
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def glb_container(document: dict[str, Any], binary: bytes) -> bytes:
    """The two chunks of a .glb, each padded to four bytes."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode("utf-8")
    text += b" " * (-len(text) % 4)
    binary += b"\0" * (-len(binary) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    return b"".join(
        [
            struct.pack("<4sII", b"glTF", 2, total),
            struct.pack("<I4s", len(text), b"JSON"),
            text,
            struct.pack("<I4s", len(binary), b"BIN\0"),
            binary,
        ]
    )


def quaternions_of(rotations: Array) -> Array:
    """Unit quaternions (T, J, 4) as x, y, z, w; neighbours in time lie in one hemisphere."""
    from scipy.spatial.transform import Rotation

    T, J = rotations.shape[:2]
    if T == 0:
        return np.zeros((0, J, 4))
    q = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_quat(canonical=True).reshape(T, J, 4)
    # q and -q are one rotation, but a viewer that interpolates between them would spin the bone.
    flips = np.where((q[1:] * q[:-1]).sum(axis=2) < 0.0, -1.0, 1.0)
    sign = np.concatenate([np.ones((1, J)), np.cumprod(flips, axis=0)])
    return q * sign[:, :, None]


def _octahedron() -> tuple[Array, Array]:
    """Flat-shaded bone along +y from 0 to 1, widest (+-1) at 0.15: vertices and normals, (24, 3) each."""
    waist = [(1.0, 0.15, 0.0), (0.0, 0.15, 1.0), (-1.0, 0.15, 0.0), (0.0, 0.15, -1.0)]
    faces = []
    for i in range(4):
        a, b = waist[i], waist[(i + 1) % 4]
        faces += [((0.0, 1.0, 0.0), b, a), ((0.0, 0.0, 0.0), a, b)]
    vertices = np.array(faces)
    normals = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return vertices.reshape(-1, 3), np.repeat(normals, 3, axis=0)


def floats(values: Array) -> list[float]:
    # float32 first: bounds must equal the stored values exactly, and the text stays short.
    return [float(v) for v in np.asarray(values, dtype=np.float32)]
