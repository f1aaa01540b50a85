"""What cannot be right is refused, with what was missing; what may be wrong is a warning."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from mocap.calibrate.bundle import WORLD, Adjusted
from mocap.calibrate.detect import Sighting
from mocap.calibrate.views import BoardViews
from mocap.data import CameraRig
from mocap.errors import MocapError

MIN_VIEWS = 6  # of each camera; fewer leave the lens undetermined
_MIN_VIEWS_KNOWN_LENS = 3  # enough to agree with the other cameras
# A board whose middle moves by less over all views, as a share of the picture's width, while its outline keeps its
# shape, does not move.
_STILL_SHARE = 0.01
# Focal lengths of square pixels agree to a few parts in a thousand.
_MAX_ASPECT, _WARN_ASPECT = 0.10, 0.03
# Standard deviation of a focal length, as a share of it.
_MAX_FOCAL_SD, _WARN_FOCAL_SD = 0.05, 0.01
_WARN_RMS_PX, _MAX_RMS_PX = 1.0, 5.0
_WARN_CENTRE = 0.15
_WARN_PLACE_SD_M = 0.02
_LOW_M = 0.1  # no camera stands lower
# Points of known place: with so many or fewer, leaving one out leaves nothing that could disagree.
_FEWEST_TO_LEAVE_OUT = 5
# One without which the others are off by less than this share of what they are with it does not belong to them.
_ODD_POINT = 0.4
_WARN_POINTS_PX = 3.0  # pointed at by hand; corners of a board are found more exactly


def check_views(views: BoardViews, floor_frame: int | None, has_lenses: bool) -> None:
    """Refuse views that cannot give a calibration, before anything is solved."""
    needed = _MIN_VIEWS_KNOWN_LENS if has_lenses else MIN_VIEWS
    for name, count in views.n_views().items():
        if count < needed:
            why = views.why_missed(name)
            raise MocapError(
                f"the board ({views.board}) was found in {count} frames, needed are {needed}"
                + (f"; of the others: {why}" if why else ""),
                camera=name,
                remedy="check --board (a checkerboard is counted by its inner corners, not squares), show the board "
                "longer, nearer and tilted, or look at more frames with --frames",
            )
        if not has_lenses and _is_still(views, name):
            raise MocapError(
                f"the board does not move: in {count} frames it is seen in one place",
                camera=name,
                remedy="carry the board through the room, tilt it in all directions and bring it near to every camera; "
                "or give known lenses with --lenses, then one place per pair of cameras is nearly enough",
            )
    if floor_frame is not None and not views.seen.get(floor_frame):
        raise MocapError(
            "no camera sees the board in the floor frame",
            frame=floor_frame,
            remedy="give a frame in which the board lies on the floor, in view of two cameras, as --floor-frame",
        )


def _is_still(views: BoardViews, name: str) -> bool:
    """Whether what a camera saw differs by less than a hundredth of the picture between all frames."""
    seen = views.of_camera(name)
    limits = np.array([[s.uv.min(axis=0), s.uv.max(axis=0)] for s in seen])
    return bool(np.ptp(limits, axis=0).max() < _STILL_SHARE * views.picture_size[name][0])


def check_solution(adjusted: Adjusted) -> None:
    """Refuse cameras that cannot be right."""
    for name in adjusted.names:
        fx, fy = np.diag(adjusted.bundle.lenses[name].K)[:2]
        deviation = adjusted.focal_deviation(name)
        if not deviation < _MAX_FOCAL_SD:
            raise MocapError(
                f"the focal length is uncertain by {100 * deviation:.0f} %: the board was shown in too few poses",
                camera=name,
                remedy="tilt the board by 30 to 45 degrees in all directions, near, far and near the picture's edges",
            )
        if not adjusted.bundle.keeps_lenses and abs(fx / fy - 1) > _MAX_ASPECT:
            raise MocapError(
                f"the focal lengths {fx:.0f} and {fy:.0f} px are apart by {100 * abs(fx / fy - 1):.0f} %, which no "
                "ordinary camera has",
                camera=name,
                remedy="tilt the board both ways, check that its squares are square, and that clips are not stretched",
            )
    if adjusted.noise_px > _MAX_RMS_PX:
        raise MocapError(
            f"corners are off by {adjusted.noise_px:.1f} px: no places of the cameras explain what they saw",
            remedy="clips must be synchronised and the board flat and stiff; check --board and --lens",
        )


def warnings(rig: CameraRig, adjusted: Adjusted, rms_px_of: Mapping[str, float]) -> list[str]:
    """What may be wrong."""
    found = []
    for camera in rig:
        name = camera.name
        fx, fy = camera.K[0, 0], camera.K[1, 1]
        if rms_px_of[name] > _WARN_RMS_PX:
            found.append(
                f"camera {name}: corners are off by {rms_px_of[name]:.1f} px; clips may not be synchronised, the board "
                "not flat, or the pictures blurred"
            )
        if abs(fx / fy - 1) > _WARN_ASPECT:
            found.append(
                f"camera {name}: focal lengths {fx:.0f} and {fy:.0f} px differ; show the board tilted both ways"
            )
        if adjusted.focal_deviation(name) > _WARN_FOCAL_SD:
            found.append(
                f"camera {name}: its focal length is uncertain by {100 * adjusted.focal_deviation(name):.1f} %; show "
                "the board nearer and more tilted"
            )
        if adjusted.center_deviation_m(name) > _WARN_PLACE_SD_M:
            found.append(
                f"camera {name}: its place is uncertain by {1000 * adjusted.center_deviation_m(name):.0f} mm; show it "
                "the board together with the other cameras more often, and a larger board on the floor"
            )
        off = abs(camera.K[:2, 2] / np.array(camera.size) - 0.5)
        if off.max() > _WARN_CENTRE:
            found.append(
                f"camera {name}: its centre is far from the middle of the picture; show the board near the edges too"
            )
        if camera.center[2] < _LOW_M:
            found.append(f"camera {name} lies at {camera.center[2]:.2f} m; is the floor frame right?")
    return found


def check_points(name: str, placed: Adjusted, without: Callable[[Sighting], Adjusted]) -> None:
    """Refuse points of known place that no place of a camera explains; one that is far off all others is named.

    without : places the camera by other points.
    """
    rms_px = _rms_px(placed)
    sighting = placed.bundle.sightings[WORLD, name]
    n = len(sighting.uv)
    if rms_px > _WARN_RMS_PX and n > _FEWEST_TO_LEAVE_OUT:
        left_px = [_rms_px_without(sighting, k, without) for k in range(n)]
        odd = int(np.argmin(left_px))
        if left_px[odd] < min(_ODD_POINT * rms_px, _MAX_RMS_PX):
            place = ", ".join(f"{x:g}" for x in sighting.points[odd])
            u, v = sighting.uv[odd]
            raise MocapError(
                f"the point at ({place}) m, pixel ({u:g}, {v:g}), does not go with the other {n - 1}: they are off by "
                f"{left_px[odd]:.1f} px without it, {rms_px:.1f} px with it",
                camera=name,
                remedy="look whether its place and its pixel belong together, or leave it out",
            )
    if rms_px > _MAX_RMS_PX:
        raise MocapError(
            f"the points of known place are off by {rms_px:.1f} px: no place of the camera explains them",
            camera=name,
            remedy="check which point is which, that places are metres with z up, and that the lens is that of "
            "this zoom and picture size",
        )


def warnings_of_points(rig: CameraRig, adjusted: Adjusted, rms_px_of: Mapping[str, float]) -> list[str]:
    """What may be wrong with cameras that were placed by points."""
    found = []
    for name in rig.names:
        n = len(adjusted.bundle.sightings[WORLD, name].uv)
        if n <= _FEWEST_TO_LEAVE_OUT:
            found.append(
                f"camera {name}: {n} points say little of their own errors; give {_FEWEST_TO_LEAVE_OUT + 1} or more"
            )
        if rms_px_of[name] > _WARN_POINTS_PX:
            found.append(
                f"camera {name}: points are off by {rms_px_of[name]:.1f} px; measure and point more exactly"
            )
        if adjusted.center_deviation_m(name) > _WARN_PLACE_SD_M:
            found.append(
                f"camera {name}: its place is uncertain by {1000 * adjusted.center_deviation_m(name):.0f} mm; give "
                "more points, further apart and at several heights"
            )
        if rig[name].center[2] < _LOW_M:
            found.append(f"camera {name} lies at {rig[name].center[2]:.2f} m; is z up, and 0 on the floor?")
    return found


def _rms_px(placed: Adjusted) -> float:
    return float(np.sqrt(np.mean([(r**2).sum(axis=1).mean() for r in placed.bundle.residuals().values()])))


def _rms_px_without(sighting: Sighting, k: int, without: Callable[[Sighting], Adjusted]) -> float:
    """What is left of all points but the k-th; infinite where the others, in one line perhaps, place no camera."""
    others = Sighting(np.delete(sighting.points, k, 0), np.delete(sighting.uv, k, 0))
    try:
        return _rms_px(without(others))
    except MocapError:
        return np.inf
