"""volume stage."""
