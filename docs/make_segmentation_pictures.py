"""Make docs/pictures/segmentation.png, second_look.png and contact_shadow.png from synthetic sessions.

mocap synth --scene demo -o out/demo/session
mocap synth --scene dark_trousers -o out/dark_trousers
mocap synth --scene walk -o out/walk
python -m docs.make_segmentation_pictures [--session out/demo/session] [--look out/dark_trousers] [--feet out/walk]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.foreground import ForegroundMask, Segmenter, learn_background
from mocap.io.session import Session, open_session
from mocap.io.video import FrameReader, iter_clip
from mocap.pipeline.stages.segment import second_look
from mocap.view import contact_sheet, crop, draw_mask

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

FRAME, CAMERA = 38, 3
LOOK_FRAME, LOOK_CAMERA = 1, 2
FEET_FRAME, FEET_CAMERA = 10, 0
FEET_PX = 60  # of the picture's height, about the feet
SHADOW_COLOUR = (86, 180, 233)
MAX_BYTES, MAX_LOOK_BYTES = 148_300, 52_000


class Shown(NamedTuple):
    """What the cameras show of a frame, and make of it."""

    images: list[Image]
    backgrounds: list[Image]
    found: list[ForegroundMask]


def segmented(session: Session, frame: int) -> Shown:
    """The frame, after all frames before it."""
    segmenters = [
        Segmenter(learn_background(iter_clip(session.background_sources[c.name]))) for c in session.rig
    ]
    with FrameReader(session.image_sources, session.rig, range(frame + 1)) as reader:
        for _, images in reader:
            found = [s.segment(image) for s, image in zip(segmenters, images, strict=True)]
    return Shown(list(images), [s.background for s in segmenters], found)


def looked_at(session: Session, frame: int, camera: int) -> tuple[list[tuple[str, Image]], Mask, Mask]:
    """Panels of one camera before and after the second look, its mask after it, and what was lost in it."""
    shown, look = segmented(session, frame), second_look(session)
    assert look is not None
    found = shown.found
    masks = look.masks([f.mask for f in found], [f.shadow for f in found], [f.doubtful for f in found])
    image, own, again = shown.images[camera], found[camera], masks[camera]
    gone = own.mask & ~again
    panels = [
        ("picture", image),
        ("one camera alone", coloured(image, own.mask, own.shadow)),
        ("after the second look", coloured(image, again, (own.shadow | gone) & ~again)),
    ]
    return panels, again | own.shadow, again


def write(path: Path, panels: list[tuple[str, Image]], most_bytes: int) -> None:
    """A row of pictures with labels, fewer colours until it is small enough."""
    sheet = contact_sheet(
        [image for _, image in panels], [label for label, _ in panels], len(panels), 330 * len(panels)
    )
    for level in (1, 4, 8, 16, 32):
        ok, data = cv2.imencode(
            ".png", (sheet // level * level)[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9]
        )
        if ok and len(data) <= most_bytes:
            break
    path.write_bytes(data.tobytes())


def coloured(image: Image, mask: Mask, shadow: Mask) -> Image:
    """The picture with its mask in magenta and the shadow in blue."""
    both = draw_mask(image, mask)
    both[shadow] = (0.5 * both[shadow] + 0.5 * np.array(SHADOW_COLOUR)).astype(np.uint8)
    return both


def write_window(
    path: Path, panels: list[tuple[str, Image]], around: Mask, most_bytes: int, height: int = 300
) -> None:
    """The part of the pictures about some pixels, so high."""
    ys, xs = np.nonzero(around)
    window = (int(xs.min()) - 12, int(ys.min()) - 12, int(xs.max()) + 12, int(ys.max()) + 12)
    scale = height / (window[3] - window[1])
    write(path, [(label, crop(picture, window, scale=scale)) for label, picture in panels], most_bytes)


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--session", type=Path, default=Path("out/demo/session"))
    parser.add_argument("--look", type=Path, default=Path("out/dark_trousers"))
    parser.add_argument("--feet", type=Path, default=Path("out/walk"))
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("pictures"))
    options = parser.parse_args(argv)
    shown = segmented(open_session(options.session), FRAME)
    image, found = shown.images[CAMERA], shown.found[CAMERA]
    mask, shadow = found.mask, found.shadow
    black_and_white = np.repeat(mask[:, :, None], 3, axis=2).astype(np.uint8) * np.uint8(255)
    panels = [
        ("picture", image),
        ("background", shown.backgrounds[CAMERA]),
        ("mask and shadow", coloured(image, mask, shadow)),
        ("mask", black_and_white),
    ]
    write_window(options.out / "segmentation.png", panels, mask | shadow, MAX_BYTES)
    panels, around, _ = looked_at(open_session(options.look), LOOK_FRAME, LOOK_CAMERA)
    write_window(options.out / "second_look.png", panels, around, MAX_LOOK_BYTES)
    panels, _, person = looked_at(open_session(options.feet), FEET_FRAME, FEET_CAMERA)
    person[: np.flatnonzero(person.any(axis=1))[-1] - FEET_PX] = False
    write_window(options.out / "contact_shadow.png", panels, person, MAX_LOOK_BYTES, height=220)
    return 0


if __name__ == "__main__":
    sys.exit(main())
