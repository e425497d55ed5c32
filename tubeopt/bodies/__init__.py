"""Bodies around the arm: obstacles, corridors, meshes, and the distance from many at once."""

from __future__ import annotations

from .corridors import Corridor, MeshObstacle
from .obstacles import Box, Capsule, HalfSpace, Obstacle, Sphere, nearest_distance

__all__ = ["Box", "Capsule", "Corridor", "HalfSpace", "MeshObstacle", "Obstacle", "Sphere", "nearest_distance"]
