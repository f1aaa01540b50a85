"""Sweeps and batches: many runs on this machine or on a dask cluster, resumable, with one table at the end."""

from mocap.pipeline.cluster.batch import Pieces, find_sessions, run_batch
from mocap.pipeline.cluster.engine import Engine, Job, Outcome, Standing, run_jobs
from mocap.pipeline.cluster.spec import SweepCell, SweepSpec, plan_cells, read_sweep_spec
from mocap.pipeline.cluster.sweep import SweepResult, join_shards, run_sweep

__all__ = [
    "Engine",
    "Job",
    "Outcome",
    "Pieces",
    "Standing",
    "SweepCell",
    "SweepResult",
    "SweepSpec",
    "find_sessions",
    "join_shards",
    "plan_cells",
    "read_sweep_spec",
    "run_batch",
    "run_jobs",
    "run_sweep",
]
