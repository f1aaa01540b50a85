"""Mutants: one-line mistakes in the numerical core, each of which some test must notice."""
