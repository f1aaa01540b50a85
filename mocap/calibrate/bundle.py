"""Bundle adjustment: lenses, places of cameras and of the board, all at once, with the covariance of the cameras.

OpenCV's `calibrateMultiview` solves the same sum for whole boards and free lenses; it takes no parts of boards, no
points of known place, and says nothing of how certain its answer is.  Poses of the board are eliminated (Schur
complement), as every sighting knows one of them only.

Source: Triggs et al., Bundle Adjustment - A Modern Synthesis, 1999, sections 6.1 and 9.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from mocap.arrays import Array
from mocap.calibrate.detect import Sighting
from mocap.calibrate.lens import Lens, LensModel, n_free, project
from mocap.data import Camera

Pose = tuple[Array, Array]  # rotation vector, translation m

_MAX_STEPS = 100
# Sums of squares that change by a smaller share have arrived.
_ARRIVED = 1e-9
# Smallest eigenvalue of the scaled matrix that is more than rounding.
_UNDETERMINED = 1e-13
_FIRST_DAMPING, _WORST_DAMPING = 1e-4, 1e12
_DIFFERENCE = 1e-6  # rad, m: of a central difference
WORLD = -1  # the object whose place is the world's: the board on the floor, or points of known place


@dataclass(frozen=True, eq=False)
class Bundle:
    """What is adjusted.

    lenses, places : by camera; places map the world to the camera.  objects : number -> pose of a board in the world;
    WORLD is not among them.  sightings : (object, camera) -> what was seen.
    """

    lenses: dict[str, Lens]
    places: dict[str, Pose]
    objects: dict[int, Pose]
    sightings: dict[tuple[int, str], Sighting]
    model: LensModel
    keeps_lenses: bool = False

    @property
    def block(self) -> int:
        """Numbers of one camera: turn, shift, then those of its lens."""
        return 6 + (0 if self.keeps_lenses else n_free(self.model))

    def residuals(self) -> dict[tuple[int, str], Array]:
        """Projections less corners, (N, 2) px, of every sighting."""
        return {key: self._projected(key)[0] for key in self.sightings}

    def camera(self, name: str) -> Camera:
        """A camera as the rest of the package knows it."""
        lens, (rotation, translation) = self.lenses[name], self.places[name]
        R = cv2.Rodrigues(rotation)[0]
        return Camera(name, lens.size, lens.K, lens.dist, R, translation, is_fisheye=lens.is_fisheye)

    def _projected(self, key: tuple[int, str]) -> tuple[Array, Array, Array]:
        """Residual (N, 2), and its derivatives by the camera (2N, block) and by the object's pose (2N, 6)."""
        item, name = key
        sighting, lens, place = self.sightings[key], self.lenses[name], self.places[name]
        if item == WORLD:
            pose, by_place, by_object = place, np.eye(6), np.zeros((6, 6))
        else:
            pose, by_object, by_place = _composed(self.objects[item], place)
        uv, by_pose, by_lens = project(sighting.points, pose, lens, self.model)
        of_camera = by_pose @ by_place
        if not self.keeps_lenses:
            of_camera = np.hstack([of_camera, by_lens])
        return uv - sighting.uv, of_camera, by_pose @ by_object

    def _moved(self, cameras: Mapping[str, Array], objects: Mapping[int, Array]) -> Bundle:
        places = {name: _shifted(self.places[name], step[:6]) for name, step in cameras.items()}
        lenses = {}
        if not self.keeps_lenses:
            lenses = {name: self.lenses[name].moved(step[6:], self.model) for name, step in cameras.items()}
        moved = {item: _shifted(self.objects[item], step) for item, step in objects.items()}
        return replace(
            self, lenses=self.lenses | lenses, places=self.places | places, objects=self.objects | moved
        )


@dataclass(frozen=True, eq=False)
class Adjusted:
    """names : cameras in the order of the covariance's blocks of `bundle.block` numbers.

    covariance : ((C * block), (C * block)): turn rad, shift m (of world to camera), then fx, fy, cx, cy px and
    distortion; the world is held.  noise_px : standard deviation of a corner's coordinate.
    """

    bundle: Bundle
    names: tuple[str, ...]
    covariance: Array
    noise_px: float

    def block_of(self, name: str) -> slice:
        """Where a camera stands in the covariance."""
        at = self.names.index(name) * self.bundle.block
        return slice(at, at + self.bundle.block)

    def focal_deviation(self, name: str) -> float:
        """Standard deviation of the longer-known focal length as a share of it; 0 for a lens that was given."""
        if self.bundle.keeps_lenses:
            return 0.0
        at = self.block_of(name).start + 6
        sd = np.sqrt(np.diag(self.covariance)[at : at + 2])
        return float(np.max(sd / np.diag(self.bundle.lenses[name].K)[:2]))

    def center_deviation_m(self, name: str) -> float:
        """Standard deviation of a camera's place along the axis where it is known worst, m."""
        pose = np.concatenate([part.ravel() for part in self.bundle.places[name]])
        steps = _DIFFERENCE * np.eye(6)
        J = np.column_stack([(_center(pose + d) - _center(pose - d)) / (2 * _DIFFERENCE) for d in steps])
        at = self.block_of(name)
        return float(np.sqrt(np.linalg.eigvalsh(J @ self.covariance[at, at][:6, :6] @ J.T)[-1]))


def adjust(bundle: Bundle) -> Adjusted:
    """The bundle of least squares: Levenberg-Marquardt with the objects eliminated.

    Raises numpy.linalg.LinAlgError where the sightings do not determine the cameras.
    """
    names = tuple(bundle.places)
    damping, cost = _FIRST_DAMPING, _cost(bundle)
    for _ in range(_MAX_STEPS):
        system = _System.of(bundle, names)
        while True:
            try:
                candidate = bundle._moved(*system.step(damping))
                new = _cost(candidate)
            except (np.linalg.LinAlgError, cv2.error):
                new = np.inf
            if new <= cost or damping > _WORST_DAMPING:
                break
            damping *= 10
        if not new <= cost:
            break
        gain, bundle, cost, damping = cost - new, candidate, new, damping / 10
        if gain <= _ARRIVED * cost:
            break
    return _with_covariance(bundle, names)


def inverse(A: Array) -> Array:
    """Of a matrix."""
    return np.asarray(np.linalg.inv(A), dtype=np.float64)


def _cost(bundle: Bundle) -> float:
    total = sum(float((r**2).sum()) for r in bundle.residuals().values())
    return total if np.isfinite(total) else np.inf


def _with_covariance(bundle: Bundle, names: tuple[str, ...]) -> Adjusted:
    """The covariance of the cameras; sightings err as wholes, not corner by corner.

    A board that is bent, blurred or badly lit moves all corners of a sighting together.  So the spread of the gradient
    is taken over sightings (Huber's sandwich), which is the usual inverse where corners err one by one.
    """
    system = _System.of(bundle, names)
    reduced, _, _ = system.reduced(0.0)
    scale = 1 / np.sqrt(np.maximum(np.diag(reduced), 1e-300))
    if not np.linalg.eigvalsh(reduced * np.outer(scale, scale))[0] > _UNDETERMINED:
        raise np.linalg.LinAlgError("the sightings do not determine the cameras")
    covariance = inverse(reduced)
    spread = np.zeros_like(reduced)
    for gradient in system.sighting_gradients():
        spread += np.outer(gradient, gradient)
    residual = np.concatenate([r.ravel() for r in bundle.residuals().values()])
    n_numbers = len(reduced) + 6 * len(bundle.objects)
    left = max(residual.size - n_numbers, 1)
    by_corner = covariance * float(residual @ residual) / left
    by_sighting = covariance @ spread @ covariance * residual.size / left
    is_joint = np.trace(by_sighting) > np.trace(by_corner)
    noise_px = float(np.sqrt(residual @ residual / left))
    return Adjusted(bundle, names, by_sighting if is_joint else by_corner, noise_px)


@dataclass(frozen=True, eq=False)
class _System:
    """Normal equations of a bundle: cameras, objects, and between them."""

    names: tuple[str, ...]
    block: int
    cameras: Array  # (C * block, C * block)
    gradient: Array  # (C * block,)
    objects: dict[int, tuple[Array, Array, Array]]  # (6, 6), (6,), (C * block, 6)
    terms: dict[tuple[int, str], tuple[Array, Array]]  # gradient of a sighting by its camera, by its object

    @classmethod
    def of(cls, bundle: Bundle, names: tuple[str, ...]) -> _System:
        n, block = len(names) * bundle.block, bundle.block
        H, g = np.zeros((n, n)), np.zeros(n)
        objects = {item: (np.zeros((6, 6)), np.zeros(6), np.zeros((n, 6))) for item in bundle.objects}
        terms = {}
        for item, name in bundle.sightings:
            residual, A, B = bundle._projected((item, name))
            at = names.index(name) * block
            own = slice(at, at + block)
            r = residual.ravel()
            H[own, own] += A.T @ A
            g[own] += A.T @ r
            terms[item, name] = A.T @ r, B.T @ r
            if item in objects:
                V, b, W = objects[item]
                V += B.T @ B
                b += B.T @ r
                W[own] += A.T @ B
        return cls(names, block, H, g, objects, terms)

    def reduced(self, damping: float) -> tuple[Array, Array, dict[int, Array]]:
        """Matrix and gradient of the cameras alone, and the inverse (6, 6) of every object."""
        S = self.cameras + damping * np.diag(np.diag(self.cameras))
        g = self.gradient.copy()
        inverses = {}
        for item, (V, b, W) in self.objects.items():
            inverses[item] = inverse(V + damping * np.diag(np.diag(V)))
            S -= W @ inverses[item] @ W.T
            g -= W @ inverses[item] @ b
        return S, g, inverses

    def step(self, damping: float) -> tuple[dict[str, Array], dict[int, Array]]:
        """Steps of cameras and objects towards the minimum."""
        S, g, inverses = self.reduced(damping)
        scale = 1 / np.sqrt(np.maximum(np.diag(S), 1e-300))
        dx = -scale * np.linalg.solve(S * np.outer(scale, scale), scale * g)
        objects = {item: -inverses[item] @ (b + W.T @ dx) for item, (_, b, W) in self.objects.items()}
        return {name: dx[k * self.block : (k + 1) * self.block] for k, name in enumerate(self.names)}, objects

    def sighting_gradients(self) -> Iterator[Array]:
        """What every sighting adds to the gradient of the cameras alone, (C * block,)."""
        inverses = {item: inverse(V) for item, (V, _, _) in self.objects.items()}
        for (item, name), (by_camera, by_object) in self.terms.items():
            gradient = np.zeros_like(self.gradient)
            at = self.names.index(name) * self.block
            gradient[at : at + self.block] = by_camera
            if item in self.objects:
                gradient -= self.objects[item][2] @ inverses[item] @ by_object
            yield gradient


def _composed(first: Pose, second: Pose) -> tuple[Pose, Array, Array]:
    """second after first, and its derivatives (6, 6) by the first and by the second pose."""
    r, t, rr1, rt1, rr2, rt2, tr1, tt1, tr2, tt2 = cv2.composeRT(*first, *second)
    by_first = np.block([[rr1, rt1], [tr1, tt1]])
    by_second = np.block([[rr2, rt2], [tr2, tt2]])
    return (r, t), by_first, by_second


def _shifted(pose: Pose, step: Array) -> Pose:
    return pose[0] + step[:3].reshape(pose[0].shape), pose[1] + step[3:6].reshape(pose[1].shape)


def _center(pose: Array) -> Array:
    """Place of a camera, (3,) m, from turn and shift (6,)."""
    return -cv2.Rodrigues(pose[:3])[0].T @ pose[3:]
