"""Evaluation scripts and the benchmark suite."""
