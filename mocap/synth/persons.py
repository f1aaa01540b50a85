"""Persons of a scene: what a TOML file may say about bodies, clothes and motions, and how a body comes of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, get_args

from pydantic import Field, ValidationInfo, field_validator, model_validator

from mocap.synth.section import Section

if TYPE_CHECKING:
    import numpy as np

    from mocap.synth.body import Body
    from mocap.synth.carried import Carried
    from mocap.synth.looks import Look
    from mocap.synth.rooms import Room

_GAMMA = 2.2  # of the pictures


class _PathMotion(Section):
    """Moving on an ellipse round `center`, or on a straight line through it when the radii are 0."""

    center_m: tuple[float, float] = (0.0, 0.0)
    radii_m: tuple[float, float] = (1.1, 1.0)
    start_deg: float = 0.0
    clockwise: bool = False
    speed_m_s: float

    def arguments(self) -> dict[str, Any]:
        """Keywords of the motion's function."""
        from mocap.synth.motions import Path as FloorPath

        path = FloorPath(self.center_m, self.radii_m, math.radians(self.start_deg), self.clockwise)
        return {"path": path, "speed_m_s": self.speed_m_s}


class WalkMotion(_PathMotion):
    """Walking."""

    kind: Literal["walk"]
    speed_m_s: float = Field(1.05, ge=0.5, le=1.8)
    backwards: bool = False

    def arguments(self) -> dict[str, Any]:
        """Keywords of the motion's function."""
        return {**super().arguments(), "backwards": self.backwards}


class JogMotion(_PathMotion):
    """Jogging."""

    kind: Literal["jog"]
    radii_m: tuple[float, float] = (1.35, 1.25)
    speed_m_s: float = Field(2.0, ge=1.4, le=3.2)


class PlaceMotion(Section):
    """A motion on the spot."""

    kind: Literal["stand", "squat", "jump", "gesture", "box", "pick_up", "dance"]
    position_m: tuple[float, float] = (0.0, 0.0)
    heading_deg: float = 0.0

    def arguments(self) -> dict[str, Any]:
        """Keywords of the motion's function."""
        return {"position": self.position_m, "heading_rad": math.radians(self.heading_deg)}


class ThrowMotion(Section):
    """Throwing a ball to a partner, who stands where `heading_deg` points, and catching it."""

    kind: Literal["throw"]
    position_m: tuple[float, float] = (0.0, 0.0)
    heading_deg: float = 0.0
    is_second: bool = False
    """Half a period behind, so that two persons play together."""

    def arguments(self) -> dict[str, Any]:
        """Keywords of the motion's function."""
        heading = math.radians(self.heading_deg)
        return {"position": self.position_m, "heading_rad": heading, "is_second": self.is_second}


class SitMotion(Section):
    """Sitting down on a seat and standing up again; a box of the room makes the seat visible."""

    kind: Literal["sit"]
    position_m: tuple[float, float] = (0.0, 0.0)
    """Middle of the seat; the person stands before it."""
    heading_deg: float = 0.0
    """The front of the seat."""
    seat_height_m: float = Field(0.45, ge=0.2, le=0.8)

    def arguments(self) -> dict[str, Any]:
        """Keywords of the motion's function."""
        return {
            "position": self.position_m,
            "heading_rad": math.radians(self.heading_deg),
            "seat_height_m": self.seat_height_m,
        }


class StairsMotion(Section):
    """Climbing a flight of stairs; `stairs` among the furniture, at the same place and heading, make it visible."""

    kind: Literal["stairs"]
    position_m: tuple[float, float] = (0.0, 0.0)
    """Where the person stands before the flight."""
    heading_deg: float = 0.0
    n_stairs: int = Field(3, ge=1, le=5)
    rise_m: float = Field(0.16, ge=0.08, le=0.22)
    going_m: float = Field(0.30, ge=0.26, le=0.45)

    def arguments(self) -> dict[str, Any]:
        """Keywords of the motion's function."""
        return {
            "position": self.position_m,
            "heading_rad": math.radians(self.heading_deg),
            **{name: getattr(self, name) for name in ("n_stairs", "rise_m", "going_m")},
        }


class FallMotion(Section):
    """A few steps, a fall to the floor, lying to the end."""

    kind: Literal["fall"]
    position_m: tuple[float, float] = (0.0, 0.0)
    """Where the fall begins."""
    heading_deg: float = 0.0
    start_s: float = 1.3
    """When it begins."""
    direction: Literal["back", "front", "left", "right"] | None = None

    def arguments(self) -> dict[str, Any]:
        """Keywords of the motion's function."""
        return {
            "position": self.position_m,
            "heading_rad": math.radians(self.heading_deg),
            "start_s": self.start_s,
            "direction": self.direction,
        }


class Waypoint(Section):
    """A point of a route."""

    at_m: tuple[float, float]
    """Where the person passes or stops; with `sit` the middle of the seat."""
    pause_s: float = Field(0.0, ge=0.0)
    """Time spent standing here (0: passes without stopping), or sitting when `sit` is set."""
    heading_deg: float | None = None
    """Where the person looks during the pause or while sitting; not given: as it arrived."""
    sit: bool = False
    seat_height_m: float = Field(0.45, ge=0.2, le=0.8)

    @model_validator(mode="after")
    def _seat_has_a_front(self) -> Waypoint:
        if self.sit and self.heading_deg is None:
            raise ValueError("a way-point with sit = true needs heading_deg, the front of the seat")
        return self


class RouteMotion(Section):
    """Walking along way-points: stops, turns on the spot, sits down on chairs and gets up again."""

    kind: Literal["route"]
    waypoints: tuple[Waypoint, ...] = Field(min_length=1)
    speed_m_s: float = Field(1.0, ge=0.5, le=1.6)
    start_s: float = 0.0
    """When the person leaves the first way-point; negative: it is already on its way in frame 0."""
    repeat: bool = False
    """Walk on to the first way-point after the last and begin again; otherwise stand at the last."""

    def arguments(self) -> dict[str, Any]:
        """Keywords of the motion's function."""
        from mocap.synth.motions import Stop

        stops = tuple(
            Stop(
                w.at_m,
                w.pause_s,
                None if w.heading_deg is None else math.radians(w.heading_deg),
                w.seat_height_m if w.sit else None,
            )
            for w in self.waypoints
        )
        return {"stops": stops, "speed_m_s": self.speed_m_s, "start_s": self.start_s, "repeat": self.repeat}


class CaptureMotion(Section):
    """Captured motion from a BVH or AMC file, performed by this person."""

    kind: Literal["capture"]
    file: str
    """A .bvh file, or an .amc file beside its .asf file; relative to the scene file."""
    map: str | None = None
    """A TOML file that maps the names of the joints; not given: a built-in map that fits."""
    start_s: float = Field(0.0, ge=0.0)
    """Where in the file to begin; after its end the person stands still."""
    position_m: tuple[float, float] = (0.0, 0.0)
    """Where the pelvis is in the first frame."""
    heading_deg: float = 0.0
    """Where it faces in the first frame."""

    @field_validator("file", "map")
    @classmethod
    def _beside_the_scene(cls, value: str | None, info: ValidationInfo) -> str | None:
        folder = (info.context or {}).get("folder")
        return value if value is None or folder is None else str(Path(folder) / value)

    def arguments(self) -> dict[str, Any]:
        """Keywords of the motion's function."""
        return {
            "file": self.file,
            "joint_map": self.map,
            "from_s": self.start_s,
            "position": self.position_m,
            "heading_rad": math.radians(self.heading_deg),
        }


AnyMotion = (
    WalkMotion
    | JogMotion
    | PlaceMotion
    | ThrowMotion
    | SitMotion
    | StairsMotion
    | FallMotion
    | RouteMotion
    | CaptureMotion
)
MOTION_KINDS = tuple(k for m in get_args(AnyMotion) for k in get_args(m.model_fields["kind"].annotation))

_Channel = Annotated[float, Field(ge=0.0, le=255.0)]
Colour = Literal["wall", "floor"] | tuple[_Channel, _Channel, _Channel]


class Colours(Section):
    """Colours as red, green, blue of 0 .. 255, or that of the room's wall or floor; not given: drawn from the seed."""

    skin: Colour | None = None
    hair: Colour | None = None
    shirt: Colour | None = None
    trousers: Colour | None = None
    """Of skirts too."""
    shoes: Colour | None = None


class Load(Section):
    """Something that a person carries."""

    kind: Literal["stick", "racket", "bag", "rucksack", "crate"]
    hand: Literal["left", "right"] = "right"
    """That holds it; a rucksack is on the back, and a crate is held by both before the trunk."""
    colour: Colour = (90.0, 60.0, 40.0)


class Person(Section):
    """One person; what is not given is drawn from the seed."""

    seed: int = Field(ge=0)
    height_m: float | None = Field(None, ge=0.95, le=2.2)
    """Barefoot stature; shoes and hair add about 2.5 cm."""
    sex: Literal["male", "female"] | None = None
    build: float | None = Field(None, ge=0.7, le=1.5)
    child: bool = False
    """With the proportions of a child; the height then lies in 0.95 .. 1.6 m."""
    hair: Literal["usual", "short", "gathered", "long", "bun", "afro", "bald"] = "usual"
    """usual: short for men and children, gathered for women."""
    clothes: Literal["fitted", "loose", "skirt"] = "fitted"
    """loose: wide trousers and a long wide shirt."""
    body: Literal["own", "anny"] = "own"
    """own: polygonised from primitives; anny: shapes of the optional package anny."""
    colours: Colours = Field(default_factory=lambda: Colours.model_validate({}))
    sleeves: Literal["short", "long"] | None = None
    stripes_m: float | None = Field(None, ge=0.0, le=0.5)
    """Period of the shirt's stripes; 0 = plain."""
    carries: tuple[Load, ...] = ()
    motion: Annotated[AnyMotion, Field(discriminator="kind")]

    @model_validator(mode="after")
    def _body_can_wear_it(self) -> Person:
        if self.body == "anny" and (self.clothes != "fitted" or self.hair not in ("usual", "short", "bald")):
            raise ValueError("bodies of the kind anny have fitted clothes, and hair usual, short or bald")
        return self

    @model_validator(mode="after")
    def _height_fits_the_age(self) -> Person:
        lower, upper = (0.95, 1.6) if self.child else (1.2, 2.2)
        if self.height_m is not None and not lower <= self.height_m <= upper:
            raise ValueError(
                f"height_m must lie in {lower} .. {upper} with child = {str(self.child).lower()}"
            )
        return self


def cast(person: Person, room: Room, rng_of: Callable[[int], np.random.Generator]) -> tuple[Body, Look]:
    """Body and look of a person.  rng_of : the generators 3, 4, 5 of the person: stature, skeleton, look."""
    from mocap.synth.body import build_body
    from mocap.synth.figure import make_figure
    from mocap.synth.looks import make_look

    rng = rng_of(3)
    sex = person.sex or ("male" if rng.uniform() < 0.5 else "female")
    stature, build = _size(person, sex, rng)
    if person.body == "anny":
        from mocap.synth.anny_body import build_anny_body

        hair = "bald" if person.hair == "bald" else "short"
        body = build_anny_body(stature, sex, build, rng=rng_of(4), is_child=person.child, hair=hair)
    else:
        figure = make_figure(
            stature,
            sex,
            build,
            rng=rng_of(4),
            is_child=person.child,
            hair=person.hair,
            clothes=person.clothes,
        )
        body = build_body(figure)
    colours = {n: _linear(c, room) for n, c in person.colours if c is not None}
    look = make_look(rng=rng_of(5), sex=sex, clothes=person.clothes, colours=colours)
    return body, look.cut(person.sleeves, person.stripes_m)


def loads_of(person: Person, room: Room, body: Body) -> tuple[Carried, ...]:
    """What a person carries, on its body."""
    from mocap.synth.carried import carried

    return tuple(carried(x.kind, x.hand, body.figure, _linear(x.colour, room)) for x in person.carries)


def _size(person: Person, sex: str, rng: np.random.Generator) -> tuple[float, float]:
    """Stature, m, and build of a person; what the scene leaves open is drawn."""
    import numpy as np

    drawn = rng.normal(1.765, 0.07) if sex == "male" else rng.normal(1.645, 0.065)
    usual = float(np.clip(drawn, 1.45, 2.0))
    build = person.build or float(np.clip(rng.normal(1.0, 0.08), 0.82, 1.25))
    if person.child:
        usual = float(np.clip(rng.normal(1.25, 0.13), 1.0, 1.5))
    return person.height_m or usual, build


def _linear(colour: Colour, room: Room) -> np.ndarray:
    """Linear RGB (3,) of a colour."""
    import numpy as np

    if colour == "wall":
        return room.wall_rgb
    if colour == "floor":
        return room.floor_rgb
    return (np.array(colour) / 255.0) ** _GAMMA
