"""trimesh's solids as meshes of ours."""

import numpy as np
import trimesh

from datagen.geometry.mesh import TexturedMesh
from datagen.reading.colors import as_rgba, grey
from datagen.reading.parts import Part, assemble


def textured(solid: trimesh.Trimesh) -> TexturedMesh:
  """A mesh with its vertex or face colours; grey without."""
  faces = np.asarray(solid.faces, np.int64)
  colors = grey(len(faces))
  if solid.visual.kind == 'vertex':
    colors = as_rgba(solid.visual.vertex_colors)[faces]
  elif solid.visual.kind == 'face':
    colors = np.repeat(as_rgba(solid.visual.face_colors)[:, None], 3, 1)
  return assemble([Part(np.asarray(solid.vertices, np.float64), faces, colors)], set())
