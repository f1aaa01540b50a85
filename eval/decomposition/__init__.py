"""The decomposition filters compared cell by cell: cells, many of them, and what was published beside them."""
