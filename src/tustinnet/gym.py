"""The environment `TustinNet-v0`, registered at Gymnasium once this module is imported.

gymnasium.make("tustinnet.gym:TustinNet-v0", model="model.safetensors", reward="swing-up")
"""

import gymnasium

ENVIRONMENT = "TustinNet-v0"

gymnasium.register(
    ENVIRONMENT,
    entry_point="tustinnet.store.environments:environment",
    vector_entry_point="tustinnet.store.environments:environments",
)
