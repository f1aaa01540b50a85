"""Make the pictures of motions and bodies in docs/synthetic.md: five instants of each scene side by side.

    python -m docs.make_motion_pictures             # all, into docs/pictures
    python -m docs.make_motion_pictures jog fall    # some

No session is written: the pictures are rendered from the scenes, without noise.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.data import Camera
from mocap.synth import load_scene
from mocap.synth.render import CameraView
from mocap.synth.world import World, build_world

Image = NDArray[np.uint8]

OUT = Path(__file__).resolve().parent / "pictures"
MAX_BYTES = 45_000  # nine of them; the pages have room for 1.5 MB of pictures
TILE = (152, 200)  # width and height, px
HEIGHT_M = 2.25  # of a tile
FROM_THE_FRONT_DEG = 50.0  # the camera is taken that sees the person most nearly like this
STRIPS: dict[str, tuple[int, ...]] = {  # frames that are shown
    "walk": (10, 16, 22, 28, 34),
    "jog": (50, 54, 58, 62, 66),
    "throw": (5, 26, 36, 44, 56),
    "dance": (10, 40, 65, 95, 130),
    "sit": (5, 30, 45, 75, 130),
    "fall": (30, 50, 60, 70, 130),
    "stroll": (30, 110, 250, 340, 470),
    "loose_clothes": (10, 15, 20, 25, 30),
    "child": (10, 15, 20, 25, 30),
}
SEEN_AT = {"stroll": 470}  # frame for which the camera is chosen, else the third


def facing_camera(world: World, frame: int) -> Camera:
    """The camera that sees the person from the wanted side."""
    actor = world.actors[0]
    pelvis, ahead = actor.position[frame, 0], actor.rotation[frame, 0, :, 0]

    def off(camera: Camera) -> float:
        to = camera.center - pelvis
        angle = np.rad2deg(np.arctan2(to[1], to[0]) - np.arctan2(ahead[1], ahead[0]))
        return abs(abs((angle + 180) % 360 - 180) - FROM_THE_FRONT_DEG)

    return min(world.rig, key=off)


def strip(world: World, camera: Camera, frames: tuple[int, ...]) -> Image:
    """The person of a world at some frames, each cut out at the same scale."""
    view = CameraView(camera, world.room)
    tiles = []
    for frame in frames:
        picture, _ = view.render(world.at(frame), world.things, world.looks)
        pelvis = world.actors[0].position[frame, 0]
        middle = np.array([pelvis[0], pelvis[1], 0.44 * HEIGHT_M])
        uv, depth = camera.project(middle[None])
        scale = float(camera.K[1, 1] * HEIGHT_M / depth[0]) / TILE[1]
        # From tile to picture: the tile's middle is the person's.
        M = np.array([[scale, 0, uv[0, 0] - scale * TILE[0] / 2], [0, scale, uv[0, 1] - scale * TILE[1] / 2]])
        flags = cv2.INTER_AREA | cv2.WARP_INVERSE_MAP if scale > 1 else cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        tile = cv2.warpAffine(picture, M, TILE, flags=flags, borderMode=cv2.BORDER_REPLICATE)
        tiles.append(np.clip(np.rint(tile), 0, 255).astype(np.uint8))
    return np.hstack(tiles)


def write_png(image: Image, path: Path) -> None:
    """A PNG below MAX_BYTES, with fewer colours when it must. Raises ValueError when even 32 are too many."""
    from PIL import Image as Pillow

    full = Pillow.fromarray(image)
    for n_colours in (128, 96, 64, 48, 32):
        full.quantize(n_colours, dither=Pillow.Dither.FLOYDSTEINBERG).save(path, optimize=True)
        if path.stat().st_size < MAX_BYTES:
            return
    raise ValueError(f"{path.name} is larger than {MAX_BYTES} bytes with 32 colours")


def main(argv: list[str] | None = None) -> int:
    """Command line entry."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", help="which, default all")
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args(argv)
    for name in arguments.scenes or STRIPS:
        frames = STRIPS[name]
        world = build_world(load_scene(name))
        path = arguments.out / f"motion_{name}.png"
        write_png(strip(world, facing_camera(world, SEEN_AT.get(name, frames[2])), frames), path)
        print(f"{path.name}: {path.stat().st_size // 1000} kB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
