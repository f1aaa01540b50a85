"""What is wrong with a calibration as a whole, told from people: exchanged cameras, another zoom, mirrored pictures.

Lines of sight along the tangents of two cameras meet (`mocap.volume.rig_refinement`). Where they do not, every mistake
that people make is tried, one at a time; the one under which they meet is named. The size of everything does not show
in them: that is told by the height of the people.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera, CameraRig
from mocap.volume.rig_refinement import Meeting, meetings, standing_height_m

Array = NDArray[np.float64]
Hulls = Sequence[Sequence[Array]]
Mistake = Literal["exchanged", "zoom", "mirrored", "upside_down"]

# Ratios of focal lengths that are tried: steps of 3.5 %, which misses an outline by a centimetre at most.
_ZOOMS = tuple(float(2**power) for power in np.linspace(-1, 1, 41) if power)
_SUSPECTS = 2  # cameras that are off most; a single mistake is theirs
_USUAL_M = 1.75  # of a person: where people come out larger, so do all distances
_LEAST_TANGENTS = 100  # of all pairs together; fewer say nothing
_LEAST_OF_CAMERA = 20


@dataclass(frozen=True)
class DoubtSettings:
    """Chosen on the development sessions: as calibrated their lines of sight are 2 to 5 mm apart, with errors of 2
    degrees and 3 cm 40 to 120 mm, with a mistake 60 mm and more, and 3 to 30 mm once it is undone.

    agrees_m : a rig whose lines of sight are no further apart is right.  explained_m : so near they must come when a
    mistake is undone, and explained : to what share of before.  clearly : the best mistake is better than the next one
    of another kind or camera by this factor.  kept : share of the tangents that still meet.
    """

    agrees_m: float = 0.03
    explained_m: float = 0.03
    explained: float = 0.4
    clearly: float = 1.3
    kept: float = 0.5


@dataclass(frozen=True)
class RigDoubt:
    """apart_m : median distance of lines of sight as calibrated, of the camera that is off most, NaN when there is too
    little to tell from.  worst : that camera.  mistake, cameras : what explains it, and of whom; None = nothing does.
    factor : of a zoom.  explained_m : median distance once that is undone.  height_m : of the tallest person, NaN when
    it cannot be told; it says nothing where lines of sight do not meet.
    """

    apart_m: float
    worst: str
    mistake: Mistake | None
    cameras: tuple[str, ...]
    factor: float
    explained_m: float
    height_m: float
    agrees: bool


@dataclass(frozen=True, eq=False)
class _Trial:
    """A mistake undone."""

    mistake: Mistake
    cameras: tuple[int, ...]
    factor: float
    rig: CameraRig
    hulls: Hulls


def doubt_rig(rig: CameraRig, hulls: Hulls, settings: DoubtSettings | None = None) -> RigDoubt:
    """Whether people fit a calibration, and which single mistake explains it when they do not.

    hulls : per camera and frame the convex hull (P, 2) px of the silhouettes, as of `refine_rig`.
    """
    s = settings or DoubtSettings()
    now = meetings(rig, hulls)
    everyone = tuple(range(len(rig)))
    if len(now.apart_m) < _LEAST_TANGENTS:
        return RigDoubt(float("nan"), rig.names[0], None, (), 1.0, float("nan"), float("nan"), agrees=False)
    of_camera = [np.nan_to_num(_median(now, (c,))) for c in everyone]
    worst = int(np.argmax(of_camera))
    height = standing_height_m(now.points, now.frames)
    apart = float(of_camera[worst])
    if apart <= s.agrees_m * max(1.0, np.nan_to_num(height, nan=1.0) / _USUAL_M):
        return RigDoubt(apart, rig.names[worst], None, (), 1.0, float("nan"), height, agrees=True)
    suspects = np.argsort(of_camera)[::-1][:_SUSPECTS].tolist()
    explained = ((_explained(now, trial, s), trial) for trial in _trials(rig, hulls, suspects))
    found = sorted(
        ((after, trial) for after, trial in explained if after is not None), key=lambda pair: pair[0]
    )
    is_clear = bool(found) and all(
        after > s.clearly * found[0][0] or trial.cameras == found[0][1].cameras for after, trial in found[1:]
    )
    if not is_clear:
        return RigDoubt(apart, rig.names[worst], None, (), 1.0, float("nan"), height, agrees=False)
    after, trial = found[0]
    names = tuple(rig.names[c] for c in trial.cameras)
    return RigDoubt(apart, rig.names[worst], trial.mistake, names, trial.factor, after, height, agrees=False)


def _trials(rig: CameraRig, hulls: Hulls, suspects: Sequence[int]) -> Iterator[_Trial]:
    """Every mistake that is looked for, undone, with a suspect in it."""
    for i, j in combinations(range(len(rig)), 2):
        if rig[i].size == rig[j].size and {i, j} & set(suspects):
            changed = list(hulls)
            changed[i], changed[j] = hulls[j], hulls[i]
            yield _Trial("exchanged", (i, j), 1.0, rig, changed)
    mirrored = [_flipped(camera, own, (True, False)) for camera, own in zip(rig, hulls, strict=True)]
    yield _Trial("mirrored", tuple(range(len(rig))), 1.0, rig, mirrored)
    for c, camera in ((c, rig[c]) for c in suspects):
        yield _Trial("mirrored", (c,), 1.0, rig, _with(hulls, c, mirrored[c]))
        yield _Trial("upside_down", (c,), 1.0, rig, _with(hulls, c, _flipped(camera, hulls[c], (True, True))))
        for factor in _ZOOMS:
            zoomed = [replace(camera, K=camera.K * [[factor, 1, 1], [1, factor, 1], [1, 1, 1]])]
            cameras = (*rig.cameras[:c], *zoomed, *rig.cameras[c + 1 :])
            yield _Trial("zoom", (c,), factor, CameraRig(cameras), hulls)


def _explained(now: Meeting, trial: _Trial, s: DoubtSettings) -> float | None:
    """Median distance among the cameras of a mistake once it is undone; None when it explains nothing."""
    before = _median(now, trial.cameras)
    then = meetings(trial.rig, trial.hulls)
    after = _median(then, trial.cameras)
    is_kept = len(then.apart_m) >= s.kept * len(now.apart_m)
    rest = _median(then, tuple(range(len(trial.rig))))
    if not is_kept or not max(after, rest) <= s.explained_m or not after <= s.explained * before:
        return None
    return after


def _median(meeting: Meeting, cameras: tuple[int, ...]) -> float:
    """Median distance (m) of lines of sight of some cameras with any other; NaN for too few."""
    is_own = np.isin(meeting.cameras, cameras).any(axis=1)
    return float(np.median(meeting.apart_m[is_own])) if is_own.sum() >= _LEAST_OF_CAMERA else float("nan")


def _with(hulls: Hulls, c: int, own: Sequence[Array]) -> Hulls:
    return [*hulls[:c], own, *hulls[c + 1 :]]


def _flipped(camera: Camera, hulls: Sequence[Array], axes: tuple[bool, bool]) -> list[Array]:
    """Hulls in pictures that are mirrored along u, v, or both."""
    far = np.array(camera.size) - 1.0
    return [np.where(axes, far - hull, hull) for hull in hulls]
