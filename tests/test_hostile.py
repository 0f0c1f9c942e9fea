"""A folder of hostile files: each is refused with a reason, and the run makes what is good."""

import base64
import json
import os
import struct
import subprocess
import sys

import numpy as np
import pytest

GOOD = 'v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n'
TEXTURED = 'mtllib {mtl}\n' + GOOD.replace('f', 'usemtl m\nf', 1)
DAE = '<?xml version="1.0"?>{doctype}<COLLADA xmlns="x">{nodes}</COLLADA>'
SELF = '<node id="a"><instance_node url="#a"/></node>'
PLY = """ply
format ascii 1.0
element vertex 1000000000
property float x
element face 1000000000
property list uchar int vertex_indices
end_header
0
"""


def gltf(nodes, faces=1):
  """Nodes that may hold one mesh, which is a triangle again and again."""
  points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32).tobytes()
  indices = np.array([0, 1, 2] * faces, np.uint16).tobytes()
  uri = 'data:application/octet-stream;base64,' + base64.b64encode(points + indices).decode()
  view = {'buffer': 0, 'byteLength': 36}
  return json.dumps(
    {
      'asset': {'version': '2.0'},
      'scenes': [{'nodes': [0]}],
      'nodes': nodes,
      'meshes': [{'primitives': [{'attributes': {'POSITION': 0}, 'indices': 1}]}],
      'accessors': [
        {'bufferView': 0, 'componentType': 5126, 'count': 3, 'type': 'VEC3'},
        {'bufferView': 1, 'componentType': 5123, 'count': 3 * faces, 'type': 'SCALAR'},
      ],
      'bufferViews': [view, view | {'byteOffset': 36, 'byteLength': len(indices)}],
      'buffers': [{'uri': uri, 'byteLength': 36 + len(indices)}],
    }
  )


def instances(count, faces):
  return gltf([{'children': list(range(1, count + 1))}] + [{'mesh': 0}] * count, faces)


# name -> (content, what the reason says)
HOSTILE = {
  'billion 1.ply': (PLY, 'declares 1000000000 vertex and holds fewer'),
  'billion 2.stl': (bytes(80) + struct.pack('<I', 10**9) + bytes(50), 'no faces'),
  'cycle.gltf': (gltf([{'children': [1]}, {'mesh': 0, 'children': [0]}]), 'no end'),
  'entities.dae': (DAE.format(doctype='<!DOCTYPE x [<!ENTITY a "a">]>', nodes=''), 'DOCTYPE'),
  'fan.obj': (GOOD + 'f 1 2 99\n', 'out of bounds'),
  'hog.gltf': (instances(1200, 15_000), 'more memory than a worker may have'),
  'laughs.gltf': (gltf([{'children': [i + 1] * 9} for i in range(20)] + [{'mesh': 0}]), 'faces'),
  'link.obj': ('../outside.obj', 'leads out of'),
  'mtl.obj': (TEXTURED.format(mtl='../outside.mtl'), 'leads out of'),
  'nan.obj': (GOOD.replace('v 1', 'v nan'), 'not finite'),
  'pipe.obj': (None, 'has no file'),
  'self.dae': (DAE.format(doctype='', nodes=SELF), 'no end'),
  'thin.obj': ('v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n', 'no faces'),
}  # fmt: skip


@pytest.fixture
def folder(tmp_path):
  folder = tmp_path / 'in'
  folder.mkdir()
  (tmp_path / 'outside.obj').write_text(GOOD)
  (tmp_path / 'outside.mtl').write_text('newmtl m\n')
  for name in ('good 1.obj', 'zoo.obj'):
    (folder / name).write_text(GOOD)
  return folder


def generate(folder, *flags):
  command = [sys.executable, '-m', 'datagen.generate', '--source=meshes', '--category=x']
  command += [f'--input={folder}', f'--output={folder}/../out', '--workers=1', *flags]
  finished = subprocess.run(command, capture_output=True, text=True, timeout=600)
  assert finished.returncode == 0, finished.stderr
  assert 'Traceback' not in finished.stderr
  return finished.stdout, json.loads((folder / '..' / 'out' / 'failures.json').read_text())


@pytest.mark.skipif(not sys.platform.startswith('linux'), reason='only Linux bounds memory')
def test_the_run_goes_on(folder):
  for name, (content, _) in HOSTILE.items():
    if name == 'link.obj':
      (folder / name).symlink_to(content)
    elif content is not None:
      (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
  os.mkfifo(folder / 'pipe.obj')
  printed, failures = generate(folder, '--memory_limit=1')
  assert f'made 2, already there 0, failed {len(HOSTILE)}' in printed
  assert len(failures) == len(HOSTILE)
  for name, (_, reason) in HOSTILE.items():
    found = failures[name.rsplit('.', 1)[0]]
    assert reason in found and '\n' not in found, (name, found)


@pytest.mark.slow
def test_what_takes_too_long_is_given_up(folder):
  (folder / 'endless.gltf').write_text(instances(500_000, 1))
  printed, failures = generate(folder, '--timeout=20')
  assert 'made 2, already there 0, failed 1' in printed
  assert failures == {'endless': 'it took more than 20 s'}
