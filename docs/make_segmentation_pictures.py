"""Make docs/pictures/segmentation.png and second_look.png from two synthetic sessions.

mocap synth --scene demo -o out/demo/session
mocap synth --scene dark_trousers -o out/dark_trousers
python -m docs.make_segmentation_pictures [--session out/demo/session] [--look out/dark_trousers]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.foreground import Segmenter, learn_background
from mocap.io.session import Session, open_session
from mocap.io.video import FrameReader, iter_clip
from mocap.pipeline.stages.segment import second_look
from mocap.view import contact_sheet, crop, draw_mask

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

FRAME, CAMERA = 38, 3
LOOK_FRAME, LOOK_CAMERA = 1, 2
SHADOW_COLOUR = (86, 180, 233)
MAX_BYTES = 190_000


def segmented(session: Session, frame: int) -> tuple[list[Image], list[Image], list[Mask], list[Mask]]:
    """Pictures, backgrounds, masks and shadows of all cameras at the frame."""
    segmenters = [
        Segmenter(learn_background(iter_clip(session.background_sources[c.name]))) for c in session.rig
    ]
    with FrameReader(session.image_sources, session.rig, range(frame + 1)) as reader:
        for _, images in reader:
            found = [s.segment(image) for s, image in zip(segmenters, images, strict=True)]
    backgrounds = [s.background for s in segmenters]
    return list(images), backgrounds, [f.mask for f in found], [f.shadow for f in found]


def write(path: Path, panels: list[tuple[str, Image]]) -> None:
    """A row of pictures with labels, fewer colours until it is small enough."""
    sheet = contact_sheet(
        [image for _, image in panels], [label for label, _ in panels], len(panels), 330 * len(panels)
    )
    for level in (1, 4, 8, 16):
        ok, data = cv2.imencode(
            ".png", (sheet // level * level)[:, :, ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9]
        )
        if ok and len(data) <= MAX_BYTES:
            break
    path.write_bytes(data.tobytes())


def coloured(image: Image, mask: Mask, shadow: Mask) -> Image:
    """The picture with its mask in magenta and the shadow in blue."""
    both = draw_mask(image, mask)
    both[shadow] = (0.5 * both[shadow] + 0.5 * np.array(SHADOW_COLOUR)).astype(np.uint8)
    return both


def write_window(path: Path, panels: list[tuple[str, Image]], around: Mask) -> None:
    """The part of the pictures about some pixels."""
    ys, xs = np.nonzero(around)
    window = (int(xs.min()) - 12, int(ys.min()) - 12, int(xs.max()) + 12, int(ys.max()) + 12)
    scale = 300 / (window[3] - window[1])
    write(path, [(label, crop(picture, window, scale=scale)) for label, picture in panels])


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--session", type=Path, default=Path("out/demo/session"))
    parser.add_argument("--look", type=Path, default=Path("out/dark_trousers"))
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("pictures"))
    options = parser.parse_args(argv)
    images, backgrounds, masks, shadows = segmented(open_session(options.session), FRAME)
    image, mask, shadow = images[CAMERA], masks[CAMERA], shadows[CAMERA]
    black_and_white = np.repeat(mask[:, :, None], 3, axis=2).astype(np.uint8) * np.uint8(255)
    panels = [
        ("picture", image),
        ("background", backgrounds[CAMERA]),
        ("mask and shadow", coloured(image, mask, shadow)),
        ("mask", black_and_white),
    ]
    write_window(options.out / "segmentation.png", panels, mask | shadow)
    session = open_session(options.look)
    images, _, masks, shadows = segmented(session, LOOK_FRAME)
    look = second_look(session)
    assert look is not None
    image, mask, shadow = images[LOOK_CAMERA], masks[LOOK_CAMERA], shadows[LOOK_CAMERA]
    again = look.masks(masks, shadows)[LOOK_CAMERA]
    panels = [
        ("picture", image),
        ("one camera alone", coloured(image, mask, shadow)),
        ("after the second look", coloured(image, again, shadow & ~again)),
    ]
    write_window(options.out / "second_look.png", panels, again | shadow)
    return 0


if __name__ == "__main__":
    sys.exit(main())
