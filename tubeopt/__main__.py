"""`python -m tubeopt` is the command `tubeopt`."""

from .cli.app import main

main()
