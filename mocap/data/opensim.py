"""A body as OpenSim has it: rigid bodies on joints with named coordinates, and the markers that they carry."""

from __future__ import annotations

from dataclasses import dataclass, field

from mocap.arrays import Array


@dataclass(frozen=True, eq=False)
class OpenSimBody:
    """One rigid body, and the joint that it hangs on.

    parent : body before it, "ground" for the first, which moves freely.  location : (3,) m of the joint in the parent's
    frame.  rotations : three (coordinate, axis), in the order of application; an empty coordinate does not turn.
    markers : name -> (3,) m in this body's frame.  mass_share : of the whole body's.
    """

    name: str
    parent: str
    location: Array
    rotations: tuple[tuple[str, tuple[float, float, float]], ...]
    mass_share: float
    markers: dict[str, Array] = field(default_factory=dict)
