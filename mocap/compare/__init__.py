"""`mocap eval`: an estimate against a truth, as numbers, page and pictures."""

from mocap.compare.comparison import Comparison, compare
from mocap.compare.detail import Action, detailed_scores
from mocap.compare.figures import write_page
from mocap.compare.match import Pair, associate_persons, matched_pairs
from mocap.compare.options import CompareOptions
from mocap.compare.run_scores import score_run
from mocap.compare.scores import evaluate

__all__ = [
    "Action",
    "CompareOptions",
    "Comparison",
    "Pair",
    "associate_persons",
    "compare",
    "detailed_scores",
    "evaluate",
    "matched_pairs",
    "score_run",
    "write_page",
]
