"""Features of a blob of voxels, and the decision tree that tells persons from other things."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BODY_DENSITY_KG_PER_LITRE = 1.1  # rho of CF Table 4.1


@dataclass(frozen=True)
class BlobFeatures:
    """The person classifier's input, one blob.

    weight_kg : volume times 1.1 kg/l.  centroid_z_m : mean height of the voxels over the floor.
    top_m : highest point.  height_m : vertical extent.  box_max_m, box_min_m : longer and shorter horizontal
    side of the axis-parallel bounding box.  An empty blob has weight 0 and NaN elsewhere.
    """

    weight_kg: float
    centroid_z_m: float
    top_m: float
    height_m: float
    box_max_m: float
    box_min_m: float

    @property
    def bottom_m(self) -> float:
        """Lowest point over the floor."""
        return self.top_m - self.height_m


@dataclass(frozen=True)
class Split:
    """One node of a decision tree: value of `feature` < `threshold` goes to `below`, otherwise to `above`.

    A leaf is a plain bool: True = person.
    """

    feature: str
    threshold: float
    below: Split | bool
    above: Split | bool


# Chosen by hand, wide on purpose: a hull is 20-25 % larger than its body, may lack limbs (43 of 73 litres
# when the shirt looks like the wall) or have a chair fused to it (210 litres with a strict hull, 380 with a
# tolerance of one of four views).  The tree stays plain data, so that a trained one can replace it.
# Branches end in the first False; nested from the inside out, because a tree is written from its leaves.
_BOX_IS_PERSON = Split(
    "box_max_m",
    0.25,  # standing straight, from shoulder to shoulder; thinner = pole, cable, ghost edge
    False,
    Split(
        "box_max_m",
        2.6,  # arm span of a tall person 2.0 m, a lunge, plus the surplus of the hull
        Split("box_min_m", 0.12, False, True),  # chest depth; thinner = door leaf, curtain
        False,
    ),
)
_HEIGHT_IS_PERSON = Split(
    "height_m",
    0.45,  # a person seated behind a table shows about 0.55 m
    False,
    Split(
        "bottom_m",
        0.35,  # stands on the floor, feet may be cut off
        _BOX_IS_PERSON,
        # Floating: the trunk of an adult behind a table has 40 kg and more, the ghosts that tolerant carving
        # makes between two persons grow to 35 kg before they touch one of them.
        Split("weight_kg", 40.0, False, _BOX_IS_PERSON),
    ),
)
PERSON_TREE = Split(
    "weight_kg",
    15.0,  # a child of four has about 16 kg; specks and lost limbs weigh less
    False,
    Split(
        "weight_kg",
        600.0,  # person + chair + tolerant carving: 418 kg; above that, a wall or an unusable background
        Split("top_m", 0.55, False, _HEIGHT_IS_PERSON),  # deep crouch of a 1.6 m person: 0.75 m; not a shadow
        False,
    ),
)


def blob_features(centers: Array, voxel_size_m: float) -> BlobFeatures:
    """Features of one blob.

    centers : (N, 3) m, world, voxel centres; N = 0 gives weight 0 and NaN elsewhere.
    Source: CF Table 4.1. Departs from it: extents are those of the cubes, not of their centres (one voxel
    side more; top half a side more), so that the features of one body agree over voxel sizes.
    """
    c = np.asarray(centers, dtype=np.float64)
    if c.ndim != 2 or c.shape[1] != 3:
        raise ValueError(f"centers has shape {c.shape}, expected (N, 3)")
    if not voxel_size_m > 0:
        raise ValueError(f"voxel_size_m must be positive, got {voxel_size_m}")
    if len(c) == 0:
        return BlobFeatures(0.0, np.nan, np.nan, np.nan, np.nan, np.nan)
    columns = np.ascontiguousarray(c.T)  # reducing rows of three is ten times slower
    return _features(len(c), float(columns[2].mean()), columns.min(axis=1), columns.max(axis=1), voxel_size_m)


def is_person(features: BlobFeatures, tree: Split | bool = PERSON_TREE) -> bool:
    """The verdict of the decision tree; an empty blob or a NaN feature is no person.

    Source: CF 4.2.3 (Figure 4.4: tree over weight, height and bounding box). Departs from it: thresholds set
    by hand instead of trained, see PERSON_TREE.
    """
    node = tree
    while isinstance(node, Split):
        value = getattr(features, node.feature)
        if np.isnan(value):
            return False
        node = node.below if value < node.threshold else node.above
    return node


@dataclass(frozen=True, eq=False)
class Components:
    """The connected components of one frame as a table, K rows in ascending label.

    order : (N',) int, voxel indices sorted by component.  start : (K + 1,) int, row k owns
    order[start[k]:start[k + 1]].  centroid, lower, upper : (K, 3) m, of the voxel centres.  weight_kg : (K,).
    component_of : (N,) int, row of each voxel, -1 where its label was negative.
    """

    order: NDArray[np.int64]
    start: NDArray[np.int64]
    centroid: Array
    lower: Array
    upper: Array
    weight_kg: Array
    component_of: NDArray[np.int64]
    voxel_size_m: float

    def __len__(self) -> int:
        return len(self.weight_kg)

    def voxels(self, k: int) -> NDArray[np.int64]:
        """Indices of the voxels of component k."""
        return self.order[self.start[k] : self.start[k + 1]]

    def features(self, k: int) -> BlobFeatures:
        """What the person classifier needs of component k."""
        n = int(self.start[k + 1] - self.start[k])
        z = float(self.centroid[k, 2])
        return _features(n, z, self.lower[k], self.upper[k], self.voxel_size_m)


def components_of(centers: Array, labels: NDArray[np.integer], voxel_size_m: float) -> Components:
    """Group voxels by label and measure every group.

    centers : (N, 3) m.  labels : (N,) int, any numbering, negative = ignore. N = 0 gives an empty table.
    Source: CF Eq. 4.1, Table 4.1.
    """
    labels = np.asarray(labels)
    order = np.argsort(labels, kind="stable").astype(np.int64)
    sorted_labels = labels[order]
    n_ignored = int(np.searchsorted(sorted_labels, 0))
    order, sorted_labels = order[n_ignored:], sorted_labels[n_ignored:]
    component_of = np.full(len(labels), -1, dtype=np.int64)
    if len(order) == 0:
        none = np.zeros((0, 3))
        start = np.zeros(1, dtype=np.int64)
        return Components(order, start, none, none, none, np.zeros(0), component_of, voxel_size_m)
    first = np.flatnonzero(np.r_[True, sorted_labels[1:] != sorted_labels[:-1]])
    start = np.r_[first, len(order)].astype(np.int64)
    count = np.diff(start)
    component_of[order] = np.repeat(np.arange(len(count)), count)
    columns = [centers[order, i] for i in range(3)]
    return Components(
        order=order,
        start=start,
        centroid=np.stack([np.add.reduceat(c, first) for c in columns], axis=1) / count[:, None],
        lower=np.stack([np.minimum.reduceat(c, first) for c in columns], axis=1),
        upper=np.stack([np.maximum.reduceat(c, first) for c in columns], axis=1),
        weight_kg=weight_kg(1, voxel_size_m) * count,
        component_of=component_of,
        voxel_size_m=voxel_size_m,
    )


def weight_kg(n_voxels: int, voxel_size_m: float) -> float:
    """Weight of n voxels of flesh. Source: CF Table 4.1."""
    return n_voxels * voxel_size_m**3 * 1000.0 * BODY_DENSITY_KG_PER_LITRE


def _features(n: int, centroid_z: float, lower: Array, upper: Array, side: float) -> BlobFeatures:
    extent = upper - lower + side
    return BlobFeatures(
        weight_kg=weight_kg(n, side),
        centroid_z_m=centroid_z,
        top_m=float(upper[2] + side / 2),
        height_m=float(extent[2]),
        box_max_m=float(max(extent[0], extent[1])),
        box_min_m=float(min(extent[0], extent[1])),
    )
