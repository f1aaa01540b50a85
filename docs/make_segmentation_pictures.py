"""Make docs/pictures/segmentation.png from the synthetic demo session.

mocap synth --scene demo -o out/demo/session
python -m docs.make_segmentation_pictures [--session out/demo/session]
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
from mocap.view import contact_sheet, crop, draw_mask

Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

FRAME, CAMERA = 38, 3
SHADOW_COLOUR = (86, 180, 233)
MAX_BYTES = 190_000


def segmented(session: Session) -> tuple[list[Image], list[Image], list[Mask], list[Mask]]:
    """Pictures, backgrounds, masks and shadows of all cameras at the frame."""
    segmenters = [
        Segmenter(learn_background(iter_clip(session.background_sources[c.name]))) for c in session.rig
    ]
    with FrameReader(session.image_sources, session.rig, range(FRAME + 1)) as reader:
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


def main(argv: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--session", type=Path, default=Path("out/demo/session"))
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("pictures"))
    options = parser.parse_args(argv)
    session = open_session(options.session)
    images, backgrounds, masks, shadows = segmented(session)
    image, mask = images[CAMERA], masks[CAMERA]
    ys, xs = np.nonzero(mask | shadows[CAMERA])
    window = (int(xs.min()) - 12, int(ys.min()) - 12, int(xs.max()) + 12, int(ys.max()) + 12)

    def part(picture: Image) -> Image:
        return crop(picture, window, scale=300 / (window[3] - window[1]))

    both = draw_mask(image, mask)
    both[shadows[CAMERA]] = (0.5 * both[shadows[CAMERA]] + 0.5 * np.array(SHADOW_COLOUR)).astype(np.uint8)
    black_and_white = np.repeat(mask[:, :, None], 3, axis=2).astype(np.uint8) * np.uint8(255)
    panels = [
        ("picture", image),
        ("background", backgrounds[CAMERA]),
        ("mask and shadow", both),
        ("mask", black_and_white),
    ]
    write(options.out / "segmentation.png", [(label, part(picture)) for label, picture in panels])
    return 0


if __name__ == "__main__":
    sys.exit(main())
