"""Make the contact sheet of the polygon world.

python -m docs.make_polygon_picture    # docs/pictures/polygons.png, half a minute
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.filters import FILTERS, FilterBudget, filter_settings, initial_particles
from mocap.polygons.likelihood import random_walk_std
from mocap.synth.polygons import (
    SMALL,
    PolygonScene,
    PolygonSceneSettings,
    draw_outline,
    make_polygon_scene,
)

OUT = Path(__file__).with_name("pictures") / "polygons.png"
TILE = (260, 208)
FRAMES = (0, 60, 120)
LARGE = PolygonSceneSettings(n_arms=4, n_levels=4)
ROWS = (
    ("4 arms, K=7: 25 parts, 27 numbers", replace(LARGE, n_levels=7)),
    ("9 arms, K=3: 19 parts, 21 numbers", replace(LARGE, n_arms=9, n_levels=3)),
    ("3 objects, 4 arms, K=3: 27 parts, 33 numbers", replace(LARGE, n_levels=3, n_objects=3)),
    ("7 arms, K=5, 40 polygons of clutter", replace(SMALL, n_arms=7, n_levels=5, n_clutter=40)),
)


def tile(picture: NDArray[np.uint8], text: str) -> NDArray[np.uint8]:
    """A picture, smaller and with a caption."""
    small = cv2.resize(picture, TILE, interpolation=cv2.INTER_AREA)
    cv2.putText(small, text, (6, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.36, (255, 255, 255), 1, cv2.LINE_AA)
    return small


def tracked(scene: PolygonScene, frame: int) -> NDArray[np.uint8]:
    """The last picture with the estimate of SBPS, 300 particles, in white."""
    std = random_walk_std(scene.tree.layout)
    settings = filter_settings(FilterBudget("sbps", n_particles=300, n_layers=1), scene.tree.layout, std)
    rng = np.random.default_rng(0)
    state = initial_particles(scene.problem(0), scene.states[0], 300)
    estimate = scene.states[0]
    for t in range(1, frame + 1):
        state, info = FILTERS["sbps"].step(scene.problem(t), state, settings, rng=rng)
        estimate = info.estimate
    return draw_outline(scene.frame(frame), scene.tree, estimate, (255, 255, 255))


def main() -> None:
    """Write the sheet."""
    rows = []
    for text, settings in ROWS:
        scene = make_polygon_scene(settings, rng=np.random.default_rng(1))
        tiles = [tile(scene.frame(t), f"frame {t}") for t in FRAMES]
        tiles[0] = tile(scene.frame(FRAMES[0]), text)
        tiles.append(tile(tracked(scene, FRAMES[-1]), f"frame {FRAMES[-1]}, SBPS in white"))
        rows.append(np.hstack(tiles))
    # Fewer levels keep the file small.
    sheet = np.vstack(rows) // 16 * 17
    cv2.imwrite(str(OUT), sheet[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
