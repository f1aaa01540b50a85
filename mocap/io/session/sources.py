"""Sources of a session: which file holds the pictures, masks, detections and keypoints of which calibrated camera."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from mocap.data import CameraRig
from mocap.errors import MocapError
from mocap.io._files import IMAGE_SUFFIXES, VIDEO_SUFFIXES, natural_key
from mocap.io.session.settings import SessionSettings, bad_key
from mocap.io.video import list_chapters

_BESIDE_PICTURES = ("masks", "background", "detections", "keypoints", "depth", "roi")
# What Pose2Sim adds to a camera's name for the folder of its keypoints, and in its calibration.
_POSE2SIM = "_json"
_POSE2SIM_LENS = ("int_", "_img")
# DeepLabCut puts its network behind the name of a video.
_NETWORK = "DLC_"
# Keypoints as tools keep them for themselves.
_UNREAD = frozenset({".h5", ".hdf5", ".slp", ".npy", ".npz", ".pickle", ".pkl"})


@dataclass(frozen=True)
class Sources:
    """Files of a session by calibrated camera, each in the order of the calibration.

    pictures : videos, and picture folders of cameras without a video.
    """

    pictures: dict[str, Path]
    masks: dict[str, Path]
    background: dict[str, Path]
    detections: dict[str, Path]
    keypoints: dict[str, Path]
    depth: dict[str, Path]
    roi: dict[str, Path]


def sources_in(
    folder: Path, kinds: frozenset[str], *, with_folders: bool = True, with_chapters: bool = False
) -> dict[str, Path]:
    """Sources of a folder by name without suffix: files of the given suffixes and folders that hold pictures.

    with_folders : False = no folders, but with_chapters those that hold videos.
    Of several kinds under one name a video comes before a folder, and a folder before a single picture.
    Raises MocapError when two videos have one name.
    """
    if not folder.is_dir():
        return {}
    found: dict[str, tuple[int, Path]] = {}
    for path in sorted(folder.iterdir(), key=lambda p: natural_key(p.name)):
        counts = with_folders or (with_chapters and bool(list_chapters(path)))
        named = None if path.name.startswith(".") else _name_and_rank(path, kinds, counts)
        if named is None:
            continue
        name, rank = named
        if name in found and found[name][0] == rank:
            raise MocapError(
                f"two sources for one camera: {found[name][1].name} and {path.name}",
                path=folder,
                camera=name,
                remedy="keep one of them",
            )
        if name not in found or rank < found[name][0]:
            found[name] = (rank, path)
    return {name: path for name, (_, path) in found.items()}


def _name_and_rank(path: Path, kinds: frozenset[str], with_folders: bool) -> tuple[str, int] | None:
    """The name that a source gives to its camera, and its rank (low comes first); None for what is no source."""
    if path.is_dir():
        return (path.name, 1) if with_folders else None
    suffix = path.suffix.lower()
    if suffix not in kinds:
        return None
    return path.stem, 2 if suffix in IMAGE_SUFFIXES else 0


def keypoint_sources_in(root: Path, *, has_pictures: bool) -> dict[str, Path]:
    """Keypoints by camera name: files and folders of keypoints/, or else the folders CAM_json of Pose2Sim's pose/.

    has_pictures : without any, those of pose-sync/ come first, which Pose2Sim has put on one clock.
    """
    found = sources_in(root / "keypoints", frozenset({".csv", ".json"}))
    if not found and not has_pictures:
        found = _of_pose2sim(root / "pose-sync")
    found = found or _of_pose2sim(root / "pose")
    return {name.removesuffix(_POSE2SIM): path for name, path in found.items()}


def _of_pose2sim(folder: Path) -> dict[str, Path]:
    return {n: p for n, p in sources_in(folder, frozenset()).items() if n.endswith(_POSE2SIM)}


def _unread_keypoints(root: Path) -> str | None:
    """What stands in keypoints/ in place of tables, as tools keep it for themselves; None = nothing of the kind."""
    folder = root / "keypoints"
    files = sorted(p.name for p in folder.iterdir() if p.suffix.lower() in _UNREAD) if folder.is_dir() else []
    if not files:
        return None
    return (
        f"keypoints/ holds {listed(files, 3)}, of which none is read: export CSV (DeepLabCut: "
        "analyze_videos_converth5_to_csv, SLEAP: the analysis CSV)"
    )


def match_sources(
    root: Path, settings: SessionSettings, rig: CameraRig, calibration: Path
) -> tuple[Sources, list[str]]:
    """Sources by calibrated camera name, and what is to be warned of.

    Raises MocapError for a name that the calibration does not know: that is an error, not a camera less.
    """
    kinds: dict[str, dict[str, Path]] = {
        "videos": sources_in(root / "videos", VIDEO_SUFFIXES, with_folders=False, with_chapters=True),
        "images": sources_in(root / "images", IMAGE_SUFFIXES),
        "background": sources_in(root / "background", VIDEO_SUFFIXES | IMAGE_SUFFIXES),
        "masks": sources_in(root / "masks", VIDEO_SUFFIXES | IMAGE_SUFFIXES | {".npz"}),
        "detections": sources_in(root / "detections", frozenset({".csv"}), with_folders=False),
        "depth": sources_in(root / "depth", frozenset()),
        "roi": sources_in(root / "roi", IMAGE_SUFFIXES, with_folders=False),
    }
    has_pictures = bool(kinds["videos"] or kinds["images"] or kinds["masks"])
    kinds["keypoints"] = keypoint_sources_in(root, has_pictures=has_pictures)
    camera_map = settings.camera_map or {}
    _check_camera_map(root, camera_map, rig, kinds)
    matched = {
        kind: _by_camera(root, kind, sources, camera_map, rig, calibration) for kind, sources in kinds.items()
    }
    both = sorted(matched["videos"].keys() & matched["images"].keys(), key=natural_key)
    warnings = [f"videos/ and images/ both have camera {listed(both)}: the videos are used"] if both else []
    unread = _unread_keypoints(root)
    if unread is not None and not kinds["keypoints"]:
        warnings.append(unread)
    if any(p.parent.name == "pose" for p in kinds["keypoints"].values()) and _of_pose2sim(root / "pose-sync"):
        warnings.append(
            "pose-sync/ is not read: its frames are not those of the pictures. pose/ is read; `mocap sync` puts "
            "pictures and keypoints on one clock"
        )
    pictures = {**matched["images"], **matched["videos"]}
    kept = {kind: matched[kind] for kind in _BESIDE_PICTURES}
    return Sources(pictures, **kept), warnings


def _check_camera_map(
    root: Path, camera_map: Mapping[str, str], rig: CameraRig, kinds: Mapping[str, Mapping[str, Path]]
) -> None:
    file_names = {name for sources in kinds.values() for name in sources}
    for file_name, camera in camera_map.items():
        what = None
        if camera not in rig.names:
            what = f"names camera {camera!r}, but the calibration has {listed(rig.names)}"
        elif file_name not in file_names:
            what = f"is no file of the session, which has {listed(sorted(file_names, key=natural_key))}"
        if what is not None:
            raise bad_key(root / "session.toml", f"camera_map.{file_name}", what)


def _by_camera(
    root: Path,
    kind: str,
    sources: Mapping[str, Path],
    camera_map: Mapping[str, str],
    rig: CameraRig,
    calibration: Path,
) -> dict[str, Path]:
    """The sources of one kind by calibrated camera."""
    named: dict[str, Path] = {}
    called: dict[str, str] = {}
    for name, path in sources.items():
        camera = camera_map[name] if name in camera_map else _meant(name, rig.names)
        called[camera] = name
        if camera in named:
            raise bad_key(
                root / "session.toml", "camera_map", f"gives camera {camera!r} two sources in {kind}/"
            )
        named[camera] = path
    if strangers := [n for n in named if n not in rig.names]:
        raise MocapError(
            f"{kind}/ has {listed(strangers)}, which the calibration does not know: {kind}/ holds "
            f"{listed(list(sources))}; {calibration.name} has {listed(rig.names)}",
            path=named[strangers[0]],
            camera=strangers[0],
            remedy="give files and calibrated cameras the same names, or say which is which in "
            f'session.toml: [camera_map] "{called[strangers[0]]}" = "CAMERA NAME"',
        )
    return {n: named[n] for n in rig.names if n in named}


def _meant(name: str, calibrated: Sequence[str]) -> str:
    """The calibrated camera that a source is of: of its name, or of the one whose name tools have added to."""
    if name in calibrated:
        return name
    before, after = _POSE2SIM_LENS
    plain = name.split(_NETWORK)[0] or name
    fit = [c for c in calibrated if c in (plain, f"{before}{plain}{after}")]
    return fit[0] if len(fit) == 1 else name


def wanted_cameras(root: Path, rig: CameraRig, cameras: tuple[str, ...] | None) -> CameraRig:
    """The cameras that session.toml asks for, in the order of the calibration; all when it does not say."""
    if cameras is None:
        return rig
    if strangers := [n for n in cameras if n not in rig.names]:
        raise bad_key(
            root / "session.toml",
            "cameras",
            f"names {listed(strangers)}, but the calibration has {listed(rig.names)}",
        )
    return rig.subset([n for n in rig.names if n in cameras])


def cameras_with_sources(root: Path, rig: CameraRig, sources: Sources) -> CameraRig:
    """The rig, when every camera of it has pictures or masks (or detections or keypoints, where nobody has either).

    Raises MocapError when there are no pictures, fewer than two cameras have any, or one of them has none.
    """
    names = set(rig.names)
    main = names & {*sources.pictures, *sources.masks} or names & {*sources.detections, *sources.keypoints}
    present = [n for n in rig.names if n in main]
    absent = [n for n in rig.names if n not in main]
    if not present:
        raise _no_pictures(root, rig, sources)
    if len(present) < 2:
        lacking = f" (nothing for {listed(absent)})" if absent else ""
        raise MocapError(
            f"only camera {present[0]} has pictures; at least two cameras are needed{lacking}",
            path=root,
            camera=[*absent, *present][0],
            remedy="add the videos of the other cameras, named as in the calibration",
        )
    if absent:
        points = "detections" if main & {*sources.detections} else "keypoints"
        has_pictures = bool(main & {*sources.pictures, *sources.masks})
        raise _without_source(root, present, absent, "video, pictures or masks" if has_pictures else points)
    return rig.subset(present)


def _no_pictures(root: Path, rig: CameraRig, sources: Sources) -> MocapError:
    has_strange = bool(sources.pictures or sources.masks or sources.detections or sources.keypoints)
    if (unread := _unread_keypoints(root)) is not None and not has_strange:
        what, _, remedy = unread.partition(": ")
        return MocapError(what, path=root / "keypoints", remedy=remedy)
    return MocapError(
        "the session has no pictures and no masks"
        + (f" of camera {listed(rig.names)}" if has_strange else ""),
        path=root,
        remedy="put videos/CAM.mp4 or images/CAM/*.png there (or masks/CAM/*.png), CAM as named in the "
        "calibration; or keypoints of another tool, keypoints/CAM.csv (docs/keypoints.md)",
    )


def _without_source(root: Path, present: list[str], absent: list[str], what: str) -> MocapError:
    kept = ", ".join(f'"{n}"' for n in present)
    verbs = ("is", "has") if len(absent) == 1 else ("are", "have")
    return MocapError(
        f"camera {listed(absent)} {verbs[0]} calibrated but {verbs[1]} no {what}",
        path=root,
        camera=absent[0],
        remedy="add what is missing, named as in the calibration, or leave the camera out in session.toml: "
        f"cameras = [{kept}]",
    )


def images_and_masks(
    root: Path, rig: CameraRig, sources: Sources
) -> tuple[dict[str, Path], dict[str, Path], list[str]]:
    """Image and mask sources that each cover the rig or are empty, and what is to be warned of.

    Raises MocapError when some cameras have only pictures and others only masks.
    """
    images, no_image = _covered(rig, sources.pictures)
    masks, no_mask = _covered(rig, sources.masks)
    if images and masks and no_image and no_mask:
        raise MocapError(
            f"camera {listed(no_image)} has masks but no pictures, camera {listed(no_mask)} pictures but no masks",
            path=root,
            camera=no_image[0],
            remedy="give pictures for all cameras, or masks for all cameras",
        )
    warnings = []
    if masks and no_mask:
        warnings.append(
            f"masks/ lacks camera {listed(no_mask)}: the masks are ignored, the pictures are used"
        )
        masks = {}
    if images and no_image:
        warnings.append(f"no pictures of camera {listed(no_image)}: only the masks are used")
        images = {}
    return images, masks, warnings


def _covered(rig: CameraRig, sources: Mapping[str, Path]) -> tuple[dict[str, Path], list[str]]:
    """The sources of the cameras of a rig, and the cameras without one."""
    return {n: sources[n] for n in rig.names if n in sources}, [n for n in rig.names if n not in sources]


def listed(names: Iterable[str], limit: int = 10) -> str:
    """Names for a message, at most `limit` of them."""
    shown = list(names)
    more = f" and {len(shown) - limit} more" if len(shown) > limit else ""
    return (", ".join(str(n) for n in shown[:limit]) or "nothing") + more
