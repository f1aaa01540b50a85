"""Where cameras saw the board: clips are searched frame by frame, and what was missing is counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.calibrate.board import Board
from mocap.calibrate.detect import Sighting, Why, find_corners
from mocap.calibrate.filmed import as_filmed
from mocap.errors import MocapError
from mocap.io._files import IMAGE_SUFFIXES, VIDEO_SUFFIXES
from mocap.io.checkerboard import COMMON_BOARDS, find_board
from mocap.io.session.sources import sources_in
from mocap.io.video import clip_info, iter_clip
from mocap.progress import Progress, no_progress

Size = tuple[int, int]

# Pictures of a camera that are tried with other common boards, when nobody saw the given one.
_TRIED_PICTURES = 3


@dataclass(frozen=True, eq=False)
class BoardViews:
    """Where a board was seen.

    picture_size : camera -> (width, height) px.  seen : frame -> camera -> what was seen.  missed : camera -> reason
    -> frames.  n_frames : of the shortest clip.
    """

    board: Board
    picture_size: dict[str, Size]
    seen: dict[int, dict[str, Sighting]]
    n_frames: int
    missed: dict[str, Counter[Why]] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        return list(self.picture_size)

    def of_camera(self, name: str) -> list[Sighting]:
        """All sightings of one camera."""
        return [seen[name] for seen in self.seen.values() if name in seen]

    def n_views(self) -> dict[str, int]:
        """Frames in which each camera saw the board."""
        return {name: len(self.of_camera(name)) for name in self.names}

    def only_mirrored(self) -> list[str]:
        """Cameras that saw nothing but mirror images of the board."""
        return [n for n in self.names if (seen := self.of_camera(n)) and all(s.is_mirrored for s in seen)]

    def why_missed(self, name: str) -> str:
        """Words for the frames without a board: `31 not in view, 4 blurred`."""
        return ", ".join(f"{n} {why}" for why, n in self.missed.get(name, Counter()).most_common())


def find_clips(folder: Path, *, at_least: int = 2) -> dict[str, Path]:
    """Camera -> clip of a folder: videos or picture folders in it, or in its videos/ or images/.

    Raises MocapError when there are fewer than `at_least`.
    """
    kinds = VIDEO_SUFFIXES | IMAGE_SUFFIXES
    for place in (folder / "videos", folder / "images", folder):
        found = sources_in(place, kinds) if place.is_dir() else {}
        if len(found) >= at_least:
            return found
    how_many = "two or more cameras" if at_least == 2 else "any camera"
    raise MocapError(
        f"no clips of {how_many} were found",
        path=folder,
        remedy="put one video (or folder of pictures) per camera there, named as the cameras",
    )


def find_board_views(
    clips: Mapping[str, Path],
    board: Board,
    *,
    floor_frame: int | None = None,
    n_frames: int = 60,
    progress: Progress = no_progress,
) -> BoardViews:
    """Look for the board in frames spread evenly over synchronised clips, and in the floor frame.

    Raises MocapError for a floor frame that is not in the clips.
    """
    infos = {name: clip_info(path, camera=name) for name, path in clips.items()}
    n = min(info.n_frames for info in infos.values())
    if floor_frame is not None and not 0 <= floor_frame < n:
        raise MocapError(
            f"the floor frame {floor_frame} is not in the clips, which have frames 0 to {n - 1}",
            remedy="give a frame in which the board lies on the floor as --floor-frame",
        )
    spread = np.linspace(0, n - 1, min(n, n_frames)).round().astype(int).tolist()
    wanted = sorted({*spread, *([] if floor_frame is None else [floor_frame])})
    sizes = {name: info.size for name, info in infos.items()}
    seen: dict[int, dict[str, Sighting]] = {f: {} for f in wanted}
    missed: dict[str, Counter[Why]] = {name: Counter() for name in clips}
    # Until somebody has seen how a ChArUco board is printed, every picture is asked.
    is_known = board.kind != "charuco"
    total, done = len(wanted) * len(clips), 0
    for name, path in clips.items():
        for frame, grey in _pictures(path, name, wanted):
            if not is_known and (filmed := as_filmed(board, grey)) is not None:
                board, is_known = filmed, True
            found = find_corners(board, grey)
            if isinstance(found, Sighting):
                seen[frame][name] = found
            else:
                missed[name][found] += 1
            done += 1
            progress("board", done, total)
    return BoardViews(board, sizes, seen, n, missed)


def board_in_place_of(views: BoardViews, clips: Mapping[str, Path]) -> tuple[int, int] | None:
    """Inner corners (columns, rows) of a common checkerboard that the clips show, when nobody saw the given board."""
    if any(views.seen.values()):
        return None
    wanted = np.unique(np.linspace(0, views.n_frames - 1, _TRIED_PICTURES).round().astype(int)).tolist()
    pictures = [grey for name, path in clips.items() for _, grey in _pictures(path, name, wanted)]
    return next(
        (size for size in COMMON_BOARDS if any(find_board(grey, size) is not None for grey in pictures)), None
    )


def _pictures(path: Path, camera: str, wanted: Sequence[int]) -> Iterator[tuple[int, NDArray[np.uint8]]]:
    """The wanted frames (ascending) of a clip in grey; nothing behind the last of them is decoded."""
    for frame, image in enumerate(iter_clip(path, camera=camera)):
        if frame in wanted:
            yield frame, cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        if frame >= wanted[-1]:
            return
