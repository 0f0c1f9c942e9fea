"""The embedded objects: the same from the same seed, upright, facing +z, and all different."""

import pickle

import numpy as np
import pytest

from cvn.errors import UserError
from datagen.geometry.mesh import albedo, check, normalize
from datagen.sources import procedural
from datagen.sources.shapes import car, heads, livery, materials, outlines, parts, poses, solids

SAMPLES = 6000
CELLS = 16


def _meshes(category, count, seed=0):
  return [procedural.load(m) for m in procedural.list_models(category, '', count, seed)]


def _surface(mesh, count=SAMPLES):
  """Points [N, 3] uniform on the surface of the normalised mesh, and their colours [N, 3]."""
  mesh = normalize(mesh)
  rng = np.random.default_rng(0)
  a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
  area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
  face = rng.choice(len(area), count, p=area / area.sum())
  weight = rng.dirichlet(np.ones(3), count)
  points = np.einsum('nk,nkc->nc', weight, mesh.vertices[mesh.faces[face]])
  return points, albedo(mesh, face, weight)[:, :3]


def _signed_volume(solid):
  a, b, c = np.moveaxis(solid.vertices[solid.faces], 1, 0)
  return np.einsum('ij,ij', a, np.cross(b, c)) / 6


@pytest.fixture(scope='module')
def meshes():
  return {c: _meshes(c, 14) for c in procedural.CATEGORIES}


@pytest.fixture(scope='module')
def surfaces(meshes):
  return {c: [_surface(m) for m in meshes[c]] for c in procedural.CATEGORIES}


@pytest.mark.parametrize('category', procedural.CATEGORIES)
def test_meshes_are_sound(category, meshes):
  for mesh in meshes[category]:
    check(mesh)
    assert len(mesh.faces) < 20_000
    assert np.isfinite(mesh.corner_uv).all()
    assert mesh.corner_colors.min() >= 0 and mesh.corner_colors.max() <= 1
    assert mesh.texture.min() >= -1 and mesh.texture.max() < len(mesh.textures)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert np.linalg.norm(np.cross(b - a, c - a), axis=1).min() > 0
    extent = np.ptp(normalize(mesh).vertices, axis=0)
    assert extent.min() > 0.05  # nothing is flat


@pytest.mark.parametrize('category', procedural.CATEGORIES)
def test_same_seed_same_bytes(category):
  model = procedural.list_models(category, '', 4, 7)[3]
  first = procedural.load(model)
  again = procedural.load(pickle.loads(pickle.dumps(model)))
  for x, y in zip(first[:5], again[:5], strict=True):
    assert x.tobytes() == y.tobytes()
  assert [t.tobytes() for t in first.textures] == [t.tobytes() for t in again.textures]


def test_a_model_does_not_depend_on_the_limit():
  few, many = (procedural.list_models('chair', '', n, 3) for n in (5, 50))
  assert many[:5] == few and len(many) == 50
  assert len(procedural.list_models('chair', '', None, 3)) == procedural.DEFAULT_LIMIT


def test_ids_and_seeds_are_unique():
  models = [
    m for c in procedural.CATEGORIES for s in (0, 1) for m in procedural.list_models(c, '', 100, s)
  ]
  assert len({m.id for m in models}) == len({m.seed for m in models}) == len(models)


def test_all_are_different(surfaces):
  """No two of 14 share their shape and colours: coarse coloured voxels lie far apart.

  The distance is the share of cells, of those that either object occupies, in which one is empty
  or the colours differ by more than a fifth of the range. Two resamplings of one object give the
  scale: about 0.05.
  """
  for category, samples in surfaces.items():
    grids = np.stack([_coarse(*s) for s in samples])
    apart = [_difference(grids[i], grids[j]) for i in range(len(grids)) for j in range(i)]
    assert min(apart) > 0.25 and np.median(apart) > 0.75, category


def _coarse(points, color):
  """[CELLS^3, 4]: mean colour and occupancy of coarse cells."""
  cell = np.ravel_multi_index(
    np.floor((points + 0.5) * CELLS).astype(int).clip(0, CELLS - 1).T, (CELLS,) * 3
  )
  count = np.bincount(cell, minlength=CELLS**3)
  mean = [np.bincount(cell, color[:, k], CELLS**3) / np.maximum(count, 1) for k in range(3)]
  return np.stack([*mean, count > 0], 1)


def _difference(a, b):
  either = (a[:, 3] + b[:, 3]) > 0
  differ = (a[:, 3] != b[:, 3]) | (np.abs(a[:, :3] - b[:, :3]).max(1) > 0.2)
  return differ[either].mean()


def test_the_measure_of_difference_knows_the_same_object(meshes):
  mesh = meshes['chair'][0]
  points, color = _surface(mesh, 2 * SAMPLES)
  halves = [_coarse(points[k::2], color[k::2]) for k in (0, 1)]
  assert _difference(*halves) < 0.1


def test_chairs_have_their_back_behind(surfaces):
  for points, _ in surfaces['chair']:
    top = points[points[:, 1] > np.quantile(points[:, 1], 0.93)]
    assert top[:, 2].mean() < -0.02


def test_cars_are_longest_from_nose_to_tail(surfaces):
  for points, _ in surfaces['car']:
    x, y, z = np.ptp(points, axis=0)
    assert z > 1.5 * x and z > y


def test_car_lamps_are_pale_in_front_and_red_behind():
  """The ends' pictures hold the lamps' colours, the tail lamps' redder than anything in front."""
  for seed in range(5):
    rng = np.random.default_rng(seed)
    look = livery.choose(rng, materials.scheme(rng), 1.8)
    form = car.FORMS['sedan']
    hull, _ = car.body(form, 4.0, 4.0, 'sedan')
    for part in livery.wear(rng, hull, form, look, [], [0.6, 0.7]):
      corners = part.vertices[part.faces]
      normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
      if np.abs(normal).sum(0).argmax() != 2:
        continue
      own, other = (look.marks.lamp, look.marks.tail_lamp)[:: np.sign(normal[0, 2]).astype(int)]
      shown = part.material.picture[..., :3] / 255
      near = [(np.abs(shown - c).max(-1) < 0.003).sum() for c in (own, other)]
      assert near[0] > 100 and near[1] == 0, seed


def test_tables_have_their_top_on_top(meshes):
  """Most of the area that looks up or down lies in the upper half."""
  for mesh in meshes['table']:
    mesh = normalize(mesh)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    level = np.abs(np.cross(b - a, c - a)[:, 1])
    height = (a + b + c)[:, 1] / 3
    middle = 0.5 * (mesh.vertices[:, 1].min() + mesh.vertices[:, 1].max())
    assert level[height > middle].sum() > level[height < middle].sum()


def test_guitars_stand_with_the_neck_up(surfaces):
  for points, _ in surfaces['guitar']:
    assert np.ptp(points[:, 1]) > 1.5 * np.ptp(points[:, 0])
    high, low = points[points[:, 1] > 0.15], points[points[:, 1] < -0.15]
    assert len(low) > len(high) and np.ptp(high[:, 0]) < np.ptp(low[:, 0])


def test_people_face_forward():
  """The pose 'stand' puts face, toes and thumbs at +z and the left hand at +x."""
  lengths = {'trunk': 0.5, 'neck': 0.1, 'upper_arm': 0.3, 'forearm': 0.25, 'thigh': 0.43}
  lengths |= {'shin': 0.42, 'hip': 0.09, 'shoulder': 0.18}
  bones = poses.frames(poses.POSES['stand'], lengths)
  assert bones['hand_l'].joint[0] > 0.18 and bones['hand_r'].joint[0] < -0.18
  assert bones['hand_l'].joint[2] > 0  # elbows bend forward
  sitting = poses.frames(poses.POSES['sit'], lengths)
  assert sitting['shin_l'].joint[2] > 0.4 and sitting['foot_l'].joint[1] < -0.35
  upside = poses.frames(poses.POSES['handstand'], lengths)
  assert upside['head'].joint[1] < upside['foot_l'].joint[1]


def test_faces_look_forward():
  """The lips are painted on the front of the skull, below its middle, and nowhere else."""
  rng = np.random.default_rng(2)
  skin = np.array([0.6, 0.4, 0.3])
  parts_of_face = heads.face(rng, 0.08, 0.12, 0.1, skin)
  painted = [p for p in parts_of_face if p.material.picture is not None]
  assert len(painted) == 1
  corners = painted[0].vertices[painted[0].faces]
  assert (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] > 0).all()
  lips = materials.close([skin, [0.66, 0.2, 0.22]], 0.5)[1]
  row, column = np.nonzero(np.abs(painted[0].material.picture[..., :3] / 255 - lips).max(-1) < 0.01)
  size = painted[0].material.picture.shape[0]
  assert len(row) > 50 and row.min() > size / 2
  assert abs(column.mean() + 0.5 - size / 2) < 2


def test_bones_keep_their_lengths():
  rng = np.random.default_rng(0)
  lengths = {'trunk': 0.5, 'neck': 0.1, 'upper_arm': 0.3, 'forearm': 0.25, 'thigh': 0.43}
  lengths |= {'shin': 0.42, 'hip': 0.09, 'shoulder': 0.18}
  for _ in range(20):
    bones = poses.frames(poses.sample(rng)[1], lengths)
    for side in ('_l', '_r'):
      upper = bones['forearm' + side].joint - bones['upper_arm' + side].joint
      lower = bones['foot' + side].joint - bones['shin' + side].joint
      np.testing.assert_allclose(np.linalg.norm(upper), 0.3, rtol=1e-12)
      np.testing.assert_allclose(np.linalg.norm(lower), 0.42, rtol=1e-12)
    for bone in bones.values():
      np.testing.assert_allclose(bone.rotation @ bone.rotation.T, np.eye(3), atol=1e-12)


def test_colours_vary_and_stay_in_the_middle(surfaces):
  for category, samples in surfaces.items():
    means = np.array([color.mean(0) for _, color in samples])
    assert means.min() > 0.03 and means.max() < 0.92, category
    assert means.std(0).min() > 0.06, category


def test_solids_are_closed_and_face_outward():
  rng = np.random.default_rng(1)
  path = np.array([[0, 0, 0], [0.2, 0.5, 0], [0.2, 1, 0.4]])
  grid = np.stack(np.broadcast_arrays(np.linspace(0, 1, 4)[:, None], np.linspace(0, 1, 5), 0.0), -1)
  for solid in (
    solids.box((1, 2, 3)),
    solids.slab(solids.ellipse(1, 2, power=4), 0, 1, bevel=0.1),
    solids.pillow(solids.ellipse(1, 1), 0, 0.4),
    solids.lathe([(0.2, 0), (0.5, 0.3), (0.1, 1)]),
    solids.tube(solids.smooth(path), 0.1),
    solids.sheet(grid, 0.1),
    solids.prism(outlines.body('double', 0.33, 0.42, cutaway=False), -0.02, 0.03),
    solids.prism(outlines.body('classical', 0.38, 0.5, cutaway=True), -0.02, 0.03),
  ):
    order = rng.permutation(len(solid.faces))
    edges = np.concatenate([solid.faces[order][:, [i, (i + 1) % 3]] for i in range(3)])
    there, back = ({tuple(e) for e in x.tolist()} for x in (edges, edges[:, ::-1]))
    assert there == back and len(there) == len(edges)
    assert _signed_volume(solid) > 0
  np.testing.assert_allclose(_signed_volume(solids.box((1, 2, 3))), 6)
  np.testing.assert_allclose(_signed_volume(solids.sheet(grid, 0.1)), 0.1)
  part = parts.paint(solids.box((1, 2, 3), (1, 0, 0)), materials.plain([0.5, 0.5, 0.5]))
  assert _signed_volume(parts.mirror(part)) > 0


def test_a_picture_is_not_mirrored_on_any_side():
  """u grows to the right of who looks at a face from outside, v upwards."""
  box = solids.box((2, 2, 2))
  mark = materials.pictured(np.zeros((4, 4), int), [[0.5, 0.5, 0.5]])
  part = parts.paint(box, mark)
  corners = part.vertices[part.faces]
  normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
  normal /= np.linalg.norm(normal, axis=1, keepdims=True)
  for n, corner, uv in zip(normal, corners, part.uv, strict=True):
    edges, steps = corner[1:] - corner[0], uv[1:] - uv[0]
    u, v = np.linalg.lstsq(np.concatenate([edges, [n]]), np.concatenate([steps, [[0, 0]]]))[0].T
    if abs(n[1]) < 0.5:
      assert np.cross(u, v) @ n > 0 and v[1] > 0
    elif n[1] > 0:
      assert np.cross(u, v) @ n > 0 and u[0] > 0


@pytest.mark.parametrize(
  ('category', 'input_dir', 'limit', 'seed', 'said'),
  [
    ('aeroplane', '', 3, 0, 'car, chair, guitar, human, table'),
    (None, '', 3, 0, 'car, chair, guitar, human, table'),
    ('chair', '/some/folder', 3, 0, 'reads no input'),
    ('chair', '', 3, -1, 'seed'),
    ('chair', '', 0, 0, 'limit'),
  ],
)
def test_bad_input_is_named(category, input_dir, limit, seed, said):
  with pytest.raises(UserError, match=said):
    procedural.list_models(category, input_dir, limit, seed)
