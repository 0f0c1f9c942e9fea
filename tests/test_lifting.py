import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cvn import camera, grid, lifting, sampler

AZIMUTHS = camera.AZIMUTHS
RAYS = lifting.make_rays(AZIMUTHS, grid_size=32, image_size=64, depths=32)


def lift(frustum, azimuths, shares=None, rays=RAYS):
  azimuths = jnp.asarray(azimuths)
  shares = jnp.ones(azimuths.shape) if shares is None else jnp.asarray(shares)
  return np.asarray(lifting.lift(frustum, azimuths, shares, rays))


def project(azimuth, size=32):
  """Where the camera of an azimuth sees the voxels: (u, v) [X, Y, Z, 2] and depths [X, Y, Z]."""
  index = np.stack(np.meshgrid(*[np.arange(size)] * 3, indexing='ij'), -1)
  return camera.project(
    grid.index_to_world(index, size=size), camera.camera_at(azimuth, image_size=1)
  )


@pytest.mark.parametrize('number', [0, 1, 5, 9])
def test_a_lifted_feature_is_the_bilinear_sample_of_the_image_at_the_projection(number):
  y, x = np.meshgrid(*[np.linspace(0, 3, 64)] * 2, indexing='ij')
  image = np.stack([np.sin(x + y), np.cos(2 * x - y)], -1)[None].astype(np.float32)
  frustum = np.broadcast_to(image[:, :, :, None], (1, 64, 64, 32, 2))
  lifted = lift(frustum, [[number]])
  flow, _ = project(AZIMUTHS[number])
  expected = sampler.bilinear(jnp.asarray(image), jnp.asarray(flow[None], jnp.float32))
  # Rows are those of the two nearest depths, so v is off by up to 1/50 of a pixel.
  np.testing.assert_allclose(lifted, expected, atol=2e-3)


@pytest.mark.parametrize('number', [0, 4, 11])
def test_coordinates_of_the_frustum_come_back(number):
  v, u, d = np.meshgrid(*[(np.arange(n) + 0.5) / n for n in (64, 64, 32)], indexing='ij')
  lifted = lift(np.stack([u, v, d], -1)[None].astype(np.float32), [[number]])[0]
  flow, depth = project(AZIMUTHS[number])
  np.testing.assert_allclose(lifted[..., :2], flow, atol=3e-4)
  share = (depth - lifting.NEAR) / (lifting.FAR - lifting.NEAR)
  held = (share > 0.5 / 32) & (share < 1 - 0.5 / 32)
  assert held.mean() > 0.99
  np.testing.assert_allclose(lifted[..., 2][held], share[held], atol=1e-5)


def test_the_frustum_holds_the_cube_at_every_azimuth():
  for azimuth in AZIMUTHS:
    flow, depth = project(azimuth)
    assert flow.min() >= 0 and flow.max() <= 1
    assert depth.min() > lifting.NEAR and depth.max() < lifting.FAR


def test_a_volume_is_the_mean_over_azimuths():
  frustum = np.random.default_rng(0).normal(size=(2, 64, 64, 32, 3)).astype(np.float32)
  one, other = lift(frustum, [[3], [3]]), lift(frustum, [[7], [0]])
  both = lift(frustum, [[3, 7], [3, 0]], [[0.25, 0.75], [1, 0]])
  np.testing.assert_allclose(both[0], 0.25 * one[0] + 0.75 * other[0], atol=1e-5)
  np.testing.assert_allclose(both[1], one[1], atol=1e-5)


def test_the_mirrored_image_gives_the_mirrored_volume():
  """The view from azimuth a, turned over, is the mirrored object's view from -a."""
  frustum = np.random.default_rng(0).normal(size=(1, 64, 64, 32, 1)).astype(np.float32)
  np.testing.assert_allclose(
    lift(frustum[:, :, ::-1], [[10]]), lift(frustum, [[2]])[:, ::-1], atol=1e-5
  )


def test_gradients_are_those_of_a_mean():
  frustum = jnp.ones((1, 64, 64, 32, 1))

  def total(frustum, shares):
    return jnp.sum(lifting.lift(frustum, jnp.array([[1, 8]]), shares, RAYS))

  of_frustum, of_shares = jax.grad(total, (0, 1))(frustum, jnp.array([[0.5, 0.5]]))
  assert np.isfinite(of_frustum).all()
  np.testing.assert_allclose(of_shares, 32**3, rtol=1e-5)
  np.testing.assert_allclose(of_frustum.sum(), 32**3, rtol=1e-5)  # each voxel's weights sum to one


def test_what_does_not_fit_is_refused():
  with pytest.raises(ValueError, match=r'a frustum \[B, 64, U, 32, C\]'):
    lift(np.zeros((1, 32, 32, 32, 1), np.float32), [[0]])
