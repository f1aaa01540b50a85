"""Scenes: what a TOML file may say, and how it becomes a session folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, ValidationError, model_validator

from mocap.errors import MocapError, did_you_mean
from mocap.files import load_toml
from mocap.synth.depth import DepthConfig
from mocap.synth.faults import KINDS as _FAULT_KINDS
from mocap.synth.faults import Fault, find_mistakes
from mocap.synth.furniture import KINDS as _FURNITURE_KINDS
from mocap.synth.furniture import Furniture
from mocap.synth.keypoints import KeypointConfig
from mocap.synth.markers import MarkerConfig
from mocap.synth.persons import MOTION_KINDS, Person
from mocap.synth.rigs import KINDS as _RIG_KINDS
from mocap.synth.rigs import RigConfig, RingRig
from mocap.synth.section import Section as _Section

SCENES_DIR = Path(__file__).resolve().parent / "scenes"
"""Scene files, in folders by purpose; a name is unique over all of them."""


class RoomConfig(_Section):
    size_m: tuple[float, float, float] = (8.5, 8.0, 3.2)
    floor: Literal["tiles", "planks", "carpet"] = "tiles"
    capture_m: tuple[tuple[float, float, float], tuple[float, float, float]] = (
        (-2.0, -2.0, 0.0),
        (2.0, 2.0, 2.2),
    )
    """Lower and upper corner of the volume in which people move."""
    furniture: tuple[Furniture, ...] = ()

    @model_validator(mode="after")
    def _inside(self) -> RoomConfig:
        if not all(a < b for a, b in zip(*self.capture_m, strict=True)):
            raise ValueError("capture_m: the lower corner must be below the upper corner in every direction")
        if min(self.size_m) < 2.0:
            raise ValueError("size_m: a room is at least 2 m in every direction")
        return self


class PictureConfig(_Section):
    noise_levels: float = Field(2.0, ge=0.0, le=40.0)
    """Standard deviation of the sensor noise, grey levels of 255."""
    light_drift: float = Field(0.01, ge=0.0, le=0.3)
    """Relative size of slow changes of the light."""
    colour_cast: float = Field(0.06, ge=0.0, le=0.3)
    """Spread of gain and colour between cameras."""
    grey: bool = False
    """Cameras that see no colours: all channels are the brightness."""
    exposure_ms: float = Field(0.0, ge=0.0, le=500.0)
    """Time for which the shutter is open: motion blur."""
    readout_ms: float = Field(0.0, ge=0.0, le=500.0)
    """Time from the first to the last row of a rolling shutter."""
    n_subframes: int = Field(7, ge=3, le=63)
    """Instants rendered per picture when the shutter is not instantaneous."""
    jpeg_quality: int | None = Field(None, ge=1, le=100)
    """Compress every picture as JPEG before it is stored."""
    container: Literal["mp4", "png", "jpg"] = "mp4"
    """videos/CAM.mp4, or the pictures one by one in images/CAM/."""


class Scene(_Section):
    """One synthetic session."""

    name: str
    description: str = ""
    seed: int = Field(ge=0)
    n_frames: int = Field(60, ge=1)
    fps: float = Field(30.0, gt=0)
    n_background_frames: int = Field(20, ge=1)
    with_background: bool = True
    masks_only: bool = False
    """Write the true silhouettes as masks/ and no pictures."""
    truth_voxels: bool = True
    """Write truth/voxels.npz, the largest file of the truth."""
    room: RoomConfig = Field(default_factory=lambda: RoomConfig.model_validate({}))
    rig: RigConfig = Field(default_factory=lambda: RingRig.model_validate({}))
    picture: PictureConfig = Field(default_factory=lambda: PictureConfig.model_validate({}))
    persons: tuple[Person, ...] = ()
    markers: MarkerConfig | None = None
    keypoints: KeypointConfig | None = None
    """Write keypoints/CAM.csv as a pose network would find them."""
    depth: DepthConfig | None = None
    """Cameras that measure depth beside their pictures: depth/CAM/*.png."""
    faults: tuple[Fault, ...] = ()

    @model_validator(mode="after")
    def _faults_fit(self) -> Scene:
        if wrong := find_mistakes(self.faults, self.rig.names, self.n_frames):
            raise ValueError("; ".join(wrong))
        return self

    @model_validator(mode="after")
    def _depth_cameras(self) -> Scene:
        names = () if self.depth is None else self.depth.cameras
        if strangers := [name for name in names if name not in self.rig.names]:
            raise ValueError(f"depth.cameras: the rig has no camera {', '.join(strangers)}")
        return self


# Names of alternatives, which pydantic puts into the path of a key.
_TAGS = {*MOTION_KINDS, *_FAULT_KINDS, *_RIG_KINDS, *_FURNITURE_KINDS}


def list_scenes() -> list[str]:
    """Names of the scenes that come with the project, sorted."""
    return sorted(_scene_files())


def _scene_files() -> dict[str, Path]:
    return {path.stem: path for path in SCENES_DIR.glob("*/*.toml")}


def load_scene(name_or_path: str | Path) -> Scene:
    """The scene of a name from `list_scenes` or of a TOML file.

    Raises MocapError with the file and the dotted path of the key for an unknown name or a bad file.
    """
    text = str(name_or_path)
    path = Path(text)
    if path.suffix != ".toml":
        known = _scene_files()
        if text not in known:
            raise MocapError(
                f"there is no scene named {text!r}{did_you_mean(text, known)}",
                remedy=f"take one of {', '.join(sorted(known))}, or give a .toml file",
            )
        path = known[text]
    document = load_toml(path, "the scene")
    return scene_from_dict({"name": path.stem, **document}, path=path)


def scene_from_dict(document: dict[str, Any], *, path: Path | None = None) -> Scene:
    """A checked scene. Raises MocapError that names every bad key by its dotted path."""
    try:
        # Files named in a scene are relative to it.
        folder = None if path is None else path.resolve().parent
        return Scene.model_validate(document, context={"folder": folder})
    except ValidationError as error:
        lines = []
        for item in error.errors():
            dotted = _dotted(item["loc"])
            what = "unknown key" if item["type"] == "extra_forbidden" else item["msg"]
            # A mistake of the scene as a whole brings its own path.
            lines.append(f"{dotted}: {what}" if dotted else what.removeprefix("Value error, "))
        raise MocapError("; ".join(lines), path=path, remedy="correct the scene file") from error


def _dotted(place: tuple[int | str, ...]) -> str:
    """The path of a key as the file has it: pydantic adds which alternative it took."""
    words = []
    for before, word in zip((None, *place), place, strict=False):
        if word not in _TAGS or not (isinstance(before, int) or before in ("motion", "rig")):
            words.append(str(word))
    return ".".join(words)
