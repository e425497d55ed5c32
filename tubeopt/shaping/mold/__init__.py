"""Mold for setting the shape of tubes: grooves, plates, files, materials."""
