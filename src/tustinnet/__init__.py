"""From logs of a mechanical system to a model that simulates it.

The public names, listed in `__init__.pyi`. JAX is loaded when a name that needs it is first used.
"""

from tustinnet.lazy_package import make_lazy

make_lazy(__name__, __file__)
