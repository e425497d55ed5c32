"""Files that are loaded in the page: bodies as YAML, as a mesh, or as an image; a later file may name earlier ones."""

from __future__ import annotations

import tempfile
from pathlib import Path, PurePosixPath

from ...bodies.corridors import load_mesh
from ...bodies.images import field_of_image, read_image
from ...bodies.obstacles import Obstacle
from ...bodies.scene import scene_of
from ...errors import InputError
from ...files.yaml_file import load_yaml
from ...runs.anatomy_file import load_anatomy
from ...runs.obstacle_file import load_obstacles

TABLES, IMAGES, MESHES = (".yaml", ".yml"), (".nii", ".nii.gz", ".mgz", ".nrrd"), (".stl", ".ply", ".obj", ".vtk")

YAML = ".yaml,.yml,application/yaml"
"""Files that a browser offers to be loaded as YAML."""

BODIES = ",".join((*TABLES, *IMAGES, ".gz", *MESHES))
"""What a browser offers; of a name with two dots it looks at the last part only."""


class Given:
    """A folder of files with the names that they were loaded under, so that a file finds those that it names."""

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)

    def keep(self, name: str, content: bytes) -> Path:
        """Where a file lies from here on; one of the same name gives way to it.

        Raises:
            InputError: a name that no file can have.
        """
        last = PurePosixPath(name.replace("\\", "/")).name
        if not last or last == ".." or "\0" in last:
            raise InputError(f"{name!r} is no name of a file")
        path = Path(self._folder.name) / last
        path.write_bytes(content)
        return path

    def words(self, error: Exception) -> str:
        """What is wrong, in names of files as they were given."""
        return str(error).replace(f"{self._folder.name}/", "").replace(self._folder.name, "the files loaded here")

    def close(self) -> None:
        """Forget all files."""
        self._folder.cleanup()


def load_bodies(path: Path) -> tuple[tuple[Obstacle, ...], str]:
    """Bodies in a file of obstacles, of an anatomy, of a mesh (mm) or of labelled voxels, and what they are, in words.

    Meshes and images alone lie where their file has them, with the plate at its origin, and the arm keeps out of what
    has a label; what is lumen, and where the robot stands, a file with the key `anatomy` says, which names them.

    Raises:
        InputError: as `load_obstacles`, `load_anatomy`, `load_mesh` and `read_image`.
    """
    name = path.name.lower()
    if name.endswith(MESHES):
        mesh = load_mesh(path)
        return (mesh,), mesh.stands_for or "a mesh where its file has it"
    if name.endswith((*IMAGES, ".gz")):
        image = read_image(path)
        if not image.labels:
            raise InputError(f"{path} has only label 0; forbidden regions must have another label")
        field = field_of_image(image, forbidden=image.chosen(image.labels, "label"), name=path.name)
        labels = ", ".join(map(str, image.labels))
        return (field,), f"all that has a label ({labels}), where the file has it"
    content = load_yaml(path)
    bodies = load_anatomy(path).bodies if isinstance(content, dict) and "anatomy" in content else load_obstacles(path)
    return bodies, "; ".join([f"obstacles, {len(bodies)}", *scene_of(bodies).stands_for])
