"""What the people in a session say of its calibration, for `mocap check`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mocap.arrays import Array
from mocap.errors import MocapError
from mocap.foreground import Fit
from mocap.io.session import Session
from mocap.io.session.reading import depth_of
from mocap.io.session.record import Finding
from mocap.pipeline.empty_clips import fits_of, words_of_fits
from mocap.pipeline.silhouettes import hulls_of
from mocap.volume.depth_turns import DepthTurn, find_turn
from mocap.volume.rig_doubts import RigDoubt, doubt_rig

# Enough to see somebody in several places; looking at them takes some seconds.
_N_FRAMES, _WITHIN = 40, 600
# Of the tallest person in the room, children included.
_HEIGHTS_M = (0.8, 2.3)
_UNTOLD = (
    "whether people agree with the calibration cannot be told: who stands in clips of the empty scene leaves holes in "
    "their outlines"
)
_UNITS = {"cm": 0.01, "mm": 0.001, "m": 1.0}


def check_people(session: Session) -> list[Finding]:
    """Whether the outlines of people agree with the calibration, and which mistake explains it when they do not."""
    if not session.image_sources and not session.mask_sources:
        return []
    try:
        fits = fits_of(session)
        hulls = hulls_to_check(session, fits)
    except MocapError as error:
        return [Finding("warning", f"people could not be looked at: {error.message}")]
    said = [Finding("warning", words) for words in words_of_fits(fits, session)]
    said += _depth(session, hulls)
    found = doubt_rig(session.rig, hulls)
    if np.isnan(found.apart_m):
        return said
    if found.agrees:
        return [*said, _agreement(found), *_size(found)]
    if not found.mistake and any(fit.gone.any() for fit in fits.values()):
        return [*said, Finding("warning", _UNTOLD)]
    return [*said, _explanation(found)]


def hulls_to_check(session: Session, fits: Mapping[str, Fit]) -> list[list[Array]]:
    """Hulls of the silhouettes that are looked at, per camera and frame.  fits : as of `hulls_of`."""
    return hulls_of(session, _frames_to_check(session), fits)


def _frames_to_check(session: Session) -> range:
    frames = session.stretches[0][:_WITHIN]
    return frames[:: max(1, len(frames) // _N_FRAMES)]


def _depth(session: Session, hulls: Sequence[Sequence[Array]]) -> list[Finding]:
    """Depth maps that do not lie on the pictures of their camera."""
    if not session.depth_sources:
        return []
    try:
        with depth_of(session, _frames_to_check(session)) as reader:
            maps = [own for _, own in reader]
    except MocapError:
        return []  # said already
    out = []
    for name, own in zip(session.depth_sources, zip(*maps, strict=True), strict=True):
        found = find_turn(own, hulls[session.rig.names.index(name)])
        if found is not None and not found.agrees:
            out.append(_of_turn(name, found))
    return out


def _of_turn(camera: str, found: DepthTurn) -> Finding:
    text = f"{100 * found.beside_share:.0f} % of what moves in the depth maps lies beside the silhouettes"
    if found.turn:
        text = f"depth maps are {found.turn}: {text}, {100 * found.explained_share:.0f} % otherwise"
        return Finding("error", text, camera, "write the maps as the pictures are")
    remedy = "check that depth/ is of this camera and clip, frame by frame, and registered onto its pictures"
    return Finding("warning", text, camera, remedy)


def _agreement(found: RigDoubt) -> Finding:
    height = "" if np.isnan(found.height_m) else f", the tallest reaches {found.height_m:.2f} m"
    return Finding(
        "ok",
        f"people agree with the calibration: lines of sight are {1000 * found.apart_m:.0f} mm apart{height}",
    )


def _size(found: RigDoubt) -> list[Finding]:
    """People of impossible height: the calibration is in another unit."""
    low, high = _HEIGHTS_M
    if np.isnan(found.height_m) or low <= found.height_m <= high:
        return []
    fits = [
        f"{a} for {b}"
        for a in _UNITS
        for b in _UNITS
        if a != b and low <= found.height_m * _UNITS[a] / _UNITS[b] <= high
    ]
    return [
        Finding(
            "error",
            f"the people are {found.height_m:.3g} m tall by this calibration"
            + (f": it has {fits[0]}" if fits else ": its scale is wrong, or the floor is not at z = 0"),
            remedy='say the unit of the file in session.toml: calibration_units = "cm", or calibrate with the right '
            "size of the squares",
        )
    ]


def _explanation(found: RigDoubt) -> Finding:
    names = " and ".join(found.cameras)
    apart = f"lines of sight at people miss each other by {1000 * found.apart_m:.0f} mm"
    fits = f", {1000 * found.explained_m:.0f} mm otherwise"
    if found.mistake == "exchanged":
        text = f"{apart}: cameras {names} are exchanged{fits}"
        return Finding("error", text, found.cameras[0], "exchange the clips of the two, or their names")
    if found.mistake == "zoom":
        text = f"{apart}: the pictures fit a focal length {found.factor:.2g} times the calibrated one{fits}"
        return Finding(
            "error",
            text,
            found.cameras[0],
            "zoom, crop or size of the pictures were others when it was calibrated: calibrate it as it films",
        )
    if found.mistake == "mirrored":
        who = "all pictures are" if len(found.cameras) > 1 else "its pictures are"
        text = f"{apart}: {who} mirrored, left for right{fits}"
        return Finding(
            "error",
            text,
            None if len(found.cameras) > 1 else found.cameras[0],
            "film without the mirror setting, or flip",
        )
    if found.mistake == "upside_down":
        text = f"{apart}: its pictures are turned by half a turn{fits}"
        return Finding("error", text, found.cameras[0], "turn the clip, or calibrate as it films")
    return Finding(
        "warning",
        f"{apart}, most at camera {found.worst}: its calibration, its clock or the masks are off",
        found.worst,
        "try `mocap sync`, then `mocap calibrate --refine`",
    )
