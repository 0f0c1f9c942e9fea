"""The paper's methods and those that go beyond it: the trainings and options of each."""

from typing import Any, NamedTuple

from cvn import blending
from experiments.lib.evaluation import ALPHAS

# The flags of experiments.train for each training.
TRAININGS: dict[str, dict[str, str]] = {
  'r2n2': {'network': 'r2n2'},
  'cross_entropy': {'network': 'shape', 'shape_loss': 'cross_entropy'},
  'msfcel': {'network': 'shape'},
  'regression': {'network': 'regression'},
  'flow': {'network': 'flow'},
  'blended': {'network': 'color'},
  'unified': {'network': 'joint'},
  'msfcel_release': {'network': 'shape', 'recipe': 'release'},
  'blended_release': {'network': 'color', 'recipe': 'release'},
  'msfcel_best': {'network': 'shape', 'recipe': 'best'},
  'blended_best': {'network': 'color', 'recipe': 'best'},
  'msfcel_mixed': {'network': 'shape', 'dtype': 'mixed'},
  'blended_mixed': {'network': 'color', 'dtype': 'mixed'},
  'blended_surface': {'network': 'color', 'heads': 'surface'},
}


class Method(NamedTuple):
  """A way to make coloured voxels from a view."""

  title: str
  shape: str  # the training of the network that gives shapes
  color: str  # the training of the network that gives colours; '' if the method has no colours
  alpha: float | str = blending.ALPHA  # or 'val': chosen on the split val
  threshold: str = 'paper'  # or 'val', for methods without a threshold in the paper's program
  flip: bool = False  # whether to average with the mirrored view
  carve: bool = False  # whether to carve shapes by the view's silhouette


_ON_VAL: dict[str, Any] = {'alpha': 'val', 'threshold': 'val'}
METHODS = {
  'r2n2': Method('Adapted R2N2', 'r2n2', 'r2n2', threshold='val'),
  'cross_entropy': Method('Ours (cross-entropy)', 'cross_entropy', ''),
  'msfcel': Method('Ours (MSFCEL)', 'msfcel', ''),
  'msfcel_release': Method("Ours (MSFCEL), authors' recipe", 'msfcel_release', ''),
  'regression': Method('Our baseline (clr. reg.)', 'msfcel', 'regression'),
  'flow': Method('Our baseline (flw.)', 'msfcel', 'flow'),
  **{f'blended_{a:g}': Method(f'Ours (α = {a:g})', 'msfcel', 'blended', a) for a in ALPHAS},
  'blended_release': Method("Ours (α = 0.2), authors' recipe", 'msfcel_release', 'blended_release'),
  'unified': Method('Unified network', 'unified', 'unified'),
  # Faster ways to train the same networks, to compare with the plain ones.
  'msfcel_mixed': Method('Ours (MSFCEL), mixed precision', 'msfcel_mixed', ''),
  'blended_mixed': Method('Ours (α = 0.2), mixed precision', 'msfcel', 'blended_mixed'),
  'blended_surface': Method('Ours (α = 0.2), surface heads', 'msfcel', 'blended_surface'),
  # Beyond the paper; each step adds one thing to the one before.
  'plus_threshold': Method('+ threshold chosen on val', 'msfcel', 'blended', threshold='val'),
  'plus_alpha': Method('+ α chosen on val', 'msfcel', 'blended', **_ON_VAL),
  'plus_color': Method('+ colours by the recipe best', 'msfcel', 'blended_best', **_ON_VAL),
  'plus_shape': Method('+ shapes by the recipe best', 'msfcel_best', 'blended_best', **_ON_VAL),
  'plus_flip': Method(
    '+ mean with the mirrored view', 'msfcel_best', 'blended_best', **_ON_VAL, flip=True
  ),
  'best': Method('Recipe best', 'msfcel_best', 'blended_best', **_ON_VAL, flip=True, carve=True),
}
