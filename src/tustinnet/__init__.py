"""From logs of a mechanical system to a model that simulates it.

The public names, listed in `__init__.pyi`. JAX is loaded when a name that needs it is first used.
"""

from typing import Any

import lazy_loader

from tustinnet.renamed import NAMES, current_name

_attribute, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    return _attribute(current_name(name, NAMES, "name"))
