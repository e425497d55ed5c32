"""Options of a compiler with which a program ends at a write beyond an array, or at what C leaves undefined."""

from __future__ import annotations

import subprocess
import tempfile
from functools import cache

OPTIONS = "-fsanitize=address,undefined", "-fno-sanitize-recover=all"


@cache
def sanitizers(*compiler: str) -> tuple[str, ...]:
    """OPTIONS, or none where this compiler of C or C++ does not know them."""
    with tempfile.TemporaryDirectory() as folder:
        command = [*compiler, *OPTIONS, "-x", "c", "-", "-o", f"{folder}/main"]
        tried = subprocess.run(command, input="int main(void) { return 0; }", text=True, capture_output=True)
    return OPTIONS if tried.returncode == 0 else ()
