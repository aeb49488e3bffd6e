"""Renders on the machines of a Ray cluster: frames, and frames cut into pieces by samples and by tiles.

>>> import penumbra.ray
>>> penumbra.ray.render("box.glb", "box.exr", spp=256, ranges=4, tiles=(2, 2), width=1024, height=1024)
>>> penumbra.ray.render("fox.glb", "fox.{frame}.exr", frames=range(24), fps=24, spp=64)

A piece that is lost with its machine is rendered again. Its bits are the same wherever it is rendered, if all machines
have the same kind of device, so an image that was cut has the bits of one that a single process made in the same way:
`Scene.render(samples=(0, spp))`, merged alone. Frames that are not cut are those of `Scene.render`.

Ray is an optional dependency: `pip install './python[ray]'`.
"""

from __future__ import annotations

import hashlib
import math
import os
import pathlib
import shutil
import tempfile
import uuid
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import ray

import penumbra

__all__ = ["Piece", "Rendered", "render"]

# Minimum number of digits of a frame's number, as in the program's file names.
_DIGITS = 4
# Tasks that wait for a free worker, for each frame's first piece: more would fill the scheduler, fewer would let
# workers wait.
_WAITING = 512


@dataclass(frozen=True)
class Piece:
    """A part of the work: a frame (None for a single image), and its cut (None where it is not cut)."""

    frame: int | None = None
    samples: tuple[int, int] | None = None
    crop: tuple[int, int, int, int] | None = None


@dataclass(frozen=True)
class Rendered:
    """A piece that is done: its statistics, the node of the cluster, and the bytes of its file."""

    piece: Piece
    statistics: dict[str, Any]
    node: str
    size: int


@dataclass(frozen=True)
class _Seen:
    """A scene in a file that workers see, and the call of `render`: until the next call the file may change."""

    path: str
    call: str


@dataclass(frozen=True)
class _Sent:
    """A scene that goes to the workers: its files by their names in one folder, of which one is the scene."""

    files: dict[str, bytes]
    scene: str
    environment: str | None


def render(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    frames: Iterable[int] | None = None,
    fps: float = 24.0,
    spp: int = 16,
    ranges: int = 1,
    tiles: tuple[int, int] = (1, 1),
    scene: dict[str, Any] | None = None,
    send: bool = False,
    retries: int = 3,
    options: dict[str, Any] | None = None,
    progress: Callable[[Rendered, int], object] | None = None,
    **settings: Any,
) -> list[Rendered]:
    """Renders a scene to `output`, .exr or .png, on a cluster, and returns a `Rendered` for each piece.

    `ranges` cuts the samples into this many ranges, and `tiles` the image into columns and rows; tiles need `width` and
    `height`. `frames` renders an animation: frame N shows the scene N / fps seconds after its beginning, and `{frame}`
    in `output` stands for N. `settings` are keywords of `Scene.render`, `scene` those of `Scene.load`.

    Workers open `path`, so each must have the file there; `send=True` sends them the file and those that it names.
    A piece whose worker dies is rendered again, up to `retries` times. `options` are Ray's options for each piece, such
    as {"num_gpus": 1}; by default a piece takes one CPU. `progress` is called with each piece that is done and the
    number of all pieces; if it raises, or Ctrl-C is pressed, unfinished pieces are cancelled, and complete frames are
    kept.

    If Ray is not connected to a cluster, `ray.init()` connects to one, or starts one on this machine.
    """
    output = os.fspath(output)
    # A frame that is named twice is rendered once.
    numbers: list[int | None] = [None] if frames is None else list(dict.fromkeys(frames))
    if frames is not None and "{frame}" not in output:
        raise penumbra.Error(f"{output}: frames are many files, so the name must contain {{frame}}")
    if frames is None and "{frame}" in output:
        raise penumbra.Error(f"{output}: {{frame}} stands for the number of a frame, so frames must be given")
    if not 0 < fps < math.inf:
        raise penumbra.Error(f"fps is {fps}; it must be finite and more than 0")
    _check_target(pathlib.Path(output))
    cuts = list(_cuts(spp, ranges, tiles, settings))
    if not ray.is_initialized():
        ray.init()
    load = dict(scene or {})
    seen = _Seen(os.fspath(path), uuid.uuid4().hex)
    source = ray.put(_pack(pathlib.Path(path), load, frames is not None) if send else seen)
    task = _render_piece.options(max_retries=retries, **(options or {}))

    def submit(number: int | None, piece: Piece) -> ray.ObjectRef[Any]:
        seconds = None if number is None else number / fps
        return task.remote(source, load, seconds, {**settings, "spp": spp}, piece)

    todo = (Piece(number, samples, crop) for number in numbers for samples, crop in cuts)
    with tempfile.TemporaryDirectory(prefix="penumbra-") as folder:
        merging = ("denoise", "oidn_library", "device")
        kept: dict[str, Any] = {name: settings[name] for name in merging if name in settings}
        assembly = _Assembly(output, len(cuts), cuts == [(None, None)], pathlib.Path(folder), kept)
        done: list[Rendered] = []
        pending: dict[ray.ObjectRef[Any], Piece] = {}
        try:
            while True:
                while len(pending) < _WAITING and (piece := next(todo, None)) is not None:
                    pending[submit(piece.frame, piece)] = piece
                if not pending:
                    return done
                ready, _ = ray.wait(list(pending))
                for reference in ready:
                    piece = pending.pop(reference)
                    data, statistics, node = _get(reference)
                    # The cluster may forget the data: a large image is in many pieces.
                    del reference
                    assembly.add(piece, data)
                    done.append(Rendered(piece, statistics, node, len(data)))
                    if progress is not None:
                        progress(done[-1], len(numbers) * len(cuts))
        finally:
            for reference in pending:
                ray.cancel(reference)


def _check_target(output: pathlib.Path) -> None:
    """Finds what would keep images from being written, before a cluster works for them."""
    if output.suffix.lower() not in (".exr", ".png"):
        raise penumbra.Error(f"{output}: an image is written as .exr or .png")
    if "{frame}" in str(output.parent):
        return
    if not output.parent.is_dir():
        raise penumbra.Error(f"{output}: there is no folder {output.parent}")
    if not os.access(output.parent, os.W_OK):
        raise penumbra.Error(f"{output}: the folder {output.parent} cannot be written to")


def _get(reference: ray.ObjectRef[Any]) -> tuple[bytes, dict[str, Any], str]:
    try:
        return ray.get(reference)  # type: ignore[no-any-return]
    except ray.exceptions.RayTaskError as error:
        # The library's own error says it in one line.
        if isinstance(error.cause, penumbra.Error):
            raise error.cause from None
        raise


class _Assembly:
    """The pieces that have come, as files, until their frame is complete."""

    def __init__(self, output: str, cuts: int, whole: bool, folder: pathlib.Path, denoise: dict[str, Any]) -> None:
        self.output = output
        self.cuts = cuts
        self.whole = whole
        self.folder = folder
        self.denoise = denoise
        self.files: dict[int | None, list[pathlib.Path]] = {}

    def add(self, piece: Piece, data: bytes) -> None:
        name = self.output if piece.frame is None else self.output.replace("{frame}", f"{piece.frame:0{_DIGITS}}")
        files = self.files.setdefault(piece.frame, [])
        files.append(self.folder / f"{piece.frame}-{len(files)}.exr")
        try:
            files[-1].write_bytes(data)
            if len(files) < self.cuts:
                return
            if self.whole:
                penumbra.read(files[0]).save(name)
            else:
                penumbra.merge(files, **self.denoise).save(name)
        except (penumbra.Error, OSError, KeyboardInterrupt) as problem:
            # A full disk, for instance: the work of the cluster stays.
            kept = tempfile.mkdtemp(prefix="penumbra-pieces-")
            for file in self.folder.iterdir():
                shutil.move(file, kept)
            remark = f"the pieces that have come are in {kept}, for penumbra.merge"
            if isinstance(problem, KeyboardInterrupt):
                raise KeyboardInterrupt(remark) from problem
            raise penumbra.Error(f"{problem}; {remark}") from problem
        for file in self.files.pop(piece.frame):
            file.unlink()


def _cuts(
    spp: int, ranges: int, tiles: tuple[int, int], settings: dict[str, Any]
) -> Iterator[tuple[tuple[int, int] | None, tuple[int, int, int, int] | None]]:
    """The cuts of an image: ranges of samples, and tiles."""
    columns, rows = tiles
    if not (1 <= ranges <= spp and columns >= 1 and rows >= 1):
        raise penumbra.Error(
            f"ranges is {ranges}, tiles is {tiles}; ranges must be from 1 to spp, {spp}, and tiles at least (1, 1)"
        )
    if (ranges, columns, rows) == (1, 1, 1):
        yield None, None
        return
    if "crop" in settings or "samples" in settings:
        raise penumbra.Error("crop and samples cannot be set: tiles and ranges set them for each piece")
    crops: list[tuple[int, int, int, int] | None] = [None]
    if (columns, rows) != (1, 1):
        width, height = settings.get("width"), settings.get("height")
        if width is None or height is None or columns > width or rows > height:
            raise penumbra.Error("tiles need width and height, and at least one pixel each")
        xs, ys = _edges(width, columns), _edges(height, rows)
        crops = [(x, y, right - x, bottom - y) for y, bottom in ys for x, right in xs]
    for samples in _edges(spp, ranges):
        for crop in crops:
            yield samples, crop


def _edges(length: int, parts: int) -> list[tuple[int, int]]:
    edges = [length * part // parts for part in range(parts + 1)]
    return list(zip(edges, edges[1:]))


def _pack(path: pathlib.Path, load: dict[str, Any], is_sequence: bool) -> _Sent:
    """The files of a scene, for workers that do not see them. Takes the environment out of `load`."""
    named = penumbra.Scene.load(path, **{**load, "at": 0.0} if is_sequence else load).files
    environment = load.pop("environment", None)
    try:
        scene = f"scene/{path.name}"
        files = {scene: path.read_bytes()}
        # A lenient import lists missing files too.
        for file in (file for file in named if file.exists()):
            files[f"scene/{file.relative_to(path.parent).as_posix()}"] = file.read_bytes()
        if environment is None:
            return _Sent(files, scene, None)
        environment = pathlib.Path(environment)
        name = f"environment/{environment.name}"
        files[name] = environment.read_bytes()
        return _Sent(files, scene, name)
    except OSError as problem:
        raise penumbra.Error(f"{path}: cannot be sent: {problem}") from problem


# Where this worker keeps the scenes that were sent to it.
_folder: tempfile.TemporaryDirectory[str] | None = None


def _unpack(sent: _Sent) -> tuple[str, str | None]:
    """Writes the files that were sent, once, and returns the paths of scene and environment."""
    global _folder
    if _folder is None:
        _folder = tempfile.TemporaryDirectory(prefix="penumbra-")
    digest = hashlib.sha256()
    for name, data in sent.files.items():
        digest.update(f"{name}\0{len(data)}\0".encode())
        digest.update(data)
    folder = pathlib.Path(_folder.name).resolve() / digest.hexdigest()
    if not folder.exists():
        # Under another name until it is complete.
        part = folder.with_suffix(".part")
        shutil.rmtree(part, ignore_errors=True)
        for name, data in sent.files.items():
            target = (part / name).resolve()
            if not target.is_relative_to(part):
                raise penumbra.Error(f"{name} is outside the folder of the scene, so it cannot be sent")
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(data)
        part.rename(folder)
    return str(folder / sent.scene), sent.environment and str(folder / sent.environment)


# The scene of the last piece: pieces of one image follow each other, and frames have one camera. A worker is one
# process.
_last: tuple[object, penumbra.Scene] | None = None


def _load(source: _Seen | _Sent, load: dict[str, Any], seconds: float | None) -> penumbra.Scene:
    """The scene, or its moment of a sequence."""
    global _last
    call = None
    if isinstance(source, _Sent):
        # The name of its folder follows from the content of the files.
        path, environment = _unpack(source)
        load = {**load, "environment": environment}
    else:
        path, call = source.path, source.call
    key = (path, call, sorted((name, str(value)) for name, value in load.items()))
    if _last is None or _last[0] != key:
        _last = None
        _last = (key, penumbra.Scene.load(path, **load if seconds is None else {**load, "at": seconds}))
    if seconds is not None:
        _last = (key, _last[1].at(seconds))
    return _last[1]


@ray.remote
def _render_piece(
    source: _Seen | _Sent, load: dict[str, Any], seconds: float | None, settings: dict[str, Any], piece: Piece
) -> tuple[bytes, dict[str, Any], str]:
    """Renders a piece: the bytes of its EXR, its statistics, and the node."""
    cut: dict[str, Any] = {} if piece.samples is None else {"samples": piece.samples, "crop": piece.crop}
    result = _load(source, load, seconds).render(**settings, **cut)
    with tempfile.TemporaryDirectory(prefix="penumbra-") as folder:
        file = pathlib.Path(folder) / "piece.exr"
        result.save(file)
        return file.read_bytes(), result.statistics, ray.get_runtime_context().get_node_id()
