"""Mutation testing by hand: each fault below must make a test fail.

python tests/mutants.py [FILE ...]

Makes a copy of the project in a temporary folder, puts one fault after the other into it and runs
the tests of that file. Prints the faults that no test found; the exit status is 1 if there are any.
A fault is one line of a source file that is replaced: a flipped sign, a shifted index, a dropped
mask. It takes about an hour on 2 cores; with FILEs only their faults are tried.
"""

import os
import pathlib
import subprocess
import sys
import tempfile

ROOT = pathlib.Path(__file__).parent.parent

# file: (tests, [(text that the file has once, its replacement)])
MUTANTS = {
  'cvn/losses.py': (
    'test_losses',
    [
      (
        'fpce = _masked_mean(jax.nn.softplus(logits), ~occupied)',
        'fpce = _masked_mean(jax.nn.softplus(logits), occupied)',
      ),
      (
        'fpce = _masked_mean(jax.nn.softplus(logits)',
        'fpce = _masked_mean(jax.nn.softplus(-logits)',
      ),
      ('return fpce**2 + fnce**2', 'return fpce + fnce'),
      ('return fpce**2 + fnce**2', 'return fpce**2 - fnce**2'),
      ('-logits, logits)))', 'logits, -logits)))'),
      ('return jnp.sum(distance) / _count(mask)', 'return jnp.mean(distance)'),
      ('jnp.sqrt(jnp.where(positive, squared, 1)), 0)', 'jnp.sqrt(squared), 0)'),
      ('difference * jnp.sign(difference)', 'jnp.abs(difference)'),
      ('(_count(mask) * target.shape[-1])', '_count(mask)'),
      (
        'jnp.mean(jnp.sum((prediction - target) ** 2, axis=-1))',
        'jnp.mean((prediction - target) ** 2)',
      ),
      (
        'blended=distance(blended, target_color, mask)',
        'blended=distance(regressed, target_color, mask)',
      ),
      ('flow=distance(flow, target_flow, mask)', 'flow=2 * distance(flow, target_flow, mask)'),
      ('return jnp.where(mask[..., None], prediction - target, 0)', 'return prediction - target'),
      (
        'return jnp.where(mask[..., None], prediction - target, 0)',
        'return (prediction - target) * mask[..., None]',
      ),
      ('jnp.maximum(jnp.sum(mask), 1)', 'jnp.sum(mask)'),
      ('jnp.sum(jnp.where(mask, x, 0)) / _count(mask)', 'jnp.sum(x) / _count(mask)'),
    ],
  ),
  'cvn/sampler.py': (
    'test_sampler',
    [
      ('x = coordinate * size - 0.5', 'x = coordinate * size'),
      ('x = coordinate * size - 0.5', 'x = coordinate * (size - 1)'),
      ('_cell(flow[..., 0], image.shape[2])', '_cell(flow[..., 1], image.shape[2])'),
      ('jnp.clip(low + 1, 0, size - 1)', 'jnp.clip(low, 0, size - 1)'),
      ('jnp.clip(low + 1, 0, size - 1)', 'jnp.mod(low + 1, size)'),
      ('return top * (1 - wr) + bottom * wr', 'return top * wr + bottom * (1 - wr)'),
      ('bottom = _gather(image, r1, c0) * (1 - wc)', 'bottom = _gather(image, r0, c0) * (1 - wc)'),
      ('jnp.floor(coordinate * size)', 'jnp.round(coordinate * size)'),
      (
        'index(flow[..., 1], shape[1]), index(flow[..., 0], shape[2])',
        'index(flow[..., 0], shape[1]), index(flow[..., 1], shape[2])',
      ),
      ('to_left <= to_right', 'to_left < to_right'),
      ('key = gap[None] ** 2 +', 'key = gap[None] +'),
      ('key * h + rows[None, :, None]', 'key * h - rows[None, :, None] + h - 1'),
      ('minimum(to_left, to_right), h + w)', 'minimum(to_left, to_right), 0)'),
      ('jnp.where(found, row,', 'jnp.where(~found, row,'),
      ('axis=1, reverse=True)', 'axis=1)'),
      ('corner = image[:, :1, :1, :1]', 'corner = image[:, -1:, :1, :1]'),
      ('jnp.any(jnp.abs(image - corner) >=', 'jnp.all(jnp.abs(image - corner) >='),
      ('bilinear(fill(image, foreground_from_color(image)), flow)', 'bilinear(image, flow)'),
    ],
  ),
  'cvn/blending.py': (
    'test_blending',
    [
      (
        'weight * sampled + (1 - weight) * regressed',
        '(1 - weight) * sampled + weight * regressed',
      ),
      ('jnp.minimum(weight / alpha, 1)', 'jnp.minimum(weight * alpha, 1)'),
      ('jnp.minimum(weight / alpha, 1)', 'weight / alpha'),
      (
        '(predicted - threshold) / (1 - threshold), 0, 1)',
        '(predicted - threshold) / (1 + threshold), 0, 1)',
      ),
      ('jnp.all(predicted > threshold, axis=-1)', 'jnp.any(predicted > threshold, axis=-1)'),
    ],
  ),
  'cvn/metrics.py': (
    'test_metrics',
    [
      ('union = (predicted | true).sum(volume)', 'union = (predicted ^ true).sum(volume)'),
      ('volume = (-3, -2, -1)', 'volume = (-2, -1)'),
      (
        "np.searchsorted(thresholds, np.ravel(score), 'left')",
        "np.searchsorted(thresholds, np.ravel(score), 'right')",
      ),
      ('+ occupied.sum() - intersection', '+ occupied.sum()'),
      ('20 * np.log10(255) - 10 * np.log10(error)', '10 * np.log10(255) - 10 * np.log10(error)'),
      ('[-0.168736, -0.331264, 0.5]', '[-0.168736, 0.331264, 0.5]'),
      ('difference @ _YCBCR.T', 'difference @ _YCBCR'),
      ('rank = np.sqrt(np.arange(len(surface)) / len(surface))', 'rank = np.zeros(len(surface))'),
      (
        'partner = aligned_colors(predicted.occupancy, true)',
        'partner = aligned_colors(true.occupancy, true)',
      ),
    ],
  ),
  'cvn/ops/matmul.py': (
    'test_deconv test_transformations',
    [
      (
        '_DECONV_TAPS[[0, 0, 1], [0, 1, 0], [0, 1, 2]] = 1',
        '_DECONV_TAPS[[0, 0, 1], [0, 1, 1], [0, 1, 2]] = 1',
      ),
      ('before = _pad(last, 1, (1, 0))', 'before = _pad(last, 1, (0, 1))'),
      ('planes(copies[:4], odd)', 'planes(copies[4:], odd)'),
      ('behind = _pad(first, 1, (0, 1))', 'behind = _pad(first, 1, (1, 0))'),
      ('ends = [s - 2 for s in g.shape[1:4]]', 'ends = [s - 3 for s in g.shape[1:4]]'),
      (
        'return given[1] + _pad(low, axis, (1, 0)) + _pad(high, axis, (0, 1))',
        'return given[1] + _pad(low, axis, (0, 1)) + _pad(high, axis, (1, 0))',
      ),
      ('y += _pad(_pad(given[:, :, :, :-1, -1:]', 'y -= _pad(_pad(given[:, :, :, :-1, -1:]'),
      ('return [g[:, 2 - i : 2 - i + n,', 'return [g[:, i : i + n,'),
      ('taps[voxel, voxel - tap + 2, tap] = 1', 'taps[voxel, voxel + tap, tap] = 1'),
      (
        'total = dy.astype(jnp.float32) + first + 2 * second',
        'total = dy.astype(jnp.float32) + first + second',
      ),
      (
        'total = dy.astype(jnp.float32) + first + 2 * second',
        'total = dy.astype(jnp.float32) + 2 * second',
      ),
      ('transpose(2, 4, 6, 0, 3, 5, 7, 1)', 'transpose(6, 4, 2, 0, 7, 5, 3, 1)'),
    ],
  ),
  'cvn/ops/deconv.py': (
    'test_deconv test_dispatch',
    [
      ('kernel[::-1, ::-1, ::-1],', 'kernel,'),
      ('[(2, 1)] * 3,', '[(1, 2)] * 3,'),
      ('return y, sums.sum(0)', 'return y, sums[0]'),
      ('dshift, dscale = dcoefficients.sum(0)', 'dscale, dshift = dcoefficients.sum(0)'),
      (
        'dy = dy.astype(jnp.float32) + first + 2 * second',
        'dy = dy.astype(jnp.float32) + first - 2 * second',
      ),
      ('return kernel.astype(x.dtype).astype(jnp.float32)', 'return kernel'),
    ],
  ),
  'datagen/geometry/voxelize.py': (
    'test_voxelize',
    [
      ('shift = np.array([1.0, 0.6, 0.35]) * 1e-6', 'shift = np.array([1.0, 0.6, 0.35]) * 1e-1'),
      ('size=size) - 0.5 + shift', 'size=size) + shift'),
      ('mesh.vertices * (1 - 1e-6)', 'mesh.vertices * (1 + 1e-6)'),
      ('limit = 0.5 * np.abs(normal).max(-1)', 'limit = 0.5 * np.abs(normal).min(-1)'),
      ('limit = 0.5 * np.abs(normal).max(-1)', 'limit = 0.6 * np.abs(normal).max(-1)'),
      ('ok = distance <= 0.5 + EPSILON', 'ok = distance <= 0.7 + EPSILON'),
      ('np.array([[-1, 0, 1]])', 'np.array([[0, 0, 0]])'),
      (
        'inside = has_inside & (v >= 0) & (w >= 0) & (v + w <= 1)',
        'inside = has_inside & (v >= 0) & (w >= 0)',
      ),
      ('np.choose(edge, [0 * t[1], t[1], t[2]])', 'np.choose(edge, [0 * t[1], t[1], 1 - t[2]])'),
      ('  _claim_thin_rods(claims, mesh, corners, size)\n', ''),
      ('f, t, point = f[~taken], t[~taken], point[~taken]', 'f, t, point = f, t, point'),
      (
        'barycentric[:, i], barycentric[:, (i + 1) % 3] = 1 - t, t',
        'barycentric[:, i], barycentric[:, (i + 1) % 3] = t, 1 - t',
      ),
      (
        'distance[order] < claims.distance[at[order]]',
        'distance[order] > claims.distance[at[order]]',
      ),
      ('ok[ok] = is_surface(mesh, face[ok], barycentric[ok])', 'ok[ok] = True'),
      ('share = 2 * s * area[f]', 'share = area[f]'),
      ('share[~seen[f]] *= UNSEEN', 'share[seen[f]] *= UNSEEN'),
      (
        '(voxel[:, 0] * size + voxel[:, 1]) * size + voxel[:, 2]',
        '(voxel[:, 2] * size + voxel[:, 1]) * size + voxel[:, 0]',
      ),
    ],
  ),
  'datagen/geometry/dominant.py': (
    'test_dominant test_voxelize',
    [
      ('order = np.lexsort((total[:, 3], voxel))', 'order = np.lexsort((-total[:, 3], voxel))'),
      ('(spread > 1).any(-1)', '(spread > 1).all(-1)'),
      (
        'window = _joined(bins[begin:end, None] + _CORNERS',
        'window = _joined(bins[begin:end, None] + 0 * _CORNERS',
      ),
      ('return voxel, total[:, :3] / total[:, 3:]', 'return voxel, total[:, 2::-1] / total[:, 3:]'),
    ],
  ),
  'datagen/geometry/flow.py': (
    'test_flow',
    [
      ('size = np.array(depth.shape[:0:-1])', 'size = np.array(depth.shape[1:])'),
      ('flow[v], visible[v] = pixel / size, near', 'flow[v], visible[v] = pixel / size, ~near'),
      ('tolerance / grid_size)\n    pixel[near]', 'tolerance)\n    pixel[near]'),
      ('centers = np.stack([column, row], -1) + 0.5', 'centers = np.stack([column, row], -1)'),
      ('low = np.floor(pixel - 0.5)', 'low = np.floor(pixel)'),
      ('np.where(color < 127.5, 255.0, 0.0)', 'np.where(color < 127.5, 0.0, 255.0)'),
      ('np.maximum(_squared(bilinear), _squared(nearest))', '_squared(bilinear)'),
      ('np.maximum(_squared(bilinear), _squared(nearest))', '_squared(nearest)'),
      (
        'np.abs(depth[row, column] - distance) <= tolerance',
        'depth[row, column] - distance <= tolerance',
      ),
      ('good &= _shows(depth, around, distance[wrong, None], tolerance)', 'good &= True'),
      ('best = far.argmin(1)\n  found', 'best = far.argmax(1)\n  found'),
      (
        'moved[wrong[found]] = around[found, best[found]] + 0.5',
        'moved[wrong[found]] = around[found, best[found]]',
      ),
      ('chosen = near[np.arange(len(pixel)), similar.argmax(1)]', 'chosen = near[:, 0]'),
      ('limit = np.rint(np.square(least))', 'limit = np.rint(np.square(2 * least))'),
      ('reach**2 + 1)', 'reach)'),
    ],
  ),
}


def main(files):
  survivors, total = [], 0
  with tempfile.TemporaryDirectory() as folder:
    listed = subprocess.check_output(['git', 'ls-files', '-z'], cwd=ROOT, text=True)
    copy = ['cp', '--parents', '-t', folder, *filter(None, listed.split('\0'))]
    subprocess.run(copy, cwd=ROOT, check=True)
    for name, (tests, changes) in MUTANTS.items():
      if files and name not in files:
        continue
      path = pathlib.Path(folder, name)
      source = path.read_text()
      for old, new in changes:
        if source.count(old) != 1:
          sys.exit(f'{name} has {source.count(old)} times: {old}')
        path.write_text(source.replace(old, new))
        found = not passes(folder, tests)
        total += 1
        print(f'{"found" if found else "SURVIVED"}: {name}: {new.strip()!r}', flush=True)
        survivors += [] if found else [(name, old, new)]
      path.write_text(source)
      if changes and not passes(folder, tests):
        sys.exit(f'{tests} fail without a fault')
  print(f'{total} faults, {len(survivors)} survived')
  return 1 if survivors else 0


def passes(folder, tests):
  """Whether the tests of these names pass on the copy of the project."""
  paths = [f'tests/{name}.py' for name in tests.split()]
  command = [sys.executable, '-B', '-m', 'pytest', '-x', '-q', '-p', 'no:cacheprovider', *paths]
  done = subprocess.run(
    command, cwd=folder, capture_output=True, env=os.environ | {'PYTHONPATH': folder}
  )
  return done.returncode == 0


if __name__ == '__main__':
  sys.exit(main(sys.argv[1:]))
