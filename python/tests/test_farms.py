"""The array job for Slurm and the job type for Flamenco, with stand-ins for both: what they would run, runs here."""

import json
import os
import shutil
import subprocess

import penumbra
import pytest

PROGRAM = os.environ.get("PENUMBRA_PROGRAM")
pytestmark = pytest.mark.skipif(PROGRAM is None, reason="PENUMBRA_PROGRAM does not name the program")

FLAGS = ["--width", "32", "--height", "24", "--max-bounces", "0"]


def expected(scenes, device, folder, spp):
    settings = {"width": 32, "height": 24, "max_bounces": 0, "device": device}
    piece = penumbra.Scene.load(scenes / "box.glb").render(spp=spp, samples=(0, spp), **settings)
    piece.save(folder / "one.exr")
    return penumbra.merge([folder / "one.exr"]).image.tobytes()


def shown(scenes, device, folder, spp):
    """The .png that the same pieces, uncut, are merged to."""
    flags = [*FLAGS, "--device", device, "--denoise", "auto", "--quiet"]
    piece, picture = folder / "one.exr", folder / "one.png"
    cut = ["--spp", str(spp), "--samples", f"0..{spp}"]
    subprocess.run([PROGRAM, "render", scenes / "box.glb", "-o", piece, *cut, *flags], check=True)
    display = ["--view", "agx", "--exposure=-1", "--device", device, "--quiet"]
    subprocess.run([PROGRAM, "merge", piece, "-o", picture, *display], check=True)
    return picture.read_bytes()


# Runs the tasks of an array one after the other, and what depends on them at once, if none has failed.
SBATCH = r"""#!/usr/bin/env bash
echo "$*" >>"$LOG"
while [[ $1 == --* ]]; do
    case $1 in
        --array=*) array=${1#--array=} ;;
        --dependency=*) [[ ! -e $LOG.failed ]] || exit 1 ;;
        --wrap=*) sh -c "${1#--wrap=}" >&2; echo 2; exit ;;
    esac
    shift
done
for ((task = ${array%-*}; task <= ${array#*-}; task++)); do
    SLURM_ARRAY_TASK_ID=$task "$@" >&2 || touch "$LOG.failed"
done
echo 1
"""


def slurm(folder):
    """The environment with the stand-in, which writes its calls to `log`."""
    bin = folder / "bin"
    bin.mkdir()
    (bin / "sbatch").write_text(SBATCH)
    (bin / "sbatch").chmod(0o755)
    return os.environ | {"PATH": f"{bin}:{os.environ['PATH']}", "PENUMBRA": PROGRAM, "LOG": str(folder / "log")}


def test_a_slurm_array_renders_and_merges(scenes, device, tmp_path):
    environment = slurm(tmp_path)
    output = tmp_path / "ein schönes Bild's.exr"
    script = scenes.parent / "scripts/farm/slurm"
    sizes = ["--ranges", "3", "--spp", "7", "--sbatch", "--time=60 --gres=gpu:1"]
    command = [script, *sizes, scenes / "box.glb", output, *FLAGS, "--device", device]
    subprocess.run(command, check=True, env=environment)
    assert penumbra.read(output).image.tobytes() == expected(scenes, device, tmp_path, 7)
    calls = (tmp_path / "log").read_text().splitlines()
    assert len(calls) == 2 and "--array=0-2 --time=60 --gres=gpu:1" in calls[0]
    assert "afterok:1 --time=60 --gres=gpu:1" in calls[1]
    pieces = tmp_path / "ein schönes Bild's.exr.pieces"
    names = [f"{piece}.{kind}" for piece in range(3) for kind in ("exr", "json")]
    assert sorted(path.name for path in pieces.iterdir()) == names
    # A second submission renders only what is missing.
    before = (pieces / "0.exr").stat().st_mtime_ns
    (pieces / "1.exr").unlink()
    output.unlink()
    subprocess.run([script, "--sbatch-merge", "--time=5", *command[1:]], check=True, env=environment)
    assert "afterok:1 --time=5 --wrap" in (tmp_path / "log").read_text()
    assert penumbra.read(output).image.tobytes() == expected(scenes, device, tmp_path, 7)
    assert (pieces / "0.exr").stat().st_mtime_ns == before
    # A task that fails lets nothing be merged.
    output.unlink()
    (pieces / "2.exr").unlink()
    failed = subprocess.run([*command, "--nearest", "0"], env=environment, capture_output=True, text=True)
    assert failed.returncode != 0 and "--nearest" in failed.stderr and not output.exists()
    for wrong, message in [
        ("--ranges 9 --spp 4 x.glb y.exr", "from 1 to 4"),
        ("--spp 010 x.glb y.exr", "--spp 010"),
        ("--spp 1e3 x.glb y.exr", "--spp 1e3"),
        ("--tiles 2x2 x.glb y.exr --width 8", "--width and --height"),
        ("--tiles 2 x.glb y.exr --width 8 --height 8", "columns and rows"),
        ("--tiles 9x2 x.glb y.exr --width=8 --height=8", "than pixels in 8 x 8"),
        ("--ranges 2 x.glb y.exr --crop 0,0,4,4", "cut the image"),
        ("x.glb y.exr --samples=0..4", "cut the image"),
    ]:
        usage = subprocess.run([script, *wrong.split()], capture_output=True, text=True)
        assert usage.returncode == 2 and message in usage.stderr, (wrong, usage)


def test_a_slurm_array_cuts_tiles(scenes, device, tmp_path):
    """Each tile has a task for each range; neither cut is in equal parts."""
    environment = slurm(tmp_path)
    output = tmp_path / "tiles.exr"
    script = scenes.parent / "scripts/farm/slurm"
    sizes = ["--tiles", "3x2", "--ranges", "2", "--spp", "5"]
    subprocess.run([script, *sizes, scenes / "box.glb", output, *FLAGS, "--device", device], check=True, env=environment)
    assert penumbra.read(output).image.tobytes() == expected(scenes, device, tmp_path, 5)
    calls = (tmp_path / "log").read_text().splitlines()
    assert len(calls) == 2 and "--array=0-11" in calls[0]


def test_a_slurm_array_makes_a_picture(scenes, device, tmp_path):
    """The picture is denoised and shown as `penumbra render` would, though it is `penumbra merge` that writes it."""
    environment = slurm(tmp_path)
    output = tmp_path / "a picture.png"
    script = scenes.parent / "scripts/farm/slurm"
    command = [script, "--ranges", "2", "--spp", "4", scenes / "box.glb", output, *FLAGS, "--device", device]
    subprocess.run([*command, "--view", "agx", "--exposure=-1"], check=True, env=environment)
    assert output.read_bytes() == shown(scenes, device, tmp_path, 4)
    merge = (tmp_path / "log").read_text().splitlines()[1]
    assert f"--device={device}" in merge and "--denoise" not in merge
    subprocess.run([*command, "--denoise", "none"], check=True, env=environment)
    calls = (tmp_path / "log").read_text().splitlines()
    assert "--denoise=none" in calls[3]


# Compiles a job as the manager does, and prints its tasks.
MANAGER = """
const fs = require("fs");
const author = {
    Task: (name, type) => ({
        name, type, commands: [], dependencies: [],
        addCommand(command) { this.commands.push(command); },
        addDependency(task) { this.dependencies.push(task.name); },
    }),
    Command: (name, parameters) => ({ name, parameters }),
};
const frameChunker = (frames, size) => frames.split(",");
const [script, given] = process.argv.slice(1);
const { JOB_TYPE, compileJob } = new Function(
    "author", "frameChunker", fs.readFileSync(script, "utf8") + "; return { JOB_TYPE, compileJob };",
)(author, frameChunker);
const settings = JSON.parse(given);
for (const setting of JOB_TYPE.settings) {
    if (!(setting.key in settings)) settings[setting.key] = setting.default;
}
const job = { settings, tasks: [], addTask(task) { this.tasks.push(task); } };
compileJob(job);
console.log(JSON.stringify(job.tasks));
"""


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_a_flamenco_job_renders_and_merges(scenes, device, tmp_path):
    script = scenes.parent / "scripts/farm/penumbra.js"

    def compile(**settings):
        settings = {"penumbra": PROGRAM, "scene": str(scenes / "box.glb"), **settings}
        command = ["node", "-e", MANAGER, script, json.dumps(settings)]
        return subprocess.run(command, capture_output=True, text=True)

    def run(tasks):
        for command in (command for task in tasks for command in task["commands"]):
            assert command["name"] == "exec"
            subprocess.run([command["parameters"]["exe"], *command["parameters"]["args"]], check=True)

    output = tmp_path / "whole.exr"
    flags = " ".join([*FLAGS, "--device", device])
    tasks = json.loads(compile(output=str(output), spp=5, ranges=2, flags=flags).stdout)
    assert [task["name"] for task in tasks] == ["samples 0..2", "samples 2..5", "merge"]
    assert tasks[2]["dependencies"] == ["samples 0..2", "samples 2..5"]
    run(tasks)
    assert penumbra.read(output).image.tobytes() == expected(scenes, device, tmp_path, 5)
    output.unlink()
    # Tiles, of which no two are equal.
    tasks = json.loads(compile(output=str(output), spp=3, ranges=2, columns=3, rows=1, flags=flags).stdout)
    assert len(tasks) == 7 and tasks[1]["name"] == "samples 0..1 of 10,0,11,24"
    run(tasks)
    assert penumbra.read(output).image.tobytes() == expected(scenes, device, tmp_path, 3)
    # A picture is denoised and shown as `penumbra render` would, though it is `penumbra merge` that writes it.
    picture = tmp_path / "picture.png"
    tasks = json.loads(compile(output=str(picture), spp=4, ranges=2, flags=f"{flags} --view agx --exposure=-1").stdout)
    run(tasks)
    assert picture.read_bytes() == shown(scenes, device, tmp_path, 4)
    tasks = json.loads(compile(output=str(picture), spp=4, ranges=2, flags=f"{flags} --denoise none").stdout)
    arguments = [task["commands"][0]["parameters"]["args"] for task in tasks]
    assert all("auto" not in of_task for of_task in arguments) and "--denoise=none" in arguments[2]

    frames = json.loads(compile(output="f.{frame}.png", frames="0-7,9", fps=12).stdout)
    arguments = [task["commands"][0]["parameters"]["args"] for task in frames]
    assert ["--frames", "0..7", "--fps", "12"] == arguments[0][-4:] and "9..9" in arguments[1]
    for wrong in [
        {"frames": "0-7"},
        {"frames": "0-7", "ranges": 2},
        {"ranges": 3, "spp": 2},
        {"ranges": 0},
        {"columns": 2, "flags": "--width 8"},
        {"columns": 9, "flags": "--width 8 --height=8"},
        {"ranges": 2, "flags": "--crop 0,0,4,4"},
    ]:
        assert compile(output="f.exr", **wrong).returncode != 0, wrong
