"""Which operations of a compiled program take an accelerator's time."""

import pathlib
import tempfile
from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import Any

import jax


def profile(run: Callable[[], Any], *, repeats: int) -> list[dict[str, Any]]:
  """The operations of a run on the device, the longest first.

  Args:
    run: computes something, and waits for it.
    repeats: how often it is called; all figures are of one call.

  Returns:
    {'operation', 'kernel', 'seconds', 'calls'} of each: its name in the compiled program, and that
    of what computes it on the device. Nothing where the device tells nothing, as a CPU does not.
  """
  with tempfile.TemporaryDirectory() as folder:
    with jax.profiler.trace(folder):
      for _ in range(repeats):
        run()
    events = [
      event
      for path in pathlib.Path(folder).rglob('*.xplane.pb')
      for event in device_events(jax.profiler.ProfileData.from_file(str(path)))
    ]
  return summarize(events, repeats=repeats)


def device_events(data: Any) -> list[tuple[str, str, float]]:
  """(operation, kernel, seconds) of each event on the streams of the devices in a profile."""
  found = []
  for plane in data.planes:
    if not plane.name.startswith('/device:'):
      continue
    for line in plane.lines:
      if not line.name.startswith('Stream'):
        continue
      for event in line.events:
        stats = dict(event.stats)
        operation = str(stats.get('hlo_op') or '')
        found.append((operation, event.name, event.duration_ns / 1e9))
  return found


def summarize(events: Sequence[tuple[str, str, float]], *, repeats: int) -> list[dict[str, Any]]:
  """Sums of equal events, the longest first."""
  sums = defaultdict(lambda: [0.0, 0])
  for operation, kernel, seconds in events:
    total = sums[operation, kernel]
    total[0] += seconds / repeats
    total[1] += 1
  rows = [
    {'operation': operation, 'kernel': kernel, 'seconds': seconds, 'calls': count / repeats}
    for (operation, kernel), (seconds, count) in sums.items()
  ]
  return sorted(rows, key=lambda row: -row['seconds'])


def format_operations(rows: Sequence[dict[str, Any]]) -> str:
  """A line for each operation."""
  return '\n'.join(
    f'  {1e3 * r["seconds"]:8.3f} ms {r["calls"]:4.1f} x {r["operation"][:40]:40s}'
    f' {r["kernel"][:90]}'
    for r in rows
  )
