"""A heap of clips, sorted: which camera filmed which of them, and whether it shows people, the empty scene or a board.

Names tell most of it; the pictures tell the rest. Nothing is moved, copied or asked.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from mocap.errors import MocapError
from mocap.io._files import IMAGE_SUFFIXES, VIDEO_SUFFIXES, natural_key
from mocap.io.calibration import calibration_candidates
from mocap.io.checkerboard import COMMON_BOARDS, find_board
from mocap.io.fiducials import TAGS, fiducials_in
from mocap.io.video import ClipInfo, clip_info, iter_clip
from mocap.progress import Progress, no_progress

Grey = NDArray[np.uint8]
Role = Literal["recording", "background", "board", "masks"]

_DEEPEST = 4  # folders below the heap
_MOST_CLIPS = 500  # more is an archive, not a recording
# Words of names, English and of common tools.
_WORDS: dict[Role, frozenset[str]] = {
    "background": frozenset(
        {"background", "backgrounds", "bg", "empty", "static", "nobody", "noone", "scene"}
    ),
    "board": frozenset(
        {
            "board",
            "checker",
            "checkerboard",
            "chessboard",
            "charuco",
            "aprilgrid",
            "apriltag",
            "calib",
            "calibration",
        }
        | {"intrinsic", "intrinsics", "extrinsic", "extrinsics"}
    ),
    "masks": frozenset({"mask", "masks", "silhouette", "silhouettes", "matte", "mattes", "segmentation"}),
    "recording": frozenset(
        {"recording", "recordings", "videos", "video", "images", "frames", "footage", "raw"}
    ),
}
_CAMERA = re.compile(r"(?i)^(cam(era)?|kamera|view|gopro|phone|iphone|pixel|port|c|dev|device)[ _-]?\d+$")
_CAMERA_INSIDE = re.compile(
    r"(?i)(?<![a-z])(cam(?:era)?|kamera|view|gopro|i?phone|port|dev(?:ice)?|c)[ _-]?\d+"
)
# GH010123, GH020123 of today's GoPros; GOPR0123, GP010123 of old ones.
_CHAPTER = re.compile(
    r"^(?:G[HXL](?P<chapter>\d\d)(?P<number>\d{4})|GP(?P<old_chapter>\d\d)(?P<old>\d{4})|GOPR(?P<first>\d{4}))$",
    re.IGNORECASE,
)
# Of the pictures, that are looked at; a clip is read to the last of them.
_LOOKED_AT, _WITHIN = 8, 240
_SMALL = (48, 36)  # px: of a picture that is compared with others
_MOVES = 12.0  # of 255: a pixel that changes by more between looks does not belong to an empty scene
_MOVES_SHARE = 0.004  # of the picture: somebody small
_BOARD_LOOKS = 3  # pictures that are searched for a board
_ALIKE = 0.9  # correlation of the small pictures of one camera, from one clip to another
_CLEARLY = 0.05  # by which the best is better than the next


@dataclass(frozen=True, eq=False)
class HeapClip:
    """A clip of the heap.

    name : of its camera.  take : what else its name says.  role : what it shows.  why : how that is known.
    info : what was counted and measured.  look : a small grey picture of what stands still.  later : chapters that
    follow the first, `path`.
    """

    path: Path
    name: str
    take: str
    role: Role
    why: str
    info: ClipInfo
    look: NDArray[np.float32]
    later: tuple[Path, ...] = ()


@dataclass(frozen=True, eq=False)
class SortedHeap:
    """What is in a heap.

    recording, background, board, masks : clips by camera.  take : that was chosen.  other_takes : the rest.
    calibration : the file, if there is just one.  notes : what was found out beside.  missing : what a run needs yet.
    """

    root: Path
    recording: dict[str, HeapClip]
    background: dict[str, HeapClip]
    board: dict[str, HeapClip]
    masks: dict[str, HeapClip]
    take: str
    other_takes: tuple[str, ...]
    calibration: Path | None
    notes: tuple[str, ...]
    missing: tuple[str, ...]


def sort_heap(
    root: Path, *, take: str | None = None, without: Path | None = None, progress: Progress = no_progress
) -> SortedHeap:
    """Find the clips below a folder, and what each of them is.

    take : which of several takes; None = the one that most cameras filmed, of those the longest.  without : folder
    that is not looked into.
    Raises MocapError for a folder without clips, and a take that there is not.
    """
    if not root.is_dir():
        raise MocapError("no such folder", path=root, remedy="give the folder that your clips lie in")
    notes: list[str] = []
    paths = list(_sources(root, root, without, _DEEPEST))
    if len(paths) > _MOST_CLIPS:
        raise MocapError(
            f"{len(paths)} clips are more than one recording",
            path=root,
            remedy="give the folder of one recording",
        )
    later, said = _chapters(paths)
    notes += said
    named = _named([path for path in paths if not any(path in own for own in later.values())], root)
    clips = []
    for k, (path, (name, at, role)) in enumerate(named.items()):
        try:
            clips.append(_with_later(_looked_at(path, name, at, role), later.get(path, ())))
        except MocapError as error:
            notes.append(f"{path.relative_to(root)} is left out: {error.message}")
        progress("clips", k + 1, len(named))
    if not clips:
        raise MocapError(
            "the folder holds no clips" + (f" that can be read: {notes[0]}" if notes else ""),
            path=root,
            remedy=f"give a folder with videos ({' '.join(sorted(VIDEO_SUFFIXES))}) or folders of pictures",
        )
    return _sorted(root, clips, take, notes)


def _sources(folder: Path, root: Path, without: Path | None, depth: int) -> Iterator[Path]:
    """Videos, and folders of pictures, in natural order."""
    if depth < 0 or (without is not None and folder.resolve() == without.resolve()):
        return
    entries = sorted(
        (p for p in folder.iterdir() if not p.name.startswith(".")), key=lambda p: natural_key(p.name)
    )
    pictures = [p for p in entries if p.is_file() and p.suffix.lower() in IMAGE_SUFFIXES]
    if (
        pictures
        and folder != root
        and (len(pictures) > 1 or len(entries) == 1)
        and not _are_cameras(pictures)
    ):
        yield folder
    elif pictures and folder != root and _role_of(folder.name) == "background":
        yield from pictures
    for path in entries:
        if path.is_dir():
            yield from _sources(path, root, without, depth - 1)
        elif path.suffix.lower() in VIDEO_SUFFIXES:
            yield path


def _are_cameras(pictures: Sequence[Path]) -> bool:
    """Whether pictures are named as cameras, one of each, and not as frames."""
    return len(pictures) > 1 and all(_CAMERA.match(p.stem) for p in pictures)


def _role_of(text: str) -> Role | None:
    """What the words of a name say."""
    words = set(re.split(r"[^a-z]+", text.lower()))
    return next((role for role, known in _WORDS.items() if words & known), None)


def _named(paths: Sequence[Path], root: Path) -> dict[Path, tuple[str, str, Role | None]]:
    """Camera, take and role by what clips and their folders are called.

    A folder per camera is told by folders that are no roles and stems that name no camera; else every stem does.
    """
    folders = {path: [p for p in path.relative_to(root).parts[:-1] if _plain(p)] for path in paths}
    by_folder = {path: parts[-1] for path, parts in folders.items() if parts}
    has_folders = len(by_folder) == len(paths) and (
        len(set(by_folder.values())) > 1
        and (
            all(_CAMERA.match(folder) for folder in by_folder.values())
            or not any(_CAMERA_INSIDE.search(_stem(path)) for path in paths)
        )
    )
    found: dict[Path, tuple[str, str, Role | None]] = {}
    for path in paths:
        relative = path.relative_to(root)
        role = _role_of(_stem(path)) or next(
            (own for part in reversed(relative.parts[:-1]) if (own := _role_of(part)) is not None), None
        )
        if has_folders:
            rest = [*folders[path][:-1], _plain(_stem(path))]
            name = by_folder[path]
        else:
            name, take = _split(_plain(_stem(path)) or _stem(path))
            rest = [*folders[path], take]
        found[path] = name, "_".join(filter(None, rest)), role
    return found


def _stem(path: Path) -> str:
    return path.name if path.is_dir() else path.stem


def _plain(text: str) -> str:
    """A name without the words that say what a clip shows."""
    words = [word for word in re.split(r"(?<=[A-Za-z0-9])[ _.-]+", text) if word]
    known = frozenset().union(*_WORDS.values())
    return "_".join(word for word in words if word.lower() not in known)


def _split(stem: str) -> tuple[str, str]:
    """Camera and take of a stem: cam1_walk is walk, filmed by cam1."""
    hit = _CAMERA_INSIDE.search(stem)
    if hit is None:
        return stem, ""
    take = (stem[: hit.start()] + "_" + stem[hit.end() :]).strip(" _.-")
    return hit.group(0), re.sub(r"[ _.-]{2,}", "_", take)


def _looked_at(path: Path, name: str, take: str, role: Role | None) -> HeapClip:
    """The clip with what its pictures say. Raises MocapError for one that cannot be read."""
    info = clip_info(path)
    greys = list(_looks(path, info.n_frames))
    small = np.stack([cv2.resize(g, _SMALL, interpolation=cv2.INTER_AREA) for g in greys]).astype(np.float32)
    still = np.median(small, axis=0)
    if role is not None:
        return HeapClip(path, name, take, role, "by its name", info, still)
    if board := _board_in(greys):
        return HeapClip(path, name, take, "board", f"shows {board}", info, still)
    moving = float((np.abs(small - still).max(axis=0) > _MOVES).mean())
    if len(greys) > 1 and moving < _MOVES_SHARE:
        return HeapClip(path, name, take, "background", "nothing moves in it", info, still)
    return HeapClip(path, name, take, "recording", "something moves in it", info, still)


def _looks(path: Path, n_frames: int) -> Iterator[Grey]:
    """Some pictures of a clip's first seconds, in grey."""
    last = min(n_frames, _WITHIN) - 1
    wanted = set(np.unique(np.linspace(0, last, _LOOKED_AT).round().astype(int)).tolist())
    for frame, picture in enumerate(iter_clip(path)):
        if frame in wanted:
            yield np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
        if frame >= last:
            return


def _board_in(greys: Sequence[Grey]) -> str:
    """What board some of the pictures show, in words; nothing when none."""
    for grey in greys[:: max(1, len(greys) // _BOARD_LOOKS)][:_BOARD_LOOKS]:
        if seen := fiducials_in(grey):
            return "tags" if seen.family == TAGS else "a ChArUco board"
        for size in COMMON_BOARDS:
            if find_board(grey, size) is not None:
                return f"a checkerboard of {size[0]} x {size[1]} inner corners"
    return ""


def _chapters(paths: Sequence[Path]) -> tuple[dict[Path, tuple[Path, ...]], list[str]]:
    """First chapter -> those that follow it, of recordings that a GoPro has cut, and what is to be said of them.

    Only what is numbered without a gap from the first on; other cameras number takes as they number chapters.
    """
    found: dict[tuple[Path, str, str], dict[int, Path]] = {}
    for path in paths:
        if hit := _CHAPTER.match(path.stem):
            number = next(text for text in (hit["number"], hit["old"], hit["first"]) if text)
            kind = "GP" if hit["number"] is None else path.stem[:2].upper()
            chapter = int(hit["chapter"] or hit["old_chapter"] or 0)
            found.setdefault((path.parent, kind, number), {})[chapter] = path
    later, notes = {}, []
    for chapters in found.values():
        numbers = sorted(chapters)
        names = ", ".join(chapters[n].name for n in numbers)
        if (
            len(numbers) > 1
            and numbers == list(range(numbers[0], numbers[0] + len(numbers)))
            and numbers[0] < 2
        ):
            later[chapters[numbers[0]]] = tuple(chapters[n] for n in numbers[1:])
            notes.append(f"{names} are chapters of one recording, and read as one clip")
        elif len(numbers) > 1:
            notes.append(f"{names} are chapters of one recording, of which some are missing")
    return later, notes


def _with_later(clip: HeapClip, later: Sequence[Path]) -> HeapClip:
    """The clip with the chapters that follow it. Raises MocapError for one that cannot be read."""
    n_frames = clip.info.n_frames + sum(clip_info(path).n_frames for path in later)
    return replace(clip, info=replace(clip.info, n_frames=n_frames), later=tuple(later))


def _sorted(root: Path, clips: list[HeapClip], take: str | None, notes: list[str]) -> SortedHeap:
    """One take, with what belongs to it."""
    takes = _takes([clip for clip in clips if clip.role == "recording"])
    if not takes:
        what = ", ".join(f"{clip.path.name} ({clip.why})" for clip in clips[:4])
        raise MocapError(
            f"no clip shows people: {what}", path=root, remedy="add the recording, one clip per camera"
        )
    chosen = _chosen(root, takes, take)
    recording = takes[chosen]
    by_role: dict[str, dict[str, HeapClip]] = {role: {} for role in get_args(Role)}
    for clip in clips:
        if clip.role == "recording":
            continue
        owner = _owner(clip, recording)
        if owner is None:
            notes.append(
                f"{clip.path.relative_to(root)} ({clip.why}) is left out: it fits no camera of the recording"
            )
        elif clip.role == "background" and clip.info.size != recording[owner].info.size:
            notes.append(
                f"{clip.path.relative_to(root)} is left out: its size is not that of {owner}'s recording"
            )
        elif owner in by_role[clip.role]:
            notes.append(f"{clip.path.relative_to(root)} is left out: {owner} has another clip of that kind")
        else:
            by_role[clip.role][owner] = replace(clip, name=owner)
    others = tuple(sorted((t for t in takes if t != chosen), key=natural_key))
    calibrations = _calibrations(root)
    if len(calibrations) > 1:
        notes.append(f"several calibrations: {', '.join(str(p.relative_to(root)) for p in calibrations)}")
    calibration = calibrations[0] if len(calibrations) == 1 else None
    background, board = by_role["background"], by_role["board"]
    missing = _missing(recording, background, board, calibration)
    masks = by_role["masks"] if by_role["masks"].keys() == recording.keys() else {}
    return SortedHeap(
        root, recording, background, board, masks, chosen, others, calibration, tuple(notes), tuple(missing)
    )


def _takes(clips: Sequence[HeapClip]) -> dict[str, dict[str, HeapClip]]:
    """Recordings by take and camera. Cameras that number their clips do not agree on names: then their order counts."""
    by_name: dict[str, dict[str, HeapClip]] = {}
    for clip in clips:
        by_name.setdefault(clip.take, {}).setdefault(clip.name, clip)
    if len({clip.name for clip in clips}) < 2 or max(map(len, by_name.values())) > 1:
        return by_name
    counts: Counter[str] = Counter()
    by_order: dict[str, dict[str, HeapClip]] = {}
    for clip in clips:
        counts[clip.name] += 1
        by_order.setdefault(str(counts[clip.name]), {})[clip.name] = clip
    return by_order if len(by_order) > 1 else {"": by_order["1"]}


def _chosen(root: Path, takes: Mapping[str, Mapping[str, HeapClip]], take: str | None) -> str:
    if take is None:
        return max(
            takes, key=lambda t: (len(takes[t]), sum(clip.info.n_frames for clip in takes[t].values()))
        )
    if take not in takes:
        raise MocapError(
            f"there is no take {take!r}",
            path=root,
            remedy=f"give one of {', '.join(sorted(t or '(without a name)' for t in takes))} as --take",
        )
    return take


def _owner(clip: HeapClip, recording: Mapping[str, HeapClip]) -> str | None:
    """The camera whose clip it is: by name, else by what stands still in its pictures."""
    if clip.name in recording:
        return clip.name
    alike = {
        name: _correlation(clip.look, other.look)
        for name, other in recording.items()
        if other.info.size == clip.info.size
    }
    ranked = sorted(alike.values(), reverse=True)
    if not ranked or ranked[0] < _ALIKE or (len(ranked) > 1 and ranked[0] - ranked[1] < _CLEARLY):
        return None
    return max(alike, key=alike.__getitem__)


def _correlation(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    a, b = a - a.mean(), b - b.mean()
    norm = float(np.linalg.norm(a) * np.linalg.norm(b))
    return float((a * b).sum()) / norm if norm > 0 else 0.0


def _calibrations(root: Path) -> list[Path]:
    """Files with a calibration's name in the heap and the folders right below."""
    folders = [root, *sorted(p for p in root.iterdir() if p.is_dir() and not p.name.startswith("."))]
    found = [path for folder in folders for path in calibration_candidates(folder) if path.is_file()]
    return list(dict.fromkeys(found))


def _missing(
    recording: Mapping[str, HeapClip],
    background: Mapping[str, HeapClip],
    board: Mapping[str, HeapClip],
    calibration: Path | None,
) -> list[str]:
    """What a run needs that the heap has not, in words, with what to do."""
    found = []
    if len(recording) < 4:
        found.append(
            f"cameras: there are {len(recording)}; four or more give usable volumes, two are the least"
        )
    if calibration is None:
        how = (
            "mocap calibrate SESSION/board"
            if len(board) > 1
            else "film a board (mocap board) and mocap calibrate"
        )
        found.append(f"a calibration: {how}, or put the file of another tool into the session")
    if lacking := [name for name in recording if name not in background]:
        found.append(
            f"clips of the empty scene of {', '.join(lacking)}: film one; without it the background is learnt from the "
            "recording"
        )
    return found
