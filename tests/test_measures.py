"""Harder measures of methods and of looked-up training models, in one table."""

import json
import os

import markdown_cells
import pytest
from test_figure_random import make_workdir, run

from experiments.lib import protocol, scoring
from experiments.lib.memory import WAYS
from experiments.paper import measures as program

MODELS = {'m2': 'car', 'm6': 'car', 'm3': 'zebra'}


@pytest.fixture
def given(tmp_path, monkeypatch):
  """Evaluations in which `best` is better by 0.2 and the oracle by 0.4, two zebras' worth each."""
  made = make_workdir(tmp_path, monkeypatch)

  def evaluate(plan, method, category, seed, *, measures, **_):
    assert measures
    trained = protocol.train(plan, 'msfcel', category, seed)

    def scored(value):
      return {
        'by_model': {
          name: {'category': c, 'source': 'synthetic'}
          | dict.fromkeys(scoring.METRICS, [value + 0.1 * (c == 'zebra')] * 3)
          for name, c in MODELS.items()
          if category in (protocol.ALL, c)
        }
      }

    best = method == 'best'
    return {
      **{'data': plan.data, 'split': 'test', 'threshold': 0.5, 'alpha': 0.2},
      **{'networks': scored(0.5 if best else 0.3), 'shape': trained.workdir},
      **{'outline': scored(0.4), 'code': scored(0.2), 'oracle': scored(0.9)},
      'options': {'runs': {'shape': {'step': trained.step, 'config': trained.config}}},
    }

  monkeypatch.setattr(protocol, 'evaluate', evaluate)
  return made


def test_methods_and_looked_up_models_stand_in_one_table(given, capsys):
  run(program, models='all', **given)
  text = capsys.readouterr().out
  table, compared = markdown_cells.read(text)[:2]
  lines = [next(x for x in text.splitlines() if title in x) for title in WAYS.values()]
  assert [x.count('**') // 2 for x in lines] == [0, 1, len(scoring.METRICS) - 1]  # lowest Chamfer
  assert table[0][1:] == [*scoring.METRICS.values()]
  ious = [row[1].split()[0] for row in table[1:]]
  assert ious == ['0.333', '0.533', '0.433', '0.233', '0.933']
  assert compared[1][0].startswith('IoU − ') and compared[1][1].split()[0] == '+0.200'
  with open(os.path.join(given['workdir'], 'tables', 'measures.json')) as f:
    part = json.load(f)['parts']['f_100']
  assert part['lines'][0]['categories']['all']['models'] == 3
  assert part['comparisons'][-1]['difference'] == pytest.approx(-0.4)
