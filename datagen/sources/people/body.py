"""Bodies: the base mesh moved by a mixture of MakeHuman's targets.

A target's name combines the ends of several scales ('female-young-maxmuscle-averageweight'). Its
weight is the product of the body's closeness to each of these ends, as in MakeHuman.
"""

import itertools
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from datagen.sources.people.data import BodyData, read_target

ETHNICITIES = ('african', 'asian', 'caucasian')
AGES = {'baby': 0.0, 'child': 0.1875, 'young': 0.5, 'old': 1.0}  # the scale of MakeHuman's age

# Scales with a target at either end, below `targets/`: how far a body may go on them.
DETAILS = {
  'head/head-fat': 0.5,
  'head/head-scale-horiz': 0.35,
  'head/head-scale-vert': 0.35,
  'stomach/stomach-pregnant': 0.6,
  'torso/torso-vshape': 0.6,
  'torso/torso-scale-vert': 0.5,
  'torso/measure-shoulder-dist': 0.6,
  'hip/hip-scale-horiz': 0.6,
}
SHAPES = ('oval', 'round', 'square', 'rectangular', 'triangular', 'invertedtriangular', 'diamond')


class Body(NamedTuple):
  """The parameters of a body; the scales run from 0 to 1."""

  gender: str  # 'female' or 'male'
  age: float  # 0.1875 a child of 12, 0.5 a grown-up of 25, 1 of 90
  muscle: float
  weight: float
  height: float
  proportions: float  # 0 uncommon, 1 ideal
  ethnicity: Mapping[str, float]  # shares of sum 1
  details: Mapping[str, float]  # targets below `targets/` and their shares


def sample(rng: np.random.Generator) -> Body:
  """A random body: children to old people, thin to stout, ethnicities in any mixture of two."""
  gender = ('female', 'male')[rng.integers(2)]
  age = rng.choice([rng.uniform(0.19, 0.38), rng.uniform(0.42, 0.65), rng.uniform(0.65, 1.0)],
                   p=[0.2, 0.55, 0.25])  # fmt: skip
  first, second = rng.permutation(len(ETHNICITIES))[:2]
  share = rng.beta(0.35, 0.35)
  details = {}
  for name in rng.choice(list(DETAILS), 4, replace=False):
    value = rng.uniform(-1, 1) * DETAILS[name]
    details[f'{name}-{"incr" if value > 0 else "decr"}'] = abs(value)
  details[f'head/head-{SHAPES[rng.integers(len(SHAPES))]}'] = rng.uniform(0.2, 0.8)
  return Body(
    gender=gender,
    age=float(age),
    muscle=rng.uniform(0.2, 0.95),
    weight=float(rng.choice([rng.uniform(0.1, 0.5), rng.uniform(0.4, 0.65), rng.uniform(0.7, 1)])),
    height=rng.uniform(0.15, 0.85),
    proportions=rng.uniform(0.3, 0.9),
    ethnicity={ETHNICITIES[first]: share, ETHNICITIES[second]: 1 - share},
    details=details,
  )


def mix(data: BodyData, body: Body) -> np.ndarray:
  """The body's vertices [V, 3], including helper surfaces and the joints' cubes.

  Raises:
    UserError: a target is damaged.
  """
  vertices = data.vertices.copy()
  for name, share in targets(body).items():
    target = read_target(data, name) if share > 1e-3 else None
    if target is not None:
      index, offset = target
      vertices[index] += share * offset  # a target names a vertex once
  return vertices


def targets(body: Body) -> dict[str, float]:
  """The names of the targets and their weights."""
  age = _between(body.age, AGES)
  muscle = _between(body.muscle, {'minmuscle': 0, 'averagemuscle': 0.5, 'maxmuscle': 1})
  weight = _between(body.weight, {'minweight': 0, 'averageweight': 0.5, 'maxweight': 1})
  height = _between(body.height, {'minheight': 0, '': 0.5, 'maxheight': 1})
  proportions = _between(
    body.proportions, {'uncommonproportions': 0, '': 0.5, 'idealproportions': 1}
  )
  shares = {}
  for (e, x), (a, y) in itertools.product(body.ethnicity.items(), age.items()):
    shares[f'macrodetails/{e}-{body.gender}-{a}'] = x * y
  for (a, x), (m, y), (w, z) in itertools.product(age.items(), muscle.items(), weight.items()):
    frame = f'{body.gender}-{a}-{m}-{w}'
    shares[f'macrodetails/universal-{frame}'] = x * y * z
    for folder, scale in (('height', height), ('proportions', proportions)):
      for end, share in scale.items():
        if end:
          shares[f'macrodetails/{folder}/{frame}-{end}'] = x * y * z * share
  return shares | dict(body.details)


def _between(value, ends):
  """Weights of the two ends that a value lies between."""
  names, places = list(ends), list(ends.values())
  k = min(max(int(np.searchsorted(places, value, side='right')) - 1, 0), len(places) - 2)
  t = float(np.clip((value - places[k]) / (places[k + 1] - places[k]), 0, 1))
  return {names[k]: 1 - t, names[k + 1]: t}
