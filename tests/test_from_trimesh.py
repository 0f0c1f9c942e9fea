"""What becomes of trimesh's colours and scenes."""

import numpy as np
import PIL.Image
import pytest
import trimesh
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from cvn.errors import UserError
from datagen.from_trimesh import MAX_TEXTURE_SIDE, from_trimesh
from datagen.mesh import NO_COLOR, TexturedMesh, albedo, check, is_surface

QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
QUAD_FACES = np.array([[0, 1, 2], [0, 2, 3]])
UV = QUAD[:, :2]
RED, GREEN, BLUE, WHITE = [255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255] * 4
FOUR = np.array([[RED, GREEN], [BLUE, WHITE]], np.uint8)  # row 0 is the image's top


def image(pixels, *, repeat=8):
  return PIL.Image.fromarray(np.repeat(np.repeat(pixels, repeat, 0), repeat, 1))


def textured(picture=None, uv=UV, **material):
  visual = TextureVisuals(uv=uv, material=SimpleMaterial(image=picture, **material))
  return trimesh.Trimesh(QUAD, QUAD_FACES, visual=visual, process=False)


def pbr(uv=UV, **material):
  visual = TextureVisuals(uv=uv, material=PBRMaterial(**material))
  return trimesh.Trimesh(QUAD, QUAD_FACES, visual=visual, process=False)


def color_at(mesh, x, y):
  """Albedo of the quad's point (x, y) in 0..255."""
  face = int(x < y)
  a, b, c = mesh.vertices[mesh.faces[face]][:, :2]
  v, w = np.linalg.solve(np.stack([b - a, c - a], 1), np.array([x, y]) - a)
  return 255 * albedo(mesh, np.array([face]), np.array([[1 - v - w, v, w]]))[0]


def assert_color(actual, expected):
  np.testing.assert_allclose(actual[: len(expected)], expected, atol=0.6)


@pytest.mark.parametrize('shift', [-1, 3, 1000, -70000])
def test_textures_repeat(shift):
  mesh = from_trimesh(textured(image(FOUR), uv=UV + shift))
  assert_color(color_at(mesh, 0.25, 0.75), RED)
  twice = from_trimesh(textured(image(FOUR), uv=2 * UV + shift))
  for x in (0.125, 0.625):
    assert_color(color_at(twice, x, x + 0.25), RED)


@pytest.mark.parametrize('diffuse', [None, [0.0, 0.0, 0.0], [0.2, 0.4, 1.0]])
def test_texture_stands_alone_beside_a_material_color(diffuse):
  mesh = from_trimesh(textured(image(FOUR), diffuse=diffuse, d=['0.5']))
  assert_color(color_at(mesh, 0.75, 0.25), WHITE[:3])
  assert color_at(mesh, 0.75, 0.25)[3] == (255 if diffuse is None else 127.5)


def test_gltf_factor_multiplies_the_texture():
  mesh = from_trimesh(pbr(baseColorTexture=image(FOUR), baseColorFactor=[1.0, 0.0, 1.0]), gltf=True)
  assert_color(color_at(mesh, 0.75, 0.25), [255, 0, 255])


@pytest.mark.parametrize(('diffuse', 'factor'), [([0.0, 0.0, 0.0], 1), ([0.2, 0.2, 0.2], 0.2)])
def test_vertex_colors_multiply_a_material_color_unless_that_is_black(diffuse, factor):
  mesh = textured(diffuse=diffuse)
  mesh.vertex_attributes['color'] = np.array([[1.0, 0.5, 0.0]] * 4)
  expected = factor * np.array([255, 127.5, 0])
  assert_color(color_at(from_trimesh(mesh), 0.75, 0.25), expected)


def test_material_color_without_texture_and_black_is_black():
  mesh = from_trimesh(textured(diffuse=[0.2, 0.4, 0.6]))
  assert not mesh.textures and (mesh.texture == -1).all()
  assert_color(color_at(mesh, 0.3, 0.6), [51, 102, 153, 255])
  assert_color(color_at(from_trimesh(textured(diffuse=[0.0, 0.0, 0.0])), 0.3, 0.6), [0, 0, 0])


@pytest.mark.parametrize(
  ('kd', 'expected'),
  [
    ([0.4, 0.4, 0.4], [102, 102, 102]),  # what trimesh takes for no colour
    ([1.2, 0.5, 0.0], [255, 127.5, 0]),
    ([200.0, 100.0, 50.0], [200, 100, 50]),
  ],
)
def test_kd_is_read_as_it_is_written(kd, expected):
  assert_color(color_at(from_trimesh(textured(diffuse=kd, kd=kd)), 0.3, 0.6), expected)


def test_placeholder_texture_is_none_and_a_small_one_from_a_file_is(tmp_path):
  grey = [NO_COLOR * 255] * 3
  bare = trimesh.Trimesh(QUAD, QUAD_FACES, visual=TextureVisuals(uv=UV), process=False)
  assert_color(color_at(from_trimesh(bare), 0.3, 0.6), grey)
  PIL.Image.fromarray(FOUR).save(tmp_path / 'small.png')
  mesh = from_trimesh(textured(PIL.Image.open(tmp_path / 'small.png')))
  assert_color(color_at(mesh, 0.25, 0.75), RED)


def test_texture_without_coordinates_is_its_mean():
  mesh = from_trimesh(textured(image(FOUR), uv=None))
  assert_color(color_at(mesh, 0.1, 0.2), [127.5, 127.5, 127.5, 255])
  assert not np.any(mesh.texture >= 0)


def test_large_texture_shrinks():
  mesh = from_trimesh(textured(image(FOUR, repeat=MAX_TEXTURE_SIDE)))
  assert mesh.textures[0].shape == (MAX_TEXTURE_SIDE, MAX_TEXTURE_SIDE, 4)
  assert_color(color_at(mesh, 0.25, 0.75), RED)


def test_vertex_and_face_colors():
  mesh = trimesh.Trimesh(QUAD, QUAD_FACES, vertex_colors=[RED, GREEN, BLUE, WHITE], process=False)
  assert_color(color_at(from_trimesh(mesh), 1, 0), GREEN)
  assert_color(color_at(from_trimesh(mesh), 0.5, 0.0), [127.5, 127.5, 0])
  mesh = trimesh.Trimesh(QUAD, QUAD_FACES, face_colors=[RED, [1, 2, 3, 255]], process=False)
  assert_color(color_at(from_trimesh(mesh), 0.7, 0.3), RED)
  assert_color(color_at(from_trimesh(mesh), 0.3, 0.7), [1, 2, 3])


def test_no_color_is_grey():
  mesh = from_trimesh(trimesh.Trimesh(QUAD, QUAD_FACES, process=False))
  assert_color(color_at(mesh, 0.3, 0.7), [NO_COLOR * 255] * 3 + [255])


@pytest.mark.parametrize(('kwargs', 'alpha'), [({'d': ['0.25']}, 0.25), ({'tr': ['0.25']}, 0.75)])
def test_glass_keeps_its_alpha_and_is_surface(kwargs, alpha):
  mesh = from_trimesh(textured(diffuse=[0.2, 0.4, 0.6], **kwargs))
  assert_color(color_at(mesh, 0.3, 0.7), [51, 102, 153, 255 * alpha])
  assert is_surface(mesh, np.array([0]), np.array([[0.2, 0.3, 0.5]])).all()


def test_invisible_material_is_left_out_and_tr_1_is_opaque():
  assert not len(from_trimesh(textured(diffuse=[1.0, 1.0, 1.0], d=['0.001'])).faces)
  mesh = from_trimesh(textured(diffuse=[1.0, 1.0, 1.0], tr=['1']))
  assert_color(color_at(mesh, 0.3, 0.7), WHITE)


def test_alpha_that_is_nowhere_opaque_cuts_nothing():
  clear = np.full((2, 2, 4), [9, 9, 9, 0], np.uint8)
  assert_color(color_at(from_trimesh(textured(image(clear))), 0.3, 0.7), [9, 9, 9, 255])


def linear(srgb):
  """The inverse of sRGB's curve, 0..255 to 0..1."""
  x = srgb / 255
  return x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4


def test_gltf_factors_and_vertex_colors_are_linear():
  factor = [linear(188), linear(128), linear(64), 1.0]
  mesh = from_trimesh(pbr(baseColorFactor=factor), gltf=True)
  np.testing.assert_allclose(color_at(mesh, 0.3, 0.7), [188, 128, 64, 255], atol=1.5)
  assert_color(
    color_at(from_trimesh(pbr(baseColorFactor=[0.2, 0.4, 0.6, 1.0])), 0.3, 0.7), [51, 102]
  )
  source = pbr(baseColorFactor=[1.0, 1.0, 1.0, 1.0])
  values = [[65535 * linear(128)] * 3 + [65535]] * 4
  source.visual.vertex_attributes['color'] = np.array(values).astype(np.uint16)
  assert_color(color_at(from_trimesh(source, gltf=True), 0.3, 0.7), [128, 128, 128, 255])


def test_gltf_textures_are_srgb_already():
  mesh = from_trimesh(pbr(baseColorTexture=image(FOUR // 2 + 20)), gltf=True)
  assert_color(color_at(mesh, 0.25, 0.75), [147, 20, 20])


@pytest.mark.parametrize(
  ('mode', 'cutoff', 'solid'),
  [(None, None, True), ('MASK', 0.3, True), ('MASK', 0.5, False), ('BLEND', None, False)],
)
def test_gltf_alpha_counts_as_its_mode_says(mode, cutoff, solid):
  picture = FOUR.copy()
  picture[1, 0, 3] = 110
  mesh = from_trimesh(
    pbr(baseColorTexture=image(picture), alphaMode=mode, alphaCutoff=cutoff), gltf=True
  )
  at = np.array([0]), np.array([[0.8, 0.1, 0.1]])  # (0.2, 0.1)
  assert is_surface(mesh, *at)[0] == solid


def test_scene_transforms_instances_and_mirrors():
  box = trimesh.creation.box((1, 1, 1))
  box.visual.face_colors = RED
  scene = trimesh.Scene()
  scene.add_geometry(box, geom_name='box', transform=trimesh.transformations.scale_matrix(2))
  shift = trimesh.transformations.translation_matrix([5, 0, 0])
  scene.graph.update('again', matrix=shift, geometry='box')
  mirror = np.diag([-1.0, 1, 1, 1])
  mirror[0, 3] = -5
  scene.graph.update('mirror', matrix=mirror, geometry='box')
  scene.add_geometry(trimesh.PointCloud([[100, 0, 0]]))
  mesh = from_trimesh(scene)
  assert mesh.faces.shape == (36, 3)
  np.testing.assert_allclose(mesh.vertices.min(0), [-5.5, -1, -1])
  np.testing.assert_allclose(mesh.vertices.max(0), [5.5, 1, 1])
  # Every copy, mirrored too, has its faces turned outwards: the volumes add up.
  volume = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume
  assert volume == pytest.approx(8 + 1 + 1)


def test_one_image_for_two_geometries_is_stored_once():
  material = SimpleMaterial(image=image(FOUR))
  scene = trimesh.Scene()
  for k in range(2):
    visual = TextureVisuals(uv=UV, material=material)
    scene.add_geometry(trimesh.Trimesh(QUAD + k, QUAD_FACES, visual=visual, process=False))
  mesh = from_trimesh(scene)
  assert len(mesh.textures) == 1 and (mesh.texture == 0).all() and len(mesh.faces) == 4


def test_faces_without_area_are_left_out():
  faces = np.concatenate([QUAD_FACES, [[0, 0, 1], [2, 2, 2]]])
  mesh = trimesh.Trimesh(QUAD, faces, process=False)
  mesh.visual.face_colors = [RED, GREEN, BLUE, BLUE]
  mesh = from_trimesh(mesh)
  assert len(mesh.faces) == len(mesh.corner_colors) == 2
  assert_color(color_at(mesh, 0.3, 0.7), GREEN)


@pytest.mark.parametrize(
  ('vertices', 'faces', 'reason'),
  [
    (QUAD, np.zeros((0, 3), int), 'no faces'),
    (np.where(QUAD == 0, np.nan, QUAD), QUAD_FACES, 'not finite'),
    (np.zeros((4, 3)), QUAD_FACES, 'no faces'),
    (QUAD, QUAD_FACES + 1, 'not there'),
  ],
)
def test_bad_meshes_are_rejected_with_the_reason(vertices, faces, reason):
  with pytest.raises(UserError, match=reason):
    check(from_trimesh(trimesh.Trimesh(vertices, faces, process=False)))


def test_types():
  mesh = from_trimesh(textured(image(FOUR)))
  expected = TexturedMesh('f8', 'i8', 'f4', 'f4', 'i4', None)
  assert [a.dtype for a in mesh[:5]] == [np.dtype(t) for t in expected[:5]]
  assert mesh.textures[0].dtype == np.uint8
