"""tubeopt: design, command and fabrication of concentric and eccentric tube robots."""

import lazy_loader

__version__ = "0.1.0"

# What `__init__.pyi` imports is loaded when it is first used, so that a script waits only for what it needs.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
