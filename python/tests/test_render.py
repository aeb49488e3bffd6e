"""Shapes, types, bits and statistics of renders."""

import os
import subprocess

import numpy
import penumbra
import pytest

# Direct light alone: fewer kernels to compile.
QUICK = {"width": 48, "height": 32, "spp": 2, "max_bounces": 0}


def test_the_image_is_a_float32_array_of_rows(box, device):
    result = box.render(**QUICK, device=device)
    assert result.image.shape == (32, 48, 3)
    assert result.image.dtype == numpy.float32
    assert result.image.flags.c_contiguous and result.image.flags.writeable
    assert result.alpha.shape == (32, 48)
    assert result.image is result.image
    assert result.image.mean() > 0.01
    # The lamp is at the ceiling: rows run from the top.
    assert result.image[:16].max() > 2 * result.image[16:].max()


def test_aovs_are_arrays_by_name(box, device):
    result = box.render(**QUICK, aovs="all", device=device)
    shapes = {name: array.shape for name, array in result.aovs.items()}
    for name in ["direct", "indirect", "albedo", "N", "P", "variance"]:
        assert shapes[name] == (32, 48, 3), name
    for name in ["Z", "samples"]:
        assert shapes[name] == (32, 48), name
    assert any(name.startswith("shadow.") and name.endswith(".class") for name in shapes)
    assert {array.dtype for array in result.aovs.values()} == {numpy.dtype("float32")}
    assert (result.aovs["samples"] == 2).all()
    lengths = numpy.linalg.norm(result.aovs["N"], axis=2)
    # Normals are normalised in f64, and stored in f32.
    assert numpy.allclose(lengths[result.alpha == 1], 1, atol=1e-6)
    assert numpy.array_equal(result.aovs["direct"], result.image)
    some = box.render(**QUICK, aovs=["Z", "albedo"], device=device)
    assert set(some.aovs) == {"Z", "albedo"}


def test_statistics_are_a_dict(box, device):
    statistics = box.render(**QUICK, seed=7, device=device).statistics
    assert statistics["samples"] == 2
    assert statistics["settings"]["seed"] == 7
    assert statistics["rays"]["camera"] == 2 * 48 * 32
    assert statistics["time"]["total"] > 0
    assert isinstance(statistics["notes"], list)


def test_pass_times_are_those_of_one_render(box, device):
    photons = box.render(**QUICK, technique="shadow-photons", photons=4096, device=device)
    rays = box.render(**QUICK, technique="two-pass", device=device)
    assert "photons/photons" in photons.statistics["time"]["passes"]
    assert "shadow/shadow" in rays.statistics["time"]["passes"]
    assert "photons/photons" not in rays.statistics["time"]["passes"]


def test_bits_are_those_of_a_second_render_and_of_a_saved_file(box, device, tmp_path):
    first = box.render(**QUICK, aovs=["Z", "N"], device=device)
    again = box.render(**QUICK, aovs=["Z", "N"], device=device)
    assert first.image.tobytes() == again.image.tobytes()
    other = box.render(**QUICK, seed=1, device=device)
    assert first.image.tobytes() != other.image.tobytes()
    first.save(tmp_path / "first.exr")
    file = penumbra.read(tmp_path / "first.exr")
    assert set(file.aovs) == {"Z", "N"} and file.samples == 2 and file.statistics == {}
    assert file.image.tobytes() == first.image.tobytes()
    assert file.aovs["N"].tobytes() == first.aovs["N"].tobytes()


PROGRAM = os.environ.get("PENUMBRA_PROGRAM")


@pytest.mark.skipif(PROGRAM is None, reason="PENUMBRA_PROGRAM does not name the program")
def test_bits_are_those_of_the_program(scenes, device, tmp_path):
    options = ["--height", "24", "--spp", "3", "--aov", "albedo,N", "--seed", "5", "--device", device]
    output = tmp_path / "program.exr"
    render = [PROGRAM, "render", scenes / "box.glb", "-o", output, "--quiet", *options]
    subprocess.run(render, check=True)
    expected = penumbra.read(output)
    scene = penumbra.Scene.load(scenes / "box.glb")
    result = scene.render(height=24, spp=3, aovs=["albedo", "N"], seed=5, device=device)
    assert result.image.tobytes() == expected.image.tobytes()
    assert result.aovs["albedo"].tobytes() == expected.aovs["albedo"].tobytes()


@pytest.mark.skipif(PROGRAM is None, reason="PENUMBRA_PROGRAM does not name the program")
def test_moments_have_the_camera_of_a_sequence(scenes, device, tmp_path):
    """The file has no camera, so its frames have the one that frames the beginning, with its lens."""
    face = scenes.parent / "tests/scene/poses/face.gltf"
    options = "--default-light --width 24 --height 16 --spp 1 --max-bounces 0 --aperture 2 --focus 9 --from 20,10"
    output = tmp_path / "{frame}.exr"
    command = [PROGRAM, "render", face, "-o", output, "--frames", "2..3", "--fps", "2", "--device", device]
    subprocess.run([*command, *options.split()], check=True)
    settings = {"width": 24, "height": 16, "spp": 1, "max_bounces": 0, "device": device}
    settings |= {"aperture": 2.0, "focus": 9.0, "direction": (20, 10)}
    later = penumbra.Scene.load(face, at=1.5, default_light=True)
    for frame, moment in [(2, later.at(1.0)), (3, later.at(1.5))]:
        expected = penumbra.read(tmp_path / f"{frame:04}.exr").image
        assert moment.render(**settings).image.tobytes() == expected.tobytes(), frame
    # A scene that is loaded at a moment is framed at that moment.
    assert not numpy.array_equal(later.render(**settings).image, expected)


def test_a_crop_is_a_part_of_the_image(box, device):
    settings = QUICK | {"spp": 1}
    whole = box.render(**settings, technique="path", device=device)
    part = box.render(**settings, technique="path", crop=(8, 4, 16, 10), device=device)
    assert part.image.tobytes() == whole.image[4:14, 8:24].tobytes()


def test_notebooks_show_a_png(box, device, tmp_path):
    result = box.render(**QUICK, device=device)
    data = result._repr_png_()
    assert data.startswith(b"\x89PNG\r\n\x1a\n")
    result.save(tmp_path / "image.png")
    assert (tmp_path / "image.png").read_bytes() == data == result.png()
    assert result.png(view="agx") != data
    assert result.png(exposure=1.0) != data


def test_a_file_keeps_what_is_transparent(box, device, tmp_path):
    """Files, of pieces too, have the PNG of the image that they were made of."""
    settings = {"width": 24, "height": 16, "spp": 2, "max_bounces": 0, "background": "transparent", "device": device}
    result = box.render(**settings)
    assert result.png()[25] == 6, "colour type 6 is RGBA"
    result.save(tmp_path / "whole.exr")
    assert penumbra.read(tmp_path / "whole.exr").png() == result.png()
    box.render(**settings, samples=(0, 2)).save(tmp_path / "piece.exr")
    merged = penumbra.merge([tmp_path / "piece.exr"])
    merged.save(tmp_path / "merged.exr")
    assert penumbra.read(tmp_path / "merged.exr").png() == merged.png()
    assert merged.png()[25] == 6


def test_a_denoised_image_is_beside_the_raw_one(box, device):
    raw = box.render(**QUICK, device=device)
    result = box.render(**QUICK, denoise="statistical", device=device)
    assert raw.denoised is None
    assert result.denoised.shape == (32, 48, 3)
    assert result.denoised is result.aovs["denoised"]
    assert result.aovs["error"].shape == (32, 48)
    assert not numpy.array_equal(result.denoised, result.image)


def test_sides_follow_from_each_other(box, device):
    # The camera of the file is square.
    assert box.render(height=16, spp=1, max_bounces=0, device=device).image.shape == (16, 16, 3)
    assert box.render(width=16, spp=1, max_bounces=0, device=device).image.shape == (16, 16, 3)


def test_views(box, device):
    settings = {"width": 16, "height": 16, "spp": 1, "max_bounces": 0, "device": device}
    assert len(box.cameras) >= 1
    default = box.render(**settings).image
    assert numpy.array_equal(box.render(**settings, camera=0).image, default)
    assert numpy.array_equal(box.render(**settings, camera=box.cameras[0]).image, default)
    assert not numpy.array_equal(box.render(**settings, direction=(40, 20)).image, default)


def test_progress_and_an_early_end(box, device):
    reports = []
    result = box.render(width=16, height=16, spp=24, max_bounces=0, device=device, progress=reports.append)
    assert result.samples == 24
    assert [report.samples for report in reports] == sorted(report.samples for report in reports)
    assert reports[-1].samples == reports[-1].spp == 24
    assert reports[-1].rays == result.statistics["rays"]["total"]
    assert len(reports) > 1
    stopped = box.render(width=16, height=16, spp=24, max_bounces=0, device=device, progress=lambda report: False)
    assert stopped.samples == reports[0].samples
    timed = box.render(width=16, height=16, max_bounces=0, device=device, time=0.01)
    assert 1 <= timed.samples


def test_samples_are_the_mean_over_the_pixels_as_in_files(box, device, tmp_path):
    adaptive = box.render(width=32, height=32, spp=64, noise=0.01, max_bounces=0, device=device)
    adaptive.save(tmp_path / "adaptive.exr")
    assert penumbra.read(tmp_path / "adaptive.exr").samples == adaptive.samples
    assert abs(adaptive.samples - adaptive.statistics["mean_samples"]) <= 0.5
    assert adaptive.samples < adaptive.statistics["samples"]


def test_scenes_tell_what_they_are(box, scenes):
    assert box.triangles > 0
    assert len(box.lights) == 1
    assert box.path == scenes / "box.glb"
    assert "box.glb" in repr(box)


def test_the_environment_lights_the_scene(scenes, device):
    lit = penumbra.Scene.load(scenes / "box.glb", environment=scenes / "sky.exr", environment_strength=2)
    assert lit.lights[-1] == "environment"


def test_devices_are_dicts():
    devices = penumbra.devices()
    assert devices and {"name", "kind", "driver"} <= set(devices[0])


def test_pieces_are_merged_to_the_bits_of_one(box, device, tmp_path):
    settings = {"width": 24, "height": 16, "spp": 6, "max_bounces": 0, "aovs": ["N"], "device": device}
    names = {}
    for name, cut in {
        "one": {"samples": (0, 6)},
        "first": {"samples": (0, 4)},
        "left": {"samples": (4, 6), "crop": (0, 0, 9, 16)},
        "right": {"samples": (4, 6), "crop": (9, 0, 15, 16)},
    }.items():
        names[name] = tmp_path / f"{name}.exr"
        piece = box.render(**settings, **cut)
        assert set(piece.aovs) == {"N"}
        piece.save(names[name])
    one = penumbra.merge([names["one"]])
    cut = penumbra.merge([names["right"], names["first"], names["left"]])
    assert one.image.tobytes() == cut.image.tobytes()
    assert one.aovs["N"].tobytes() == cut.aovs["N"].tobytes()
    assert cut.samples == 6
    some = [names["first"], names["left"]]
    with pytest.raises(penumbra.Error, match="samples 4..6 of the pixels 9,0,15,16 are in no piece; partial=True"):
        penumbra.merge(some)
    partial = penumbra.merge(some, partial=True)
    assert numpy.array_equal(partial.image[:, :9], one.image[:, :9])
    assert not numpy.array_equal(partial.image, one.image)
    with pytest.raises(penumbra.Error, match="denoise"):
        penumbra.merge([names["one"]], denoise="statistical", device=device)


def test_merged_pieces_are_denoised_as_one_render(box, device, tmp_path):
    settings = {"width": 24, "height": 16, "spp": 8, "max_bounces": 0, "denoise": "statistical", "device": device}

    def merged(*cuts):
        names = []
        for start, end in cuts:
            names.append(tmp_path / f"{start}-{end}.exr")
            piece = box.render(**settings, samples=(start, end))
            assert piece.denoised is None
            piece.save(names[-1])
        return penumbra.merge(names, denoise="statistical", device=device)

    cut, whole = merged((4, 8), (0, 4)), merged((0, 8))
    assert cut.image.tobytes() == whole.image.tobytes()
    assert cut.denoised.tobytes() == whole.denoised.tobytes()
    assert cut.denoised.tobytes() != cut.image.tobytes()
