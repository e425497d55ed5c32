"""The command line, a module per group of commands. Each turns flags into a question, and an answer into text."""

from __future__ import annotations

from .start import main

__all__ = ["main"]
