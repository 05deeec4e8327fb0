"""The bundled denoiser through its C library."""

import copy
import os
import pathlib
import sys
import threading

import numpy as np
import pytest
from test_denoise import scene

import tauflow
from tauflow import TauflowError, TauflowWarning

BUILT = pathlib.Path(__file__).parents[2] / "target" / "release" / "libtauflow_denoiser_c.so"


@pytest.fixture(scope="module")
def library():
    path = pathlib.Path(os.environ.get("TAUFLOW_DENOISE_LIBRARY", BUILT))
    if not path.exists():
        pytest.skip("no library: cargo build --release -p tauflow-denoiser-c")
    return path


def any_normals(shape):
    """Unit vectors but for rounding, of which most face the camera."""
    normals = np.random.default_rng(5).normal(size=shape).astype(np.float32) + np.float32([0, 0, 1.5])
    return normals / np.linalg.norm(normals, axis=2, keepdims=True)


def test_damaged_normals_and_albedo_have_the_bits_of_the_command(library):
    noisy, albedo, _ = scene()
    normal = any_normals(noisy.shape)
    albedo, normal = albedo.copy(), normal.copy()
    albedo[3, 4, 1], normal[5, 6, 2], normal[7, 8] = np.nan, np.inf, np.nan
    with pytest.warns(TauflowWarning, match="of the (albedo|normals) are not finite"):
        own = tauflow.Denoiser("fast", library)(noisy, albedo, normal)
        command = tauflow.denoise(noisy, albedo, normal, weights="fast", normals="camera")
    assert np.array_equal(own, command)


@pytest.mark.parametrize("weights", ["fast", "best"])
def test_images_have_the_bits_of_the_command(library, weights):
    noisy, albedo, normal = scene()
    denoiser = tauflow.Denoiser(weights, library)
    variance = np.full_like(noisy, 0.02)
    before = noisy.copy()
    for images, options in [
        ((noisy,), {}),
        ((noisy, albedo, normal), {}),
        ((noisy, albedo, normal), {"spp": 4, "strength": 0.75}),
        ((noisy,), {"variance": variance, "exposure": 0.5}),
        ((noisy, albedo, normal), {"variance": variance, "spp": np.int64(8), "strength": 0.1}),
        ((noisy, albedo, any_normals(noisy.shape)), {}),
    ]:
        command = tauflow.denoise(*images, weights=weights, normals="camera", **options)
        own = denoiser(*images, **options)
        assert own.dtype == np.float32 and np.array_equal(own, command), options
    assert np.array_equal(noisy, before)
    # A view of another layout.
    assert np.array_equal(denoiser(noisy[:, ::-1]), denoiser(np.ascontiguousarray(noisy[:, ::-1])))


def test_threads_share_one(library):
    noisy, albedo, normal = scene()
    denoiser, found = tauflow.Denoiser("fast", library), []
    call = lambda: found.append(denoiser(noisy, albedo, normal))
    threads = [threading.Thread(target=call) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 4 and all(np.array_equal(found[0], other) for other in found)


def test_what_is_wrong_is_told(library, monkeypatch):
    noisy, albedo, normal = scene()
    with pytest.raises(TauflowError, match="`better`"):
        tauflow.Denoiser("better", library)
    denoiser = tauflow.Denoiser("fast", library)
    with pytest.raises(TauflowError, match="belong together"):
        denoiser(noisy, albedo)
    with pytest.raises(TauflowError, match=r"`albedo` has the shape \(12, 40, 3\)"):
        denoiser(noisy, albedo[::2], normal)
    with pytest.raises(TauflowError, match="no finite pixel"):
        denoiser(noisy * np.nan)
    odd = noisy.copy()
    odd[1, 2, 0], odd[3, 4] = np.nan, -1.0
    texts = ["1 of 960 pixels of radiance are not finite", "3 values are negative", "normals are longer than 1"]
    for denoise in [denoiser, lambda *images: tauflow.denoise(*images, weights="fast", normals="camera")]:
        with pytest.warns(TauflowWarning) as told:
            denoise(odd, albedo, 3.0 * normal + 2.0)
        for text in texts:
            assert any(text in str(one.message) for one in told), (text, [str(one.message) for one in told])
        assert len(told) == len(texts) and all(one.filename == __file__ for one in told)
    for options in [{"strength": -1.0}, {"strength": float("nan")}, {"spp": 0}, {"spp": -1}, {"exposure": 0.0}]:
        with pytest.raises(TauflowError, match=f"`{next(iter(options))}` is"):
            denoiser(noisy, **options)
    with pytest.raises(TypeError, match="cannot be copied"):
        copy.copy(denoiser)
    with pytest.raises(TauflowError, match="this is no library"):
        tauflow.Denoiser("fast", __file__)
    monkeypatch.delenv("TAUFLOW_DENOISE_LIBRARY", raising=False)
    with pytest.raises(TauflowError, match="cargo build"):
        tauflow.Denoiser("fast")
    monkeypatch.setenv("TAUFLOW_DENOISE_LIBRARY", str(library))
    assert tauflow.Denoiser("fast")(noisy).shape == noisy.shape


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_forked_process_is_told(library):
    noisy = scene()[0]
    denoiser = tauflow.Denoiser("fast", library)
    denoiser(noisy)
    child = os.fork()
    if child == 0:
        code = 1
        try:
            denoiser(noisy)
        except TauflowError as error:
            code = 0 if "spawn" in str(error) else 2
        finally:
            sys.stdout.flush()
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
