"""Captured motion as it stands in a file: a tree of joints with rotations over time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.spatial.transform import Rotation, Slerp

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Recording:
    """Joints of a capture file in the file's own units and axes.

    names : J joint names, parents before children.  parents : (J,) int, -1 for the root.
    offsets : (J, 3) joint origin in the parent's frame at rest.  places : (T, J, 3) the same in every frame; of the
    root, in the world.  rotations : (T, J, 3, 3) local.  fps : frames per second, None when the file does not say.
    """

    names: tuple[str, ...]
    parents: NDArray[np.int64]
    offsets: Array
    places: Array
    rotations: Array
    fps: float | None

    @property
    def n_frames(self) -> int:
        return len(self.rotations)

    def world(self) -> tuple[Array, Array]:
        """Positions (T, J, 3) and rotations (T, J, 3, 3) of all joints."""
        T, J = self.rotations.shape[:2]
        position, rotation = np.zeros((T, J, 3)), np.zeros((T, J, 3, 3))
        for j in range(J):
            p = int(self.parents[j])
            if p < 0:
                position[:, j] = self.places[:, j]
                rotation[:, j] = self.rotations[:, j]
            else:
                position[:, j] = position[:, p] + np.einsum("tab,tb->ta", rotation[:, p], self.places[:, j])
                rotation[:, j] = rotation[:, p] @ self.rotations[:, j]
        return position, rotation

    def at_rest(self) -> Recording:
        """One frame with all rotations at zero and all joints at their offsets."""
        eye = np.tile(np.eye(3), (1, len(self.names), 1, 1))
        return replace(self, rotations=eye, places=self.offsets[None])

    def sampled(self, frames: Array) -> Recording:
        """The recording at fractional frame numbers (N,); beyond its ends it stands still."""
        at = np.clip(np.asarray(frames, dtype=np.float64), 0, self.n_frames - 1)
        if self.n_frames == 1:
            index = np.zeros(len(at), dtype=int)
            return replace(self, rotations=self.rotations[index], places=self.places[index])
        times = np.arange(self.n_frames)
        turned = [
            Slerp(times, Rotation.from_matrix(self.rotations[:, j]))(at).as_matrix()
            for j in range(len(self.names))
        ]
        places = make_interp_spline(times, self.places, k=1)(at)
        return replace(self, rotations=np.stack(turned, axis=1), places=places)


def euler_matrix(axes: str, degrees: Array) -> Array:
    """Product of rotations in the order of `axes` ("zyx": Rz Ry Rx), (T, 3, 3).  degrees : (T, len(axes))."""
    if not axes:
        return np.tile(np.eye(3), (len(degrees), 1, 1))
    return (
        Rotation.from_euler(axes.upper(), np.atleast_2d(degrees), degrees=True).as_matrix().reshape(-1, 3, 3)
    )
