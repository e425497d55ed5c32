"""Firmware of a rig: a sketch that heats a tube by a law, its board, its wiring."""
