import pytest
from trimesh.exchange.obj import parse_mtl
from trimesh.visual.material import SimpleMaterial

from datagen.mtl import plain_mtl


@pytest.mark.parametrize(
  ('line', 'plain'),
  [
    (b'Kd 0.1 0.2 0.3', b'Kd 0.1 0.2 0.3'),
    (b'\tKd  0.5 ', b'Kd 0.5 0.5 0.5'),
    (b'Kd 0.1 0.2', b'Kd 0.1 0.2 0.2'),
    (b'kd 1 0 0 # red', b'kd 1 0 0'),
    (b'Kd 1 0 0 1', b'Kd 1 0 0'),
    (b'Kd spectral ident.rfl', b''),
    (b'Kd', b''),
    (b'  map_Kd -s 1 1 1 my wood #2.png', b'  map_Kd -s 1 1 1 my wood #2.png'),
    (b'newmtl fine wood', b'newmtl fine wood'),
    (b'd 0.5', b'd 0.5'),
    (b'TR 0.5', b'TR 0.5'),
    (b'Ka 0.5', b''),
    (b'image x', b''),
    (b'# Kd 1 1 1', b''),
    (b'', b''),
  ],
)
def test_lines(line, plain):
  assert plain_mtl(line) == plain


def test_odd_lines_cost_no_material():
  mtl = b'newmtl a\r\nKa 0.5\r\nself 1\r\nKd 0.5\r\nimage x\r\nnewmtl b\r\nKd 1 0 0\r\n'
  materials = {name: SimpleMaterial(**m) for name, m in parse_mtl(plain_mtl(mtl)).items()}
  assert materials['a'].diffuse.tolist() == [128, 128, 128, 255]
  assert materials['b'].diffuse.tolist() == [255, 0, 0, 255]
  assert materials['a'].image is None
