"""Is a mistake in a calibration recognised from people, and named rightly? `mocap check`'s search on mistakes put in.

    python -m eval.rig_mistakes                    # development scenes
    python -m eval.rig_mistakes --test             # the scenes kept for the final judgement
    python -m eval.rig_mistakes SESSION [...]      # sessions with a right calibration

Of every session: nothing wrong; two cameras exchanged (three pairs); another zoom of one camera (0.7, 0.93, 1.07 and
1.4 times, two cameras each); pictures of one camera, and of all, mirrored; one camera upside down; all turned by
2 degrees about some axis. `named` is what was said, `right` whether that is the mistake and the camera (a zoom within
3 %; of turned cameras: that nothing explains it). Writes eval/results/rig_mistakes_{development,test}.csv (--name:
another name).
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from eval.refine_rig import DEVELOPMENT, TEST, disturbed
from eval.session_tables import Row, names_of, session_of, session_parser, write_table
from mocap.arrays import Array
from mocap.data import Camera, CameraRig
from mocap.io.session import Session, open_session
from mocap.pipeline.empty_clips import fits_of
from mocap.pipeline.people_check import hulls_to_check
from mocap.volume.rig_doubts import RigDoubt, doubt_rig

Hulls = list[list[Array]]
_ZOOMS = (0.7, 0.93, 1.07, 1.4)
_ZOOM_OFF = 0.03


class Trial(NamedTuple):
    """A mistake that is put in: the rig as it would be written, the hulls as they would be seen."""

    mistake: str
    cameras: tuple[str, ...]
    factor: float
    rig: CameraRig
    hulls: Hulls


def flipped(camera: Camera, hulls: list[Array], axes: tuple[int, ...]) -> list[Array]:
    """Hulls (P, 2) px of pictures that are mirrored (axis 0), or stand on their heads (0 and 1)."""
    out = []
    for hull in hulls:
        turned = hull.copy()
        for axis in axes:
            turned[:, axis] = camera.size[axis] - 1 - turned[:, axis]
        out.append(turned)
    return out


def trials(rig: CameraRig, hulls: Hulls, rng: np.random.Generator) -> Iterator[Trial]:
    """The mistakes of one session."""
    n = len(rig)
    yield Trial("none", (), 1.0, rig, hulls)
    for _ in range(3):
        i, j = sorted(rng.choice(n, 2, replace=False).tolist())
        swapped = list(hulls)
        swapped[i], swapped[j] = hulls[j], hulls[i]
        yield Trial("exchanged", (rig.names[i], rig.names[j]), 1.0, rig, swapped)
    for factor in _ZOOMS:
        for c in rng.choice(n, 2, replace=False).tolist():
            K = rig[c].K.copy()
            K[[0, 1], [0, 1]] /= factor  # what was calibrated; the pictures are as they are
            cameras = [replace(camera, K=K) if k == c else camera for k, camera in enumerate(rig)]
            yield Trial("zoom", (rig.names[c],), factor, CameraRig(tuple(cameras)), hulls)
    c = int(rng.integers(n))
    one = [flipped(rig[c], own, (0,)) if k == c else own for k, own in enumerate(hulls)]
    yield Trial("mirrored", (rig.names[c],), 1.0, rig, one)
    every = [flipped(camera, own, (0,)) for camera, own in zip(rig, hulls, strict=True)]
    yield Trial("mirrored", rig.names, 1.0, rig, every)
    heads = [flipped(rig[c], own, (0, 1)) if k == c else own for k, own in enumerate(hulls)]
    yield Trial("upside_down", (rig.names[c],), 1.0, rig, heads)
    yield Trial("turned", rig.names, 1.0, disturbed(rig, 2.0, 0.0, rng), hulls)


def is_right(trial: Trial, found: RigDoubt) -> bool:
    """Whether what was said is what was put in."""
    if trial.mistake == "none":
        return found.agrees
    if trial.mistake == "turned":
        return not found.agrees and found.mistake is None
    is_zoom = trial.mistake != "zoom" or abs(found.factor / trial.factor - 1) < _ZOOM_OFF
    return found.mistake == trial.mistake and set(found.cameras) == set(trial.cameras) and is_zoom


def evaluate(session: Session) -> Iterator[Row]:
    """All mistakes of one session."""
    hulls = hulls_to_check(session, fits_of(session))
    for trial in trials(session.rig, hulls, np.random.default_rng([7, *session.root.name.encode()])):
        found = doubt_rig(trial.rig, trial.hulls)
        named = "agrees" if found.agrees else found.mistake or "unexplained"
        yield {
            "session": session.root.name,
            "mistake": trial.mistake,
            "cameras": "+".join(trial.cameras),
            "factor": trial.factor,
            "apart_mm": round(1000 * found.apart_m, 1),
            "named": named,
            "named_cameras": "+".join(found.cameras),
            "named_factor": round(found.factor, 3),
            "right": int(is_right(trial, found)),
        }


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the table."""
    options = session_parser(__doc__, "out/refine_rig").parse_args(arguments)
    rows: list[Row] = []
    for name in names_of(options, DEVELOPMENT, TEST):
        own = list(evaluate(open_session(session_of(name, options.work))))
        print(
            f"{own[0]['session']}: {sum(int(row['right'] or 0) for row in own)} of {len(own)} right",
            flush=True,
        )
        rows += own
    write_table("rig_mistakes", options, rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
