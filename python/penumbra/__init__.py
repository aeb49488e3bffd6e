"""Penumbra renders glTF scenes with shadow photons, on a Vulkan device.

>>> import penumbra
>>> scene = penumbra.Scene.load("scenes/box.glb")
>>> result = scene.render(width=256, height=256, spp=16)
>>> result.image.shape
(256, 256, 3)

`penumbra.ray` renders on many machines.
"""

from ._penumbra import (
    AOVS,
    TECHNIQUES,
    Error,
    Interrupted,
    Progress,
    Result,
    Scene,
    __version__,
    devices,
    merge,
    read,
)

__all__ = [
    "AOVS",
    "TECHNIQUES",
    "Error",
    "Interrupted",
    "Progress",
    "Result",
    "Scene",
    "__version__",
    "devices",
    "merge",
    "read",
]
