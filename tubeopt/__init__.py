"""tubeopt: design, command and fabrication of concentric and eccentric tube robots."""

import warnings
from typing import Any

import lazy_loader

__version__ = "0.1.0"

RENAMED = {
    "Verdict": "SnapAssessment",
    "judge": "assess_snapping",
    "lead_by": "design_feedback",
}
"""Old names of the documentation -> their names now; they go after one release."""

# What `__init__.pyi` imports is loaded when it is first used, so that a script waits only for what it needs.
_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name in RENAMED:
        warnings.warn(f"tubeopt.{name} is now tubeopt.{RENAMED[name]}", DeprecationWarning, stacklevel=2)
    return _load(RENAMED.get(name, name))
