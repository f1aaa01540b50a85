"""Calibration files of other tools and our own: found in a session, and read into a rig in metres with z up.

Every conversion that a reader makes is reported in `CalibrationFile.notes`, every doubt in `CalibrationFile.warnings`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from mocap.errors import MocapError
from mocap.files import load_json
from mocap.io.calibration.anipose import read_toml
from mocap.io.calibration.easymocap import read_easymocap
from mocap.io.calibration.frame import in_our_frame
from mocap.io.calibration.laboratory import joined, read_biocv, read_humaneva, read_qualisys, read_vicon
from mocap.io.calibration.opencap import opencap_files, read_opencap
from mocap.io.calibration.opencv import read_opencv, read_opencv_folder
from mocap.io.calibration.panoptic import read_panoptic
from mocap.io.calibration.public_sets import is_totalcapture, read_skeletool, read_totalcapture
from mocap.io.calibration.reconstruction import is_colmap, is_opensfm, read_colmap, read_opensfm
from mocap.io.calibration.record import CalibrationFile, RawRig
from mocap.io.units import AXES, METRES_PER_UNIT

_STORAGE_SUFFIXES = {".yml", ".yaml", ".xml"}
_PICKLE_SUFFIXES = {".pickle", ".pkl"}
_QUALISYS = ".qca.txt"
_COLMAP_STEMS = {"cameras", "images"}


def _read_cal(path: Path) -> RawRig:
    return read_totalcapture(path) if is_totalcapture(path) else read_humaneva(path)


_READERS: dict[str, Callable[[Path], RawRig]] = {
    ".cal": _read_cal,
    ".calib": read_biocv,
    ".calibration": read_skeletool,
    ".xcp": read_vicon,
}


def read_calibration(
    path: Path | str, *, units: str | None = None, up: str | None = None, check_world: bool = True
) -> CalibrationFile:
    """Read a calibration of any supported format into metres, z up.

    path : anipose, Pose2Sim, FreeMoCap or Caliscope TOML; EasyMocap intri.yml or extri.yml (or their folder);
    OpenCV FileStorage YAML, XML or JSON with camera_matrix, distortion and extrinsics, one camera per file (a
    folder of them makes a rig) or one map per camera; CMU Panoptic JSON; OpenCap's pickles (their folder; the pickle is
    not run); HumanEva .cal and bioCV .calib (one camera per file, a folder makes a rig); TotalCapture .cal;
    MPI-INF-3DHP .calibration; Qualisys .qca.txt; Vicon .xcp; a model of COLMAP (its folder) and reconstruction.json of
    OpenSfM.
    units : "m", "cm" or "mm" of the translations; overrides what the file says.
    up : axis of the file that points up, "z", "-y", ...; None = what the file or its format says, else z.
    check_world : False accepts a world whose floor is not at z = 0 (a file that is only to be converted).
    Raises MocapError (path, camera, remedy) for an unreadable file, zero cameras, doubled names, numbers that
    are not finite, a singular matrix, a mirrored rotation, implausible distances, cameras below the floor.
    """
    path = Path(path)
    if units is not None and units not in METRES_PER_UNIT:
        raise ValueError(f"units must be one of m, cm, mm, got {units!r}")
    if up is not None and up not in AXES:
        raise ValueError(f"up must be one of {', '.join(AXES)}, got {up!r}")
    if not path.exists():
        raise MocapError("no such calibration file", path=path, remedy="check the path")
    try:
        raw = _read_folder(path) if path.is_dir() else _read_file(path)
    except OSError as error:
        raise MocapError(
            f"calibration cannot be read: {error.strerror}", path=path, remedy="check the file's permissions"
        ) from error
    return in_our_frame(raw, path, units, up, check_world)


def _read_file(path: Path) -> RawRig:
    suffix = path.suffix.lower()
    if suffix == ".toml":
        return read_toml(path)
    if suffix == ".json":
        return _read_json(path)
    if suffix in _STORAGE_SUFFIXES:
        return read_easymocap(path) if path.stem in {"intri", "extri"} else read_opencv(path)
    if suffix in _PICKLE_SUFFIXES:
        return read_opencap([path])
    if suffix in _READERS:
        return _READERS[suffix](path)
    if path.stem in _COLMAP_STEMS and suffix in {".txt", ".bin"}:
        return read_colmap(path.parent)
    if path.name.lower().endswith(_QUALISYS):
        return read_qualisys(path)
    raise MocapError(
        f"calibration format {suffix or 'without suffix'} is not known",
        path=path,
        remedy="give .toml (anipose, Pose2Sim, FreeMoCap, Caliscope), .yml, .yaml, .xml or .json (OpenCV, "
        "EasyMocap), .json (CMU Panoptic, OpenSfM), .pickle (OpenCap), .cal (HumanEva, TotalCapture), .calib (bioCV), "
        ".calibration (MPI-INF-3DHP), .qca.txt (Qualisys), .xcp (Vicon) or the folder of a COLMAP model",
    )


def _read_json(path: Path) -> RawRig:
    document = load_json(path, "the calibration", remedy="correct the file or calibrate again")
    if is_opensfm(document):
        return read_opensfm(path, document)
    is_panoptic = isinstance(document, dict) and isinstance(document.get("cameras"), list)
    return read_panoptic(path, document) if is_panoptic else read_opencv(path)


def _read_folder(path: Path) -> RawRig:
    for suffix in (".yml", ".yaml"):
        if (path / f"intri{suffix}").is_file() or (path / f"extri{suffix}").is_file():
            return read_easymocap(path / f"intri{suffix}")
    if is_colmap(path):
        return read_colmap(path)
    if pickles := opencap_files(path):
        return read_opencap(pickles)
    for suffix in (".cal", ".calib"):
        if files := sorted(p for p in path.iterdir() if p.suffix.lower() == suffix):
            return joined([_READERS[suffix](file) for file in files])
    files = sorted(p for p in path.iterdir() if p.suffix.lower() in {*_STORAGE_SUFFIXES, ".json"})
    if not files:
        raise MocapError(
            "the folder holds no calibration",
            path=path,
            remedy="give the calibration file itself, or a folder with one OpenCV .yml, HumanEva .cal or bioCV .calib "
            "per camera, of an OpenCap session, or of a COLMAP model",
        )
    return read_opencv_folder(path, files)


def find_calibration(root: Path | str) -> Path:
    """The calibration of a session folder: calibration.toml, else the only file with a name we recognise.

    Raises MocapError when there is none, or several and none is called calibration.toml.
    """
    root = Path(root)
    if (root / "calibration.toml").exists():
        return root / "calibration.toml"
    found = calibration_candidates(root)
    if not found:
        raise MocapError(
            "the session has no calibration",
            path=root,
            remedy="put a calibration.toml there (or intri.yml and extri.yml, Calib_*.toml, "
            "calibration_*.json ...), or name the file with --calibration",
        )
    if len(found) > 1:
        raise MocapError(
            f"the session has several calibrations: {', '.join(p.name for p in found)}",
            path=root,
            remedy="call the right one calibration.toml, or name it with --calibration",
        )
    return found[0]


def calibration_candidates(root: Path) -> list[Path]:
    """All files (and the calibration/ folder) of a session with a calibration's name, sorted by name."""
    folders = [folder for folder in (root, root / "calibration") if folder.is_dir()]
    found = [path for folder in folders for path in sorted(folder.iterdir()) if _has_name(path)]
    if not found and (root / "calibration").is_dir():
        found.append(root / "calibration")
    # Caliscope writes the same rig twice; its own file has more in it.
    if (twin := root / "camera_array_aniposelib.toml") in found and (root / "camera_array.toml") in found:
        found.remove(twin)
    return found


def _has_name(path: Path) -> bool:
    """Whether a file is called as calibrations are."""
    stem, suffix = path.stem.lower(), path.suffix.lower()
    if not path.is_file() or stem.startswith("."):
        return False
    is_toml = suffix == ".toml" and ("calib" in stem or stem.startswith("camera_array"))
    is_storage = suffix in {*_STORAGE_SUFFIXES, ".json"} and "calib" in stem
    is_laboratory = suffix == ".xcp" or path.name.lower().endswith(_QUALISYS)
    return (
        is_toml
        or is_storage
        or is_laboratory
        or path.name in {"extri.yml", "extri.yaml", "reconstruction.json"}
    )
