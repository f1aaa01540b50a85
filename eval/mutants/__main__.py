"""Try the mutants: each is planted in a copy of the checkout, and its tests must fail there.

python -m eval.mutants                  all of them (make mutants); exit code 1 below the wanted share; writes
                                        eval/results/mutants.csv; about 25 minutes on one core
python -m eval.mutants --only angles    those with this in their name or file

A run that was stopped goes on where it stopped, until a file of the checkout changes (out/eval/mutants.json).
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path

from eval.mutants.registry import ROOT, load_mutants
from eval.mutants.trial import RESULTS_NAME, checkout_digest, try_all
from eval.whole import write_csv, write_text

WANTED_SHARE = 0.95
RESULTS = ROOT / "eval" / "results" / RESULTS_NAME
STORE = ROOT / "out" / "eval" / "mutants.json"


def kept_of(digest: str, store: Path = STORE) -> dict[str, bool]:
    """What an earlier run found out about the mutants of the same checkout: name -> noticed."""
    found = json.loads(store.read_text("utf-8")) if store.exists() else {}
    return found["noticed"] if found.get("of") == digest else {}


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
    digest = checkout_digest()
    kept = kept_of(digest)
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        try_all(
            mutants,
            Path(folder),
            kept,
            lambda: write_text(STORE, json.dumps({"of": digest, "noticed": kept})),
        )
    survivors = [m.name for m in mutants if not kept[m.name]]
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
