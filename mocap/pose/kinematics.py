"""Kinematics of one person: all that follows from the poses, computed once for whatever tells it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mocap.data import LANDMARKS, AngleSeries, Motion
from mocap.pose.angles import anatomical_states, angles_of
from mocap.pose.cycles import GaitCycles, cycles_of
from mocap.pose.method import Method
from mocap.pose.moves import Move, moves_of
from mocap.pose.opensim import coordinate_of_angle, coordinates_of_states
from mocap.pose.result import PersonPoses, motion_of
from mocap.pose.steps import Gait, gait_of

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Kinematics:
    """What tables, exports and report tell of one person; each is computed when it is first asked for.

    method : its settings of angles and contacts are looked at.
    """

    poses: PersonPoses
    fps: float
    method: Method = field(default_factory=Method)

    def frame_of(self, row: int) -> int:
        """The frame of a pose, or the one after the last pose before `row`, where there is none in it."""
        frames = self.poses.frames
        return int(frames[row]) if row < len(frames) else int(frames[-1]) + 1

    @cached_property
    def motion(self) -> Motion:
        """Landmarks."""
        return motion_of(self.poses, self.fps)

    @cached_property
    def angles(self) -> AngleSeries:
        """Anatomical angles."""
        return angles_of(self.poses, self.fps, self.method.angles, self._anatomy)

    @cached_property
    def coordinates(self) -> dict[str, Array]:
        """Coordinate of OpenSim -> (T,), degrees and metres, of the poses that the angles are those of."""
        return coordinates_of_states(self.poses.body, self._anatomy[0])

    @cached_property
    def unseen(self) -> tuple[str, ...]:
        """The coordinates of OpenSim that were observed in no frame: they are what is usual."""
        seen = self.angles.observed
        found = (coordinate_of_angle(name) for name in self.angles.names)
        return tuple(c[0] for a, c in enumerate(found) if c and seen is not None and not seen[:, a].any())

    @cached_property
    def gait(self) -> Gait:
        """Contacts and steps."""
        return gait_of(self.poses, self.fps, self.method.contact)

    @cached_property
    def cycles(self) -> tuple[GaitCycles, ...]:
        """Angles over the gait cycles of both feet."""
        return cycles_of(self.gait, self.angles, self.poses.landmarks[:, LANDMARKS.index("pelvis"), :2])

    @cached_property
    def moves(self) -> tuple[Move, ...]:
        """Jumps and squats."""
        return moves_of(self.poses, self.gait, self.fps)

    @cached_property
    def _anatomy(self) -> tuple[Array, Array]:
        # By far the longest of all: angles and coordinates share it.
        return anatomical_states(self.poses, self.method.angles)
