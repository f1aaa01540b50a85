"""What tells an empty clip of another place from one of the recording: likeness, what differs, and what has gone.

    python -m eval.empty_clips [SESSION ...]    # sessions with background/; realistic ones and two scenes when absent

The clip of every camera is held against its recording as it is, exchanged for that of the next camera, seen through
lenses of 3 to 8 % more focal length, and with somebody in it: what the recording shows a third after its beginning.
Writes eval/results/empty_clips.csv. Ten seconds a session.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from eval.occlusion import prepared
from eval.pose_sessions import DEV, ROOT
from eval.whole import write_csv
from mocap.data import Camera
from mocap.foreground import Background, fit_background, learn_background
from mocap.io.session import Session, open_session
from mocap.io.session.reading import pictures_of
from mocap.io.video import iter_camera
from mocap.pipeline.empty_clips import frames_to_fit

RESULTS = ROOT / "eval" / "results" / "empty_clips.csv"
SESSIONS = ("walk", "reach", "cross", "room", "furnished", "steps")
SCENES = ("gesture", "walk")
ZOOMS = (1.03, 1.05, 1.08)

Image = NDArray[np.uint8]


def zoomed(picture: NDArray[np.float32], factor: float) -> NDArray[np.float32]:
    """The picture through a lens of so many times the focal length."""
    height, width = picture.shape[:2]
    matrix = cv2.getRotationMatrix2D((width / 2, height / 2), 0.0, factor)
    return np.asarray(cv2.warpAffine(picture, matrix, (width, height), borderMode=cv2.BORDER_REPLICATE))


def clips_of(session: Session) -> Iterator[tuple[str, str, Background, list[Image]]]:
    """Camera, what was done to its clip, the clip's background, and pictures of the recording to hold it against."""
    own = {c.name: learn_background(iter_camera(session.background_sources[c.name], c)) for c in session.rig}
    for c, camera in enumerate(session.rig):
        name, following = camera.name, session.rig.names[(c + 1) % len(session.rig)]
        pictures = _pictures(session, camera, frames_to_fit(len(session.frames), session.fps))
        yield name, "as it is", own[name], pictures
        if own[following].mean.shape == own[name].mean.shape:
            yield name, "of another camera", own[following], pictures
        for factor in ZOOMS:
            mean = zoomed(own[name].mean, factor)
            yield name, f"zoomed by {factor - 1:.0%}", replace(own[name], mean=mean), pictures
        third = len(session.frames) // 3
        somebody = _pictures(session, camera, slice(third, third + 15))
        yield name, "somebody in it", learn_background(somebody), pictures


def _pictures(session: Session, camera: Camera, which: slice) -> list[Image]:
    with pictures_of(session, session.frames[which], cameras=(camera.name,)) as reader:
        return [picture for _, (picture,) in reader]


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m eval.empty_clips",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("sessions", nargs="*", type=Path, help="session folders with background/")
    parser.add_argument("--work", type=Path, default=Path("out/no_empty_clip"), help="for the scenes")
    options = parser.parse_args(argv)
    roots = options.sessions or [DEV / name for name in SESSIONS if (DEV / name).exists()]
    if not options.sessions:
        roots += [prepared(name, options.work, with_furniture=True) for name in SCENES]
    rows = []
    for root in roots:
        for camera, clip, background, pictures in clips_of(open_session(root)):
            fit = fit_background(background, pictures)
            rows.append(
                {
                    "session": root.name,
                    "camera": camera,
                    "clip": clip,
                    "likeness": round(fit.likeness, 3),
                    "differing_share": round(fit.differing_share, 5),
                    "is_elsewhere": int(fit.is_elsewhere),
                    "gone_share": round(float(fit.gone.mean()), 5),
                }
            )
    write_csv(RESULTS, list(rows[0]), rows)
    for clip in dict.fromkeys(row["clip"] for row in rows):
        own = [row for row in rows if row["clip"] == clip]
        alike, differing = (np.array([float(row[k]) for row in own]) for k in ("likeness", "differing_share"))
        print(
            f"{clip}: likeness {alike.min():.2f} to {alike.max():.2f}, differing {differing.min():.4f} to "
            f"{differing.max():.4f}, called elsewhere {sum(int(row['is_elsewhere']) for row in own)}, "
            f"something gone {sum(float(row['gone_share']) > 0 for row in own)} of {len(own)}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
