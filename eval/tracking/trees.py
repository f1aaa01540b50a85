"""Decision trees as plain data: from scikit-learn to the TOML file that mocap.tracking reads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eval.tracking.blobs import FEATURES
from eval.whole import write_text
from mocap.tracking import BlobFeatures, Split, is_person

Array = NDArray[np.float64]
_HEAD = """# Is a component of the hull a person? Source: CF 4.2.3. Made by `python -m eval.tracking_classifier --write`
# from development scenes; {about}.
# Nodes by number, the root is 0. A feature of BlobFeatures below `threshold` leads to `below`, otherwise to `above`:
# the number of a node, or true = person, false = none.
"""


def as_split(tree: Any) -> Split | bool:
    """A fitted DecisionTreeClassifier over FEATURES whose classes are False and True.

    Thresholds are rounded to 3 decimals (grams, millimetres); branches that say the same are joined.
    """
    nodes = tree.tree_
    classes = list(tree.classes_)

    def node(i: int) -> Split | bool:
        if nodes.children_left[i] < 0:
            return bool(classes[int(np.argmax(nodes.value[i][0]))])
        below, above = node(nodes.children_left[i]), node(nodes.children_right[i])
        if isinstance(below, bool) and below is above:
            return below
        return Split(FEATURES[nodes.feature[i]], round(float(nodes.threshold[i]), 3), below, above)

    return node(0)


def verdicts(tree: Split | bool, features: Array) -> NDArray[np.bool_]:
    """What a tree says of (N, 6) features."""
    return np.array([is_person(BlobFeatures(*row), tree) for row in features.tolist()], dtype=np.bool_)


def n_leaves(tree: Split | bool) -> int:
    """Number of leaves."""
    return n_leaves(tree.below) + n_leaves(tree.above) if isinstance(tree, Split) else 1


def write_tree(tree: Split | bool, path: Path, about: str) -> None:
    """The tree as TOML; `mocap.tracking.features.read_person_tree` reads it."""
    blocks: list[str] = []

    def add(node: Split) -> int:
        number = len(blocks)
        blocks.append("")
        ends = [str(add(n)) if isinstance(n, Split) else str(n).lower() for n in (node.below, node.above)]
        blocks[number] = (
            f'[[node]]\nfeature = "{node.feature}"\nthreshold = {node.threshold!r}\n'
            f"below = {ends[0]}\nabove = {ends[1]}\n"
        )
        return number

    if not isinstance(tree, Split):
        raise ValueError("the tree has no split")
    add(tree)
    write_text(path, _HEAD.format(about=about) + "\n" + "\n".join(blocks))
