"""Java's properties format, and the pieces that a catalogue in it lists."""

import zipfile

import pytest

from cvn.errors import UserError
from datagen.reading.files import archive_files
from datagen.sources import furniture_catalogue
from datagen.sources.furniture_catalogue import parse_properties, read_catalogue


@pytest.mark.parametrize(
  ('text', 'properties'),
  [
    ('a=1\nb: 2\nc 3\n', {'a': '1', 'b': '2', 'c': '3'}),
    ('  a  =  1  \r\n\r\n\tb=2\rc=3', {'a': '1  ', 'b': '2', 'c': '3'}),
    ('# a=1\n  ! b=2\nname#1=x # y\n', {'name#1': 'x # y'}),
    ('a=one, \\\n    two, \\\n  three\nb=4', {'a': 'one, two, three', 'b': '4'}),
    ('a=x\\\\\nb=2', {'a': 'x\\', 'b': '2'}),
    ('a=x\\\n', {'a': 'x'}),
    ('a=x\\', {'a': 'x'}),
    (r'a=\u00e9t\u00C9\tb\n\=\q', {'a': 'étÉ\tb\n=q'}),
    (r'a\ b\:c=d', {'a b:c': 'd'}),
    (r'a=\ud83e\ude91', {'a': '🪑'}),
    (r'a=\ud83e!', {'a': '\ufffd!'}),
    (r'a=\u12', {'a': 'u12'}),
    ('a==b=c', {'a': '=b=c'}),
    ('a', {'a': ''}),
    ('a=1\na=2', {'a': '2'}),
    ('', {}),
  ],
)
def test_properties(text, properties):
  assert parse_properties(text) == properties


def catalogue(tmp_path, members):
  with zipfile.ZipFile(tmp_path / 'a.sh3f', 'w') as archive:
    for name, text in members.items():
      archive.writestr(name, text.encode('latin-1'))
  with archive_files(str(tmp_path / 'a.sh3f')) as files:
    return read_catalogue(files)


def test_pieces_come_in_the_order_of_their_numbers(tmp_path):
  text = 'license=L\nmodel#10=/m/j.obj\nmodel#9=i.obj\nname#9=Nine\nname#2=no model\nmodel#x=/x.obj'
  pieces = catalogue(tmp_path, {'PluginFurnitureCatalog.properties': text})
  assert [(p.model, p.name, p.licence) for p in pieces] == [
    ('i.obj', 'Nine', 'L'),
    ('m/j.obj', '', 'L'),
  ]


def test_all_that_a_piece_says(tmp_path):
  text = (
    'name=The library\nid=L\nlicense=For all\nname#1=  Caf\xe9   chair \ntags#1=Seat, Oak\n'
    'creator#1=A\nid#1=L#1\nmodel#1=chair/../b.obj\nmodelRotation#1=1 0 0 0 1 0 0 0 1\n'
    'width#1=1.5\nheight#1=2\ndepth#1=3\nlicense#1=Its own\n'
  )
  (piece,) = catalogue(tmp_path, {'x/y/DefaultFurnitureCatalog.properties': text})
  assert piece == furniture_catalogue.Piece(
    model='x/y/b.obj',
    id='L#1',
    name='Café chair',
    tags=('Seat', 'Oak'),
    rotation='1 0 0 0 1 0 0 0 1',
    size=('1.5', '2', '3'),
    creator='A',
    licence='Its own',
  )


def test_only_catalogues_are_read(tmp_path):
  members = {name: 'model#1=/a.obj' for name in ('a.properties', 'FurnitureCatalog_fr.properties')}
  assert catalogue(tmp_path, members) == []


def test_a_catalogue_that_is_too_large(tmp_path, monkeypatch):
  monkeypatch.setattr(furniture_catalogue, 'MAX_CATALOGUE', 3)
  with pytest.raises(UserError, match=r'PluginFurnitureCatalog\.properties is larger'):
    catalogue(tmp_path, {'PluginFurnitureCatalog.properties': 'a=12'})
