"""How far an image's features lie from those of the training images.

Batch normalisation keeps the mean and the variance that every feature had in training. So the
network itself knows what is usual: for training images, the squared deviation of a feature from
its mean is one variance on average.
"""

from typing import Any

import jax
import jax.numpy as jnp

from cvn.data import GREY, composite
from cvn.networks import ENCODER, Encoder

_EPSILON = 1e-3  # of the layers' normalisation


@jax.jit
def feature_deviation(variables: Any, views: Any, *, background: float = GREY) -> jax.Array:
  """Mean squared deviation of the encoder's code, in the variances of training.

  Args:
    variables: {'params', 'batch_stats'} of any of the networks.
    views: [B, H, W, 4], straight-alpha sRGB, uint8 or float in [0, 1].
    background: grey level in [0, 1] behind the object.

  Returns:
    [B], about 1 for images like those of training, larger for others.
  """
  params, stats = (variables[k]['trunk']['encoder'] for k in ('params', 'batch_stats'))
  encoder = Encoder(params['latent1']['kernel'].shape[-1])
  last = f'conv{len(ENCODER)}'
  _, found = encoder.apply(
    {'params': params, 'batch_stats': stats},
    composite(views, background=background),
    False,
    capture_intermediates=lambda module, _: module.name == last,
    mutable=['intermediates'],
  )
  code = found['intermediates'][last]['__call__'][0]
  layer, norm = params['latent0'], stats['latent0']['norm']
  mean = (norm['mean'] - layer['bias'])[None]
  deviation = (code @ layer['kernel'] - mean) ** 2 / (norm['var'] + _EPSILON)[None]
  return jnp.mean(deviation, -1)
