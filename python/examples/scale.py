"""What pieces of an image cost on this machine, and how many workers are worth it: the figures of docs/scale.md.

    python python/examples/scale.py measure scenes/box.glb --width 256 --height 192 --spp 4096    # costs, as JSON
    python python/examples/scale.py workers scenes/box.glb --width 256 --height 192    # with 1 and 2 workers of Ray
    python python/examples/scale.py simulate costs.json --spp 4096    # efficiency by workers
"""

import argparse
import json
import os
import pathlib
import tempfile
import time
from dataclasses import asdict, dataclass

import penumbra


@dataclass
class Costs:
    """Processor seconds where nothing else is said: they depend less than the clock on what else a machine does."""

    # Once for each process: the import of the scene, the device, and its kernels.
    start: float
    # For each piece with all samples of a tile: BVH, photons and irradiance records, of all stages.
    tile_set_up: float
    # For each range of samples after the first: records and photons of all stages up to its first sample.
    range_set_up: float
    # For each sample of all pixels.
    sample: float
    # Sizes of the scene's and of a piece's file.
    scene_bytes: int
    piece_bytes: int
    # Reading and adding a piece; writing the image.
    merge_piece: float
    merge_image: float


def processor() -> float:
    times = os.times()
    return times.user + times.system


# Samples beyond the 192nd, from which photons and irradiance records no longer grow (`src/render/stages.rs`).
FEW, MANY = 192, 384


def measure(path: pathlib.Path, spp: int, device: str, settings: dict) -> Costs:
    """The costs: a first render in this process, then renders of few and of many samples, and merges."""
    if spp < MANY:
        raise SystemExit(f"--spp {spp}: at least {MANY} samples, so that photons and records have their final number")

    def seconds(first: int, last: int) -> float:
        before = processor()
        scene.render(**settings, spp=spp, samples=(first, last), device=device)
        return processor() - before

    before = processor()
    scene = penumbra.Scene.load(path)
    start = processor() - before
    # The first of two equal renders compiles the kernels.
    start += seconds(0, 1) - seconds(0, 1)
    last = seconds(spp - 1, spp)
    few, many = seconds(0, FEW), seconds(0, MANY)
    sample = (many - few) / (MANY - FEW)
    files = []
    with tempfile.TemporaryDirectory() as folder:
        for index in range(4):
            files.append(pathlib.Path(folder) / f"{index}.exr")
            result = scene.render(**settings, spp=spp, samples=(16 * index, 16 * index + 16), device=device)
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
    return Costs(
        start=max(start, 0.0),
        tile_set_up=max(few - FEW * sample, 0.0),
        range_set_up=max(last - sample, 0.0),
        sample=sample,
        scene_bytes=path.stat().st_size,
        piece_bytes=piece_bytes,
        merge_piece=(merges[1] - merges[0]) / 3,
        merge_image=write,
    )


def on_cluster(path: pathlib.Path, workers: int, tiles: tuple[int, int], spp: int, settings: dict) -> list[float]:
    """Seconds by the clock on a Ray cluster of workers with one core each: of an image in one piece (the smallest
    possible time of one worker), and of one in tiles. All workers have compiled their kernels before."""
    import penumbra.ray
    import ray

    ray.init(num_cpus=workers, include_dashboard=False, log_to_driver=False)
    with tempfile.TemporaryDirectory() as folder:
        output = pathlib.Path(folder) / "image.exr"

        def seconds(tiles: tuple[int, int]) -> float:
            before = time.perf_counter()
            penumbra.ray.render(path, output, spp=spp, tiles=tiles, **settings)
            return time.perf_counter() - before

        seconds((2, workers))
        times = [seconds((1, 1)), seconds(tiles)]
    ray.shutdown()
    return times


def simulate(costs: Costs, spp: int, workers: int, bandwidth: float, cores: float, tiles: bool) -> float:
    """Seconds until the image is there. Each worker has a piece: a range of the samples, or with `tiles` all samples of
    some of the pixels. Workers fetch the scene from one machine, which also merges, one piece after the other.
    `bandwidth` is that machine's, in bytes a second; `cores` divides the work of renders, not of merges."""
    begin = workers * costs.scene_bytes / bandwidth + costs.start / cores
    set_up = costs.tile_set_up if tiles or workers == 1 else costs.range_set_up
    end = begin + (set_up + spp * costs.sample / workers) / cores
    merge = costs.piece_bytes / bandwidth + costs.merge_piece
    return end + (merge if tiles else workers * merge) + costs.merge_image


def table(costs: Costs, spp: int, bandwidth: float, cores: float) -> None:
    """Efficiency: the time of one worker with one piece, over workers times their time."""
    alone = (costs.start + costs.tile_set_up + spp * costs.sample) / cores
    frame = (costs.tile_set_up + spp * costs.sample) / cores
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
    spread = commands.add_parser("workers")
    for command in (measured, spread):
        command.add_argument("scene", type=pathlib.Path)
        command.add_argument("--width", type=int, required=True)
        command.add_argument("--height", type=int, required=True)
    measured.add_argument("--spp", type=int, required=True)
    measured.add_argument("--technique", default="shadow-photons")
    measured.add_argument("--device", default="best")
    spread.add_argument("--spp", type=int, default=64)
    spread.add_argument("--tiles", type=int, nargs=2, default=[2, 2])
    spread.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    simulated = commands.add_parser("simulate")
    simulated.add_argument("costs", type=pathlib.Path)
    simulated.add_argument("--spp", type=int, required=True)
    simulated.add_argument("--bandwidth", type=float, default=1.25e9, help="bytes a second of the merging machine")
    simulated.add_argument("--larger", type=float, default=1.0, help="by which the image has more pixels than here")
    simulated.add_argument("--cores", type=float, default=1.0, help="by which renders are faster than here")
    arguments = parser.parse_args()
    if arguments.command == "measure":
        settings = {"width": arguments.width, "height": arguments.height, "technique": arguments.technique}
        costs = measure(arguments.scene, arguments.spp, arguments.device, settings)
        print(json.dumps(asdict(costs), indent=1))
    elif arguments.command == "workers":
        # Workers of one core each: lavapipe would use all cores for each of them.
        os.environ["LP_NUM_THREADS"] = "1"
        settings = {"width": arguments.width, "height": arguments.height}
        print("| workers | one piece, s | tiles, s |")
        print("| ---: | ---: | ---: |")
        for workers in arguments.workers:
            times = on_cluster(arguments.scene, workers, tuple(arguments.tiles), arguments.spp, settings)
            print(f"| {workers} | {' | '.join(f'{seconds:.2f}' for seconds in times)} |", flush=True)
    else:
        costs = Costs(**json.loads(arguments.costs.read_text()))
        for name in ("tile_set_up", "range_set_up", "sample", "piece_bytes", "merge_piece", "merge_image"):
            setattr(costs, name, arguments.larger * getattr(costs, name))
        table(costs, arguments.spp, arguments.bandwidth, arguments.cores)


if __name__ == "__main__":
    main()
