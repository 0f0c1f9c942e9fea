import numpy as np
import pytest
import trimesh

from datagen.geometry.mesh import TexturedMesh
from datagen.quality.facts import facts_of
from datagen.reading import notes


def textured(solid, missing=()):
  faces = np.asarray(solid.faces)
  return TexturedMesh(
    np.asarray(solid.vertices) + 5.0,  # where it stands has no say
    faces,
    np.ones((len(faces), 3, 4), np.float32),
    np.zeros((len(faces), 3, 2), np.float32),
    np.full(len(faces), -1, np.int32),
    (),
    missing,
  )


def test_a_box_fills_its_box():
  facts = facts_of(textured(trimesh.creation.box((1, 2, 3)), missing=('a.png', 'b.png')))
  assert facts.faces == 12
  assert facts.missing == 2
  assert facts.volume == pytest.approx(1)


def test_a_ball_and_its_inside():
  ball = trimesh.creation.icosphere(subdivisions=4)
  assert facts_of(textured(ball)).volume == pytest.approx(np.pi / 6, rel=0.01)
  ball.invert()
  assert facts_of(textured(ball)).volume == pytest.approx(-np.pi / 6, rel=0.01)


def test_both_sides_and_sheets_have_no_volume():
  ball = trimesh.creation.icosphere(subdivisions=2)
  other = ball.copy()
  other.invert()
  assert facts_of(textured(trimesh.util.concatenate(ball, other))).volume == pytest.approx(0)
  sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
  assert facts_of(textured(sheet)).volume == 0


def test_notes_are_bits_of_a_float32():
  box = textured(trimesh.creation.box())._replace(notes=(notes.POSE, notes.NO_COORDINATES))
  bits = np.float32(facts_of(box).notes)
  assert notes.from_bits(bits) == (notes.NO_COORDINATES, notes.POSE)
  every = np.float32(notes.to_bits(notes.NOTES))
  assert notes.from_bits(every) == notes.NOTES and len(set(notes.NOTES)) == len(notes.NOTES) <= 24
  assert notes.from_bits(0.0) == ()
