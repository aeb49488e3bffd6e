"""What the tests share. They run on lavapipe unless PENUMBRA_DEVICE names another device, as Penumbra's other tests."""

import os
import pathlib
import signal

import penumbra
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]

# A shell that starts a job in the background has it ignore Ctrl-C, and Python then installs no handler: renders that a
# test interrupts would never end.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def scenes() -> pathlib.Path:
    return ROOT / "scenes"


@pytest.fixture(scope="session")
def device() -> str:
    return os.environ.get("PENUMBRA_DEVICE") or "software"


@pytest.fixture(scope="session")
def box(scenes: pathlib.Path) -> penumbra.Scene:
    return penumbra.Scene.load(scenes / "box.glb")
