"""The bundled denoiser on arrays."""

import pathlib
import warnings

import numpy as np
import pytest

import tauflow
from tauflow import TauflowError, TauflowWarning

MODELS = pathlib.Path(__file__).parents[2] / "models"


def scene():
    """A striped wall under noise: radiance, albedo and normal."""
    albedo = np.where(np.arange(40) // 8 % 2 == 0, 0.2, 0.8)[None, :, None] * np.ones((24, 1, 3))
    noise = np.random.default_rng(3).exponential(size=(24, 40, 1))
    return (albedo * noise).astype(np.float32), albedo, np.broadcast_to([0.0, 0.0, 1.0], albedo.shape)


def test_arrays_are_denoised():
    noisy, albedo, normal = scene()
    error = lambda image: float(((image - albedo) ** 2).mean())
    clean = tauflow.denoise(noisy, albedo, normal)
    assert clean.dtype == np.float32 and clean.shape == noisy.shape and error(clean) < 0.25 * error(noisy)
    assert not np.array_equal(tauflow.denoise(noisy, weights="fast"), tauflow.denoise(noisy))
    own = tauflow.denoise(noisy, model=MODELS / "fast_rgb.safetensors")
    assert np.array_equal(own, tauflow.denoise(noisy, weights="fast"))
    assert np.array_equal(tauflow.denoise(noisy, strength=0.0), noisy)
    kept = tauflow.denoise(noisy, albedo, normal, variance=np.zeros_like(noisy))
    assert ((kept - noisy) ** 2).mean() < 0.1 * error(noisy)


def test_a_guess_at_the_space_of_normals_is_told():
    noisy, albedo, _ = scene()
    away = np.broadcast_to([0.0, 0.8, 0.6], albedo.shape).copy()
    away[:6] = [0.8, 0.0, -0.6]
    with pytest.warns(TauflowWarning, match="look as if they were in world space"):
        guessed = tauflow.denoise(noisy, albedo, away)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        camera = tauflow.denoise(noisy, albedo, away, normals="camera")
        world = tauflow.denoise(noisy, albedo, away, normals="world")
    assert np.array_equal(guessed, world) and not np.array_equal(guessed, camera)


def test_what_does_not_fit_is_told():
    noisy, albedo, normal = scene()
    with pytest.raises(TauflowError, match="belong together"):
        tauflow.denoise(noisy, albedo)
    with pytest.raises(TauflowError, match=r"`albedo` has the shape \(12, 40, 3\)"):
        tauflow.denoise(noisy, albedo[::2], normal)
    with pytest.raises(TauflowError, match=r"`radiance` has the shape \(24, 40\)"):
        tauflow.denoise(noisy[..., 0])
    with pytest.raises(TauflowError, match="the image: .*no finite pixel"):
        tauflow.denoise(noisy * np.nan)
    with pytest.raises(TauflowError, match="better"):
        tauflow.denoise(noisy, weights="better")
