"""What pieces of an image cost on this machine, and how many workers are worth it: the figures of docs/scale.md.

    python python/examples/scale.py measure scenes/box.glb --width 256 --height 192    # costs, as JSON
    python python/examples/scale.py simulate costs.json --spp 4096                     # efficiency by workers
"""

import argparse
import json
import os
import pathlib
import tempfile
from dataclasses import asdict, dataclass

import penumbra


@dataclass
class Costs:
    """Processor seconds where nothing else is said: they depend less than the clock on what else a machine does."""

    # Once for each process: the import of the scene, the device, and its kernels.
    start: float
    # For each piece: hierarchy, photons, irradiance records.
    set_up: float
    # For each sample of all pixels.
    sample: float
    # Of the scene, and of a piece's file.
    scene_bytes: int
    piece_bytes: int
    # Reading and adding a piece; writing the image.
    merge_piece: float
    merge_image: float


def processor() -> float:
    times = os.times()
    return times.user + times.system


def measure(path: pathlib.Path, samples: list[int], device: str, settings: dict) -> Costs:
    """The costs: a first render in this process, then renders of few and of many samples, and merges."""
    before = processor()
    scene = penumbra.Scene.load(path)
    # A piece as all others, since kernels depend on the settings.
    spp = 4 * samples[1]
    scene.render(**settings, spp=spp, samples=(0, 1), device=device)
    first = processor() - before
    seconds = []
    with tempfile.TemporaryDirectory() as folder:
        files = []
        for count in samples:
            before = processor()
            result = scene.render(**settings, spp=spp, samples=(0, count), device=device)
            seconds.append(processor() - before)
        for index in range(4):
            files.append(pathlib.Path(folder) / f"{index}.exr")
            part = (index * samples[1], (index + 1) * samples[1])
            result = scene.render(**settings, spp=spp, samples=part, device=device)
            result.save(files[-1])
        merges = []
        for count in (1, 4):
            before = processor()
            penumbra.merge(files[:count], partial=True)
            merges.append(processor() - before)
        before = processor()
        result.save(pathlib.Path(folder) / "image.exr")
        write = processor() - before
        piece_bytes = max(file.stat().st_size for file in files)
    sample = (seconds[1] - seconds[0]) / (samples[1] - samples[0])
    set_up = max(seconds[0] - samples[0] * sample, 0.0)
    return Costs(
        start=max(first - set_up - sample, 0.0),
        set_up=set_up,
        sample=sample,
        scene_bytes=path.stat().st_size,
        piece_bytes=piece_bytes,
        merge_piece=(merges[1] - merges[0]) / 3,
        merge_image=write,
    )


def simulate(costs: Costs, spp: int, workers: int, bandwidth: float, cores: float, tiles: bool) -> float:
    """Seconds until the image is there. Each worker has a piece: a range of the samples, or with `tiles` all samples of
    some of the pixels. Workers fetch the scene from one machine, which also merges, one piece after the other.
    `bandwidth` is that machine's, in bytes a second; `cores` divides the work of renders, not of merges."""
    begin = workers * costs.scene_bytes / bandwidth + costs.start / cores
    end = begin + (costs.set_up + spp * costs.sample / workers) / cores
    merge = costs.piece_bytes / bandwidth + costs.merge_piece
    return end + (merge if tiles else workers * merge) + costs.merge_image


def table(costs: Costs, spp: int, bandwidth: float, cores: float) -> None:
    """Efficiency: the time of one worker with one piece, over workers times their time."""
    alone = (costs.start + costs.set_up + spp * costs.sample) / cores
    frame = (costs.set_up + spp * costs.sample) / cores
    print("| workers | ranges of samples: time, s | efficiency | tiles: time, s | efficiency | 10,000 frames |")
    print("| ---: | ---: | ---: | ---: | ---: | ---: |")
    for workers in (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1000):
        by_samples, by_tiles = (simulate(costs, spp, workers, bandwidth, cores, tiles) for tiles in (False, True))
        frames = workers * costs.scene_bytes / bandwidth + costs.start / cores + -(-10_000 // workers) * frame
        whole = costs.start / cores + 10_000 * frame
        cells = [f"{workers:,}"]
        for time in (by_samples, by_tiles):
            cells += [f"{time:,.0f}", f"{100 * alone / workers / time:.0f} %"]
        cells.append(f"{100 * whole / workers / frames:.0f} %")
        print(f"| {' | '.join(cells)} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    measured = commands.add_parser("measure")
    measured.add_argument("scene", type=pathlib.Path)
    measured.add_argument("--width", type=int, required=True)
    measured.add_argument("--height", type=int, required=True)
    measured.add_argument("--samples", type=int, nargs=2, default=[2, 16])
    measured.add_argument("--technique", default="shadow-photons")
    measured.add_argument("--device", default="best")
    simulated = commands.add_parser("simulate")
    simulated.add_argument("costs", type=pathlib.Path)
    simulated.add_argument("--spp", type=int, required=True)
    simulated.add_argument("--bandwidth", type=float, default=1.25e9, help="bytes a second of the merging machine")
    simulated.add_argument("--larger", type=float, default=1.0, help="by which the image has more pixels than here")
    simulated.add_argument("--cores", type=float, default=1.0, help="by which renders are faster than here")
    arguments = parser.parse_args()
    if arguments.command == "measure":
        settings = {"width": arguments.width, "height": arguments.height, "technique": arguments.technique}
        print(json.dumps(asdict(measure(arguments.scene, arguments.samples, arguments.device, settings)), indent=1))
    else:
        costs = Costs(**json.loads(arguments.costs.read_text()))
        for name in ("set_up", "sample", "piece_bytes", "merge_piece", "merge_image"):
            setattr(costs, name, arguments.larger * getattr(costs, name))
        table(costs, arguments.spp, arguments.bandwidth, arguments.cores)


if __name__ == "__main__":
    main()
