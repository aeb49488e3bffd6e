"""Errors, interruptions and the interpreter's lock."""

import inspect
import os
import pickle
import signal
import threading

import penumbra
import pytest


def test_errors_of_files_are_the_librarys(tmp_path):
    with pytest.raises(penumbra.Error, match="missing.glb") as raised:
        penumbra.Scene.load(tmp_path / "missing.glb")
    assert raised.value.result is None
    damaged = tmp_path / "damaged.glb"
    damaged.write_bytes(b"glTF\x02\0\0\0\xff\xff\xff\xff")
    with pytest.raises(penumbra.Error, match="damaged.glb: "):
        penumbra.Scene.load(damaged)
    with pytest.raises(penumbra.Error, match="must be .exr, .png or .hdr"):
        penumbra.read(damaged)


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"width": 0}, "^width is 0; it must be from 1 to 16384$"),
        ({"width": -1}, "^width is -1, which is out of range$"),
        ({"nearest": 600}, "^nearest is 600; it must be from 1 to 511$"),
        ({"audit": 2.0}, "^audit is 2; "),
        ({"flux_photons": 0}, "^flux_photons is 0; "),
        ({"technique": "raster"}, "raster.*path"),
        ({"aovs": ["colour"]}, "no AOV is called 'colour'"),
        ({"denoise": "yes"}, "no denoiser is called 'yes'"),
        ({"camera": "none"}, "no camera is called 'none'"),
        ({"camera": 99}, "no camera is called '99'"),
        ({"crop": (0, 0, 9999, 1)}, "^crop is 9999 x 1 pixels"),
        ({"time": -1.0}, "^time is -1; "),
        ({"time": 1.0, "samples": (0, 8)}, "^time cannot be combined with samples"),
        ({"focus": 1.0}, "need aperture"),
        ({"aperture": 0.0}, "^aperture: an f-number must be"),
        ({"aperture": 2.0, "focus": -1.0}, "^aperture: a focus distance must be"),
        ({"aperture": 2.0, "iris_blades": 2}, "^aperture: an iris must have"),
        ({"background": "sky"}, "^background is 'sky'"),
        ({"background": (1.0, 0.5)}, "^background is "),
        ({"crop": (0, 0, 8)}, "^crop is "),
        ({"samples": (0, 8, 16)}, "^samples is "),
        ({"direction": (0.0,)}, "^direction is "),
        ({"device": "no such device"}, "no such device"),
        ({"oidn_library": "missing.so"}, "^oidn_library missing.so is used only with denoise"),
    ],
)
def test_errors_of_keywords_name_the_keyword(box, keywords, message):
    with pytest.raises(penumbra.Error, match=message):
        box.render(**keywords)


def test_wrong_types_are_type_errors(box):
    with pytest.raises(TypeError, match="has no keyword argument 'samples_per_pixel'"):
        box.render(samples_per_pixel=4)
    with pytest.raises(TypeError, match="^spp: "):
        box.render(spp="many")
    with pytest.raises(TypeError, match="has no keyword argument 'repeat'"):
        penumbra.Scene.load("box.glb", repeat=True)
    with pytest.raises(penumbra.Error, match="need at"):
        penumbra.Scene.load("box.glb", loop=True)
    with pytest.raises(penumbra.Error, match="need environment"):
        penumbra.Scene.load("box.glb", environment_rotation=90.0)


@pytest.mark.parametrize("exposure", [float("nan"), float("inf")])
def test_an_exposure_is_finite(box, device, tmp_path, exposure):
    result = box.render(width=4, height=4, spp=1, max_bounces=0, device=device)
    with pytest.raises(penumbra.Error, match=f"^exposure is {exposure}; it must be finite$".replace("nan", "NaN")):
        result.save(tmp_path / "a.png", exposure=exposure)
    with pytest.raises(penumbra.Error, match="^exposure is "):
        result.png(exposure=exposure)


def test_every_keyword_of_the_signature_is_known(box):
    names = set(inspect.signature(penumbra.Scene.render).parameters) - {"self", "device"}
    assert len(names) > 30
    # A name that is not known would be a TypeError before the device is looked for.
    with pytest.raises(penumbra.Error, match="no such device"):
        box.render(**dict.fromkeys(names), device="no such device")


def test_animations_are_refused_where_there_is_none(box):
    with pytest.raises(penumbra.Error, match="^at has no meaning: the scene has no animation$"):
        box.at(1.0)


def test_a_callback_cannot_render(box, device):
    """It would wait for its own render for ever."""

    def progress(_):
        box.render(width=8, height=8, spp=1, device=device)

    with pytest.raises(penumbra.Error, match="cannot use a device"):
        box.render(width=8, height=8, spp=2, device=device, progress=progress)
    box.render(width=8, height=8, spp=1, device=device)


def test_an_exception_of_the_callback_ends_the_render(box, device):
    class Mine(Exception):
        pass

    def fail(progress):
        raise Mine(progress.samples)

    with pytest.raises(Mine) as raised:
        box.render(width=16, height=16, spp=64, max_bounces=0, device=device, progress=fail)
    assert 1 <= raised.value.result.samples < 64
    # The device is as it was.
    assert box.render(width=16, height=16, spp=1, max_bounces=0, device=device).samples == 1


def test_ctrl_c_ends_the_render_and_keeps_its_samples(box, device):
    def interrupt(progress):
        if progress.samples >= 2:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt) as raised:
        box.render(width=16, height=16, spp=1 << 20, max_bounces=0, device=device, progress=interrupt)
    assert isinstance(raised.value, penumbra.Interrupted)
    result = raised.value.result
    assert 2 <= result.samples < 1 << 20
    expected = box.render(
        width=16, height=16, spp=1 << 20, max_bounces=0, device=device,
        progress=lambda progress: progress.samples < result.samples,
    )
    assert result.image.tobytes() == expected.image.tobytes()


def test_ctrl_c_while_denoising_keeps_the_samples(box, device):
    """A signal after the last batch is raised with the result, not between the render and its assignment."""
    timer = threading.Timer(0.05, os.kill, [os.getpid(), signal.SIGINT])

    def start(progress):
        if progress.samples == 2:
            timer.start()

    # The filter takes far longer than the timer for this many pixels.
    with pytest.raises(penumbra.Interrupted) as raised:
        box.render(
            width=640, height=640, spp=2, max_bounces=0, technique="two-pass", denoise="statistical", device=device,
            progress=start,
        )
    timer.join()
    assert raised.value.result.samples == 2


def test_a_fork_is_told_how_to_start_processes(box):
    """It lacks the threads of its parent, and would wait for them for ever."""
    child = os.fork()
    if child == 0:
        try:
            box.at(0.0)
        except penumbra.Error as error:
            os._exit(7 if "set_start_method('spawn')" in str(error) else 1)
        finally:
            os._exit(2)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7


def test_a_signal_from_outside_is_seen_without_a_callback(box, device):
    timer = threading.Timer(1.0, os.kill, [os.getpid(), signal.SIGINT])
    timer.start()
    with pytest.raises(penumbra.Interrupted):
        # It would take hours.
        box.render(width=64, height=64, spp=1 << 24, max_bounces=0, device=device)
    timer.join()


def test_other_threads_go_on_while_a_render_runs(box, device):
    """With the lock held, this thread would stop at its first wait, and go on when the render is over. On a busy machine
    a wait of a millisecond has taken 50."""
    settings = {"width": 64, "height": 64, "max_bounces": 0, "device": device}
    box.render(**settings, spp=1)
    thread = threading.Thread(target=lambda: box.render(**settings, time=1.0))
    thread.start()
    waits = 0
    while thread.is_alive():
        thread.join(0.001)
        waits += 1
    assert waits > 3


def test_threads_render_in_turn_on_one_device(box, device):
    results = {}

    def render(seed):
        results[seed] = box.render(width=16, height=16, spp=2, max_bounces=0, seed=seed, device=device).image.tobytes()

    threads = [threading.Thread(target=render, args=[seed]) for seed in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for seed, bits in results.items():
        alone = box.render(width=16, height=16, spp=2, max_bounces=0, seed=seed, device=device)
        assert alone.image.tobytes() == bits
    assert len(set(results.values())) == 3


def test_errors_can_be_pickled():
    """Ray and multiprocessing carry exceptions from worker to driver."""
    error = pickle.loads(pickle.dumps(penumbra.Error("text")))
    assert isinstance(error, penumbra.Error) and str(error) == "text"
