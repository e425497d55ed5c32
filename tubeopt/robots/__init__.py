"""Robots as plain data: tubes, drives, limits and loads, and the sections that the tubes form."""
