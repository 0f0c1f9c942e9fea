"""One person from one seed: a random body, outfit and pose, dressed, bent and coloured."""

from typing import NamedTuple

import numpy as np

from datagen.geometry.mesh import TexturedMesh
from datagen.sources.people import body as bodies
from datagen.sources.people import charts, face, garments, hair, layers, outfits, poses, rig
from datagen.sources.people.data import BodyData

GROUPS = ('body', 'helper-tights', 'helper-skirt', 'helper-hair')  # that surfaces are made of
HEM = 0.06  # dm of skin below the hems that cover it: more would tint their voxels
# The mouth's hollow of the base mesh: faces in this ball that look to its middle line it.
HOLLOW = ((0.0, 6.65, 0.95), 0.62)


class Person(NamedTuple):
  """The random choices, made before any vertex is moved."""

  body: bodies.Body
  skin: np.ndarray  # [3] sRGB
  outfit: outfits.Outfit
  head: hair.Head
  face: face.Face
  family: str  # of poses
  seed: int  # of the pose


def sample(seed: int) -> Person:
  """The person of a seed."""
  rng = np.random.default_rng(seed)
  body = bodies.sample(rng)
  skin = skin_color(rng, body)
  woman = body.gender == 'female'
  outfit = outfits.sample(rng, woman=woman, skin=skin)
  family = poses.sample_family(rng, upright=outfits.wants_skirt(outfit))
  head = hair.sample(
    rng, woman=woman, old=body.age > 0.75, cloth=outfit.under, trim=outfit.top_cloth.colors[0]
  )
  beard = not woman and body.age > 0.45 and rng.random() < 0.3
  painted = face.sample(rng, skin, head.hair, beard=beard)
  return Person(body, skin, outfit, head, painted, family, int(rng.integers(2**63)))


def skin_color(rng: np.random.Generator, body: bodies.Body) -> np.ndarray:
  """A tone [3] between those of the body's ethnicities."""
  tones = {
    'african': (0.4, 0.25, 0.17),
    'asian': (0.86, 0.67, 0.5),
    'caucasian': (0.92, 0.73, 0.62),
  }
  tone = sum(share * np.array(tones[name]) for name, share in body.ethnicity.items())
  return np.clip(tone * rng.uniform(0.82, 1.06) + rng.normal(0, 0.012, 3), 0.08, 0.97)


def build(data: BodyData, person: Person) -> TexturedMesh:
  """The person's mesh.

  Raises:
    UserError: a file of the body's data is damaged.
  """
  vertices = bodies.mix(data, person.body)
  at = rig.joints(data, vertices)
  chart = charts.chart(data, vertices, at)
  worn, covered = garments.dress(data, chart, person.outfit)
  rng = np.random.default_rng(person.seed)
  hairs, props, haired = hair.layers(rng, data, chart, person.head)
  surfaces = worn + hairs + _skin(data, chart, person, HEM - np.maximum(covered, haired))
  pose = poses.sample(rng, data, at, person.family, girth=_girth(data, chart))
  outward = sum(layers.normals(vertices, data.groups[g]) for g in GROUPS)
  transforms = rig.bone_transforms(data, at, pose.turns)
  return layers.assemble(data, surfaces, props, vertices, outward, transforms)


def _girth(data, chart):
  """Half the depth of the trunk, dm."""
  used = np.unique(data.groups['body'])
  trunk = used[~(chart.is_arm | chart.is_leg)[used] & (chart.head_weight[used] < 0.1)]
  low, high = chart.at['pelvis'][1], chart.at['spine_03'][1]
  belly = trunk[(chart.vertices[trunk, 1] > low) & (chart.vertices[trunk, 1] < high)]
  return 0.45 * float(np.ptp(chart.vertices[belly, 2])) if len(belly) else 0.0


def _skin(data, chart, person, bare):
  """Bare skin, the image of the face on the head's front, and the eyes."""
  quads = data.groups['body']
  a, b, c, d = np.moveaxis(data.vertices[quads], 1, 0)
  offset = 0.25 * (a + b + c + d) - HOLLOW[0]
  inward = np.einsum('fk,fk->f', offset, np.cross(c - a, d - b)) < 0
  quads = quads[~(inward & (np.linalg.norm(offset, axis=1) < HOLLOW[1]))]
  at = face.marks(data, chart)
  painted = layers.Paint(person.skin, face.draw(person.face, at), face.uv(chart, at.window))
  ear = chart.at['head'][2] + 0.35 * chart.height / 16.7
  p = chart.vertices[quads].mean(1)
  front = (chart.head_weight[quads].mean(1) > 0.5) & (p[:, 2] > ear)
  flat = np.zeros(len(bare))
  found = [
    layers.Layer(quads[~front], bare, flat, layers.Paint(person.skin)),
    layers.Layer(quads[front], bare, flat, painted),
  ]
  for side in 'lr':
    eye = data.groups[f'helper-{side}-eye']
    middle = chart.vertices[np.unique(eye)].mean(0)
    found.append(layers.Layer(eye, chart.vertices[:, 2] - middle[2], flat, painted))
  return found
