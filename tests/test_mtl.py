import pytest

from datagen.reading import notes as notes_lib
from datagen.reading.mtl import Map, Material, find_material, read_mtl


def one(*lines):
  (material,) = read_mtl(b'newmtl a\n' + b'\n'.join(lines), 'x', set())
  return material


@pytest.mark.parametrize(
  ('line', 'color'),
  [
    (b'Kd 0.1 0.2 0.3', (0.1, 0.2, 0.3)),
    (b'\tKd  0.5 ', (0.5, 0.5, 0.5)),
    (b'Kd\t0.1 0.2', (0.1, 0.2, 0.2)),
    (b'kd 1 0 0 # red', (1, 0, 0)),
    (b'KD 1 0 0 1', (1, 0, 0)),
    (b'Kd spectral ident.rfl', None),
    (b'Kd', None),
    (b'# Kd 1 1 1', None),
    (b'Ka 0.5', None),
  ],
)
def test_colors(line, color):
  assert one(line).color == color


@pytest.mark.parametrize(
  ('line', 'expected'),
  [
    (b'map_Kd wood.png', Map('wood.png')),
    (b'  map_kd\tmy  wood (1).png ', Map('my  wood (1).png')),
    (b'map_Kd "my wood.png"', Map('my wood.png')),
    (b'map_Kd -s 2 3 1 -o 0.5 0 0 my wood #2.png', Map('my wood #2.png', (2, 3), (0.5, 0))),
    (b'map_Kd -o 0.5 wood.png', Map('wood.png', offset=(0.5, 0))),
    (b'map_Kd -s 2 wood.png', Map('wood.png', scale=(2, 1))),
    (b'map_Kd -clamp on -blendu off -bm 1.5 wood.png', Map('wood.png', clamp=True)),
    (b'map_Kd -clamp off -mm 0 1 -imfchan r -texres 512 wood.png', Map('wood.png')),
    (b'map_Kd -type sphere -t 0.1 0.2 0.3 wood.png', Map('wood.png')),
    (b'map_Kd -odd.png', Map('-odd.png')),
    (b'map_Kd C:\\Users\\anna\\wood.png', Map('C:\\Users\\anna\\wood.png')),
    (b'map_Kd', None),
    (b'map_Kd -s 1 1 1', Map('1')),
    (b'map_Ka wood.png', None),
  ],
)
def test_textures(line, expected):
  assert one(line).texture == expected


@pytest.mark.parametrize(
  ('line', 'dissolve'),
  [
    (b'd 0.5', 0.5),
    (b'TR 0.25', 0.75),
    (b'Tr 1', 1),
    (b'd -halo 0.3', 0.3),
    (b'd 7', 1),
    (b'd x', 1),
    (b'Tf 0 0 0', 1),
  ],
)
def test_dissolve(line, dissolve):
  assert one(line).dissolve == dissolve


def test_masks_and_folders():
  assert one(b'map_d -s 2 2 mask.png') == Material('a', mask=Map('mask.png', (2, 2)), folder='x')


def test_odd_lines_cost_no_material():
  content = (
    b'Kd 1 1 1\r\nnewmtl a\r\nKa 0.5\r\nself 1\r\nKd 0.5\r\nimage x\rnewmtl\tb\rKd 1 0 0\r\n'
  )
  for start in (b'', b'\xef\xbb\xbf'):
    a, b = read_mtl(start + content, '', set())
    assert (a.name, a.color, b.name, b.color) == ('a', (0.5,) * 3, 'b', (1, 0, 0))
  assert [m.name for m in read_mtl(content.decode().encode('utf-16'), '', set())] == ['a', 'b']


@pytest.mark.parametrize(
  ('name', 'found', 'guessed'),
  [
    ('Oak wood', 'Oak wood', False),
    ('Oak  wood ', 'Oak wood', False),
    ('Oak wood # of course', 'Oak wood', False),
    ('oak wood', 'Oak wood', True),
    ('Color #3', 'Color #3', False),
    ('Color #4', 'Color #4', False),
    ('"Ash"', 'Ash', False),
    ('Oak', None, False),
    ('', None, False),
  ],
)
def test_names(name, found, guessed):
  materials = {n: Material(n) for n in ('Oak wood', 'Color #3', 'Color #4', 'Ash')}
  notes = set()
  material = find_material(materials, name, notes)
  assert (material and material.name) == found
  assert notes == ({notes_lib.MATERIAL_GUESSED} if guessed else set())
