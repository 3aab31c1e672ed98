"""Controllers designed on identified models: equilibria, feedback, plans, predictive control.

The public names, listed in `__init__.pyi`. Arrays in and out are plain NumPy.
"""

from tustinnet.lazy_package import make_lazy

make_lazy(__name__, __file__)
