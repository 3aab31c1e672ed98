"""Controllers designed on identified models: equilibria, feedback, plans, predictive control.

The public names, listed in `__init__.pyi`. Arrays in and out are plain NumPy.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
