"""Checks of mesh files before a library reads them.

A library that trusts a stranger's file allocates all that it declares, and follows an endless scene
until memory is full.
"""

from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from xml.parsers import expat

from cvn.errors import UserError

MAX_FACES = 20_000_000  # of a scene, each instance of a mesh counted
MAX_INSTANCES = 100_000  # of meshes in a DAE file, which does not say at once how large they are
MAX_DEPTH = 256  # of XML elements within one another


def check_dae(content: bytes) -> None:
  """Checks a DAE file.

  Raises:
    UserError: it has a DOCTYPE, whose entities might expand to anything; it is nested too deeply;
      its scene is endless or has too many parts.
    expat.ExpatError: it is not XML.
  """
  parser = expat.ParserCreate()
  path: list[Hashable] = []  # the elements that are open; a node's is what it is called
  children, own = defaultdict(list), defaultdict(int)

  def start(tag, attributes):
    tag = tag.split(':')[-1]
    parent = next((p for p in reversed(path) if p is not None), None)
    key = attributes.get('id') or object() if tag == 'node' else None
    if key is not None:
      children[parent].append(key)
    elif tag == 'instance_node':
      children[parent].append(attributes.get('url', '')[1:])
    elif tag in ('instance_geometry', 'instance_controller'):
      own[parent] += 1
    path.append(key)
    if len(path) > MAX_DEPTH:
      raise UserError(f'its elements are nested more than {MAX_DEPTH} deep')

  def doctype(*_):
    raise UserError('it has a DOCTYPE, which DAE files do not need: remove it')

  parser.StartElementHandler = start
  parser.EndElementHandler = lambda _: path.pop()
  parser.StartDoctypeDeclHandler = doctype
  parser.Parse(content, True)
  count = count_instances(children, own)
  if count > MAX_INSTANCES:
    raise UserError(f'its scene has {count} parts, more than {MAX_INSTANCES}')


def count_instances(
  children: Mapping[Hashable, Sequence[Hashable]], own: Mapping[Hashable, int]
) -> int:
  """The maximum over nodes of what a node contains, with everything below it counted for each use.

  Args:
    children: node -> nodes below it, repeated for each use.
    own: node -> what it contains itself.

  Raises:
    UserError: a node is below itself.
  """
  totals: dict[Hashable, int] = {}
  for root in children:
    todo, open_nodes = [(root, False)], set()
    while todo:
      node, is_done = todo.pop()
      if is_done:
        open_nodes.remove(node)
        totals[node] = own.get(node, 0) + sum(totals[c] for c in children.get(node, ()))
      elif node in open_nodes:
        raise UserError('its scene has no end: a node is below itself')
      elif node not in totals:
        open_nodes.add(node)
        todo.append((node, True))
        todo += [(c, False) for c in children.get(node, ()) if c not in totals]
  return max(totals.values(), default=0)
