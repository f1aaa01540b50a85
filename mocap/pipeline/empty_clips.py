"""Clips of the empty scene, held against the recording, and what is said of those that are not of it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from mocap.arrays import Image
from mocap.data import Camera
from mocap.errors import MocapError
from mocap.foreground import LEAST_PICTURES, Fit, fit_background, is_black, learn_background, unfitted
from mocap.io.session import Session
from mocap.io.session.reading import pictures_of
from mocap.io.video import iter_camera
from mocap.threads import in_parallel

REMEDY = "record an empty scene as background/CAMERA.mp4"
# A clip is held against so many pictures, from so many seconds in which people step aside.
_PICTURES, _WITHIN_S = 8, 8.0
# So many cameras show somebody: he stands in the room, and is not one thing that was carried out.
_LEAST_HOLDING = 4
_SHIFT_WORTH_A_WORD_PX = 1.0


def fits_of(session: Session, n_threads: int = 1) -> dict[str, Fit]:
    """The fits of all cameras that have a clip of the empty scene, by name; none where masks are taken over.

    Raises MocapError as `fit_of_clip` does.
    """
    named = () if session.mask_sources else session.background_sources
    cameras = [camera for camera in session.rig if camera.name in named]
    found = in_parallel(lambda camera: fit_of_clip(camera, session), cameras, n_threads)
    return {camera.name: fit for camera, fit in zip(cameras, found, strict=True)}


def fit_of_clip(camera: Camera, session: Session) -> Fit:
    """The background of a camera's empty clip, fitted to the first seconds of the recording where that can be read.

    Raises MocapError for a camera without a clip, and one that cannot be read.
    """
    if camera.name not in session.background_sources:
        raise MocapError(
            "there is no clip of the empty scene",
            camera=camera.name,
            path=session.root / "background",
            remedy="record one, or set segmentation.background to recording, median or first",
        )
    pictures: list[Image] = []
    if camera.name in session.image_sources:
        frames = session.frames[frames_to_fit(len(session.frames), session.fps)]
        with pictures_of(session, frames, cameras=(camera.name,)) as reader:
            pictures = [picture for _, (picture,) in reader]
    return fitted(session.background_sources[camera.name], camera, pictures)


def frames_to_fit(n_frames: int, fps: float) -> slice:
    """Which of the frames of a recording an empty clip is held against; none of a recording that is too short."""
    n = min(n_frames, round(_WITHIN_S * fps))
    return slice(0, n if n >= _PICTURES else 0, max(1, n // _PICTURES))


def fitted(clip: Path, camera: Camera, pictures: Sequence[Image]) -> Fit:
    """The background of an empty clip, fitted to the pictures of the recording that show something, if there are any.

    Raises MocapError for a clip that cannot be read.
    """
    background = learn_background(iter_camera(clip, camera))
    lit = [picture for picture in pictures if not is_black(picture)]
    return fit_background(background, lit) if len(lit) >= LEAST_PICTURES else unfitted(background)


def unlike_recording(fits: Mapping[str, Fit]) -> list[str]:
    """Cameras whose clip tells less of the empty scene than the recording does: of another place; and where at least
    half of the cameras, four or more, show somebody who is not in the recording, those. Who stands before so many is
    likely to be the one who is recorded, and his place then is no background either where both times he covers it.
    """
    holding = [name for name, fit in fits.items() if fit.gone.any()]
    if len(holding) < max(_LEAST_HOLDING, len(fits) / 2):
        holding = []
    return [name for name, fit in fits.items() if fit.is_elsewhere or name in holding]


def words_of_fits(fits: Mapping[str, Fit], session: Session, replaced: Collection[str] = ()) -> list[str]:
    """What is said of empty clips that are not of this recording.

    fits : by camera.  replaced : cameras whose background is learnt from the recording instead.
    """
    said = []
    for name, fit in fits.items():
        clip = session.background_sources[name]
        clip = clip.relative_to(session.root) if clip.is_relative_to(session.root) else clip
        if fit.is_elsewhere:
            instead = "; its background is learnt from the recording instead" if name in replaced else ""
            said.append(
                f"camera {name}: {clip} shows another place than its recording, or the same through another lens"
                f"{instead}. Remedy: {REMEDY} with this camera as it stands, or take the file away"
            )
        if max(map(abs, fit.shift_px)) >= _SHIFT_WORTH_A_WORD_PX:
            right, down = fit.shift_px
            said.append(
                f"camera {name}: {clip} was shifted by ({right:.1f}, {down:.1f}) px, which is where the recording has "
                "the room. Remedy: if the camera was pushed after it was calibrated, calibrate it again"
            )
    if holding := {name: fit.gone.mean() for name, fit in fits.items() if fit.gone.any()}:
        shares = ", ".join(f"{name} {share:.1%}" for name, share in holding.items())
        is_replaced = set(holding) <= set(replaced)
        where = "the background of these cameras" if is_replaced else "there the background"
        said.append(
            f"in clips of the empty scene stands what is not in the recording, somebody or a thing ({shares} of the "
            f"picture); {where} is that of the recording. Remedy: {REMEDY}, with nobody in it"
        )
    return said
