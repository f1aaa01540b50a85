"""likelihood stage."""
