"""`python -m tubeopt` is the command `tubeopt`."""

from .cli import main

main()
