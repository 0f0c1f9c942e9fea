"""The paper's methods, and what goes beyond them: the trainings and options of each."""

from typing import Any, NamedTuple

from cvn import blending
from experiments.lib.evaluation import ALPHAS

# The flags of experiments.train that make the paper's networks, and each recipe's.
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
}


class Method(NamedTuple):
  """What makes coloured voxels of a view."""

  title: str
  shape: str  # the training whose network gives shapes
  color: str  # likewise colours; '' for methods of shapes alone
  alpha: float | str = blending.ALPHA  # or 'val': chosen on the split val
  threshold: str = 'paper'  # or 'val', where the paper's program has none
  flip: bool = False  # whether means with the mirrored view are taken
  carve: bool = False  # whether shapes are carved by the view's silhouette


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
  # What goes beyond the paper, one thing after the other.
  'plus_threshold': Method('+ threshold chosen on val', 'msfcel', 'blended', threshold='val'),
  'plus_alpha': Method('+ α chosen on val', 'msfcel', 'blended', **_ON_VAL),
  'plus_color': Method('+ colours by the recipe best', 'msfcel', 'blended_best', **_ON_VAL),
  'plus_shape': Method('+ shapes by the recipe best', 'msfcel_best', 'blended_best', **_ON_VAL),
  'plus_flip': Method(
    '+ mean with the mirrored view', 'msfcel_best', 'blended_best', **_ON_VAL, flip=True
  ),
  'best': Method('Recipe best', 'msfcel_best', 'blended_best', **_ON_VAL, flip=True, carve=True),
}
