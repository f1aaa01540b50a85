"""Try the mutants: each is planted in a copy of the checkout, and its tests must fail there.

python -m eval.mutants                  all of them (make mutants); exit code 1 below the wanted share; writes
                                        eval/results/mutants.csv; about 25 minutes on one core
python -m eval.mutants --only angles    those with this in their name or file
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from eval.mutants.registry import ROOT, load_mutants
from eval.mutants.trial import try_all
from eval.whole import write_csv

WANTED_SHARE = 0.95
RESULTS = ROOT / "eval" / "results" / "mutants.csv"


def main(arguments: list[str] | None = None) -> int:
    """Print who was killed and who survived."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", default="", help="part of a mutant's name or file")
    wanted = parser.parse_args(arguments).only
    mutants = [m for m in load_mutants() if wanted in m.name or wanted in m.file]
    problems = [p for m in mutants for p in m.problems()]
    if problems or not mutants:
        print("\n".join(problems or [f"no mutant is named like {wanted!r}"]))
        return 2
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        survivors = try_all(mutants, Path(folder))
    killed = len(mutants) - len(survivors)
    if not wanted:
        lines = [
            {"mutant": m.name, "file": m.file, "noticed": "no" if m.name in survivors else "yes"}
            for m in mutants
        ]
        write_csv(RESULTS, ("mutant", "file", "noticed"), lines)
    print(f"{killed} of {len(mutants)} killed; survivors: {', '.join(survivors) or 'none'}")
    return 0 if killed >= WANTED_SHARE * len(mutants) else 1


if __name__ == "__main__":
    raise SystemExit(main())
