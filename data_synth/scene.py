"""Scenes: what a TOML file may say, and how it becomes a session folder."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from mocap.errors import MocapError

SCENES_DIR = Path(__file__).resolve().parent.parent / "configs" / "scenes"

Progress = Callable[[str, int, int], None]


_KINDS = ("walk", "stand", "gesture", "box", "pick_up")


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class WalkMotion(_Section):
    """Walking on an ellipse round `center`, or on a straight line through it when the radii are 0."""

    kind: Literal["walk"]
    center_m: tuple[float, float] = (0.0, 0.0)
    radii_m: tuple[float, float] = (1.1, 1.0)
    start_deg: float = 0.0
    clockwise: bool = False
    speed_m_s: float = Field(1.05, ge=0.5, le=1.8)


class PlaceMotion(_Section):
    """A motion on the spot."""

    kind: Literal["stand", "gesture", "box", "pick_up"]
    position_m: tuple[float, float] = (0.0, 0.0)
    heading_deg: float = 0.0


class Person(_Section):
    """One person; what is not given is drawn from the seed."""

    seed: int = Field(ge=0)
    height_m: float | None = Field(None, ge=1.2, le=2.2)
    """Barefoot stature; shoes and hair add about 2.5 cm."""
    sex: Literal["male", "female"] | None = None
    build: float | None = Field(None, ge=0.7, le=1.5)
    motion: Annotated[WalkMotion | PlaceMotion, Field(discriminator="kind")]


class Box(_Section):
    """A piece of furniture: an axis-aligned box that hides what is behind it and throws shadows."""

    lower_m: tuple[float, float, float]
    upper_m: tuple[float, float, float]

    @model_validator(mode="after")
    def _not_empty(self) -> Box:
        if not all(a < b for a, b in zip(self.lower_m, self.upper_m, strict=True)):
            raise ValueError("lower_m must be below upper_m in every direction")
        return self


class RoomConfig(_Section):
    size_m: tuple[float, float, float] = (8.5, 8.0, 3.2)
    floor: Literal["tiles", "planks", "carpet"] = "tiles"
    capture_m: tuple[tuple[float, float, float], tuple[float, float, float]] = (
        (-2.0, -2.0, 0.0),
        (2.0, 2.0, 2.2),
    )
    """Lower and upper corner of the volume in which people move."""
    furniture: tuple[Box, ...] = ()

    @model_validator(mode="after")
    def _inside(self) -> RoomConfig:
        if not all(a < b for a, b in zip(*self.capture_m, strict=True)):
            raise ValueError("capture_m: the lower corner must be below the upper corner in every direction")
        if min(self.size_m) < 2.0:
            raise ValueError("size_m: a room is at least 2 m in every direction")
        return self


class RigConfig(_Section):
    n_cameras: int = Field(7, ge=1, le=32)
    radius_m: tuple[float, float] = (3.2, 3.9)
    height_m: tuple[float, float] = (1.1, 2.4)
    focal_px: float = Field(500.0, ge=100.0)
    """Focal length for a picture 640 pixels wide."""
    size_px: tuple[int, int] = (640, 480)
    distortion: bool = True

    @model_validator(mode="after")
    def _whole_blocks(self) -> RigConfig:
        if self.size_px[0] % 8 or self.size_px[1] % 8 or min(self.size_px) < 64:
            raise ValueError("size_px: width and height must be multiples of 8, at least 64")
        return self


class PictureConfig(_Section):
    noise_levels: float = Field(2.0, ge=0.0, le=40.0)
    """Standard deviation of the sensor noise, grey levels of 255."""
    light_drift: float = Field(0.01, ge=0.0, le=0.3)
    """Relative size of slow changes of the light."""
    colour_cast: float = Field(0.06, ge=0.0, le=0.3)
    """Spread of gain and colour between cameras."""


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
    room: RoomConfig = Field(default_factory=lambda: RoomConfig.model_validate({}))
    rig: RigConfig = Field(default_factory=lambda: RigConfig.model_validate({}))
    picture: PictureConfig = Field(default_factory=lambda: PictureConfig.model_validate({}))
    persons: tuple[Person, ...] = ()


def list_scenes() -> list[str]:
    """Names of the scenes that come with the project, sorted."""
    return sorted(p.stem for p in SCENES_DIR.glob("*.toml"))


def load_scene(name_or_path: str | Path) -> Scene:
    """The scene of a name from `list_scenes` or of a TOML file.

    Raises MocapError with the file and the dotted path of the key for an unknown name or a bad file.
    """
    text = str(name_or_path)
    path = Path(text)
    if path.suffix != ".toml":
        path = SCENES_DIR / f"{text}.toml"
        if not path.is_file():
            raise MocapError(
                f"there is no scene named {text!r}",
                remedy=f"take one of {', '.join(list_scenes())}, or give a .toml file",
            )
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise MocapError(
            f"the scene cannot be read: {error}", path=path, remedy="correct the file"
        ) from error
    return scene_from_dict({"name": path.stem, **document}, path=path)


def synthesise(
    scene: Scene | str | Path,
    out: Path | str,
    *,
    seed: int | None = None,
    workers: int = 2,
    progress: Progress | None = None,
) -> Path:
    """Write the session folder of a scene (or scene name, or TOML file) to `out` and return it.

    seed : replaces the scene's seed and draws other persons.
    workers : processes over which the cameras are shared; the result does not depend on it.
    progress : called as progress(what, done, total); a `what` may run in several rounds.
    The folder is complete or absent: an earlier session there is replaced at the end, anything else is refused.
    Raises MocapError without embreex, for an unknown scene, and when `out` holds something that is no session;
    ValueError for workers < 1.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    from data_synth.session import write_session

    checked = scene if isinstance(scene, Scene) else load_scene(scene)
    return write_session(checked, Path(out), seed=seed, workers=workers, progress=progress)


def scene_from_dict(document: dict[str, Any], *, path: Path | None = None) -> Scene:
    """A checked scene. Raises MocapError that names every bad key by its dotted path."""
    try:
        return Scene.model_validate(document)
    except ValidationError as error:
        lines = []
        for item in error.errors():
            dotted = ".".join(str(p) for p in item["loc"] if p not in _KINDS)
            what = "unknown key" if item["type"] == "extra_forbidden" else item["msg"]
            lines.append(f"{dotted or 'scene'}: {what}")
        raise MocapError("; ".join(lines), path=path, remedy="correct the scene file") from error
