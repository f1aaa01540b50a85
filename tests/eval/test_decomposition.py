"""The comparison harness: equal evaluations, paired ratios, rows that survive a stop, failures that stay alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from eval.decomposition import published, store
from eval.decomposition.cells import KEY_FIELDS, VALUE_FIELDS, Cell, RunKey, SceneKey, run_scene, scene_of
from eval.decomposition.statistics import group, ratio_of_means, share_that_holds
from eval.decomposition.store import append_rows, missing, read_rows, run_cells
from eval.decomposition.tables import Seeds, Table, result_lines
from eval.decomposition_sw_tables import several_objects, sweep_table
from eval.decomposition_xn_6 import N_CLUTTER, clutter_table
from mocap.data.problem import StateLayout
from mocap.filters import FILTERS

TINY = SceneKey("sw", 2, 3, n_frames=6)
FEW = Seeds(scenes=(0,), runs=(0, 1), n_workers=1, is_full=False, n_frames=5)


def row(scene: int, run: int, error: float, status: str = "ok") -> dict[str, str]:
    cell = Cell(SceneKey("sw", 4, 3, seed=scene), RunKey("ps", 50, seed=run))
    return cell.key() | dict.fromkeys(VALUE_FIELDS, "") | {"error_px": str(error), "status": status}


@pytest.mark.parametrize("name", [n for n in FILTERS if n != "sir"])
def test_every_filter_spends_the_same_on_the_same_cell(name: str) -> None:
    """Within a particle per part of 48: budgets are whole numbers of particles."""
    found = run_scene(TINY, [RunKey(name, 48, layers) for layers in (2, 4)])
    for one in found:
        assert one["status"] == "ok", one
        assert float(one["evaluations"]) == pytest.approx(48, abs=1)


def test_a_cell_is_the_same_alone_and_beside_others() -> None:
    together = run_scene(TINY, [RunKey("ps", 20), RunKey("sbps", 20), RunKey("sir", 20)])
    alone = run_scene(TINY, [RunKey("sbps", 20)])
    assert together[1]["error_px"] == alone[0]["error_px"]
    other = run_scene(TINY, [RunKey("sbps", 20, seed=1)])
    assert other[0]["error_px"] != alone[0]["error_px"]


def test_a_failed_run_leaves_the_others_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    calls = []

    def broken(*args: object, **kwargs: object) -> None:
        calls.append(1)
        raise FloatingPointError("no\nmore")

    monkeypatch.setitem(FILTERS, "ps", replace(FILTERS["ps"], step=broken))
    found = run_scene(TINY, [RunKey("ps", 20), RunKey("sbps", 20), RunKey("no such filter", 20)])
    by_name = {one["filter"]: one for one in found}
    assert by_name["ps"]["status"] == "FloatingPointError: no more"
    assert by_name["ps"]["error_px"] == ""
    assert by_name["sbps"]["status"] == "ok"
    assert "no such filter" in by_name["no such filter"]["status"]
    assert len(calls) == 1


def test_one_filter_per_object_tracks_every_object() -> None:
    key = SceneKey("sw", 2, 2, n_objects=2, n_frames=8)
    whole, split = run_scene(key, [RunKey("ps", 100), RunKey("ps", 100, is_split=True)])
    assert float(split["evaluations"]) == pytest.approx(2 * float(whole["evaluations"]))
    n_corners = scene_of(key).tree.n_corners
    assert float(split["error_px"]) < 5 * n_corners
    assert float(whole["error_px"]) < 5 * n_corners


def test_clutter_leaves_the_motion_of_a_cell_as_it_is() -> None:
    plain, noisy = scene_of(SceneKey("xn6", 4, 3)), scene_of(SceneKey("xn6", 4, 3, n_clutter=7))
    np.testing.assert_array_equal(plain.states, noisy.states)
    assert np.count_nonzero(noisy.background) > 0


def test_results_are_kept_and_only_missing_cells_are_computed(tmp_path: Path) -> None:
    path = tmp_path / "cells.csv"
    cells = [Cell(TINY, RunKey("sir", 10, seed=s)) for s in range(3)]
    first = run_cells(cells[:2], n_workers=1, path=path)
    text = path.read_text()
    again = run_cells(cells[:2], n_workers=1, path=path)
    assert again == first
    assert path.read_text() == text
    assert missing(cells, path) == {TINY: [cells[2].run]}
    # A process killed in mid-write leaves half a line: that cell is computed again, the others are not.
    path.write_text(text[: len(text) - 15])
    assert missing(cells[:2], path) == {TINY: [cells[1].run]}
    rows = run_cells(cells[:2], n_workers=1, path=path)
    assert [r["error_px"] for r in rows] == [r["error_px"] for r in first]
    assert len(read_rows(path)) == 2


def test_failed_cells_are_tried_again_and_their_message_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "cells.csv"
    cell = Cell(TINY, RunKey("sir", 10))
    append_rows([cell.key() | dict.fromkeys(VALUE_FIELDS, "") | {"status": "boom"}], path)
    assert missing([cell], path) == {TINY: [cell.run]}
    assert run_cells([cell], n_workers=1, path=path)[0]["status"] == "ok"
    assert missing([cell], path) == {}


def test_processes_give_what_one_process_gives(tmp_path: Path) -> None:
    cells = [Cell(SceneKey("sw", 1, 2, seed=s, n_frames=3), RunKey("sir", 10)) for s in (0, 1)]
    alone = run_cells(cells, n_workers=1, path=tmp_path / "a.csv")
    spread = run_cells(cells, n_workers=2, path=tmp_path / "b.csv")
    assert [r["error_px"] for r in alone] == [r["error_px"] for r in spread]


def test_a_cluster_gives_what_one_process_gives(tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason="needs the extra `cluster`")
    cells = [Cell(SceneKey("sw", 1, 2, seed=s, n_frames=3), RunKey("sir", 10)) for s in (0, 1)]
    alone = run_cells(cells, n_workers=1, path=tmp_path / "a.csv")
    with distributed.Client(
        processes=False, n_workers=1, threads_per_worker=1, dashboard_address=None
    ) as client:
        address = client.scheduler_info()["address"]
        spread = run_cells(cells, n_workers=1, scheduler=address, path=tmp_path / "b.csv")
    assert [r["error_px"] for r in alone] == [r["error_px"] for r in spread]
    assert all(r["status"] == "ok" for r in spread)


def test_mean_and_spread_by_hand() -> None:
    rows = [row(0, 0, 10), row(0, 1, 14), row(1, 0, 30), row(1, 1, 34), row(1, 2, 0, status="lost")]
    g = group(rows)
    assert (g.n, g.n_failed, g.mean) == (4, 1, 22.0)
    # Within scenes both deviate by +-2: variance 8 + 8 over 2 degrees of freedom.
    assert g.std_in_scene == pytest.approx(np.sqrt(8.0))
    assert g.std == pytest.approx(np.std([10, 14, 30, 34], ddof=1))


def test_ratios_are_paired_and_their_interval_holds_them() -> None:
    """Scenes differ by a factor of ten and the ratio is 0.8 in each: pairing makes that certain."""
    better = [row(s, r, 0.8 * 10.0**s * (1 + 0.01 * r)) for s in range(3) for r in range(2)]
    worse = [row(s, r, 10.0**s * (1 + 0.01 * r)) for s in range(3) for r in range(2)]
    found = ratio_of_means(better, worse)
    assert found.ratio == pytest.approx(0.8)
    assert found.low == pytest.approx(0.8)
    assert found.high == pytest.approx(0.8)
    assert found.verdict == "yes"
    assert ratio_of_means(worse, better).verdict == "no"
    assert ratio_of_means(better[:1], worse[2:]).n == 0


def test_the_bootstrap_interval_covers_the_truth_at_about_its_level() -> None:
    """Of 200 intervals for a true ratio of 0.9 over 20 runs: 95 % wanted, bootstrap of 20 gives about 92 %."""
    rng = np.random.default_rng(0)
    covered = 0
    for _ in range(200):
        a, b = 90 * rng.lognormal(0, 0.3, 20), 100 * rng.lognormal(0, 0.3, 20)
        found = ratio_of_means(
            [row(0, i, x) for i, x in enumerate(a)], [row(0, i, x) for i, x in enumerate(b)]
        )
        covered += found.low <= 0.9 <= found.high
    assert 175 <= covered <= 198


def test_tables_claim_what_is_printed() -> None:
    assert published.SW_TABLE_1["sbps", 600, 7] == (612, 11)
    assert published.SW_TABLE_2["ps", 50, 9] == (485, 19)
    assert published.XN_TABLE_6_1["HAPSOPF", 4, 4, 50, True] == (204, 39)
    assert published.XN_TABLE_6_1["APF", 7, 5, 200, False] == (278, 4)
    assert published.XN_TABLE_5_1["combinatorial", 8, 4, 600] == 22.3
    full = Seeds((0,), (0,), 1, is_full=True)
    one = sweep_table(1, full)
    assert len(one.cells) == 5 * 3 * 2
    assert one.pairs(("7", "600")) == [("SBPS", "PS", 612 / 767)]
    three = several_objects(full)
    assert ("1 SBPS", "1 PS", 242 / 611) in three.pairs(("3",))
    # XN: "HAPSOPF is best in 15 of 16 cells"; 79 of the 80 orders, HPSO ties in one.
    six = clutter_table(full)
    orders = [p for a, k in ((4, 4), (5, 5), (6, 4), (7, 5)) for c in (0, N_CLUTTER) for n in (200, 800)
              for p in six.pairs((str(a), str(k), str(c), str(n)))]  # fmt: skip
    assert len(orders) == 79


def test_a_small_table_runs_from_end_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import eval.decomposition.tables as tables

    monkeypatch.setattr(tables, "RESULTS", tmp_path)
    monkeypatch.setattr(store, "RESULTS", tmp_path)
    table = several_objects(FEW)
    table = tables.Table(
        table.name,
        [c for c in table.cells if c.scene.n_objects == 2],
        table.cell_fields,
        table.pairs,
        table.published,
        table.name_of,
    )
    claims = tables.run_tables("test", [table], FEW, store=tmp_path / "cells.csv")
    assert len(claims) == 8
    n, holds, yes, no = share_that_holds(claims)
    assert n == 8
    assert yes + no <= n
    assert yes <= holds
    lines = tables.read_csv(tmp_path / "decomposition_test.csv")
    assert {line["method"] for line in lines} == {
        "1 PS", "M PS", "M PS/100", "1 SBPS", "M SBPS", "M SBPS/100"
    }  # fmt: skip
    assert next(line for line in lines if line["method"] == "1 SBPS")["published_px"] == "211"
    assert all(line["runs"] == "2" and line["failed"] == "0" for line in lines)
    assert len(tables.read_csv(tmp_path / "decomposition_test_ranking.csv")) == 8
    assert "of 8 orders hold" in tables.summary(claims)


def test_lines_without_results_stay_empty() -> None:
    table = sweep_table(1, FEW)
    cell = table.cells[0]
    rows = [cell.key() | dict.fromkeys(VALUE_FIELDS, "") | {"status": "lost"}]
    (line,) = result_lines(table, rows)
    assert (line["runs"], line["failed"], line["error_px"]) == ("0", "1", "")
    assert set(KEY_FIELDS) <= set(cell.key())


@dataclass(frozen=True, eq=False)
class NearTruth:
    """A Gaussian around one state, the same for every part."""

    layout: StateLayout
    truth: np.ndarray

    def propagate(self, particles: np.ndarray, std: np.ndarray, *, rng: np.random.Generator) -> np.ndarray:
        moved = particles + std * rng.standard_normal(particles.shape)
        return np.clip(moved, self.layout.lower, self.layout.upper)

    def log_likelihood(
        self, particles: np.ndarray, parts: Sequence[int] | None = None, given: Sequence[int] = ()
    ) -> np.ndarray:
        chosen = range(self.layout.n_parts) if parts is None else parts
        misfit = -50.0 * (particles - self.truth) ** 2
        return np.stack([misfit[:, self.layout.columns_of(p)].sum(axis=1) for p in chosen], axis=1)


def test_all_filters_run_on_a_body_with_equal_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    from eval.decomposition_3d import Clip, track_all
    from mocap.body import landmarks_of, load_body_model, neutral_state, scale_body

    def broken(*args: object, **kwargs: object) -> None:
        raise ValueError("not today")

    monkeypatch.setitem(FILTERS, "pso", replace(FILTERS["pso"], step=broken))
    body = scale_body(load_body_model("anthropometric"), 1.7)
    truth = neutral_state(body)
    problem = NearTruth(body.layout, truth)
    clip = Clip(
        problems={"toy": lambda row: problem},
        bodies={"toy": body},
        truth=np.repeat(landmarks_of(body, truth[None]), 3, axis=0),
        start=truth,
        std=0.02 * np.ones(body.layout.n_columns),
    )
    lines = {line["method"]: line for line in track_all(clip, "toy", [64], 2)}
    assert len(lines) == len(FILTERS)
    assert lines["PSO"]["note"] == "ValueError: not today"
    assert lines["PSO"]["error_mm"] == ""
    for method, line in lines.items():
        if method != "PSO":
            assert float(line["error_mm"]) < 100.0, line
            # A whole particle more or less per frame.
            assert float(line["spent"]) == pytest.approx(64, abs=4), line


def test_the_page_is_written_from_the_tables(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import eval.decomposition.pictures as pictures
    import eval.decomposition.tables as tables
    import eval.decomposition_page as pages

    for module in (tables, pages, pictures):
        monkeypatch.setattr(module, "RESULTS", tmp_path)
    table = sweep_table(2, FEW)
    # One point of the sweep, so that the test stays short.
    small = [c for c in table.cells if c.scene.n_arms == 3 and c.run.n_evaluations == 50]
    table = tables.Table(table.name, small, table.cell_fields, table.pairs, table.published, x="n_arms")
    claims = tables.run_tables("sw", [table], FEW, store=tmp_path / "cells.csv")
    assert pictures.picture_of("sw", [table]).read_bytes().startswith(b"\x89PNG")
    text = pages.page()
    assert "SW Table 2" in text
    assert "*(150 ± 10)*" in text
    assert "| SBPS < PS | 1 |" in text
    assert f"{claims[0].ours.ratio:.2f} to {claims[0].ours.ratio:.2f} | 0.74 to 0.74" in text


def test_the_page_says_where_orders_of_the_sources_hold() -> None:
    import eval.decomposition_page as pages

    base = {
        "better": "SBPS",
        "worse": "PS",
        "table": "own",
        "runs": "10",
        "low": "",
        "high": "",
        "published": "",
    }
    lines = [
        base | {"cell": f"world={w}, |P_j|={a}, K={k}, N=50", "ratio": r, "verdict": v}
        for (a, k), w, r, v in (
            ((4, 3), "sw_slow", "0.800", "yes"),
            ((8, 4), "sw_slow", "1.100", "no"),
            ((4, 3), "sw", "0.950", "open"),
        )
    ]
    (row,) = [line for line in pages.by_regime(lines) if line.startswith("| SBPS < PS")]
    assert "| 1 of 1 (0 / 0), 0.95 to 0.95 | 1 of 2 (1 / 1), 0.80 to 1.10 |" in row
    text = "\n".join(pages.answer(lines, lines))
    assert "**2 of 3 published orders hold" in text
    assert (
        "1 of those that hold and\n1 of those that fail are decided by the 10 runs of their cells, the other 1 lie"
        in text
    )
    assert "in 1 of 2 objects, 0.80 to 1.10" in text
    assert "**0.80** *1.10*" in "\n".join(pages.own_worlds(lines))


def test_kept_cells_are_compared_with_today_s_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from eval.decomposition_check import cell_of, main

    path = tmp_path / "cells.csv"
    cells = [
        Cell(SceneKey("sw", 2, 2, n_clutter=3, seed=4, n_frames=3), RunKey("sir", 10, resampling="residual")),
        Cell(SceneKey("xn6", 2, 3, n_objects=2, n_frames=3), RunKey("ps", 10, 2, is_split=True, seed=5)),
    ]
    rows = run_cells(cells, n_workers=1, path=path)
    assert [cell_of(row) for row in rows] == cells
    assert main(["--store", str(path)]) == 0
    append_rows([rows[1] | {"error_px": "0.001"}], path)
    assert main(["--store", str(path)]) == 1
    out = capsys.readouterr().out
    assert "2 of 2 worlds" in out
    assert f"xn6, ps: 0.001 px kept, {rows[1]['error_px']} px today" in out
    assert "1 of 2 worlds" in out


def test_a_check_of_nothing_fails(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from eval.decomposition_check import main

    assert main(["--store", str(tmp_path / "absent.csv")]) == 1
    assert "no cell" in capsys.readouterr().err


def test_many_cells_go_on_in_another_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(store, "_MOST_LINES", 2)
    keys = [Cell(TINY, RunKey("ps", n)).key() for n in range(20, 25)]
    rows = [key | dict.fromkeys(VALUE_FIELDS, "1.5") | {"status": "ok"} for key in keys]
    store.write_cells("one", rows, tmp_path)
    assert len(list(tmp_path.glob("*_cells.csv"))) == 3
    assert list(store.cells_of("one", tmp_path).values()) == rows
    store.write_cells("one", rows[:1], tmp_path)
    assert list(store.cells_of("one", tmp_path).values()) == rows[:1]


def test_committed_cells_need_no_computing_and_the_store_goes_first(tmp_path: Path) -> None:
    cells = [Cell(TINY, RunKey("ps", n)) for n in (20, 21)]
    rows = [c.key() | dict.fromkeys(VALUE_FIELDS, "1.5") | {"status": "ok"} for c in cells]
    store.write_cells("one", [*rows, rows[0], rows[1] | {"n_frames": "7", "status": "lost"}], tmp_path)
    assert len(read_rows(tmp_path / "decomposition_one_cells.csv")) == 2
    path = tmp_path / "cells.csv"
    append_rows([rows[1] | {"error_px": "2.5"}], path)
    known = store.known_rows(path, tmp_path)
    assert sorted(row["error_px"] for row in known.values()) == ["1.5", "2.5"]


def test_tables_that_are_not_run_stay_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import eval.decomposition.tables as tables

    monkeypatch.setattr(tables, "RESULTS", tmp_path)

    def table(name: str, n: int) -> Table:
        cells = FEW.cells(TINY, RunKey("ps", n)) + FEW.cells(TINY, RunKey("sbps", n))
        return Table(name, cells, ("n_evaluations",), lambda cell: [("SBPS", "PS", 0.5)], {})

    both = [table("first", 20), table("second", 22)]
    tables.run_tables("test", both, FEW, store=tmp_path / "cells.csv")
    files = [tmp_path / f"decomposition_test{end}.csv" for end in ("", "_ranking", "_cells")]
    before = [file.read_text() for file in files]
    again = tables.run_tables("test", both, replace(FEW, only=("second",)), store=tmp_path / "cells.csv")
    assert len(again) == 1
    assert [file.read_text() for file in files] == before
    other = [both[0], table("second", 24)]
    tables.run_tables("test", other, replace(FEW, only=("second",)), store=tmp_path / "cells.csv")
    changed = [file.read_text() for file in files]
    assert [line for line in changed[0].splitlines() if line.startswith("first")] == [
        line for line in before[0].splitlines() if line.startswith("first")
    ]
    assert "n_evaluations=24" in changed[0]
    assert "n_evaluations=22" not in changed[0]
    assert {row["n_evaluations"] for row in read_rows(files[2]).values()} == {"20", "24"}


def test_failing_orders_add_up() -> None:
    """Of the committed tables: what fails and what holds is all there is."""
    from eval.decomposition.tables import read_csv
    from eval.decomposition_page import SCRIPTS, failing

    claims = [c for name in SCRIPTS for c in read_csv(store.RESULTS / f"decomposition_{name}_ranking.csv")]
    known = [c for c in claims if c["verdict"] != "none"]
    rows = [line.strip("| ").split(" | ") for line in failing(claims)[2:]]
    holds = sum(float(c["ratio"]) < 1 for c in known)
    assert int(rows[-1][1]) == len(known) - holds == sum(int(row[1]) for row in rows[:-1])
    assert int(rows[-1][2]) == len(known) >= sum(int(row[2]) for row in rows[:-1])


def test_the_committed_tables_are_those_of_the_committed_cells() -> None:
    """Every line whose cells are committed, recomputed from them: errors, runs, ratios and verdicts."""
    from eval import (
        decomposition_as_printed,
        decomposition_own_worlds,
        decomposition_sw_tables,
        decomposition_xn_4,
        decomposition_xn_5,
        decomposition_xn_6,
    )
    from eval.decomposition.tables import claim_line, claims_of, read_csv, result_lines

    scripts = {
        "sw": decomposition_sw_tables.tables,
        "xn_4": decomposition_xn_4.tables,
        "xn_5": decomposition_xn_5.tables,
        "xn_6": decomposition_xn_6.tables,
        "as_printed": decomposition_as_printed.as_printed,
        "own_worlds": lambda seeds: [decomposition_own_worlds.own_worlds(seeds)],
    }
    timed = ("resampling_ms", "swapping_ms", "step_ms")
    checked = []
    for name, tables_of in scripts.items():
        cells = store.cells_of(name)
        lines = read_csv(store.RESULTS / f"decomposition_{name}.csv")
        orders = read_csv(store.RESULTS / f"decomposition_{name}_ranking.csv")
        is_own = name == "own_worlds"
        first, frames = (3000, 100) if is_own else (0, 150)
        for n_runs in sorted({int(line["runs"]) for line in lines}):
            seeds = Seeds(
                tuple(range(first, first + 5)), tuple(range(n_runs // 5)), 1, is_own, n_frames=frames
            )
            for table in tables_of(seeds):
                kept = [line for line in lines if line["table"] == table.name]
                keys = [tuple(cell.key().values()) for cell in dict.fromkeys(table.cells)]
                if not keys or any(key not in cells for key in keys):
                    continue
                if min(int(line["runs"]) for line in kept) != n_runs:
                    continue
                rows = [cells[key] for key in keys]
                again = result_lines(table, rows)
                for ours, theirs in zip(again, kept, strict=True):
                    assert {k: v for k, v in ours.items() if k not in timed} == {
                        k: v for k, v in theirs.items() if k not in timed
                    }
                claims = [claim_line(claim) for claim in claims_of(table, rows)]
                assert claims == [order for order in orders if order["table"] == table.name]
                checked.append(table.name)
    assert {"XN Table 6.1", "XN Figure 5-9", "XN Figure 5-12", "Own worlds, SW and XN 4-5"} <= set(checked)


def test_motion_apart_is_of_the_committed_cells() -> None:
    """Over all frames the orders are those of the tables; over either kind they are computed again for SW."""
    from eval.decomposition.tables import claim_line, read_csv
    from eval.decomposition_motion import COUNTS, SCRIPTS, claims_in, committed

    lines = read_csv(store.RESULTS / "decomposition_motion.csv")
    reported = [
        claim
        for name in SCRIPTS
        for claim in read_csv(store.RESULTS / f"decomposition_{name}_ranking.csv")
        if claim["verdict"] != "none"
    ]
    kept = {count: [dict(line) for line in lines if line["count"] == count] for count in COUNTS}
    assert [line | {"count": ""} for line in kept["all"]] == [claim | {"count": ""} for claim in reported]
    own = committed("sw")
    for count in COUNTS:
        again = [claim_line(claim) for table, rows in own for claim in claims_in(table, rows, count)]
        assert [{"count": count, **claim} for claim in again] == kept[count][: len(again)]


def test_motion_apart_uses_the_error_of_its_frames() -> None:
    from eval.decomposition_motion import claims_in

    table = Table("t", [], ("n_evaluations",), lambda cell: [("SBPS", "PS", 0.5)], {})
    rows = [
        Cell(SceneKey("sw", 4, 3), RunKey(name, 50)).key()
        | dict.fromkeys(VALUE_FIELDS, "")
        | {"error_px": whole, "error_weak_px": weak, "error_strong_px": strong, "status": "ok"}
        for name, whole, weak, strong in (("sbps", "3", "1", "8"), ("ps", "4", "2", "4"))
    ]
    ratios = [claims_in(table, rows, count)[0].ours.ratio for count in ("all", "weak", "strong")]
    assert ratios == [0.75, 0.5, 2.0]


def test_runs_that_agree_in_two_scenes_that_do_not_decide_nothing_about_others() -> None:
    from eval.decomposition.statistics import ratio_over_scenes

    one = [row(scene, run, error) for scene, error in ((0, 1.0), (1, 5.0)) for run in range(40)]
    two = [row(scene, run, 2.0) for scene in (0, 1) for run in range(40)]
    of_these, of_others = ratio_of_means(one, two), ratio_over_scenes(one, two)
    assert of_these.ratio == of_others.ratio == 1.5
    assert of_these.verdict == "no"
    assert (of_others.low, of_others.high, of_others.verdict, of_others.n) == (0.5, 2.5, "open", 80)


def test_factors_of_several_objects_change_one_thing_and_are_of_their_cells() -> None:
    from eval.decomposition.tables import claim_line, claims_of, read_csv, result_lines
    from eval.decomposition_several_objects import FACTORS, Factor, table_of

    same = Factor("")
    for factor in FACTORS:
        changed = [
            f
            for f in ("world", "n_objects", "n_particles", "first_scene")
            if getattr(factor, f) != getattr(same, f)
        ]
        assert len(changed) == 1, factor
    cells = read_rows(store.RESULTS / "decomposition_several_objects_cells.csv")
    lines = read_csv(store.RESULTS / "decomposition_several_objects.csv")
    orders = read_csv(store.RESULTS / "decomposition_several_objects_ranking.csv")
    seeds = Seeds(tuple(range(5)), tuple(range(int(lines[0]["runs"]) // 5)), 1, True, n_frames=150)
    timed = ("resampling_ms", "swapping_ms", "step_ms")
    for factor in FACTORS:
        table = table_of(factor, seeds)
        rows = [cells[store.cell_key(cell.key())] for cell in dict.fromkeys(table.cells)]
        kept = [line for line in lines if line["table"] == factor.name]
        for ours, theirs in zip(result_lines(table, rows), kept, strict=True):
            assert {k: v for k, v in ours.items() if k not in timed} == {
                k: v for k, v in theirs.items() if k not in timed
            }
        claims = [claim_line(claim) for claim in claims_of(table, rows)]
        assert claims == [order for order in orders if order["table"] == factor.name]


def test_the_committed_page_is_that_of_the_committed_files() -> None:
    import eval.decomposition_page as pages

    assert pages.PAGE.read_text("utf-8") == pages.page(), "run python -m eval.decomposition_page"
