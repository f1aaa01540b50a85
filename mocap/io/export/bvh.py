"""BVH, the skeleton animation that every animation tool opens."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.data import Skeleton
from mocap.io.export._common import Y_UP_FROM_WORLD, check_fps, held_poses, root_and_order, write_bytes

Array = NDArray[np.float64]

_CM = 100.0


def write_bvh(path: Path, skeleton: Skeleton, fps: float) -> None:
    """Write an animated skeleton as BVH in centimetres, Y up, Euler order Z X Y.

    The rest pose is the skeleton's own, facing +Z with the left side at +X. A joint's rotation is
    Rz(z) Rx(x) Ry(y) with the channels in that order; the root also has its absolute position. Angles run on
    over 180 degrees so that curves have no jumps. A frame with a NaN holds the last known pose.
    Raises ValueError for fps <= 0 or joints that are not one tree, MocapError when the file cannot be
    written.
    """
    check_fps(fps)
    order = root_and_order(skeleton)
    rotations, root = held_poses(skeleton)
    P = Y_UP_FROM_WORLD
    angles = _zxy_degrees(P @ rotations @ P.T)
    columns = [_CM * root @ P.T, *(angles[:, j] for j in order)]
    table = np.concatenate(columns, axis=1)

    lines = ["HIERARCHY", *_hierarchy(skeleton, order[0], 0)]
    lines += ["MOTION", f"Frames: {len(table)}", f"Frame Time: {1.0 / fps:.8f}"]
    # Adding zero turns -0.0 into 0.0: equal poses must give equal bytes.
    lines += [" ".join(f"{value:.6f}" for value in row) for row in np.round(table, 6) + 0.0]
    write_bytes(path, ("\n".join(lines) + "\n").encode("utf-8"))


def _hierarchy(skeleton: Skeleton, joint: int, depth: int) -> list[str]:
    """Text of one joint and everything below it."""
    pad, inner = "\t" * depth, "\t" * (depth + 1)
    is_root = depth == 0
    # The root's channels hold its absolute position, to which some readers add the OFFSET: it must be zero.
    offset = np.zeros(3) if is_root else skeleton.offsets[joint]
    channels = "6 Xposition Yposition Zposition" if is_root else "3"
    lines = [
        f"{pad}{'ROOT' if is_root else 'JOINT'} {skeleton.names[joint].replace(' ', '_')}",
        f"{pad}{{",
        f"{inner}{_offset(offset)}",
        f"{inner}CHANNELS {channels} Zrotation Xrotation Yrotation",
    ]
    children = [k for k, p in enumerate(skeleton.parents) if int(p) == joint]
    for child in children:
        lines += _hierarchy(skeleton, child, depth + 1)
    if not children:
        end = skeleton.end_offsets.get(joint, np.zeros(3))
        lines += [f"{inner}End Site", f"{inner}{{", f"{inner}\t{_offset(end)}", f"{inner}}}"]
    return [*lines, f"{pad}}}"]


def _offset(offset_m: Array) -> str:
    x, y, z = np.round(_CM * Y_UP_FROM_WORLD @ np.asarray(offset_m, dtype=np.float64), 6) + 0.0
    return f"OFFSET {x:.6f} {y:.6f} {z:.6f}"


def _zxy_degrees(rotations: Array) -> Array:
    """Euler angles (T, J, 3) in degrees, order z, x, y, of R = Rz Rx Ry; (T, J, 3, 3) in."""
    from scipy.spatial.transform import Rotation

    T, J = rotations.shape[:2]
    if T == 0:
        return np.zeros((0, J, 3))
    with warnings.catch_warnings():
        # At x = +-90 degrees z and y are one; SciPy then sets one of them to zero, which is a right answer.
        warnings.filterwarnings("ignore", message="Gimbal lock")
        angles = Rotation.from_matrix(rotations.reshape(-1, 3, 3)).as_euler("ZXY")
    return np.degrees(np.unwrap(angles.reshape(T, J, 3), axis=0))
