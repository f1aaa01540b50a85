"""Every promise of docs/reliability.md: its tests are run and counted, and the page is written.

    python -m eval.reliability                 # all promises; ten minutes of one core
    python -m eval.reliability --only store    # those whose key holds this; the others keep their counts
    python -m eval.reliability --page          # the page alone, from the tables that are there

Writes eval/results/reliability.csv and the marked parts of docs/reliability.md, which also show the tables of
`python -m eval.fault_table`.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from eval.whole import write_csv, write_text

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "eval" / "results"
TABLE, PAGE = RESULTS / "reliability.csv", ROOT / "docs" / "reliability.md"
FIELDS = ("key", "tests", "passed", "failed", "skipped")


@dataclass(frozen=True)
class Promise:
    """What is promised, how it is tried, and the tests that try it.

    is_slow : whether its tests are among those that `make test` leaves out.
    """

    key: str
    text: str
    how: str
    tests: tuple[str, ...]
    is_slow: bool = False


PROMISES = (
    Promise(
        "store-flips",
        "A store that was damaged says so, and which stage to run again",
        "10,000 single bits turned in the files of a product, one at a time; silent, traceback or hang is a failure",
        ("tests/io/test_store_damage.py::test_ten_thousand_bits",),
        is_slow=True,
    ),
    Promise(
        "store-damage",
        "So does one with files that are cut, gone, empty, exchanged, or of another run",
        "every file of a product; offsets that do not follow each other",
        ("tests/io/test_store_damage.py",),
    ),
    Promise(
        "power-cut",
        "After a power cut there are old or new products and outputs, nothing in between",
        "what was not brought to the disk is dropped; every file of a product lost once",
        (
            "tests/io/test_store_damage.py::test_a_product_is_on_the_disk_before_it_takes_its_place",
            "tests/io/test_store_damage.py::test_outputs_are_on_the_disk_before_they_take_their_places",
            "tests/io/test_store_damage.py::test_a_cut_that_loses_a_file_of_a_product_is_never_silent",
        ),
    ),
    Promise(
        "one-folder",
        "All outputs in a folder are of one run, and one command at a time works there",
        "formats left out, shorter runs, failed and killed publications, mixed stores and tables, locks held and left",
        ("tests/pipeline/test_one_output_folder.py",),
    ),
    Promise(
        "outside",
        "No command puts results into a session, where the next run would take them for input",
        "eleven commands that take `-o`, in three places of a session, by links, with the session known or not",
        ("tests/pipeline/test_outside.py",),
    ),
    Promise(
        "kills",
        "A run that is killed at any instant goes on to the bytes of one that never was",
        "12 kills of a run that goes on from each, outputs and store compared",
        ("tests/pipeline/test_kills.py",),
        is_slow=True,
    ),
    Promise(
        "pieces",
        "A recording run in pieces and joined is the run of the whole but for the smoothing window",
        "two people whose numbers are exchanged in the later piece; pieces of others, gaps, other settings",
        ("tests/pipeline/test_join.py",),
    ),
    Promise(
        "long",
        "A long recording takes no more memory nor disk for its pictures, and says how long it will take",
        "scene and report of more frames than they show; lines of progress",
        (
            "tests/pipeline/test_one_output_folder.py::test_of_a_long_recording_the_scene_shows_every_so_many_frames",
            "tests/cli/test_cluster_words.py::test_the_time_left_is_that_of_what_was_done_since_the_stage_began",
        ),
    ),
    Promise(
        "keys",
        "A product is reused only for what it was made of; `--rehash` distrusts even the file system",
        "every setting, fact, file and camera changed, one at a time",
        ("tests/pipeline/test_stage_keys.py",),
    ),
    Promise(
        "fail-early",
        "What would cost a computed run is found before the first stage; a failed export costs no other file",
        "damaged truth, absurd settings, folders in the way, names that are no UTF-8, signals",
        ("tests/pipeline/test_early_failures.py",),
    ),
    Promise(
        "memory",
        "Too little memory ends in one message",
        "limits from 60 to 700 MB, and what Python, OpenCV, threads and libraries that are loaded say of it",
        (
            "tests/cli/test_program.py::test_a_limit_of_memory_below_what_libraries_take_is_told",
            "tests/cli/test_program.py::test_whoever_runs_out_of_memory_reads_so",
        ),
    ),
    Promise(
        "strangers",
        "Whatever a file holds, reading it ends in a value or in one message",
        "10,000 damaged files of 49 kinds",
        (
            "tests/io/test_files_from_strangers.py::"
            "test_ten_thousand_damaged_files_of_every_kind_give_a_value_or_a_message",
        ),
        is_slow=True,
    ),
    Promise(
        "former-failures",
        "What once failed does not fail again",
        "pipes, bombs, nesting, digits, headers, crashes of parsers, senseless numbers",
        ("tests/io/test_files_from_strangers.py",),
    ),
    Promise(
        "cameras",
        "Cameras that lie are named: those that change, and those whose calibration is wrong from the start",
        "faults put into silhouettes; whole runs in the tables below, which also tell what is missed",
        ("tests/volume/test_camera_faults.py", "tests/volume/test_rig_agreement.py"),
    ),
    Promise(
        "uncertainty",
        "What the run could not know shows in one score, `silent_error_percent`",
        "errors flagged, in and outside their regions; its goals, and those of regions, are missed as told below",
        ("tests/metrics/test_volume_and_coverage.py", "tests/compare/test_evaluate.py"),
    ),
    Promise(
        "places",
        "Unwritable homes, folders with umlauts, ASCII locales and other systems are met",
        "kernels in a private folder, C3D under LC_ALL=C, modules of one system blocked",
        ("tests/test_portable.py", "tests/cli/test_doctor_and_bundle.py"),
    ),
)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m eval.reliability", description=__doc__)
    parser.add_argument("--only", default="", help="promises whose key holds this")
    parser.add_argument("--page", action="store_true", help="run no tests")
    options = parser.parse_args(argv)
    for promise in PROMISES:
        if not options.page and options.only in promise.key:
            row = counted(promise)
            print(row, flush=True)
            # Written at once: what was counted stays when the command is stopped.
            rows = {known["key"]: known for known in _rows(TABLE)} | {promise.key: row}
            write_csv(TABLE, FIELDS, [rows[p.key] for p in PROMISES if p.key in rows])
    write_text(PAGE, page(PAGE.read_text(encoding="utf-8")))
    return int(any(int(row["failed"]) for row in _rows(TABLE)))


def counted(promise: Promise) -> dict[str, str]:
    """Run the tests of a promise in a process of their own, and count them."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        marks = ["-m", "slow" if promise.is_slow else "not slow"]
        pytest = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", f"--junitxml={report}"]
        subprocess.run([*pytest, *marks, *promise.tests], cwd=ROOT, check=False)
        suite = ElementTree.parse(report).getroot().find("testsuite")
    assert suite is not None
    n = {name: int(suite.attrib[name]) for name in ("tests", "failures", "errors", "skipped")}
    failed = n["failures"] + n["errors"]
    return {
        "key": promise.key,
        "tests": str(n["tests"]),
        "passed": str(n["tests"] - failed - n["skipped"]),
        "failed": str(failed),
        "skipped": str(n["skipped"]),
    }


def page(text: str) -> str:
    """The page with its marked parts written anew."""
    parts = {
        "promises": promise_table(),
        "faults development": fault_table(RESULTS / "fault_table_development.csv"),
        "faults test": fault_table(RESULTS / "fault_table_test.csv"),
        "healthy": healthy_table(RESULTS / "healthy_cameras.csv"),
    }
    for name, written in parts.items():
        begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
        if begin in text and written:
            before, _, rest = text.partition(begin)
            _, _, after = rest.partition(end)
            text = f"{before}{begin}\n{written}\n{end}{after}"
    return text


def promise_table() -> str:
    """Promise, how it is tried, test, counts."""
    rows = {row["key"]: row for row in _rows(TABLE)}
    lines = ["| promise | tried with | tests | passed | failed |", "|---|---|---|---|---|"]
    for promise in PROMISES:
        row = rows.get(promise.key, {})
        tests = ", ".join(f"`{test}`" for test in promise.tests)
        cells = (promise.text, promise.how, tests, row.get("passed", ""), row.get("failed", ""))
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def fault_table(path: Path) -> str:
    """Fault, whether it was found and who was named, and the mean error."""
    lines = [
        "| fault | cameras | moves people by | found | named | others blamed "
        "| mean error, mm: healthy, ignored, handled | coverage, % |",
        "|---|---|---|---|---|---|---|---|",
    ]
    rows = _rows(path)
    for row in rows:
        errors = ", ".join(row[key] or "-" for key in ("healthy_mm", "ignored_mm", "handled_mm"))
        told = f"{_yes(row['is_found'])} | {_yes(row['is_right'])} | {row['false_alarms']}"
        held = row["handled_coverage_90_percent"] or "-"
        lines.append(f"| {row['fault']} | {row['cameras']} | {_moved(row)} | {told} | {errors} | {held} |")
    return "\n".join(lines) if rows else ""


def _moved(row: dict[str, str]) -> str:
    return f"{row['moves_px']} px, {row['misses_mm']} mm" if row.get("moves_px") else ""


def healthy_table(path: Path) -> str:
    """Picture size, sessions, false alarms."""
    rows = _rows(path)
    widths = sorted({int(row["session"].rpartition("_")[2]) for row in rows}, reverse=True)
    lines = ["| picture width, px | healthy sessions | false alarms |", "|---|---|---|"]
    for width in widths:
        own = [row for row in rows if row["session"].endswith(f"_{width}")]
        lines.append(f"| {width} | {len(own)} | {sum(int(row['false_alarms']) for row in own)} |")
    return "\n".join(lines) if rows else ""


def _yes(number: str) -> str:
    return "yes" if int(number) else "no"


def _rows(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


if __name__ == "__main__":
    sys.exit(main())
