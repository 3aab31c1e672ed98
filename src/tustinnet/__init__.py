"""From logs of a mechanical system to a model that simulates it.

The public names, listed in `__init__.pyi`. JAX is loaded when a name that needs it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
