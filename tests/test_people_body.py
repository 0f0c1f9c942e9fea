"""Mixtures of targets: their names, their shares, and what they do to known vertices."""

import makehuman
import numpy as np
import pytest

from datagen.sources.people import body as bodies
from datagen.sources.people import data

AVERAGE = bodies.Body(
  gender='female',
  age=0.5,
  muscle=0.5,
  weight=0.5,
  height=0.5,
  proportions=0.5,
  ethnicity={'asian': 0.25, 'african': 0.75},
  details={},
)


def _universal(shares):
  return {k: v for k, v in shares.items() if k.startswith('macrodetails/universal') and v > 0}


def test_an_average_body_is_of_one_universal_target():
  shares = bodies.targets(AVERAGE)
  assert _universal(shares) == {makehuman.TARGET: 1.0}
  assert shares['macrodetails/asian-female-young'] == 0.25
  assert shares['macrodetails/african-female-young'] == 0.75
  assert not any(v for k, v in shares.items() if '/height/' in k or '/proportions/' in k)


def test_shares_are_products_of_closeness():
  shares = bodies.targets(AVERAGE._replace(gender='male', weight=0.75, height=0.9))
  assert _universal(shares) == {makehuman.FAT: 0.5, makehuman.TARGET.replace('fem', 'm'): 0.5}
  tall = 'macrodetails/height/male-young-averagemuscle-maxweight-maxheight'
  assert shares[tall] == pytest.approx(0.5 * 0.8)


@pytest.mark.parametrize('seed', range(20))
def test_shares_of_any_body_sum_to_one(seed):
  body = bodies.sample(np.random.default_rng(seed))
  shares = bodies.targets(body)
  assert sum(_universal(shares).values()) == pytest.approx(1)
  assert sum(v for k, v in shares.items() if k.count('/') == 1 and 'universal' not in k
             and k.startswith('macro')) == pytest.approx(1)  # fmt: skip
  assert min(shares.values()) >= 0
  assert set(body.details) < set(shares)


def test_targets_move_their_vertices_by_their_shares(tmp_path):
  base = data.read_body(makehuman.write_wheel(tmp_path))
  moved = bodies.mix(base, AVERAGE) - base.vertices
  np.testing.assert_allclose(moved[0], [0, 0.5, 0])
  assert not moved[1:].any()
  moved = bodies.mix(base, AVERAGE._replace(gender='male', weight=0.75)) - base.vertices
  np.testing.assert_allclose(moved[1], [0, 0, 0.125])
  assert not moved[0].any() and not moved[2:].any()


def test_bodies_vary():
  drawn = [bodies.sample(np.random.default_rng(s)) for s in range(200)]
  assert {b.gender for b in drawn} == {'female', 'male'}
  ages = np.array([b.age for b in drawn])
  assert (ages < 0.4).any() and (ages > 0.8).any() and (np.abs(ages - 0.5) < 0.1).any()
  assert np.ptp([b.weight for b in drawn]) > 0.8
