"""The report: everything that is there in one page, and commands for what is missing."""

import json
import re

import markdown_cells
import pages
import pytest
import synthetic
import workdirs

from cvn.errors import UserError
from experiments.lib import stages
from experiments.report import __main__ as program
from experiments.report import setting


def run(output, *folders, **named):
  named = {'workdir': ','.join(map(str, folders)), 'output': output, 'per_category': 0, **named}
  program.main([f'--{k}={v}' for k, v in named.items()])
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


def table_of(text, *head):
  """The first table whose head begins so."""
  return next(t for t in markdown_cells.read(text) if t[0][: len(head)] == [*head])


def test_everything_is_in_the_page_and_in_the_text(made):
  root, page, text = made
  pages.check_alone(page)
  sections = re.findall('^## (.*)', text, re.MULTILINE)
  assert sections == re.findall('<h2 id=.*?>(.*?)</h2>', page)
  assert {'Table 1: shapes', 'Articulated objects', 'What people prefer'} <= {*sections}
  missing = re.findall('not made yet.*?experiments[.]([a-z.]+)', text)
  figures = ('intermediate', 'nearest', 'flow', 'threshold')
  assert missing == [f'paper.figures.{name}' for name in figures]
  shapes = table_of(text, '', 'car (2)', 'paper')
  assert shapes[1][:3] == ['Ours (MSFCEL)', '0.350 ± 0.050', '0.395']
  protocol = markdown_cells.column(table_of(text, '', 'paper'), 'one network for all categories')
  assert protocol['views seen by a network'] == '8' and protocol['epochs'] == '2'
  written = {p.name for p in (root / 'out').iterdir()}
  assert written == {'index.html', 'report.md', *re.findall(r'\]\((\S+?\.png)\)', text)}
  assert {'iou_work.png', 'random_work.png', 'glance.png'} <= written


def test_no_folder_of_this_machine_is_named(made):
  root, *found = made
  for text in found:
    assert str(root) not in text and '/home/someone' not in text
    assert 'workdir=msfcel_all_0' in text


def test_commands_stand_in_their_order_with_their_times(made):
  _, _, text = made
  asked, ran = re.findall('```sh\n(.*?)\n```', text, re.DOTALL)
  own = stages.argv()  # of the process that runs the tests
  assert re.findall(r'^python -m (\S+)', asked, re.MULTILINE) == [
    *('experiments.collection', 'experiments.paper.iou', 'experiments.paper.psnr'),
    *('experiments.paper.ablation', 'experiments.paper.measures', 'experiments.paper.structure'),
    *('experiments.paper.people',),
    *('experiments.paper.figures.random', 'experiments.study.chart'),
    *(own[2:3] if own[:2] == ['python', '-m'] else ()),
  ]
  assert 'python -m experiments.paper.iou --data=objects --workdir=work\n' in asked
  assert [x.rpartition('  # ')[2] for x in ran.splitlines()] == ['30 s', '2 min']


def test_data_is_listed_by_source_licence_and_creator(made):
  _, _, text = made
  counts = table_of(text, '', 'synthetic, train')
  assert counts[-1] == ['all', '3', '1', '1']  # one of the four to train on is not made
  assert table_of(text, '', 'models', 'licence')[1] == [
    *('synthetic', '5', 'not stated', 'not stated (5)')
  ]


def test_what_is_missing_is_left_out_with_its_command(tmp_path):
  workdirs.write_training(tmp_path / 'work')
  page, text = run(tmp_path / 'out', tmp_path / 'work', per_category=1)
  missing = re.findall(r'not made yet.*?experiments[.]([a-z.]+)', text)
  assert {*missing} == {
    *(f'paper.{x}' for x in ('iou', 'psnr', 'ablation', 'measures', 'structure', 'people')),
    'paper.figures.random',
    *(f'paper.figures.{x}' for x in ('intermediate', 'nearest', 'flow', 'threshold')),
    *('study', 'study.chart', 'collection'),
  }
  assert page.count('not made yet') == len(missing)
  assert re.findall(r'\]\((\S+?\.png)\)', text) == ['training_work.png']


def test_folders_stand_beside_each_other(made, tmp_path):
  root, *_ = made
  chairs = tmp_path / 'chairs'
  workdirs.write_tables(chairs, seeds=3, category=['chair'])
  for seed in range(3):
    workdirs.write_training(chairs, f'msfcel_chair_{seed}', category=['chair'], seed=seed)
  _, text = run(tmp_path / 'out', root / 'work', chairs)
  protocol = table_of(text, '', 'paper')
  label = 'a network a category (chair), 3 seeds'
  assert protocol[0][2:] == ['one network for all categories', label]
  assert markdown_cells.column(protocol, label)['seeds'] == '0, 1, 2'
  assert text.count('### A network a category (chair), 3 seeds') >= 4


def test_captions_become_text(tmp_path):
  workdirs.write_figure(tmp_path / 'figures/random.png', 'At random, <b>not</b> chosen.')
  page, text = run(tmp_path / 'out', tmp_path)
  assert 'At random, &lt;b&gt;not&lt;/b&gt; chosen.</figcaption>' in page
  shown = tmp_path / 'out' / re.search(r'\]\((random_\S+?\.png)\)', text).group(1)
  assert shown.read_bytes() == (tmp_path / 'figures/random.png').read_bytes()


def test_numbers_of_networks_that_have_changed_since_are_marked(tmp_path):
  workdirs.write_tables(tmp_path / 'work')
  workdirs.write_training(tmp_path / 'work')
  assert 'at step 4' not in run(tmp_path / 'out', tmp_path / 'work')[1]
  workdirs.write_training(tmp_path / 'work', batch_size=1)
  assert 'msfcel\\_all\\_0 at step 4' in run(tmp_path / 'out', tmp_path / 'work')[1]


@pytest.mark.parametrize(
  ('line', 'short'),
  [
    ('a --data=/x/data/objects --b=1', 'a --data=objects --b=1'),
    ('a --data=file:///x/data/objects/', 'a --data=objects'),
    ('a --workdir=/x/work/runs/m_0', 'a --workdir=m_0'),
    ('a --list=/x/work,/y/z', 'a --list=work,z'),
    ("a '--list=/x/a b,/y'", "a '--list=a b,y'"),
    ('a --data=gs://bucket/data --c=d/e', 'a --data=gs://bucket/data --c=d/e'),
  ],
)
def test_absolute_paths_are_shortened(line, short):
  assert setting.shorten(line) == short


def test_a_damaged_file_writes_nothing(tmp_path):
  workdirs.write_tables(tmp_path / 'work')
  table = json.loads((tmp_path / 'work/tables/iou.json').read_text())
  del table['parts']['paper']['lines'][0]['seeds']
  workdirs.write_json(tmp_path / 'work/tables/iou.json', table)
  with pytest.raises(UserError, match=r'iou\.json is damaged'):
    run(tmp_path / 'out', tmp_path / 'work')
  assert not (tmp_path / 'out').exists()
