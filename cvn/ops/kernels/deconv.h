// The stride-2 3x3x3 deconvolution of f(gain x + offset).
//
// Along one axis, y[2 j + t] += x[j] w[t]. Rows along z are copied into buffers with zeros where
// the map ends, so that the innermost loops know no borders.

#ifndef CVN_DECONV_H_
#define CVN_DECONV_H_

#include "products.h"
#include "rows.h"

namespace cvn {

struct Volume {
  int64_t b, x, y, z;  // of the input
  int64_t cin, cout;
};

// Weights as a volume of T needs them.
template <typename T>
Scratch<float> RoundedWeights(const float* w, int64_t n) {
  Scratch<float> rounded(n);
  for (int64_t i = 0; i < n; ++i) rounded[i] = Rounded<T>(w[i]);
  return rounded;
}

// Where a row of the output is, of those of 2 z voxels.
inline int64_t FineRow(const Volume& s, int64_t sample, int64_t x, int64_t y) {
  return (sample * 2 * s.x + x) * 2 * s.y + y;
}

// The taps that an output of a parity reads along an axis, and how many voxels back.
struct Reads {
  int count;
  int shift[2], tap[2];
};
constexpr Reads kReads[2] = {{2, {0, 1}, {0, 2}}, {1, {0, 0}, {1, 0}}};

// Lists the taps of one phase: f(tap's index, its number of 27, shifts along x, y and z).
template <typename F>
int ForTaps(int phase, const F& f) {
  const Reads &x = kReads[phase >> 2], &y = kReads[phase >> 1 & 1], &z = kReads[phase & 1];
  int n = 0;
  for (int i = 0; i < x.count; ++i) {
    for (int j = 0; j < y.count; ++j) {
      for (int k = 0; k < z.count; ++k) {
        f(n++, (x.tap[i] * 3 + y.tap[j]) * 3 + z.tap[k], x.shift[i], y.shift[j], z.shift[k]);
      }
    }
  }
  return n;
}

constexpr int64_t kDeconvSlab = 8;  // planes done in a row, which share their neighbours' copies

// `sums` is [B, 2, out]: of y and of y^2.
template <typename Product, typename In, typename Out>
void DeconvRows(const Volume& s, const Source<In>& in, const float* w, ffi::ThreadPool& pool,
                Out* out, float* sums) {
  using Element = typename Product::Element;
  const int64_t wide = RoundUp(s.cout, kLanes);
  const int64_t deep = RoundUp(s.cin, std::max(kLanes, Product::kDepth));
  const int64_t high = RoundUp(s.z, Product::kRows);
  Scratch<float> rounded = RoundedWeights<In>(w, kTaps * s.cin * s.cout);
  Scratch<Element> weight(kTaps * deep * wide);
  for (int64_t t = 0; t < kTaps; ++t) {
    Product::Pack(rounded.data() + t * s.cin * s.cout, s.cout, 1, s.cin, s.cout,
                  weight.data() + t * deep * wide);
  }
  const int64_t slabs = (s.x + kDeconvSlab - 1) / kDeconvSlab;
  Scratch<double> parts(s.b * slabs * 2 * s.cout);
  ParallelFor(pool, s.b * slabs, [&](int64_t item) {
    typename Product::Session session;
    const int64_t sample = item / slabs, first = item % slabs * kDeconvSlab;
    const int64_t last = std::min(first + kDeconvSlab, s.x);
    // Two planes, which begin with a row of zeros as a row does with a voxel.
    const int64_t row_size = (high + 1) * deep, size = (s.y + 1) * row_size;
    Scratch<Element> buffer(2 * size);
    Scratch<float> sum(2 * high * wide), scratch(in.padded);
    Sums moments(s.cout);
    const auto plane_at = [&](int64_t x) { return buffer.data() + (x & 1) * size; };
    const auto fill = [&](int64_t x) {
      for (int64_t y = 0; y < s.y; ++y) {
        in.Row((sample * s.x + x) * s.y + y, deep, scratch.data(),
               plane_at(x) + (y + 1) * row_size + deep);
      }
    };
    if (first > 0) fill(first - 1);
    for (int64_t x = first; x < last; ++x) {
      fill(x);
      for (int64_t y = 0; y < s.y; ++y) {
        for (int phase = 0; phase < 8; ++phase) {
          const Element *a[8], *b[8];
          const int taps = ForTaps(phase, [&](int n, int tap, int i, int j, int k) {
            a[n] = plane_at(x - i) + (y + 1 - j) * row_size + (1 - k) * deep;
            b[n] = weight.data() + tap * deep * wide;
          });
          Out* to = out + FineRow(s, sample, 2 * x + phase / 4, 2 * y + phase / 2 % 2) * 2 * s.z *
                              s.cout;
          float* row = sum.data();
          if constexpr (std::is_same_v<Out, float>) {
            if (wide == s.cout && high == s.z) row = to;
          }
          Product::Multiply(taps, a, deep, b, high, deep, wide, row + phase % 2 * wide, 2 * wide);
          if (phase % 2) {
            moments.AddRow(row, wide, 2 * s.z);
            if (row == sum.data()) Unpad(row, wide, 2 * s.z, s.cout, to);
          }
        }
      }
    }
    std::copy_n(moments.data(), 2 * s.cout, parts.data() + item * 2 * s.cout);
  });
  AddParts(parts.data(), s.b, slabs, 2 * s.cout, sums);
}

}  // namespace cvn

#endif  // CVN_DECONV_H_
