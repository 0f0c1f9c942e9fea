"""Deviations from the paper's protocol, as the stored configurations of runs tell them."""

import workdirs

from experiments.lib import differences
from experiments.lib.runs import Run

MODELS = {'a': {'category': 'car', 'source': 'mine'}, 'b': {'category': 'car', 'source': 'mine'}}


def run(**changes):
  config = workdirs.CONFIG | {'category': ['car'], 'batch_size': 60, 'models': 120, 'seed': 3}
  config |= {'dtype': 'float32', 'fresh_statistics': 0, 'learning_rate': 3e-4}
  return Run('W', config | {'counts': {'car (mine)': 120}} | changes, 1000)


def test_only_what_differs_is_told():
  models = {'models to train on': '120 car (mine)', 'models to test on': '2 car (mine)'}
  assert differences.find_differences([run()], MODELS) == models
  other = run(category=[], batch_size=12, learning_rate=1e-3, dtype='mixed', fresh_statistics=20)
  found = differences.find_differences([other], MODELS)
  assert found == models | {
    'networks': 'one for all categories',
    'epochs': '100',
    'batch': '12',
    'learning rate': '0.001',
    'arithmetic': 'mixed',
    'BatchNorm at test time': 'statistics of 20 fresh batches',
  }
  lines = differences.to_text(found).splitlines()
  assert '- epochs: 100 [500]' in lines and len(lines) == 1 + len(found)


def test_values_that_differ_between_networks_stand_side_by_side():
  found = differences.find_differences([run(), run(learning_rate=0.01), run()], MODELS)
  assert found['learning rate'] == '0.0003, 0.01'


def test_a_caption_is_of_the_networks():
  both = [run(), run(seed=4)]
  expected = 'Networks: one a category, epochs: 500, seed 3, 4.'
  assert differences.say_training(both) == expected
