"""Command line of the benchmark: table, --json, --only PATTERN, --compare, --gate, --write-baseline."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from eval.bench.registry import Skip, load_measures, select
from eval.whole import write_text

BASELINE = Path(__file__).with_name("baseline.json")


def main(argv: list[str] | None = None) -> int:
    """Run the measures and print them; 2 when no measure has such a name, 1 when one fails the gate."""
    parser = argparse.ArgumentParser(prog="python -m eval.bench", description=__doc__)
    parser.add_argument("--json", action="store_true", help="print one JSON object instead of a table")
    parser.add_argument("--only", metavar="PATTERN", help="measures whose name contains or matches PATTERN")
    parser.add_argument("--compare", action="store_true", help="add the ratio to the committed baseline")
    parser.add_argument(
        "--gate",
        action="store_true",
        help="compare, and end with 1 when a value is worse than the baseline by more than its tolerance",
    )
    parser.add_argument("--write-baseline", action="store_true", help="put the values into baseline.json")
    parser.add_argument("--list", action="store_true", help="print the names and stop")
    options = parser.parse_args(argv)
    measures = select(load_measures(), options.only)
    if not measures:
        print(f"no measure is named like {options.only!r}; --list shows the names", file=sys.stderr)
        return 2
    if options.list:
        print("\n".join(m.name for m in measures))
        return 0
    import cv2

    # One thread, so that figures do not depend on what the other cores are doing.
    cv2.setNumThreads(1)
    baseline = json.loads(BASELINE.read_text()) if BASELINE.exists() else {}
    results: dict[str, dict[str, float | str]] = {}
    failed: list[str] = []
    for m in measures:
        value = m.run()
        if isinstance(value, Skip):
            print(f"{m.name}: skipped, {value.reason}", file=sys.stderr)
            continue
        results[m.name] = {
            "value": round(float(value), 4),
            "unit": m.unit,
            "better": m.better,
            "tolerance": m.tolerance,
        }
        if (options.compare or options.gate) and m.name in baseline:
            known = baseline[m.name]["value"]
            results[m.name]["of_baseline"] = round(float(value) / known, 3)
            if options.gate and not m.passes(float(value), known):
                failed.append(
                    f"{m.name}: {m.worsening(float(value), known):.1f} times worse than the baseline"
                )
        if not options.json:
            print(_row(m.name, results[m.name]), flush=True)
    if options.json:
        print(json.dumps(results, indent=1))
    if options.write_baseline:
        baseline.update(
            {k: {x: v[x] for x in ("value", "unit", "better", "tolerance")} for k, v in results.items()}
        )
        write_text(BASELINE, json.dumps(dict(sorted(baseline.items())), indent=1) + "\n")
    for line in failed:
        print(line, file=sys.stderr)
    return 1 if failed else 0


def _row(name: str, result: dict[str, float | str]) -> str:
    text = f"{name:28s} {result['value']:>12} {result['unit']:<6} {result['better']} is better"
    if "of_baseline" in result:
        text += f"   {result['of_baseline']} x baseline"
    return text


if __name__ == "__main__":
    sys.exit(main())
