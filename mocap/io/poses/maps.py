"""Maps of foreign skeletons to our landmarks: known skeletons, and the small TOML file of `--map`.

Names are compared without case, blanks, underscores and a prefix up to a colon, so that `LeftArm`, `left_arm` and
`mixamorig:LeftArm` are one. Skeletons agree on knees and elbows; they do not agree on neck, head and hips. What cannot
be taken over honestly (a nose is no top of the head) is left out.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mocap.data import ALL_LANDMARKS, FURTHER_LANDMARKS
from mocap.errors import MocapError
from mocap.files import load_toml
from mocap.io.units import AXES, UNITS

_LIMBS = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")


@dataclass(frozen=True)
class KnownSkeleton:
    """Names of our landmarks in a skeleton: `a+b` is the mean of two points, `a|b` the first that is there.

    sides : how left and right are written in `limbs`, whose {s} they replace.  needs : names that no other skeleton
    has; where they are, they decide.
    """

    name: str
    middle: Mapping[str, str]
    limbs: Sequence[str]
    sides: tuple[str, str]
    needs: tuple[str, ...] = ()
    note: str = ""

    def sources(self) -> dict[str, str]:
        """Landmark -> expression."""
        found = dict(self.middle)
        for side, word in zip(("left", "right"), self.sides, strict=True):
            for limb, text in zip(_LIMBS, self.limbs, strict=True):
                if text:
                    found[f"{side}_{limb}"] = text.replace("{s}", word)
        return found


_PLAIN = tuple(f"{{s}}{limb}" for limb in _LIMBS)
SKELETONS: tuple[KnownSkeleton, ...] = (
    KnownSkeleton(
        "mocap BVH",
        {
            "pelvis": "lefthip+righthip",
            "neck": "neck",
            "head": "neckend",
            "left_toe": "leftankleend",
            "left_hand_tip": "leftwristend",
            "right_toe": "rightankleend",
            "right_hand_tip": "rightwristend",
        },
        ("{s}shoulder", "{s}elbow", "{s}elbowend|{s}wrist", "{s}hip", "{s}knee", "{s}kneeend|{s}ankle"),
        ("left", "right"),
        needs=("waist", "neckend"),
    ),
    KnownSkeleton(
        "SMPL",
        {"pelvis": "lefthip+righthip|lhip+rhip", "neck": "neck"},
        tuple(f"{{s}}{limb}" for limb in _LIMBS),
        ("left", "right"),
        needs=("leftcollar",),
        note="its head joint is the base of the skull, so that head is left out",
    ),
    KnownSkeleton(
        "SMPL",
        {"pelvis": "lhip+rhip", "neck": "neck"},
        _PLAIN,
        ("l", "r"),
        needs=("lcollar",),
        note="its head joint is the base of the skull, so that head is left out",
    ),
    KnownSkeleton(
        "CMU BVH, Mixamo",
        {
            "pelvis": "leftupleg+rightupleg",
            "neck": "neck",
            "head": "headtopend|headend|headnub|headendend",
        },
        ("{s}arm", "{s}forearm", "{s}hand", "{s}upleg", "{s}leg", "{s}foot"),
        ("left", "right"),
        needs=("leftforearm",),
        note="its spine joints end at Neck; head is the end of the head bone",
    ),
    KnownSkeleton(
        "OptiTrack",
        {"pelvis": "lthigh+rthigh", "neck": "neck", "head": "headend"},
        ("{s}uarm", "{s}farm", "{s}hand", "{s}thigh", "{s}shin", "{s}foot"),
        ("l", "r"),
        needs=("lfarm",),
    ),
    KnownSkeleton(
        "Poser, Daz",
        {"pelvis": "lthigh+rthigh", "neck": "neck", "head": "headend"},
        ("{s}shldr", "{s}forearm", "{s}hand", "{s}thigh", "{s}shin", "{s}foot"),
        ("l", "r"),
        needs=("lshldr",),
    ),
    KnownSkeleton(
        "Character Creator",
        {"pelvis": "ccbaselthigh+ccbaserthigh", "neck": "ccbasenecktwist01"},
        tuple(f"ccbase{{s}}{bone}" for bone in ("upperarm", "forearm", "hand", "thigh", "calf", "foot")),
        ("l", "r"),
        needs=("ccbaselforearm",),
        note="its head joint is the base of the skull, so that head is left out",
    ),
    KnownSkeleton(
        "Unreal",
        {"pelvis": "thighl+thighr", "neck": "neck01"},
        tuple(f"{bone}{{s}}" for bone in ("upperarm", "lowerarm", "hand", "thigh", "calf", "foot")),
        ("l", "r"),
        needs=("lowerarml",),
        note="its head joint is the base of the skull, so that head is left out",
    ),
    KnownSkeleton(
        "Plug-in Gait joint centres",
        {"pelvis": "lhjc+rhjc", "neck": "c7+clav", "head": "lfhd+rfhd+lbhd+rbhd"},
        ("{s}sjc", "{s}ejc", "{s}wjc", "{s}hjc", "{s}kjc", "{s}ajc"),
        ("l", "r"),
        needs=("lhjc",),
    ),
    KnownSkeleton(
        "Plug-in Gait markers",
        {
            "pelvis": "lasi+rasi+lpsi+rpsi|lasi+rasi+sacr",
            "neck": "c7+clav",
            "head": "lfhd+rfhd+lbhd+rbhd",
        },
        ("{s}sho", "{s}elb", "{s}wra+{s}wrb", "", "{s}kne", "{s}ank"),
        ("l", "r"),
        needs=("lasi",),
        note="markers on the skin, not joint centres: look at the errors after the offsets; hips are left out",
    ),
    KnownSkeleton(
        "mocap",
        {name: name.replace("_", "") for name in ("pelvis", "neck", "head", *FURTHER_LANDMARKS)},
        tuple(f"{{s}}{limb}" for limb in _LIMBS),
        ("left", "right"),
    ),
    KnownSkeleton(
        "COCO, MediaPipe",
        {"pelvis": "lefthip+righthip", "neck": "neck|leftshoulder+rightshoulder", "head": "headtop"},
        tuple(f"{{s}}{limb}" for limb in _LIMBS),
        ("left", "right"),
        note="neck is the middle of the shoulders unless the file names one",
    ),
    KnownSkeleton(
        "OpenPose, Pose2Sim, Panoptic",
        {"pelvis": "lhip+rhip", "neck": "neck|lshoulder+rshoulder", "head": "headtop|head"},
        _PLAIN,
        ("l", "r"),
    ),
)
_MIN_LANDMARKS = 4


@dataclass(frozen=True)
class SideMap:
    """What a user says about one side: landmark -> names whose mean it is; None or empty = find out."""

    landmarks: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    unit: str | None = None
    up: str | None = None
    fps: float | None = None


def skeletons_known() -> tuple[str, ...]:
    """Names of the skeletons that are found by their names, each once."""
    return tuple(dict.fromkeys(s.name for s in SKELETONS))


def plain(name: str) -> str:
    """A name as it is compared."""
    return re.sub(r"[^a-z0-9]", "", name.rpartition(":")[2].lower().removeprefix("mixamorig"))


def automatic(names: Sequence[str]) -> tuple[KnownSkeleton, dict[str, tuple[str, ...]]] | None:
    """The known skeleton that these names are of, and landmark -> names; None when none has enough of them."""
    at = {plain(n): n for n in reversed(names)}
    best: tuple[KnownSkeleton, dict[str, tuple[str, ...]]] | None = None
    for skeleton in SKELETONS:
        found = _found_in(skeleton, at)
        if len(found) < _MIN_LANDMARKS:
            continue
        if skeleton.needs and all(word in at for word in skeleton.needs):
            return skeleton, found
        if not skeleton.needs and (best is None or len(found) > len(best[1])):
            best = (skeleton, found)
    return best


def _found_in(skeleton: KnownSkeleton, at: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """Landmark -> names of a file, in the order of ALL_LANDMARKS.  at : plain name -> name in the file."""
    found = {}
    for landmark, text in skeleton.sources().items():
        for choice in text.split("|"):
            parts = choice.split("+")
            if all(part in at for part in parts):
                found[landmark] = tuple(at[part] for part in parts)
                break
    return {name: found[name] for name in ALL_LANDMARKS if name in found}


def read_map(path: Path | str) -> dict[str, SideMap]:
    """Read a `--map` file: tables [estimate] and [truth], either may be missing.

        [truth]
        unit = "mm"          # m, cm or mm
        up = "y"             # x, -x, y, -y, z or -z
        fps = 120.0
        [truth.landmarks]
        pelvis = ["LASI", "RASI", "LPSI", "RPSI"]   # their mean
        head = "HeadTop"

    Landmarks that are not listed are not scored. Raises MocapError with the dotted name of what is wrong.
    """
    path = Path(path)
    content = load_toml(path, "the map", remedy="correct the map; docs/metrics.md shows one")
    if unknown := sorted(set(content) - {"estimate", "truth"}):
        raise _bad(path, f"{unknown[0]} is not known; the tables are [estimate] and [truth]")
    return {side: _side(path, side, content.get(side, {})) for side in ("estimate", "truth")}


def _side(path: Path, side: str, table: Any) -> SideMap:
    if not isinstance(table, dict):
        raise _bad(path, f"{side} must be a table")
    if unknown := sorted(set(table) - {"landmarks", "unit", "up", "fps"}):
        raise _bad(path, f"{side}.{unknown[0]} is not known; known are landmarks, unit, up, fps")
    fps = table.get("fps", 1.0)
    for key, words in (("unit", UNITS), ("up", AXES)):
        if table.get(key) is not None and table[key] not in words:
            raise _bad(path, f"{side}.{key} is {table[key]!r}, expected one of {', '.join(words)}")
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not fps > 0:
        raise _bad(path, f"{side}.fps is {fps!r}, expected a positive number")
    named = _named_landmarks(path, side, table.get("landmarks", {}))
    return SideMap(named, table.get("unit"), table.get("up"), float(fps) if "fps" in table else None)


def _named_landmarks(path: Path, side: str, landmarks: Any) -> dict[str, tuple[str, ...]]:
    if not isinstance(landmarks, dict):
        raise _bad(path, f"{side}.landmarks must be a table")
    named = {}
    for landmark, names in landmarks.items():
        if landmark not in ALL_LANDMARKS:
            known = ", ".join(ALL_LANDMARKS)
            raise _bad(path, f"{side}.landmarks.{landmark} is not a landmark; known are {known}")
        listed = [names] if isinstance(names, str) else names
        if not isinstance(listed, list) or not listed or not all(isinstance(n, str) for n in listed):
            raise _bad(path, f"{side}.landmarks.{landmark} must be a name or a list of names")
        named[landmark] = tuple(listed)
    return named


def _bad(path: Path, message: str) -> MocapError:
    return MocapError(message, path=path, remedy="correct the map; docs/metrics.md shows one")
