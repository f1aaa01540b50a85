"""A session folder laid out from a sorted heap of clips: links to what lies there, and a session.toml."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from mocap.errors import MocapError
from mocap.io._files import atomic_text, writing
from mocap.io.calibration import read_calibration
from mocap.io.session.heap import HeapClip, SortedHeap
from mocap.io.session.settings import read_session_settings
from mocap.io.video import SAME_RATE

_FOLDERS = {"recording": ("videos", "images"), "background": ("background",) * 2, "board": ("board",) * 2}
_FOLDERS |= {"masks": ("masks",) * 2}


@dataclass(frozen=True)
class Placed:
    """A clip of the heap in the session.

    camera : its name there.  source : in the heap.  target : in the session; None = it lies there already.
    """

    camera: str
    role: str
    source: Path
    target: Path | None


@dataclass(frozen=True)
class Layout:
    """root : of the session.  placed : clips.  calibration : file and its place in the session.  text : of
    session.toml.  notes : what was renamed."""

    root: Path
    placed: tuple[Placed, ...]
    calibration: tuple[Path, Path] | None
    text: str
    notes: tuple[str, ...]


def plan_layout(heap: SortedHeap, out: Path | None = None) -> Layout:
    """What `write_layout` would do.

    out : folder of the session; None = where the clips are, when they lie in videos/ or images/ as in a session, else
    `session` in the heap.
    Raises MocapError for a session.toml that is there, a folder that is not empty, and a calibration that is none.
    """
    is_in_place = out is None and _is_session(heap)
    root = heap.root if is_in_place else out if out is not None else heap.root / "session"
    if (root / "session.toml").exists():
        raise MocapError(
            "there is a session.toml already",
            path=root,
            remedy="go on with `mocap check`, or choose another -o",
        )
    if not is_in_place:
        check_is_new(root)
    names, notes = _names(heap)
    placed = []
    for role, clips in _by_role(heap).items():
        for name, clip in clips.items():
            folder = _FOLDERS[role][int(clip.path.is_dir() or clip.info.header_frames is None)]
            ending = "" if clip.path.is_dir() else clip.path.suffix.lower()
            target = None if is_in_place else root / folder / f"{names[name]}{ending}"
            if target is None or not clip.later:
                placed.append(Placed(names[name], role, clip.path, target))
                continue
            for chapter in (clip.path, *clip.later):
                own = target.with_suffix("") / f"{chapter.stem}{chapter.suffix.lower()}"
                placed.append(Placed(names[name], role, chapter, own))
    calibration = None
    if heap.calibration is not None and not is_in_place:
        calibration = heap.calibration, root / heap.calibration.name
    return Layout(root, tuple(placed), calibration, _text(heap, names), tuple(notes))


def check_is_new(root: Path) -> None:
    """MocapError unless a folder is empty or not there."""
    if root.exists() and (not root.is_dir() or any(root.iterdir())):
        raise MocapError("the folder is not empty", path=root, remedy="choose another folder with -o")


def write_layout(layout: Layout, *, copies: bool = False) -> None:
    """Make the folder with links to the clips (copies : with copies), and session.toml.

    Raises MocapError where that cannot be written.
    """
    pairs = [(placed.source, placed.target) for placed in layout.placed if placed.target is not None]
    if layout.calibration is not None:
        pairs.append(layout.calibration)
    for source, target in pairs:
        with writing(target):
            target.parent.mkdir(parents=True, exist_ok=True)
            if not copies:
                target.symlink_to(os.path.relpath(source.resolve(), target.parent.resolve()))
            elif source.is_dir():
                shutil.copytree(source, target)
            else:
                shutil.copy2(source, target)
    atomic_text(layout.root / "session.toml", layout.text)
    read_session_settings(layout.root / "session.toml")


def _by_role(heap: SortedHeap) -> dict[str, dict[str, HeapClip]]:
    return {
        "recording": heap.recording,
        "background": heap.background,
        "board": heap.board,
        "masks": heap.masks,
    }


def _is_session(heap: SortedHeap) -> bool:
    """Whether the recording lies as a session has it."""
    if any(clip.later for clip in heap.recording.values()):
        return False  # chapters lie in a folder of their own
    places = {clip.path.parent for clip in heap.recording.values()}
    return bool(places) and places <= {heap.root / "videos", heap.root / "images"}


def _names(heap: SortedHeap) -> tuple[dict[str, str], list[str]]:
    """Names of the cameras in the session: those of the calibration where they are alike, and what to say of it."""
    if heap.calibration is None:
        return {name: name for name in heap.recording}, []
    known = read_calibration(heap.calibration, check_world=False).rig.names
    plain = {_bare(name): name for name in known}
    names, notes = {}, []
    for name in heap.recording:
        own = name if name in known else plain.get(_bare(name), name)
        names[name] = own
        if own != name:
            notes.append(f"{name} is called {own}, as in {heap.calibration.name}")
    if strangers := [name for name in names.values() if name not in known]:
        notes.append(
            f"{heap.calibration.name} does not know {', '.join(strangers)}; it has {', '.join(known)}. Say in "
            "session.toml under [camera_map] which is which"
        )
    return names, notes


def _bare(name: str) -> str:
    """A name without what people write differently: cam_01, Cam1 and camera-1 are one."""
    text = re.sub(r"[^a-z0-9]", "", name.lower()).replace("camera", "cam")
    return re.sub(r"0*(\d+)", r"\1", text)


def _text(heap: SortedHeap, names: Mapping[str, str]) -> str:
    """session.toml, with what was found as comments."""
    lines = ["# Written by `mocap init`. All keys may be missing; what begins with # is only said.", ""]
    for name, clip in heap.recording.items():
        info = clip.info
        rate = f"{info.fps:.3f} frames/s" if info.fps else "no frame rate"
        lines.append(
            f"# {names[name]}: {_shown(clip.path, heap.root)}{_and_later(clip)}, {info.size[0]} x {info.size[1]} px, "
            f"{info.n_frames} frames, {rate}"
        )
    lines.append("")
    rates = {round(clip.info.fps, 3) for clip in heap.recording.values() if clip.info.fps}
    if not rates:
        lines.append("# Pictures have no frame rate. 30 is taken unless you say it here:")
        lines.append("# fps = 30.0")
    elif max(rates) > (1 + SAME_RATE) * min(rates):
        lines.append(
            "# The clips have different rates; each frame is shown by the pictures taken nearest to it."
        )
    else:
        lines.append(f"# fps = {max(rates):g}   # as the videos say; write it to overrule them")
    if len({clip.info.n_frames for clip in heap.recording.values()}) > 1:
        lines.append(
            "# The clips differ in length: `mocap sync` finds when each began, and writes [offset_s] here."
        )
    lines += ["", "# person_height_m = 1.75   # of the person; otherwise it is read from the volume"]
    if heap.calibration is None:
        lines.append(
            "# There is no calibration yet: put calibration.toml beside this file (`mocap calibrate`)."
        )
    lines += [f"# {note}" for note in heap.notes]
    return "\n".join(lines) + "\n"


def _and_later(clip: HeapClip) -> str:
    return f" and {len(clip.later)} more chapter{'s' * (len(clip.later) != 1)}" if clip.later else ""


def _shown(path: Path, root: Path) -> str:
    return str(path.relative_to(root)) if path.is_relative_to(root) else path.name
