"""Texture: the colours of every place of a person's surface, learnt over a clip, as residuals of a pose.

Where a sleeve ends, where hem and hairline lie, a pose that is off by a centimetre shows another colour. Neither hull
nor outlines tell how a trunk turns inside its silhouette, nor where along its length a limb is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import convolve1d

from mocap.arrays import Array
from mocap.body.model import Body
from mocap.data.problem import StateLayout
from mocap.likelihood.colours import PixelRays, luma_and_chroma
from mocap.likelihood.residuals._texture_kernels import (
    Lattice,
    SeenRays,
    TextureTerms,
    learn_texture,
    texture_equations,
)

_SMALL = 1e-9


@dataclass(frozen=True)
class TextureSettings:
    """How the surface is divided, and what is believed of its colours."""

    spacing_m: float = 0.02
    """Between nodes, along a cone and about it."""
    least_std: tuple[float, float, float] = (8.0, 3.0, 3.0)
    """What luma and the two chromas of a place vary by at least, of 255."""
    least_pixels: float = 6.0
    """A node that fewer pixels have shown is not known."""
    least_cosine: float = 0.35
    """Rays that graze the flesh say nothing: the rim of a cone is not that of the person."""
    scale: float = 2.5
    """Deviations at which a pixel loses three quarters of its pull (Geman-McClure)."""
    gate: float = 3.0
    """Deviations beyond which a pixel shows something else, when the colours are learnt for the second time."""
    soft: float = 0.5
    """What the neighbours of a node on each side count in its colour, against 1 of its own."""


def lattice_of(body: Body, spacing_m: float) -> Lattice:
    """Nodes on the flesh of a body, about `spacing_m` apart."""
    cones = body.cones
    along = cones.end - cones.start
    length = np.linalg.norm(along, axis=1)
    axes = np.empty((len(length), 3, 3))
    for k, direction in enumerate(along):
        first = direction / length[k] if length[k] > 0 else np.array([0.0, 0.0, 1.0])
        second = np.cross(first, np.eye(3)[int(np.abs(first).argmin())])
        second /= np.linalg.norm(second)
        axes[k] = first, second, np.cross(first, second)
    n_along = np.maximum(2, np.rint((length + cones.radii.sum(axis=1)) / spacing_m).astype(np.int64) + 1)
    n_about = np.maximum(4, np.rint(2.0 * np.pi * cones.radii.mean(axis=1) / spacing_m).astype(np.int64))
    first_node = np.cumsum(n_along * n_about) - n_along * n_about
    return Lattice(axes, length, np.stack([n_along, n_about], axis=1), first_node)


def _seen(rays: PixelRays) -> SeenRays:
    return SeenRays(rays.columns, luma_and_chroma(rays.rgb))


@dataclass(frozen=True, eq=False)
class Texture:
    """What is known of the colours of a person's surface."""

    body: Body
    terms: TextureTerms


def learnt_texture(
    body: Body, frames: Sequence[tuple[PixelRays, Array]], settings: TextureSettings | None = None
) -> Texture:
    """The texture that frames teach, each with the rays through its pixels and its pose (D,).

    Twice: what differs too much from what was learnt first is something else, an arm before the trunk for instance.
    """
    numbers = settings or TextureSettings()
    lattice = lattice_of(body, numbers.spacing_m)
    n_nodes = int(lattice.shape.prod(axis=1).sum())
    seen = [(_seen(rays), np.ascontiguousarray(state, dtype=np.float64)) for rays, state in frames]
    unknown = np.zeros((n_nodes, 3))
    terms = TextureTerms(lattice, unknown, unknown, numbers.least_cosine, numbers.scale)
    for _ in range(2):
        sums = np.zeros(n_nodes), np.zeros((n_nodes, 3)), np.zeros((n_nodes, 3))
        for rays, state in seen:
            learn_texture(state, body.arrays, rays, terms, numbers.gate, *sums)
        terms = _known(lattice, *sums, numbers)
    return Texture(body, terms)


def _known(
    lattice: Lattice, weight: Array, total: Array, square: Array, settings: TextureSettings
) -> TextureTerms:
    """Colours and deviations of the nodes from sums of shares (N,), colours and their squares (N, 3)."""
    sums = np.concatenate([weight[:, None], total, square], axis=1)
    kernel = np.array([settings.soft, 1.0, settings.soft]) / (1.0 + 2.0 * settings.soft)
    for (n_along, n_about), first in zip(lattice.shape, lattice.first, strict=True):
        own = sums[first : first + n_along * n_about].reshape(n_along, n_about, -1)
        own[:] = convolve1d(convolve1d(own, kernel, axis=0, mode="nearest"), kernel, axis=1, mode="wrap")
    share = np.maximum(sums[:, :1], _SMALL)
    mean = sums[:, 1:4] / share
    variance = np.maximum(sums[:, 4:] / share - mean**2, 0.0) + np.square(settings.least_std)
    is_known = sums[:, :1] >= settings.least_pixels
    inverse = np.where(is_known, 1.0 / np.sqrt(variance), 0.0)
    return TextureTerms(lattice, mean, inverse, settings.least_cosine, settings.scale)


@dataclass(frozen=True, eq=False)
class TextureProblem:
    """The colours of one frame's pixels against the texture: `normal_equations(state)` for a refinement.

    weight : nats per mean squared deviation, half of them, of a pixel.
    """

    texture: Texture
    rays: PixelRays
    weight: float = 1.0

    @property
    def layout(self) -> StateLayout:
        return self.texture.body.layout

    def normal_equations(self, state: Array) -> tuple[float, Array, Array]:
        """Robust cost, nats, its Gauss-Newton matrix (D, D) and gradient (D,) at a state (D,).

        Deviations are held, as weights of a reweighted fit are. A pixel whose place on the body is not known costs
        nothing and pulls nowhere.
        """
        D = self.layout.n_columns
        H, g = np.zeros((D, D)), np.zeros(D)
        x = np.ascontiguousarray(state, dtype=np.float64)
        body, terms = self.texture.body, self.texture.terms
        cost = texture_equations(x, body.arrays, _seen(self.rays), terms, H, g)
        share = self.weight / max(len(self.rays), 1)
        return share * float(cost), share * H, share * g
