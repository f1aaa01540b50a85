"""Features of a blob of voxels, and the decision tree that tells persons from other things."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mocap.arrays import Array
from mocap.tracking import _kernels

BODY_DENSITY_KG_PER_LITRE = 1.1  # rho of CF Table 4.1
# Person + chair + tolerant carving: 418 kg; above that, several persons, a wall or an unusable background.
MOST_KG = 600.0


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


FEATURES = (*(f.name for f in fields(BlobFeatures)), "bottom_m")


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
        MOST_KG,
        Split("top_m", 0.55, False, _HEIGHT_IS_PERSON),  # deep crouch of a 1.6 m person: 0.75 m; not a shadow
        False,
    ),
)


# Somebody on the floor, who is lower than any tree allows: a chest is 20 cm deep, a shadow has no depth.
_LOW_M = 0.2
# Of somebody who was lying when first seen less is known: long, and not as flat as a door leaf.
_LYING_IS_PERSON = Split(
    "weight_kg",
    25.0,
    False,
    Split(
        "top_m",
        0.75,
        Split("box_max_m", 1.0, False, Split("box_min_m", 0.25, False, True)),  # stretched out, at any angle
        False,
    ),
)

# Across the box of somebody of 1.6 m with his knees drawn up; chairs, bags and what people carry are shorter.
_STRETCHED_M = 1.2

TREES = ("wide", "trained")
_TRAINED = Path(__file__).with_name("person_tree.toml")


def person_tree(name: str) -> Split | bool:
    """A tree by name: `wide`, PERSON_TREE, or `trained`, which comes with the package as a data file.

    Raises ValueError for another name, or where the file is missing.
    """
    if name == "wide":
        return PERSON_TREE
    if name != "trained":
        raise ValueError(f"tree must be one of {', '.join(TREES)}, got {name!r}")
    if not _TRAINED.exists():
        raise ValueError(f"there is no trained tree: {_TRAINED.name} is missing; use wide")
    return read_person_tree(_TRAINED)


def read_person_tree(path: Path) -> Split | bool:
    """The tree of a TOML file: a list of `node` tables, the root first.

    feature, threshold : of `Split`.  below, above : true, false, or the number of a later node.
    Raises ValueError for a feature that there is not, a number that is none, or a node that leads back.
    """
    nodes = tomllib.loads(path.read_text("utf-8")).get("node", [])

    def end(value: object, parent: int) -> Split | bool:
        if isinstance(value, bool):
            return value
        if not isinstance(value, int) or not parent < value < len(nodes):
            raise ValueError(
                f"{path.name}: node {parent} leads to {value!r}, expected true, false or a later node"
            )
        return split(value)

    def split(i: int) -> Split:
        node = nodes[i]
        if node.get("feature") not in FEATURES:
            raise ValueError(
                f"{path.name}: node {i}: feature is {node.get('feature')!r}, known are {', '.join(FEATURES)}"
            )
        threshold = node.get("threshold")
        if (
            isinstance(threshold, bool)
            or not isinstance(threshold, int | float)
            or not math.isfinite(threshold)
        ):
            raise ValueError(f"{path.name}: node {i}: threshold is {threshold!r}, expected a number")
        return Split(node["feature"], float(threshold), end(node.get("below"), i), end(node.get("above"), i))

    if not nodes:
        raise ValueError(f"{path.name}: there is no node")
    return split(0)


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
    return features_of(
        len(c), float(columns[2].mean()), columns.min(axis=1), columns.max(axis=1), voxel_size_m
    )


def is_person(features: BlobFeatures, tree: Split | bool = PERSON_TREE) -> bool:
    """The verdict of the decision tree; an empty blob or a NaN feature is no person.

    Source: CF 4.2.3 (Figure 4.4: tree over weight, height and bounding box). Departs from it:
    PERSON_TREE, the default, is set by hand; a trained one is `person_tree("trained")`.
    """
    node = tree
    while isinstance(node, Split):
        value = getattr(features, node.feature)
        if np.isnan(value):
            return False
        node = node.below if value < node.threshold else node.above
    return node


def may_be_low(features: BlobFeatures) -> bool:
    """Whether a blob could be somebody on the floor whom one knows already: no shadow, and not the whole room."""
    is_thick = features.height_m >= _LOW_M and features.top_m - features.height_m < 0.35
    return is_thick and features.weight_kg < MOST_KG and is_person(features, _BOX_IS_PERSON)


def may_lie(features: BlobFeatures) -> bool:
    """Whether a blob could be somebody who lies on the floor, of whom nothing else is known."""
    return may_be_low(features) and is_person(features, _LYING_IS_PERSON)


def is_stretched_out(features: BlobFeatures) -> bool:
    """Whether a blob could be a grown-up person who lies, rather than a thing that somebody has put down."""
    return may_lie(features) and math.hypot(features.box_max_m, features.box_min_m) >= _STRETCHED_M


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
    component_of: NDArray[np.int32]
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
        return features_of(n, z, self.lower[k], self.upper[k], self.voxel_size_m)


def components_of(centers: Array, labels: NDArray[np.integer], voxel_size_m: float) -> Components:
    """Group voxels by label and measure every group.

    centers : (N, 3) m.  labels : (N,) int, any numbering, negative = ignore. N = 0 gives an empty table.
    Source: CF Eq. 4.1, Table 4.1.
    """
    points = np.ascontiguousarray(centers, dtype=np.float64)
    plain = np.ascontiguousarray(labels)
    highest = int(plain.max()) if len(plain) else -1
    if highest > 10 * len(plain) + 1000:
        # Numbers far above the number of voxels: a table by label would not fit into memory.
        _, inverse = np.unique(plain, return_inverse=True)
        plain = np.where(plain < 0, -1, inverse.reshape(-1))
        highest = int(plain.max())
    size_of = np.zeros(highest + 1 if highest >= 0 else 0, dtype=np.int64)
    _kernels.count_labels(plain, size_of)
    used = size_of > 0
    rank = np.cumsum(used) - 1
    count = size_of[used]
    start = np.r_[0, np.cumsum(count)].astype(np.int64)
    order = np.empty(start[-1], dtype=np.int64)
    component_of = np.empty(len(plain), dtype=np.int32)
    _kernels.group_by_label(plain, rank, start, order, component_of)
    mean, lower, upper = (np.empty((len(count), 3)) for _ in range(3))
    _kernels.measure_groups(points, order, start, mean, lower, upper)
    return Components(
        order=order,
        start=start,
        centroid=mean,
        lower=lower,
        upper=upper,
        weight_kg=weight_kg(1, voxel_size_m) * count.astype(np.float64),
        component_of=component_of,
        voxel_size_m=voxel_size_m,
    )


def measure_voxels(
    centers: Array, voxels: NDArray[np.int64], voxel_size_m: float
) -> tuple[BlobFeatures, Array, Array]:
    """Features, centroid (3,) m and bounding box (2, 3) m of some voxels, by row of centers (N, 3).

    The box is that of the centres. None give weight 0 and NaN elsewhere.  Source: CF Eq. 4.5, Table 4.1.
    """
    if not len(voxels):
        nothing = BlobFeatures(0.0, np.nan, np.nan, np.nan, np.nan, np.nan)
        return nothing, np.full(3, np.nan), np.full((2, 3), np.nan)
    mean, lower, upper = (np.empty((1, 3)) for _ in range(3))
    start = np.array([0, len(voxels)], dtype=np.int64)
    _kernels.measure_groups(centers, voxels, start, mean, lower, upper)
    features = features_of(len(voxels), float(mean[0, 2]), lower[0], upper[0], voxel_size_m)
    return features, mean[0], np.concatenate([lower, upper])


def weight_kg(n_voxels: int, voxel_size_m: float) -> float:
    """Weight of n voxels of flesh. Source: CF Table 4.1."""
    return n_voxels * voxel_size_m**3 * 1000.0 * BODY_DENSITY_KG_PER_LITRE


def features_of(n: int, centroid_z: float, lower: Array, upper: Array, side: float) -> BlobFeatures:
    """Features of n voxels of a side in m: mean height of their centres, lowest and highest of them, (3,) m."""
    extent = upper - lower + side
    return BlobFeatures(
        weight_kg=weight_kg(n, side),
        centroid_z_m=centroid_z,
        top_m=float(upper[2] + side / 2),
        height_m=float(extent[2]),
        box_max_m=float(max(extent[0], extent[1])),
        box_min_m=float(min(extent[0], extent[1])),
    )
