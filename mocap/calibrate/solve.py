"""Lenses and places of all cameras from the views of a board, in the world of the floor or of known points.

Cameras of known lenses need no board where points of known place are in their pictures: `resect`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np

from mocap.arrays import Array
from mocap.calibrate import doubts
from mocap.calibrate.bundle import WORLD, Adjusted, Bundle, Pose, adjust, inverse
from mocap.calibrate.detect import Sighting
from mocap.calibrate.lens import Lens, LensModel, lens_from_views
from mocap.calibrate.numbering import agree, board_pose, readings
from mocap.calibrate.views import BoardViews
from mocap.data import CameraRig
from mocap.errors import MocapError

_BAD_VIEW = 2.5  # sightings that are off by so many times the median are left out
# Points of known place that fix a camera in the world.
_MIN_POINTS = 4


@dataclass(frozen=True, eq=False)
class WorldPoints:
    """Points of known place in the pictures: camera -> points (N, 3) m and their pixels (N, 2)."""

    sightings: dict[str, Sighting]


@dataclass(frozen=True, eq=False)
class Calibrated:
    """rig : the cameras, m, z up.  adjusted : what was solved, and how certain it is.

    rms_px_of, n_views_of, center_deviation_m, focal_deviation : by camera.  warnings : what to look at.  A view is one
    of a board, or the points of known place together.
    """

    rig: CameraRig
    adjusted: Adjusted
    rms_px: float
    rms_px_of: dict[str, float]
    n_views_of: dict[str, int]
    warnings: tuple[str, ...]

    @property
    def center_deviation_m(self) -> dict[str, float]:
        return {name: self.adjusted.center_deviation_m(name) for name in self.rig.names}

    @property
    def focal_deviation(self) -> dict[str, float]:
        return {name: self.adjusted.focal_deviation(name) for name in self.rig.names}


def calibrate(
    views: BoardViews,
    *,
    world: int | WorldPoints,
    lenses: Mapping[str, Lens] | None = None,
    model: LensModel = "radial",
) -> Calibrated:
    """Solve for the cameras that saw a board.

    world : the frame in which the board lies on the floor (origin at its middle, x along its rows, z up), or points of
    known place.  lenses : camera -> lens that is kept as it is; None = they are solved for.
    Raises MocapError where the views cannot give what is asked: too few of them, cameras without common views, a board
    that does not move, a world that nobody saw, focal lengths that cannot be right.
    """
    doubts.check_views(views, None if isinstance(world, WorldPoints) else world, lenses is not None)
    own = dict(lenses) if lenses is not None else {name: _lens(views, name, model) for name in views.names}
    numbered, relative = agree(views, own)
    bundle = _first(views, numbered, relative, own, world, model, lenses is not None)
    adjusted = _solved(bundle)
    sharp = _without_bad_views(adjusted.bundle)
    if len(sharp.sightings) < len(bundle.sightings):
        adjusted = _solved(sharp)
    adjusted = _above_floor(adjusted)
    doubts.check_solution(adjusted)
    return _calibrated(adjusted, views.names, doubts.warnings)


def resect(world: WorldPoints, lenses: Mapping[str, Lens]) -> Calibrated:
    """Place the cameras of known lenses, each by the points of known place that it sees.

    Raises MocapError for a camera with fewer than four points, or with points in one line, and where no place explains
    them; a point that is far from all others is named.
    """
    for name in lenses:
        n_points = len(world.sightings[name].uv) if name in world.sightings else 0
        if n_points < _MIN_POINTS:
            raise MocapError(
                f"{n_points} points of known place are given, needed are {_MIN_POINTS} or more",
                camera=name,
                remedy="give more rows, camera,u_px,v_px,x_m,y_m,z_m, with the cameras' names as in the lenses",
            )
    placed = {name: _resected(name, lens, world.sightings[name]) for name, lens in lenses.items()}
    for name, one in placed.items():
        doubts.check_points(name, one, partial(_resected, name, lenses[name]))
    adjusted = adjust(
        Bundle(
            dict(lenses),
            {name: one.bundle.places[name] for name, one in placed.items()},
            {},
            {(WORLD, name): world.sightings[name] for name in lenses},
            "radial",
            keeps_lenses=True,
        )
    )
    return _calibrated(adjusted, list(lenses), doubts.warnings_of_points)


def _resected(name: str, lens: Lens, sighting: Sighting) -> Adjusted:
    """One camera placed by points of known place."""
    place = _pose(_place_by_points(name, sighting, lens))
    bundle = Bundle({name: lens}, {name: place}, {}, {(WORLD, name): sighting}, "radial", keeps_lenses=True)
    try:
        return adjust(bundle)
    except np.linalg.LinAlgError as error:
        raise _undetermined_by_points(name) from error


def _place_by_points(name: str, sighting: Sighting, lens: Lens) -> Array:
    """Pose (4, 4) of the world in the frame of a camera."""
    try:
        return board_pose(sighting, lens)
    except cv2.error as error:
        raise _undetermined_by_points(name) from error


def _undetermined_by_points(name: str) -> MocapError:
    return MocapError(
        "the points of known place do not determine the camera",
        camera=name,
        remedy="give points that lie not in one line, spread over the picture and at several heights",
    )


def _calibrated(
    adjusted: Adjusted,
    names: Sequence[str],
    warnings: Callable[[CameraRig, Adjusted, dict[str, float]], list[str]],
) -> Calibrated:
    residuals = adjusted.bundle.residuals()
    rms_of = {name: _rms([r for (_, by), r in residuals.items() if by == name]) for name in names}
    counts = {name: sum(by == name for _, by in residuals) for name in names}
    rig = CameraRig(tuple(adjusted.bundle.camera(name) for name in names))
    return Calibrated(
        rig, adjusted, _rms(list(residuals.values())), rms_of, counts, tuple(warnings(rig, adjusted, rms_of))
    )


def lens_of_clip(views: BoardViews, name: str, model: LensModel) -> Lens:
    """The lens of one camera from its own clip; refused like the views of a calibration."""
    doubts.check_views(views, None, has_lenses=False)
    return _lens(views, name, model)


def _rms(residuals: Sequence[Array]) -> float:
    """Root mean square distance, px."""
    return float(np.sqrt(np.mean(np.concatenate([(r**2).sum(axis=1) for r in residuals]))))


def _lens(views: BoardViews, name: str, model: LensModel) -> Lens:
    """Of one camera alone; which end of a checkerboard is which does not matter."""
    seen = [readings(views.board, sighting)[0] for sighting in views.of_camera(name)]
    try:
        return lens_from_views(
            views.picture_size[name], [s.points for s in seen], [s.uv for s in seen], model
        )
    except cv2.error as error:
        raise MocapError(
            f"the lens has no solution: {error.err}",
            camera=name,
            remedy="show the board in more places and at more angles, near the picture's edges too",
        ) from error


def _solved(bundle: Bundle) -> Adjusted:
    try:
        return adjust(bundle)
    except np.linalg.LinAlgError as error:
        raise MocapError(
            "the views do not determine the cameras",
            remedy="show the board in more places and at more angles, to two cameras at once",
        ) from error


def _first(
    views: BoardViews,
    numbered: Mapping[int, Mapping[str, Sighting]],
    relative: Mapping[str, Array],
    lenses: dict[str, Lens],
    world: int | WorldPoints,
    model: LensModel,
    keeps_lenses: bool,
) -> Bundle:
    """Everything in its first place."""
    of_board = {(frame, name): s for frame, seen in numbered.items() for name, s in seen.items()}
    if isinstance(world, WorldPoints):
        at_world = {(WORLD, name): s for name, s in world.sightings.items() if name in lenses}
        floor_frame = None
    else:
        at_world = {(WORLD, name): s for name, s in numbered[world].items()}
        floor_frame = world
    T_rig_world = _world_in_rig(at_world, relative, lenses)
    places = {name: _pose(inverse(T) @ T_rig_world) for name, T in relative.items()}
    boards = {}
    for frame, seen in numbered.items():
        if seen and frame != floor_frame:
            name, sighting = max(seen.items(), key=lambda item: np.ptp(item[1].uv, axis=0).min())
            T_rig_board = relative[name] @ board_pose(sighting, lenses[name])
            boards[frame] = _pose(inverse(T_rig_world) @ T_rig_board)
    sightings = {key: s for key, s in of_board.items() if key[0] != floor_frame} | at_world
    return Bundle(lenses, places, boards, sightings, model, keeps_lenses)


def _world_in_rig(
    at_world: Mapping[tuple[int, str], Sighting], relative: Mapping[str, Array], lenses: Mapping[str, Lens]
) -> Array:
    """Pose (4, 4) of the world in the frame of the first camera, from the camera that sees it largest."""
    usable = {name: s for (_, name), s in at_world.items() if len(s.uv) >= _MIN_POINTS}
    if not usable:
        raise MocapError(
            f"no camera sees {_MIN_POINTS} of the points of known place",
            remedy="give more rows, camera,u_px,v_px,x_m,y_m,z_m, with the cameras' names as in the clips",
        )
    name = max(usable, key=lambda n: float(np.ptp(usable[n].uv, axis=0).min()))
    return relative[name] @ _place_by_points(name, usable[name], lenses[name])


def _pose(T: Array) -> Pose:
    return cv2.Rodrigues(T[:3, :3])[0].ravel(), T[:3, 3].copy()


def _above_floor(adjusted: Adjusted) -> Adjusted:
    """The world turned by half a turn about x where most cameras would be below the floor.

    A board's z axis points into it, or out of it where its corners are counted from another end.  Points of known
    place say themselves where up is, and a rig that hangs below them is the user's own.
    """
    heights = [adjusted.bundle.camera(name).center[2] for name in adjusted.names]
    if np.mean(heights) >= 0 or any(np.ptp(s.points[:, 2]) for s in _at_world(adjusted.bundle)):
        return adjusted
    half_turn = np.diag([1.0, -1.0, -1.0])
    bundle = adjusted.bundle
    places = {}
    for name, (rotation, translation) in bundle.places.items():
        places[name] = cv2.Rodrigues(cv2.Rodrigues(rotation)[0] @ half_turn)[0].ravel(), translation
    turn = np.eye(4)
    turn[:3, :3] = half_turn
    objects = {item: _pose(turn @ _matrix(pose)) for item, pose in bundle.objects.items()}
    turned = {
        key: Sighting(s.points @ half_turn, s.uv) if key[0] == WORLD else s
        for key, s in bundle.sightings.items()
    }
    return adjust(replace(bundle, places=places, objects=objects, sightings=turned))


def _at_world(bundle: Bundle) -> list[Sighting]:
    return [s for (item, _), s in bundle.sightings.items() if item == WORLD]


def _matrix(pose: Pose) -> Array:
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(pose[0])[0]
    T[:3, 3] = pose[1].ravel()
    return T


def _without_bad_views(bundle: Bundle) -> Bundle:
    """Without sightings that are off much more than most, such as boards seen at a grazing angle.

    A camera keeps doubts.MIN_VIEWS, and a board one sighting; the world stays.
    """
    rms = {key: _rms([r]) for key, r in bundle.residuals().items()}
    limit = _BAD_VIEW * float(np.median(list(rms.values())))
    kept = dict(bundle.sightings)
    for key, error in sorted(rms.items(), key=lambda found: -found[1]):
        item, name = key
        n_of_camera = sum(by == name for _, by in kept)
        n_of_board = sum(of == item for of, _ in kept)
        if error > limit and item != WORLD and n_of_camera > doubts.MIN_VIEWS and n_of_board > 1:
            del kept[key]
    return replace(bundle, sightings=kept)
