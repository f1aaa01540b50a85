"""Colours of a person by rest position: skin, hair, shirt, trousers, shoes, with fabric and small details."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from mocap.synth.body import Body
from mocap.synth.figure import JOINT, SIDES

Array = NDArray[np.float64]

_SKIN = [(0.72, 0.50, 0.40), (0.62, 0.40, 0.30), (0.44, 0.27, 0.19), (0.24, 0.14, 0.10), (0.78, 0.57, 0.47)]
_HAIR = [(0.05, 0.035, 0.03), (0.12, 0.07, 0.04), (0.30, 0.20, 0.10), (0.20, 0.08, 0.04), (0.03, 0.03, 0.03)]
_SHIRT = [(0.05, 0.16, 0.38), (0.50, 0.07, 0.06), (0.60, 0.42, 0.08), (0.06, 0.28, 0.12), (0.72, 0.72, 0.70)]
_TROUSERS = [
    (0.04, 0.05, 0.09),
    (0.16, 0.12, 0.08),
    (0.10, 0.10, 0.11),
    (0.07, 0.10, 0.20),
    (0.28, 0.24, 0.17),
]
_SHOES = [(0.03, 0.03, 0.03), (0.12, 0.07, 0.04), (0.45, 0.45, 0.44)]
_SHORT, _LONG = 0.30, 0.95  # sleeves, as shares of the arm
_ON_HAIR_M = 0.006  # what is nearer to the hair's own shape than this has its colour


@dataclass(frozen=True, eq=False)
class Look:
    """Linear RGB albedos in 0 .. 1 and the cut of the clothes.

    sleeve, leg : share of the arm and of the leg (shoulder to wrist, hip to ankle) covered by cloth.
    hem : lower edge of the shirt over the hip joints, of stature.
    stripes_m : period of the shirt's stripes, 0 = plain.  table : (32, 32, 32) noise of the fabric.
    """

    skin: Array
    hair: Array
    shirt: Array
    second: Array
    trousers: Array
    shoes: Array
    sleeve: float
    leg: float
    stripes_m: float
    table: Array
    hem: float = 0.045

    def cut(self, sleeves: str | None, stripes_m: float | None) -> Look:
        """The same with other sleeves, `short` or `long`, and stripes; None = as they are."""
        sleeve = self.sleeve if sleeves is None else {"short": _SHORT, "long": _LONG}[sleeves]
        return replace(self, sleeve=sleeve, stripes_m=self.stripes_m if stripes_m is None else stripes_m)

    def albedo(self, body: Body, rest: Array) -> Array:
        """Linear RGB (N, 3) at rest positions (N, 3) m on the body's surface."""
        H = body.figure.stature_m
        x, y, z = rest.T
        out = np.empty((len(rest), 3))
        stripe = np.zeros(len(rest))
        if self.stripes_m > 0:
            stripe = 0.5 + 0.5 * np.clip(4 * np.sin(2 * np.pi * z / self.stripes_m), -1, 1)
        out[:] = self.shirt + stripe[:, None] * (self.second - self.shirt)
        at = body.rest_position
        on_arm = np.zeros(len(rest), dtype=bool)
        for side, _ in SIDES:
            shoulder, wrist = at[JOINT[f"{side}_shoulder"]], at[JOINT[f"{side}_wrist"]]
            axis = (wrist - shoulder) / np.linalg.norm(wrist - shoulder)
            along = (rest - shoulder) @ axis
            across = np.linalg.norm(rest - shoulder - along[:, None] * axis, axis=1)
            arm = (along > 0.03) & (across < 0.11)
            on_arm |= arm
            out[arm & (along > self.sleeve * float(np.linalg.norm(wrist - shoulder)))] = self.skin
            if not body.parts:
                # The rest pose of bodies from elsewhere bends the arms: hands are what lies beyond the wrist.
                beyond = (wrist - rest) @ body.rest_rotation[JOINT[f"{side}_wrist"], :, 2]
                hand = (beyond > 0) & (np.linalg.norm(rest - wrist, axis=1) < 0.14 * H)
                on_arm |= hand
                out[hand] = self.skin
        hips = at[JOINT["left_hip"], 2]
        ankles = at[JOINT["left_ankle"], 2]
        low = ~on_arm & (z < hips + self.hem * H)
        out[low] = self.trousers
        if self.hem > 0:
            out[low & (z > hips + 0.036 * H)] = 0.3 * self.trousers  # belt
        out[low & ((hips - z) > self.leg * (hips - ankles))] = self.skin
        out[~on_arm & (z < ankles + 0.006 * H)] = self.shoes
        out[~on_arm & (z < ankles - 0.033 * H)] = 0.5 * self.shoes + 0.05  # sole
        figure = body.figure
        size = figure.head_top[2] / (0.110 * H) if figure.is_child else 1.0  # of the head against an adult's
        p = (rest - at[JOINT["head"]]) / (size * H)
        collar = at[JOINT["neck"], 2] + 0.006 * H + 0.10 * (np.abs(y) - 0.04) - 0.25 * np.clip(x, 0, None)
        top = ~on_arm & (z > collar) & (np.abs(y) < 0.065 * size * H)
        out[top] = self.skin
        in_hair = top & (p[:, 2] > 0.040 + 0.85 * p[:, 0]) & (figure.hair != "bald")
        if figure.sex == "female" and figure.hair in ("usual", "gathered"):
            in_hair |= top & (p[:, 0] < -0.012) & (p[:, 2] > -0.045)
        for part in body.parts:
            if part.layer == "hair":
                in_hair |= part.distance(rest) < _ON_HAIR_M
        in_hair &= ~((np.abs(p[:, 1]) > 0.0415) & (p[:, 2] < 0.046) & (p[:, 0] > -0.018))  # ears
        out[in_hair] = self.hair
        top |= in_hair
        front = top & (p[:, 0] > 0.03)
        eye = front & (((np.abs(p[:, 1]) - 0.0165) / 0.006) ** 2 + ((p[:, 2] - 0.043) / 0.0035) ** 2 < 1)
        out[eye] = (0.05, 0.04, 0.04)
        brow = front & (np.abs(np.abs(p[:, 1]) - 0.0170) < 0.0095) & (np.abs(p[:, 2] - 0.052) < 0.0022)
        out[brow] = self.hair
        mouth = front & ((p[:, 1] / 0.0125) ** 2 + ((p[:, 2] - 0.003) / 0.0032) ** 2 < 1)
        out[mouth] = self.skin * (0.75, 0.45, 0.45)
        fine = value_noise(self.table, rest, 0.035) - 0.5
        coarse = value_noise(self.table, rest + 7.3, 0.13) - 0.5
        cloth = np.where(top | (on_arm & (out[:, 0] == self.skin[0])), 0.25, 1.0)
        return np.clip(out * (1 + cloth * (0.16 * fine + 0.22 * coarse))[:, None], 0.005, 0.95)


def make_look(
    *,
    rng: np.random.Generator,
    sex: str,
    clothes: str = "fitted",
    colours: Mapping[str, Array | tuple[float, float, float]] | None = None,
) -> Look:
    """A look drawn at random: plain or striped shirt, long or short sleeves, trousers or shorts.

    clothes : as of the figure, one of CLOTHES; loose clothes and skirts have their own cut.
    colours : linear RGB in 0 .. 1 for some of skin, hair, shirt, trousers, shoes instead of drawn ones; a given shirt
    is plain. Raises ValueError for another name.
    """
    given: dict[str, Any] = {k: np.asarray(v, dtype=np.float64) for k, v in (colours or {}).items()}
    if unknown := set(given) - {"skin", "hair", "shirt", "trousers", "shoes"}:
        raise ValueError(
            f"colours must be of skin, hair, shirt, trousers, shoes, got {', '.join(sorted(unknown))}"
        )

    def pick(palette: list[tuple[float, float, float]]) -> Array:
        base = np.array(palette[int(rng.integers(len(palette)))])
        return np.clip(base * rng.uniform(0.85, 1.15) * rng.uniform(0.93, 1.07, 3), 0.01, 0.9)

    shirt = pick(_SHIRT)
    look = Look(
        skin=pick(_SKIN),
        hair=pick(_HAIR),
        shirt=shirt,
        second=np.clip(0.35 * shirt + rng.uniform(0.0, 0.45), 0.02, 0.9),
        trousers=pick(_TROUSERS),
        shoes=pick(_SHOES),
        sleeve=float(rng.choice([_SHORT, _LONG, _LONG])),
        leg=float(rng.choice([0.45, 1.2, 1.2, 1.2])),
        stripes_m=float(rng.choice([0.0, 0.0, 0.09])),
        table=rng.uniform(size=(32, 32, 32)),
    )
    if clothes == "loose":
        look = replace(look, sleeve=_LONG if look.sleeve > 0.5 else 0.47, leg=1.2, hem=-0.083)
    elif clothes == "skirt":
        look = replace(look, leg=0.46)
    if "shirt" in given:
        look = replace(look, stripes_m=0.0)
    return replace(look, **given)


def value_noise(table: Array, points: Array, period_m: float) -> Array:
    """Smooth noise in 0 .. 1 at points (N, 3) m; lattice of the given period, wrapping round the table."""
    coordinates = (points / period_m).T
    return map_coordinates(table, coordinates, order=1, mode="grid-wrap")
