"""A real Ray cluster of two workers on this machine, of which one is killed while it renders."""

import penumbra
import pytest

ray = pytest.importorskip("ray", reason="Ray is not installed: pip install './python[ray]'")

import penumbra.ray  # noqa: E402
from ray.cluster_utils import Cluster  # noqa: E402

SETTINGS = {"width": 64, "height": 48, "max_bounces": 0}


class Workers:
    """A head that does not work, and two nodes of one worker each."""

    def __init__(self) -> None:
        # A dead node is noticed after three seconds instead of half a minute.
        health = {
            "health_check_initial_delay_ms": 0,
            "health_check_period_ms": 1000,
            "health_check_failure_threshold": 3,
        }
        self.cluster = Cluster(
            initialize_head=True, head_node_args={"num_cpus": 0, "_system_config": health, "include_dashboard": False}
        )
        self.nodes = []
        self.complete()
        ray.init(address=self.cluster.address, log_to_driver=False)

    def complete(self) -> None:
        """Two workers, both alive."""
        while len(self.nodes) < 2:
            self.nodes.append(self.cluster.add_node(num_cpus=1))
        self.cluster.wait_for_nodes()
        self.killed: str | None = None

    def kill_one(self) -> None:
        node = self.nodes.pop()
        self.killed = node.node_id
        self.cluster.remove_node(node, allow_graceful=False)

    def stop(self) -> None:
        ray.shutdown()
        self.cluster.shutdown()


@pytest.fixture(scope="module")
def cluster():
    workers = Workers()
    yield workers
    workers.stop()


@pytest.fixture
def workers(cluster):
    cluster.complete()
    return cluster


def test_pieces_of_a_killed_worker_are_rendered_again(workers, scenes, device, tmp_path):
    """16 pieces: four ranges of samples, four tiles."""
    seen = []

    def progress(rendered, count):
        assert count == 16
        seen.append(rendered)
        if len({piece.node for piece in seen}) == 2 and workers.killed is None:
            workers.kill_one()

    output = tmp_path / "whole.exr"
    done = penumbra.ray.render(
        scenes / "box.glb", output, spp=8, ranges=4, tiles=(2, 2), aovs=["albedo", "N"], device=device,
        progress=progress, **SETTINGS,
    )
    assert len(done) == 16 and len({piece.piece for piece in done}) == 16
    assert workers.killed is not None, "both workers must have had pieces before one is killed"
    assert len({piece.node for piece in done}) == 2
    scene = penumbra.Scene.load(scenes / "box.glb")
    alone = tmp_path / "alone.exr"
    scene.render(spp=8, samples=(0, 8), aovs=["albedo", "N"], device=device, **SETTINGS).save(alone)
    expected = tmp_path / "expected.exr"
    penumbra.merge([alone]).save(expected)
    assert output.read_bytes() == expected.read_bytes()


def test_frames_are_those_of_one_process(workers, scenes, device, tmp_path):
    """A scene that is sent, since workers on other machines would not see it; one worker is killed on the way."""
    animated = tmp_path / "animated.glb"
    animated.write_bytes(turning((scenes / "box.glb").read_bytes()))

    def progress(rendered, count):
        assert count == 24
        if rendered.piece.frame == 8 and workers.killed is None:
            workers.kill_one()

    output = tmp_path / "frame.{frame}.exr"
    settings = {"width": 24, "height": 24, "max_bounces": 0, "device": device}
    done = penumbra.ray.render(animated, output, frames=range(24), spp=2, send=True, progress=progress, **settings)
    assert sorted(piece.piece.frame for piece in done) == list(range(24))
    assert workers.killed is not None
    images = set()
    scene = penumbra.Scene.load(animated)
    for frame in range(24):
        written = penumbra.read(tmp_path / f"frame.{frame:04}.exr").image.tobytes()
        assert written == scene.at(frame / 24).render(spp=2, **settings).image.tobytes()
        images.add(written)
    assert len(images) == 24, "the animation moves"


def test_a_file_that_changes_is_read_again(workers, scenes, device, tmp_path):
    """Workers keep the last scene, and have it from the first image."""
    scene, output = tmp_path / "scene.glb", tmp_path / "whole.exr"
    settings = {"spp": 8, "device": device, **SETTINGS}
    for name in ["box.glb", "sphere.glb"]:
        scene.write_bytes((scenes / name).read_bytes())
        penumbra.ray.render(scene, output, ranges=4, **settings)
        alone = tmp_path / "alone.exr"
        penumbra.Scene.load(scene).render(samples=(0, 8), **settings).save(alone)
        assert penumbra.read(output).image.tobytes() == penumbra.merge([alone]).image.tobytes(), name


def test_frames_have_one_camera(workers, scenes, device, tmp_path):
    """The file has no camera, so each worker must frame the same moment."""
    face = scenes.parent / "tests/scene/poses/face.gltf"
    settings = {"width": 24, "height": 16, "max_bounces": 0, "device": device, "spp": 1}
    output = tmp_path / "{frame}.exr"
    penumbra.ray.render(face, output, frames=range(1, 4), fps=2, scene={"default_light": True}, **settings)
    scene = penumbra.Scene.load(face, default_light=True)
    for frame in range(1, 4):
        written = penumbra.read(tmp_path / f"{frame:04}.exr").image.tobytes()
        assert written == scene.at(frame / 2).render(**settings).image.tobytes(), frame


def test_a_png_has_its_alpha_channel(workers, scenes, device, tmp_path):
    settings = {"width": 24, "height": 16, "max_bounces": 0, "device": device, "spp": 2, "background": "transparent"}
    penumbra.ray.render(scenes / "sphere.glb", tmp_path / "whole.png", **settings)
    assert (tmp_path / "whole.png").read_bytes() == penumbra.Scene.load(scenes / "sphere.glb").render(**settings).png()


def test_all_files_of_a_scene_are_sent(workers, scenes, device, tmp_path):
    """Functions of procedural objects, which a .glb names, and a panorama; none of them is there later."""
    import shutil

    folder = tmp_path / "here"
    shutil.copytree(scenes / "procedural", folder / "procedural")
    for name in ["procedural.glb", "sky.exr"]:
        shutil.copy(scenes / name, folder)
    settings = {"width": 24, "height": 24, "max_bounces": 0, "spp": 1, "device": device}
    load = {"environment": folder / "sky.exr", "environment_rotation": 90.0}
    loaded = penumbra.Scene.load(folder / "procedural.glb", **load)
    assert [file.name for file in loaded.files] == ["marble.wgsl", "menger.wgsl", "sphere.wgsl"]
    expected = loaded.render(**settings).image.tobytes()
    sent = penumbra.ray._pack(folder / "procedural.glb", dict(load), False)
    shutil.rmtree(folder)
    kept = {"environment_rotation": 90.0}
    assert penumbra.ray._load(sent, kept, None).render(**settings).image.tobytes() == expected


def test_missing_files_of_a_lenient_scene_are_not_sent(scenes, tmp_path):
    import json

    document = json.loads((scenes.parent / "tests/scene/poses/face.gltf").read_bytes())
    document["images"] = [{"uri": "missing.png"}]
    file = tmp_path / "face.gltf"
    file.write_text(json.dumps(document))
    assert [file.name for file in penumbra.Scene.load(file, lenient=True).files] == ["missing.png"]
    assert list(penumbra.ray._pack(file, {"lenient": True}, False).files) == ["scene/face.gltf"]


def turning(glb: bytes) -> bytes:
    """The scene with an animation that turns its camera's node for a second."""
    import json
    import struct

    length = struct.unpack_from("<I", glb, 12)[0]
    document = json.loads(glb[20 : 20 + length])
    rest = glb[20 + length :]
    blob_length = struct.unpack_from("<I", rest, 0)[0]
    blob = rest[8 : 8 + blob_length]
    camera = next(index for index, node in enumerate(document["nodes"]) if "camera" in node)
    at = document["nodes"][camera].get("translation", [0, 0, 0])
    times = struct.pack("<2f", 0, 1)
    moves = struct.pack("<6f", *at, at[0] + 0.2, at[1], at[2])
    views, accessors = document["bufferViews"], document["accessors"]
    for data, count, kind, limits in [
        (times, 2, "SCALAR", {"min": [0], "max": [1]}),
        (moves, 2, "VEC3", {}),
    ]:
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(data)})
        accessors.append({"bufferView": len(views) - 1, "componentType": 5126, "count": count, "type": kind, **limits})
        blob += data
    document["buffers"][0]["byteLength"] = len(blob)
    channel = {"sampler": 0, "target": {"node": camera, "path": "translation"}}
    sampler = {"input": len(accessors) - 2, "output": len(accessors) - 1}
    document["animations"] = [{"channels": [channel], "samplers": [sampler]}]
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text + struct.pack("<II", len(blob), 0x004E4942) + blob
    return struct.pack("<III", 0x46546C67, 2, 12 + len(chunks)) + chunks


def test_errors_come_back_as_the_librarys(scenes, tmp_path):
    with pytest.raises(penumbra.Error, match="must contain {frame}"):
        penumbra.ray.render(scenes / "box.glb", tmp_path / "frame.exr", frames=range(2))
    with pytest.raises(penumbra.Error, match="written as .exr or .png"):
        penumbra.ray.render(scenes / "box.glb", tmp_path / "whole.jpg")
    with pytest.raises(penumbra.Error, match="there is no folder"):
        penumbra.ray.render(scenes / "box.glb", tmp_path / "none" / "whole.exr")
    with pytest.raises(penumbra.Error, match="^fps is 0"):
        penumbra.ray.render(scenes / "box.glb", tmp_path / "{frame}.exr", frames=range(2), fps=0)
    with pytest.raises(penumbra.Error, match="^fps is inf; it must be finite"):
        penumbra.ray.render(scenes / "box.glb", tmp_path / "{frame}.exr", frames=range(2), fps=float("inf"))
    with pytest.raises(penumbra.Error, match="^ranges is 17"):
        penumbra.ray.render(scenes / "box.glb", tmp_path / "whole.exr", ranges=17)
    with pytest.raises(penumbra.Error, match="need width and height"):
        penumbra.ray.render(scenes / "box.glb", tmp_path / "whole.exr", tiles=(2, 2))


def test_an_error_of_a_worker_is_the_librarys(workers, scenes, device, tmp_path):
    with pytest.raises(penumbra.Error, match="^nearest is 600; it must be from 1 to 511$"):
        penumbra.ray.render(scenes / "box.glb", tmp_path / "whole.exr", spp=4, ranges=2, nearest=600, device=device)
    assert not (tmp_path / "whole.exr").exists()
