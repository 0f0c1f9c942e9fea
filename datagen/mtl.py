"""MTL text, made plain for trimesh, which loses all materials of a file over one odd line."""

_KEPT = (b'newmtl', b'map_kd', b'd', b'tr')


def plain_mtl(content: bytes) -> bytes:
  """Keeps what colours come from: `newmtl`, `Kd`, `map_Kd`, `d`, `Tr`.

  `Kd` becomes three numbers: one alone stands for red, green and blue, as the format says.

  Args:
    content: of the file.
  """
  lines = []
  for line in content.splitlines():
    key, *words = line.split() or [b'']
    if key.lower() == b'kd':
      numbers = _leading_numbers(words)[:3]
      if numbers:
        lines.append(b' '.join([key, *numbers, *numbers[-1:] * (3 - len(numbers))]))
    elif key.lower() in _KEPT:
      lines.append(line)
  return b'\n'.join(lines)


def _leading_numbers(words):
  """The words before the first one that is no number."""
  for n, word in enumerate(words):
    try:
      float(word)
    except ValueError:
      return words[:n]
  return words
