"""glTF 2.0 binary (.glb): the skeleton as animated nodes with a visible stick figure."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mocap.data import Skeleton
from mocap.io.formats._writing import Y_UP_FROM_WORLD, check_fps, held_poses, root_and_order, write_bytes

Array = NDArray[np.float64]

_FLOAT, _ARRAY_BUFFER = 5126, 34962
_WIDTH_SHARE, _MIN_WIDTH_M, _MAX_WIDTH_M = 0.12, 0.012, 0.045  # half width of a bone against its length


def write_glb(path: Path, skeleton: Skeleton, fps: float) -> None:
    """Write an animated skeleton as binary glTF in metres, Y up, facing +Z.

    One node per joint; the root's translation and all rotations are animated (linear, one key per frame).
    Every bone is an octahedron under the node of its parent joint, so that the file shows a stick figure in
    any viewer; nodes rest in the pose of the first frame. A frame with a NaN holds the last known pose; a
    skeleton without frames gives the rest pose and no animation.
    Raises ValueError for fps <= 0 or joints that are not one tree, MocapError when the file cannot be
    written.
    """
    check_fps(fps)
    order = root_and_order(skeleton)
    rotations, root = held_poses(skeleton)
    P = Y_UP_FROM_WORLD
    quaternions = _quaternions(P @ rotations @ P.T)
    root = root @ P.T
    binary = _Binary()
    document: dict[str, Any] = {
        "asset": {
            "version": "2.0",
            "generator": "mocap",
            "extras": {"units": "m", "up_axis": "y", "person": int(skeleton.person), "fps": float(fps)},
        },
        "scene": 0,
        "scenes": [{"nodes": [order[0]]}],
        "nodes": _nodes(skeleton, order, quaternions, root),
        "meshes": [_bone_mesh(binary)],
        "materials": [
            {
                "name": "bone",
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
        document["animations"] = [_animation(f"person_{skeleton.person}", time, outputs)]
    document["accessors"] = binary.accessors
    document["bufferViews"] = binary.views
    document["buffers"] = [{"byteLength": len(binary.data)}]
    write_bytes(path, glb_container(document, bytes(binary.data)))


def _nodes(skeleton: Skeleton, order: list[int], quaternions: Array, root: Array) -> list[dict[str, Any]]:
    """The joints of a skeleton as nodes in its own order, and behind them one node per bone.

    order : joints depth first from the root.  quaternions : (T, J, 4).  root : (T, 3) m, Y up.
    """
    offsets = skeleton.offsets @ Y_UP_FROM_WORLD.T
    nodes: list[dict[str, Any]] = []
    for j, name in enumerate(skeleton.names):
        node: dict[str, Any] = {"name": name, "translation": floats(offsets[j]), "children": []}
        if len(quaternions):
            node["rotation"] = floats(quaternions[0, j])
        nodes.append(node)
    nodes[order[0]]["translation"] = floats(root[0]) if len(root) else [0.0, 0.0, 0.0]
    for j in order[1:]:
        nodes[int(skeleton.parents[j])]["children"].append(j)
    for parent, vector, name in _bones(skeleton, order):
        length = float(np.linalg.norm(vector))
        if length > 1e-6:
            nodes[parent]["children"].append(len(nodes))
            nodes.append(_bone_node(f"bone_{name}", vector, length))
    # glTF knows no empty list of children.
    return [{key: value for key, value in node.items() if value != []} for node in nodes]


def _bones(skeleton: Skeleton, order: list[int]) -> list[tuple[int, Array, str]]:
    """(joint that it hangs on, vector (3,) m with Y up, name) of every bone, the ends of limbs last."""
    P = Y_UP_FROM_WORLD
    offsets = skeleton.offsets @ P.T
    bones = [(int(skeleton.parents[j]), offsets[j], skeleton.names[j]) for j in order[1:]]
    ends = sorted(skeleton.end_offsets.items())
    return bones + [(j, P @ tip, f"{skeleton.names[j]}_end") for j, tip in ends]


def _bone_mesh(binary: _Binary) -> dict[str, Any]:
    vertices, normals = _octahedron()
    return {
        "name": "bone",
        "primitives": [
            {
                "attributes": {
                    "POSITION": binary.add(vertices, "VEC3", target=_ARRAY_BUFFER, bounds=True),
                    "NORMAL": binary.add(normals, "VEC3", target=_ARRAY_BUFFER),
                },
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

    def add(self, values: Array, kind: str, *, target: int | None = None, bounds: bool = False) -> int:
        """Append float32 rows (N, width); returns the accessor's index."""
        rows = np.ascontiguousarray(values, dtype="<f4")
        view: dict[str, Any] = {"buffer": 0, "byteOffset": len(self.data), "byteLength": rows.nbytes}
        if target is not None:
            view["target"] = target
        accessor = {
            "bufferView": len(self.views),
            "componentType": _FLOAT,
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


def _quaternions(rotations: Array) -> Array:
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


def _bone_node(name: str, vector: Array, length: float) -> dict[str, Any]:
    """Node that stretches the unit octahedron along `vector` (3,) m."""
    x, y, z = vector / length
    if y > -1.0 + 1e-9:
        quaternion = np.array([z, 0.0, -x, 1.0 + y])  # shortest rotation from +y
    else:
        quaternion = np.array([1.0, 0.0, 0.0, 0.0])
    quaternion /= np.linalg.norm(quaternion)
    width = float(np.clip(_WIDTH_SHARE * length, _MIN_WIDTH_M, _MAX_WIDTH_M))
    return {
        "name": name,
        "mesh": 0,
        "rotation": floats(quaternion),
        "scale": floats(np.array([width, length, width])),
    }


def floats(values: Array) -> list[float]:
    # float32 first: bounds must equal the stored values exactly, and the text stays short.
    return [float(v) for v in np.asarray(values, dtype=np.float32)]
