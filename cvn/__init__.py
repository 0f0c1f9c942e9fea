"""Colorful Voxel Network: one image in, a coloured 3D model out.

  conventions   grid (voxels), camera (views), errors, files
  mathematics   sampler, blending, losses, metrics, carving, boundary
  networks      networks, layers, surface (heads at surface voxels), ops (the layers' operations)
  training      recipe, objectives, train, checkpoint, parallel (devices and processes)
  data          dataset (on disk), data (batches), augment
  inference     infer (views to coloured voxels), readouts, photo (an image file to a view)
  output        export (mesh files), figures (images)
  evaluation    baselines, intervals, complexity of colours
  processes     environment (memory and compilation cache)

`cvn.infer.reconstruct` is where to start. Modules are imported on first use.
"""

import importlib
from types import ModuleType

__all__ = (
  'augment',
  'blending',
  'boundary',
  'camera',
  'carving',
  'checkpoint',
  'data',
  'dataset',
  'environment',
  'errors',
  'evaluation',
  'export',
  'figures',
  'files',
  'grid',
  'infer',
  'layers',
  'losses',
  'metrics',
  'networks',
  'objectives',
  'ops',
  'parallel',
  'photo',
  'readouts',
  'recipe',
  'sampler',
  'surface',
  'train',
)


def __getattr__(name: str) -> ModuleType:
  if name not in __all__:
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
  return importlib.import_module(f'{__name__}.{name}')


def __dir__() -> list[str]:
  return sorted({*globals(), *__all__})
