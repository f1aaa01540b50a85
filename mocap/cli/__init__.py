"""The command line `mocap COMMAND`: one module per group of commands; see `app` for the table of them."""

from mocap.cli.app import app, main

__all__ = ["app", "main"]
