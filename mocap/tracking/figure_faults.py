"""Faults of keypoints, told from geometry: exchanged cameras, other frame rates, mirrored names, pictures of people.

Cameras that agree on a person say where its points are; what a camera shows of it is compared with that as it stands,
and as it would be with another camera's file, another frame rate or left and right exchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from mocap.arrays import Array
from mocap.data.keypoints import KEYPOINTS, MIRRORED
from mocap.geometry.epipolar import symmetric_epipolar_distance
from mocap.tracking.figures import FigurePerson, FigureSettings, FigureViews, View2D, points_of_figures

Figures = Mapping[int, Sequence[View2D]]

_ROW = {name: k for k, name in enumerate(KEYPOINTS)}
# Ratios of the usual frame rates: 15, 24, 25, 30, 50 and 60 per second.
_RATES = (0.5, 2.0, 0.8, 1.25, 5 / 6, 1.2)


@dataclass(frozen=True)
class FaultSettings:
    """When keypoints count as wrong. Chosen on `tests/keypoint_world.py` with the noise of a network."""

    n_frames: int = 40
    """Frames, spread over the clip, that are looked at."""
    least_frames: int = 5
    """With fewer frames that tell, nothing is said."""
    apart_m: float = 0.06
    """Median distance of a camera's keypoints from where the others see the person, from which it is looked into;
    MediaPipe's are 20 to 30 mm off."""
    strange_m: float = 0.15
    """The same from which a camera does not agree, whatever the reason."""
    better: float = 0.5
    """Another explanation must bring it down to this share."""
    most_cameras: int = 8
    """All orders of so many cameras are tried."""
    epipolar_px: float = 12.0
    """Median distance of keypoints from the epipolar lines of another camera's, from which two do not agree."""
    lags: int = 60
    """Frames that a camera may be early or late, and at most half of the clip: of what is left of it hardly anything
    would tell."""
    backward_share: float = 0.7
    """Share of the frames in which faces look away from chests, from which left and right are exchanged."""
    bent_m: float = 0.05
    """Distance of a knee from the line of hip and ankle from which it tells where front is: noise leaves 30 mm."""
    flat_m: float = 0.02
    """Deviation of a picture's points from their plane; somebody's who stands lie 35 mm off, by nose and toes."""
    still_m: float = 0.02
    """What a picture's points move over a clip: the noise of keypoints."""
    still_focal: float = 0.006
    """The same of a picture that one camera alone shows, as a share of the focal length: 2 cm, 3 m away."""
    pair_better: float = 0.7
    """Of two cameras alone, the share to which another explanation must bring the distance from epipolar lines down: of
    MediaPipe's points left and right exchanged leave 0.43 to 0.63 of it, other clocks 0.2 to 0.53; good ones have
    none below 0.95."""
    pair_focal: float = 0.008
    """Distance from epipolar lines, as a share of the focal length, to which an explanation must bring two cameras
    alone: right ones leave 0.005 of it, the best of another clip's keypoints 0.014."""
    beside_m: float = 0.01
    """Distance of keypoints from the silhouettes in the same frame, in the mean over points and cameras, from which it
    is looked into: right ones lie 1 to 6 mm beside them, or 80 where silhouettes lack half of somebody; those of 12
    frames before 20 to 30 mm where somebody stands, 100 to 160 where he walks."""
    elsewhere_m: float = 0.15
    """The same from which keypoints and pictures are not of one recording, whatever the reason."""
    agreed_share: float = 0.6
    """Share of the frames with somebody in two pictures or more, in which at least two cameras must agree on somebody:
    0.97 to 1 of good keypoints, up to 0.45 of another clip's."""


@dataclass(frozen=True)
class FigureFault:
    """What is wrong.  camera : its index, None = all or none of them.  person : that is none, by its number.
    is_unexplained : the camera's keypoints lie elsewhere, and nothing is known that explains it.  is_mirrored : left
    and right are exchanged in all cameras."""

    message: str
    remedy: str
    camera: int | None = None
    person: int | None = None
    is_unexplained: bool = False
    is_mirrored: bool = False


@dataclass(frozen=True, eq=False)
class Clip:
    """The figures of a clip, and what was made of them.  names : of the cameras."""

    figures: Figures
    persons: Sequence[FigurePerson]
    views: FigureViews
    names: tuple[str, ...]
    fps: float
    figure_settings: FigureSettings
    settings: FaultSettings

    def some_frames(self) -> list[int]:
        """Frames spread over the clip."""
        frames = sorted(self.figures)
        step = max(1, -(-len(frames) // self.settings.n_frames))
        return frames[::step]

    def clocks(self) -> dict[str, Callable[[int], int]]:
        """Other clocks that a camera may have."""
        return _other_clocks(self.settings, len(self.figures))

    def of_camera(self, frame: int, camera: int) -> list[View2D]:
        """The figures of one picture."""
        return [f for f in self.figures.get(frame, ()) if f.camera == camera]


def find_figure_faults(clip: Clip) -> list[FigureFault]:
    """What geometry says against the keypoints of a clip."""
    exchanged = _exchanged(clip)
    if exchanged:
        return exchanged
    if len(clip.names) == 2:
        found = _of_pair(clip)
    else:
        faults = [_of_camera(clip, camera) for camera in range(len(clip.views.P))]
        found = _or_of_the_rig(clip, [fault for fault in faults if fault is not None])
    found = found or [*_strangers(clip), *_pictures_of_one_camera(clip)]
    return found + _mirrored(clip) + _pictures(clip)


def without_pictures(persons: Sequence[FigurePerson], faults: Sequence[FigureFault]) -> list[FigurePerson]:
    """The persons that are no pictures, numbered anew from 1."""
    kept = [p for p in persons if p.number not in {fault.person for fault in faults}]
    return [replace(p, number=n) for n, p in enumerate(kept, 1)]


# --- exchanged cameras ---------------------------------------------------------------------------------------


def _exchanged(clip: Clip) -> list[FigureFault]:
    """Another order of the files under which the cameras agree, where they do not as they are."""
    n = len(clip.names)
    limit = clip.settings.epipolar_px if n > 2 else _pair_limit_px(clip)
    if not 2 <= n <= clip.settings.most_cameras:
        return []
    score = _pair_scores(clip)
    pairs = np.array([(a, b) for a in range(n) for b in range(a)])
    orders = np.array(list(permutations(range(n))))
    of_pairs = np.stack([score[orders[:, a], a, orders[:, b], b] for a, b in pairs], axis=1)
    # A pair that nobody is seen by says nothing of any order; far is far.
    totals = np.nan_to_num(np.minimum(of_pairs, 4 * limit), nan=limit).mean(axis=1)
    as_it_is = totals[np.flatnonzero((orders == np.arange(n)).all(axis=1))[0]]
    best = int(totals.argmin())
    if totals[best] > limit or totals[best] > clip.settings.better * as_it_is:
        return []
    moved = [c for c in range(n) if orders[best, c] != c]
    text = ", ".join(f"those of {clip.names[orders[best, c]]} fit camera {clip.names[c]}" for c in moved)
    return [
        FigureFault(
            f"the keypoints of cameras {', '.join(clip.names[c] for c in moved)} are exchanged: {text}",
            "give the files the names of their cameras, or say which is which in session.toml: [camera_map]",
            moved[0],
        )
    ]


def _pair_scores(clip: Clip) -> Array:
    """Distance (C, C, C, C) px of the keypoints of file i, taken for camera a, from the epipolar lines of those of file
    j, taken for camera b: the best pair of figures of a frame, the median over frames."""
    n, frames = len(clip.names), clip.some_frames()[:: max(1, clip.settings.n_frames // 10)]
    F = {(a, b): clip.views.fundamental(a, b) for a in range(n) for b in range(n) if a != b}
    out = np.full((n, n, n, n), np.nan)
    for i in range(n):
        for j in range(i):
            pairs = [
                [(f.uv, g.uv) for f in clip.of_camera(frame, i) for g in clip.of_camera(frame, j)]
                for frame in frames
            ]
            for (a, b), fundamental in F.items():
                found = [min(_epipolar_px(fundamental, *pair) for pair in own) for own in pairs if own]
                if len(found) >= min(clip.settings.least_frames, len(frames)):
                    out[i, a, j, b] = out[j, b, i, a] = np.nanmedian(found)
    return out


def _epipolar_px(F: Array, a: Array, b: Array) -> float:
    known = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    if known.sum() < 3:
        return float("inf")
    return float(np.median(np.sqrt(symmetric_epipolar_distance(F, a[known], b[known]))))


# --- one camera against the others ---------------------------------------------------------------------------


def _of_camera(clip: Clip, camera: int) -> FigureFault | None:
    """What a camera's keypoints are that the others do not agree with."""
    seen = _without(clip, camera)
    if len(seen) < clip.settings.least_frames:
        return None
    own = _gap_m(clip, camera, seen, lambda frame: frame)
    if not np.isfinite(own) or own <= clip.settings.apart_m:
        return None
    name = clip.names[camera]
    mirrored = _gap_m(clip, camera, seen, lambda frame: frame, is_mirrored=True)
    if mirrored <= clip.settings.better * own:
        return FigureFault(
            f"left and right are exchanged in the keypoints of camera {name}",
            "exchange the names in its file; a mirrored picture has them exchanged",
            camera,
        )
    gaps = {what: _gap_m(clip, camera, seen, at) for what, at in clip.clocks().items()}
    what = min(gaps, key=gaps.__getitem__)
    # A clock under which the camera does not agree either explains nothing: somebody else was there before, perhaps.
    if gaps[what] <= min(clip.settings.better * own, clip.settings.strange_m):
        return FigureFault(
            f"the keypoints of camera {name} are {what}",
            "number its frames as those of the other cameras",
            camera,
        )
    if own <= clip.settings.strange_m:
        return None
    return FigureFault(
        f"the keypoints of camera {name} do not agree with those of the others: half of them lie further than "
        f"{1000 * own:.0f} mm from whom the others see. It shows somebody whom no other camera shows, or its "
        "keypoints are of another camera, clip or calibration",
        "detect all persons in all pictures (who is seen by one camera alone is not followed), check the files, or "
        "leave the camera out (session.toml: cameras)",
        camera,
        is_unexplained=True,
    )


def _or_of_the_rig(clip: Clip, found: list[FigureFault]) -> list[FigureFault]:
    """Faults of single cameras; where the others are no majority, or seldom agree, it is no single camera's."""
    strange = [fault.camera for fault in found if fault.is_unexplained]
    if strange and (seldom := _strangers(clip)):
        return seldom
    if not strange or 2 * len(strange) < len(clip.names):
        return found
    names = ", ".join(clip.names[c] for c in strange if c is not None)
    return [
        FigureFault(
            f"the keypoints of cameras {names} do not agree with those of the others, {len(strange)} of "
            f"{len(clip.names)}, so that none can be said to be right: keypoints or calibration are of another rig or "
            "clip, or the cameras run apart",
            "check that keypoints/ and the calibration are of this recording, and run `mocap sync`",
        )
    ]


def _of_pair(clip: Clip) -> list[FigureFault]:
    """What is wrong between two cameras, of which none can be told to be right."""
    first, second = clip.names
    own = _pair_px(clip, lambda frame: frame)
    tries = {
        f"left and right are exchanged in the keypoints of camera {first} or of {second}": _pair_px(
            clip, lambda frame: frame, is_mirrored=True
        )
    }
    for what, at in clip.clocks().items():
        said = f"the keypoints of camera {second} are {what.replace('the others', first)}"
        tries[said] = _pair_px(clip, at)
    said = min(tries, key=tries.__getitem__)
    if tries[said] > min(clip.settings.pair_better * own, _pair_limit_px(clip)):
        return []
    is_clock = said.startswith("the keypoints")
    remedy = (
        "number its frames as those of the other camera" if is_clock else "exchange the names in its file"
    )
    return [FigureFault(said, remedy, 1 if is_clock else None)]


def _pair_limit_px(clip: Clip) -> float:
    return clip.settings.pair_focal * float(np.mean(clip.views.focal))


def _pair_px(clip: Clip, shown_at: Callable[[int], int], *, is_mirrored: bool = False) -> float:
    """Median over frames of how far the keypoints of the second camera lie from the epipolar lines of the first, px."""
    F = clip.views.fundamental(0, 1)
    distances = []
    for frame in clip.some_frames():
        figures = clip.of_camera(shown_at(frame), 1)
        uv = [f.uv[MIRRORED] if is_mirrored else f.uv for f in figures]
        found = [_epipolar_px(F, f.uv, other) for f in clip.of_camera(frame, 0) for other in uv]
        distances += [min(found)] if found else []
    return float(np.median(distances)) if len(distances) >= clip.settings.least_frames else float("inf")


def _strangers(clip: Clip) -> list[FigureFault]:
    """Cameras that show somebody, and agree on nobody: no one of them can be blamed."""
    shown = [f for f, seen in clip.figures.items() if len({g.camera for g in seen}) >= 2]
    agreed = {frame for person in clip.persons for frame in person.frames}
    share = sum(f in agreed for f in shown) / max(len(shown), 1)
    if len(shown) < clip.settings.least_frames or share >= clip.settings.agreed_share:
        return []
    return [
        FigureFault(
            f"two cameras or more show somebody in {len(shown)} frames, and agree on a person in {100 * share:.0f} % "
            "of them: each shows somebody else, the keypoints are of another rig, clip or calibration, or the cameras "
            "run apart",
            "detect all persons in all pictures, check that keypoints/ and the calibration are of this recording, and "
            "run `mocap sync`",
        )
    ]


def find_picture_fault(
    beside_m: Callable[[int, int], float], frames: Sequence[int], settings: FaultSettings
) -> FigureFault | None:
    """What is wrong with keypoints that agree with each other and not with the silhouettes in the same pictures.

    beside_m : frame of the pictures, frame of the keypoints -> how far those lie beside the silhouettes, m, NaN where
    nobody is known.  frames : of the clip.
    """

    def median_m(shown_at: Callable[[int], int]) -> float:
        looked_at = frames[:: max(1, -(-len(frames) // settings.n_frames))]
        gaps = np.array([beside_m(frame, shown_at(frame)) for frame in looked_at])
        gaps = gaps[np.isfinite(gaps)]
        return float(np.median(gaps)) if len(gaps) >= settings.least_frames else float("inf")

    own = median_m(lambda frame: frame)
    if not np.isfinite(own) or own <= settings.beside_m:
        return None
    gaps = {what: median_m(at) for what, at in _other_clocks(settings, len(frames)).items()}
    what = min(gaps, key=gaps.__getitem__)
    if gaps[what] <= settings.better * own:
        said = what.replace("the others", "the pictures")
        beside = "" if said != what else " beside the pictures"
        return FigureFault(f"the keypoints are {said}{beside}", "number frames as the clips do")
    if own <= settings.elsewhere_m:
        return None
    return FigureFault(
        f"the keypoints agree with each other, and lie {1000 * own:.0f} mm beside the silhouettes of the same frames: "
        "they are of another clip than the pictures, or at another time",
        "check that keypoints/ is of this recording, or run without them (--observation voxels)",
    )


def _other_clocks(settings: FaultSettings, n_frames: int) -> dict[str, Callable[[int], int]]:
    """What is said of a camera's clock -> frame of the others -> frame of this camera.  n_frames : of the clip."""
    most = max(1, min(settings.lags, n_frames // 2))
    tries: dict[str, Callable[[int], int]] = {}
    for k in range(1, most + 1):
        more = " or more" if k == most else ""
        tries |= {f"late by {k} frames{more}": _shift(k), f"early by {k} frames{more}": _shift(-k)}
    return tries | {f"at {rate:.3g} times the frame rate of the others": _scale(rate) for rate in _RATES}


def _shift(k: int) -> Callable[[int], int]:
    return lambda frame: frame + k


def _scale(rate: float) -> Callable[[int], int]:
    return lambda frame: round(frame * rate)


def _without(clip: Clip, camera: int) -> dict[int, list[Array]]:
    """Frame -> points (K, 3) m of the persons as the cameras but one see them."""
    seen: dict[int, list[Array]] = {}
    for frame in clip.some_frames():
        for person in clip.persons:
            chosen = person.views.get(frame)
            if chosen is None:
                continue
            figures = [clip.figures[frame][i] for c, i in enumerate(chosen) if i >= 0 and c != camera]
            points = points_of_figures(figures, clip.views, clip.figure_settings, person.points.get(frame))
            if np.isfinite(points).all(axis=1).sum() >= clip.figure_settings.min_points:
                seen.setdefault(frame, []).append(points)
    return seen


def _gap_m(
    clip: Clip,
    camera: int,
    seen: Mapping[int, Sequence[Array]],
    shown_at: Callable[[int], int],
    *,
    is_mirrored: bool = False,
) -> float:
    """Median over frames of the distance of a camera's nearest figure from a person, m; inf where few frames tell.

    shown_at : frame of the others -> frame of this camera.
    """
    gaps = []
    for frame, persons in seen.items():
        figures = clip.of_camera(shown_at(frame), camera)
        if is_mirrored:
            figures = [replace(f, uv=f.uv[MIRRORED], confidence=f.confidence[MIRRORED]) for f in figures]
        distances = [
            np.nanmedian(clip.views.distance_m(p, f)) for p in persons for f in figures if _shares(p, f)
        ]
        if distances:
            gaps.append(min(distances))
    return float(np.median(gaps)) if len(gaps) >= min(clip.settings.least_frames, len(seen)) else float("inf")


def _shares(points: Array, figure: View2D) -> bool:
    return int((np.isfinite(points).all(axis=1) & np.isfinite(figure.uv).all(axis=1)).sum()) >= 3


# --- persons -------------------------------------------------------------------------------------------------


def _mirrored(clip: Clip) -> list[FigureFault]:
    """Left and right exchanged everywhere: chests look away from the faces above them, and toes and knees point
    backwards."""
    signs = []
    for person in clip.persons:
        for points in person.points.values():
            across = points[_ROW["left_hip"]] - points[_ROW["right_hip"]]
            across = across + points[_ROW["left_shoulder"]] - points[_ROW["right_shoulder"]]
            ahead = np.cross(across, [0.0, 0.0, 1.0])
            votes = [float(np.sign(ahead @ way)) for way in _forwards(points, clip.settings.bent_m)]
            signs += [float(np.sign(sum(votes)))] if np.isfinite(ahead).all() and votes else []
    if len(signs) < clip.settings.least_frames or np.mean(np.array(signs) < 0) < clip.settings.backward_share:
        return []
    return [
        FigureFault(
            "left and right seem exchanged in the keypoints of all cameras: faces, toes and knees point backwards",
            "exchange the names, or check that the calibration is not mirrored",
            is_mirrored=True,
        )
    ]


def _forwards(points: Array, bent_m: float) -> list[Array]:
    """Which way face, feet and bent knees of a person (K, 3) m point, those that are known."""
    at = {name: points[k] for name, k in _ROW.items()}
    ways = [at["nose"] - 0.5 * (at["left_ear"] + at["right_ear"])]
    for side in ("left", "right"):
        ways.append(at[f"{side}_toe"] - at[f"{side}_heel"])
        hip, knee, ankle = (at[f"{side}_{name}"] for name in ("hip", "knee", "ankle"))
        leg = ankle - hip
        bend = (knee - hip) - ((knee - hip) @ leg) / max(float(leg @ leg), 1e-9) * leg
        if np.linalg.norm(bend) > bent_m:
            ways.append(bend)
    return [way for way in ways if np.isfinite(way).all()]


def _pictures_of_one_camera(clip: Clip) -> list[FigureFault]:
    """Figures that are no person's, of one camera, that are there all the time and never move."""
    found = []
    frames = clip.some_frames()
    for camera, name in enumerate(clip.names):
        taken = {(f, int(p.views[f][camera])) for p in clip.persons for f in p.views}
        free = [
            [g for i, g in enumerate(clip.figures[f]) if g.camera == camera and (f, i) not in taken]
            for f in frames
        ]
        still_px = clip.settings.still_focal * float(clip.views.focal[camera])
        for first in next((own for own in free if own), []):
            n = sum(any(_apart_px(first, other) < still_px for other in own) for own in free)
            if n >= max(clip.settings.least_frames, clip.settings.agreed_share * len(frames)):
                u, v = np.nanmean(first.uv, axis=0)
                found.append(
                    FigureFault(
                        f"camera {name} shows somebody at pixel ({u:.0f}, {v:.0f}) who never moves and whom no other "
                        "camera shows: a picture of a person perhaps, which is not followed",
                        "cover the picture, or take its figures out of the file",
                        camera,
                    )
                )
    return found


def _apart_px(a: View2D, b: View2D) -> float:
    """Median distance of the keypoints of two figures, px; inf where they share few."""
    apart = np.linalg.norm(a.uv - b.uv, axis=1)
    known = apart[np.isfinite(apart)]
    return float(np.median(known)) if len(known) >= FigureSettings.min_points else float("inf")


def _pictures(clip: Clip) -> list[FigureFault]:
    """Persons that are flat and never move."""
    found = []
    for person in clip.persons:
        points = np.array([person.points[f] for f in person.frames])
        known = np.isfinite(points).all(axis=2).mean(axis=0) > 0.5
        if known.sum() < 8:
            continue
        middle = np.full(points.shape[1:], np.nan)
        middle[known] = np.nanmedian(points[:, known], axis=0)
        moved = float(np.nanmedian(np.linalg.norm(points[:, known] - middle[known], axis=2)))
        off = np.linalg.svd(middle[known] - middle[known].mean(axis=0), compute_uv=False)[2] / np.sqrt(
            known.sum()
        )
        if moved < clip.settings.still_m and off < clip.settings.flat_m:
            x, y, z = middle[known].mean(axis=0)
            found.append(
                FigureFault(
                    f"somebody at ({x:.1f}, {y:.1f}, {z:.1f}) m never moves and is flat ({1000 * off:.0f} mm): a "
                    "picture of a person, which is not followed",
                    "cover the picture, or take its figures out of the files",
                    person=person.number,
                )
            )
    return found
