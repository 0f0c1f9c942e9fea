"""What is told of how numbers were made, where the paper's were made otherwise."""

import synthetic
from absl import flags

from experiments import differences, protocol


def parse(data, *arguments):
  f = flags.FlagValues()
  protocol.define_flags(f)
  f(['program', f'--data={data}', '--workdir=W', *arguments])
  return f


def test_only_what_differs_is_told(tmp_path):
  data = synthetic.make_dataset(
    tmp_path / 'data',
    5,
    splits=('train', 'train', 'train', 'test', 'test'),
    categories=('car',),
    image_size=32,
    grid_size=16,
  ).root
  models = {
    'models to train on': '3 car (synthetic)',
    'models to test on': '2 car (synthetic)',
  }
  assert differences.find_differences(parse(data)) == models
  other = '--models=all', '--epochs=16', '--batch_size=12', '--learning_rate=1e-3', '--dtype=mixed'
  found = differences.find_differences(parse(data, *other, '--fresh_statistics=20'))
  assert found == models | {
    'networks': 'one for all categories',
    'epochs': '16',
    'batch': '12',
    'learning rate': '0.001',
    'arithmetic': 'mixed',
    'BatchNorm at test time': 'statistics of 20 fresh batches',
  }
  lines = differences.to_text(found).splitlines()
  assert '- epochs: 16 [500]' in lines and len(lines) == 1 + len(found)
