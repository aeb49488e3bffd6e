import pathlib
from collections.abc import Callable, Iterable, Sequence
from os import PathLike
from typing import Any, Literal, final

import numpy
from numpy.typing import NDArray

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

__version__: str
TECHNIQUES: list[str]
AOVS: list[str]

_Floats = NDArray[numpy.float32]
_Path = str | PathLike[str]
_View = Literal["neutral", "agx", "standard", "raw"]

class Error(Exception):
    result: Result | None

class Interrupted(KeyboardInterrupt):
    result: Result | None

@final
class Progress:
    @property
    def samples(self) -> int: ...
    @property
    def spp(self) -> int | None: ...
    @property
    def rays(self) -> int: ...
    @property
    def boundary_share(self) -> float: ...
    @property
    def seconds(self) -> float: ...

@final
class Result:
    @property
    def image(self) -> _Floats: ...
    @property
    def alpha(self) -> _Floats: ...
    @property
    def aovs(self) -> dict[str, _Floats]: ...
    @property
    def denoised(self) -> _Floats | None: ...
    @property
    def statistics(self) -> dict[str, Any]: ...
    @property
    def samples(self) -> int: ...
    def save(self, path: _Path, *, view: _View = "neutral", exposure: float = 0.0) -> None: ...
    def png(self, *, view: _View = "neutral", exposure: float = 0.0) -> bytes: ...
    def _repr_png_(self) -> bytes: ...

@final
class Scene:
    @staticmethod
    def load(
        path: _Path,
        *,
        at: float | None = None,
        animation: str | int | None = None,
        loop: bool = False,
        variant: str | None = None,
        environment: _Path | None = None,
        environment_rotation: float = 0.0,
        environment_strength: float = 1.0,
        default_light: bool = False,
        lenient: bool = False,
    ) -> Scene: ...
    def at(self, seconds: float, *, animation: str | int | None = None) -> Scene: ...
    def render(
        self,
        *,
        width: int | None = None,
        height: int | None = None,
        spp: int | None = None,
        samples: tuple[int, int] | None = None,
        technique: str | None = None,
        seed: int | None = None,
        camera: str | int | None = None,
        direction: tuple[float, float] | None = None,
        aperture: float | None = None,
        focus: float | None = None,
        iris_blades: int | None = None,
        crop: tuple[int, int, int, int] | None = None,
        aovs: str | Iterable[str] | None = None,
        background: str | tuple[float, float, float] | None = None,
        denoise: Literal["none", "auto", "statistical", "oidn"] | None = None,
        oidn_library: _Path | None = None,
        sampling: Literal["uniform", "adaptive"] | None = None,
        noise: float | None = None,
        time: float | None = None,
        progress: Callable[[Progress], object] | None = None,
        device: str | int | None = None,
        light_scale: float | None = None,
        max_bounces: int | None = None,
        flux_photons: int | None = None,
        clamp: float | None = None,
        cache: bool | None = None,
        accuracy: float | None = None,
        gather_rays: int | None = None,
        photons: int | None = None,
        nearest: int | None = None,
        shadow_photons_per_ray: int | None = None,
        shadow_samples: int | None = None,
        dilate: int | None = None,
        audit: float | None = None,
        paper_counting: bool | None = None,
        fine_cells: bool | None = None,
        light_sampling: str | None = None,
        sampled_lights: int | None = None,
        cells: int | None = None,
        cell_rays: int | None = None,
        light_buffer_cells: int | None = None,
        shadow_tolerance: float | None = None,
    ) -> Result: ...
    @property
    def cameras(self) -> list[str]: ...
    @property
    def lights(self) -> list[str]: ...
    @property
    def triangles(self) -> int: ...
    @property
    def notes(self) -> list[str]: ...
    @property
    def path(self) -> pathlib.Path: ...
    @property
    def files(self) -> list[pathlib.Path]: ...

def devices() -> list[dict[str, Any]]: ...
def merge(
    pieces: Sequence[_Path],
    *,
    partial: bool = False,
    denoise: Literal["none", "auto", "statistical", "oidn"] | None = None,
    oidn_library: _Path | None = None,
    device: str | int | None = None,
) -> Result: ...
def read(path: _Path) -> Result: ...
