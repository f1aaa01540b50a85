"""`python -m mocap`."""

from mocap.cli import main

main()
