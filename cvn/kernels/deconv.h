// The stride-2 3x3x3 deconvolution of f(gain x + offset), and its gradients.
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
  const int64_t wide = RoundUp(s.cout, kLanes), deep = RoundUp(s.cin, std::max(kLanes, Product::kDepth));
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
          Product::Multiply(taps, a, deep, b, high, deep, wide, sum.data() + phase % 2 * wide,
                            2 * wide);
          if (phase % 2) {
            const int64_t row = FineRow(s, sample, 2 * x + phase / 4, 2 * y + phase / 2 % 2);
            Unpad(sum.data(), wide, 2 * s.z, s.cout, out + row * 2 * s.z * s.cout);
            moments.AddRow(sum.data(), wide, 2 * s.z);
          }
        }
      }
    }
    std::copy_n(moments.data(), 2 * s.cout, parts.data() + item * 2 * s.cout);
  });
  AddParts(parts.data(), s.b, slabs, 2 * s.cout, sums);
}

// A row of the output's gradient, as the two products of its input's and its kernel's gradient take
// it.
template <typename Product>
struct FineRows;

template <>
struct FineRows<Vectors> {
  static int64_t Size(int64_t high, int64_t wide) { return (2 * high + 1) * wide; }
  static void Finish(int64_t, int64_t, int64_t, float*) {}

  // Adds one strip's terms of a kernel's gradient.
  static void AddTerms(int count, const float* left, int64_t left_size, const float* const* rows,
                       int tap, int64_t high, int64_t wide_in, int64_t wide_out, float* total) {
    const float *a[kMaxTaps], *b[kMaxTaps];
    for (int i = 0; i < count; ++i) {
      a[i] = left + i * left_size;
      b[i] = rows[i] + tap * wide_out;
    }
    AddOuter(count, a, wide_in, b, 2 * wide_out, high, wide_in, wide_out, total, wide_out);
  }

  // f(gain x + offset) for the left side of these products: [z][wide].
  static int64_t LeftSize(int64_t high, int64_t wide) { return high * wide; }
  template <typename In>
  static void Left(const Source<In>& in, int64_t row, int64_t, int64_t wide, float* scratch,
                   float* to) {
    in.Row(row, wide, scratch, to);
  }
};

#if CVN_TILES

// Behind the voxels, which are [2 high + 1][deep], there are for each tap along z the tiles of
// pairs of voxels that are two apart.
template <>
struct FineRows<Tiles> {
  static int64_t Voxels(int64_t high, int64_t wide) {
    return (2 * high + 1) * RoundUp(wide, kTileDepth);
  }
  static int64_t Pairs(int64_t high, int64_t wide) { return RoundUp(high, kTileDepth) * wide; }
  static int64_t Size(int64_t high, int64_t wide) {
    return Voxels(high, wide) + 3 * Pairs(high, wide);
  }

  static void Finish(int64_t z, int64_t high, int64_t wide, Bf16* row) {
    const int64_t deep = RoundUp(wide, kTileDepth), pairs = Pairs(high, wide);
    const int64_t column = RoundUp(high, kTileDepth) / kTileDepth * kTileSize;
    for (int64_t t = 0; t < 3; ++t) {
      Bf16* to = row + Voxels(high, wide) + t * pairs;
      for (int64_t i = 0; i < z; i += 2) {
        const Bf16* first = row + (2 * i + t) * deep;
        const Bf16* second = row + std::min(2 * i + 2 + t, 2 * high) * deep;
        InterleavePair(first, second, wide, column, to + i / 2 * kTileDepth);
      }
    }
  }

  static void AddTerms(int count, const Bf16* left, int64_t left_size, const Bf16* const* rows,
                       int tap, int64_t high, int64_t wide_in, int64_t wide_out, float* total) {
    const Bf16 *a[kMaxTaps], *b[kMaxTaps];
    for (int i = 0; i < count; ++i) {
      a[i] = left + i * left_size;
      b[i] = rows[i] + Voxels(high, wide_out) + tap * Pairs(high, wide_out);
    }
    const int64_t long_z = RoundUp(high, kTileDepth);
    TileMultiply<true>(count, a, long_z, b, wide_in, long_z, wide_out, total, wide_out);
  }

  // [wide][z]
  static int64_t LeftSize(int64_t high, int64_t wide) { return RoundUp(high, kTileDepth) * wide; }
  template <typename In>
  static void Left(const Source<In>& in, int64_t row, int64_t high, int64_t wide, float* scratch,
                   Bf16* to) {
    in.Row(row, wide, scratch + RoundUp(high * wide, kLanes), scratch);
    const int64_t long_z = RoundUp(high, kTileDepth);
    for (int64_t i = 0; i < high; i += kTileRows) {
      for (int64_t c = 0; c < wide; c += kLanes) {
        Transpose16(scratch + i * wide + c, wide, to + c * long_z + i, long_z);
      }
    }
  }
};

#endif  // CVN_TILES

constexpr int kStrip = 4;  // rows whose terms of a kernel's gradient are summed in registers

// The gradients of input, gain and offset (`sums`, see Source), and kernel; `dw` is
// [B, 27, in, out]: one term a sample, so that its sum does not depend on the number of threads.
template <typename Product, typename In, typename Out>
void DeconvGradients(const Volume& s, const Source<In>& in, const float* w,
                     const Cotangent<Out>& cotangent, ffi::ThreadPool& pool, In* dx, float* sums,
                     float* dw) {
  using Element = typename Product::Element;
  using Fine = FineRows<Product>;
  const int64_t wide_in = RoundUp(s.cin, kLanes), wide_out = RoundUp(s.cout, kLanes);
  const int64_t deep = RoundUp(s.cout, std::max(kLanes, Product::kDepth)), high = RoundUp(s.z, Product::kRows);
  Scratch<float> rounded = RoundedWeights<In>(w, kTaps * s.cin * s.cout);
  Scratch<Element> weight(kTaps * deep * wide_in);
  for (int64_t t = 0; t < kTaps; ++t) {
    Product::Pack(rounded.data() + t * s.cin * s.cout, 1, s.cout, s.cout, s.cin,
                  weight.data() + t * deep * wide_in);
  }
  ParallelFor(pool, s.b, [&](int64_t sample) {
    typename Product::Session session;
    constexpr int kRows = 2 * kStrip + 1;  // of the output, for a strip
    const int64_t row_size = RoundUp(Fine::Size(high, wide_out), 32), left_size = Fine::LeftSize(high, wide_in);
    // The output's plane 2 x + 2 is kept for the next x; of the two others a strip at a time.
    const int64_t kept_rows = 2 * s.y;
    Scratch<Element> buffer((kept_rows + 2 * kRows + 1) * row_size), left(kStrip * left_size);
    Scratch<float> fine(cotangent.padded), sum(high * wide_in), flat(in.padded);
    Scratch<float> scratch(2 * (high * wide_in + in.padded)), total(kTaps * wide_in * wide_out);
    Scratch<float> places(2 * in.padded);
    Sums moments(s.cin);
    std::vector<Element*> kept(kept_rows);
    Element *rows[2][kRows], *next = buffer.data();
    for (auto& row : kept) row = next, next += row_size;
    for (int i = 0; i < 2 * kRows; ++i) rows[i / kRows][i % kRows] = next, next += row_size;
    const Element* const zero = next;
    const auto fill = [&](int64_t x, int64_t y, Element* to) {
      cotangent.template Row<In>(FineRow(s, sample, x, y), deep, fine.data(), to);
      Fine::Finish(s.z, high, wide_out, to);
    };
    for (int64_t y = 0; y < 2 * s.y; ++y) fill(0, y, kept[y]);
    for (int64_t x = 0; x < s.x; ++x) {
      const bool last = x + 1 == s.x;
      for (int64_t first = 0; first < s.y; first += kStrip) {
        const int count = static_cast<int>(std::min<int64_t>(kStrip, s.y - first));
        const Element* source[3][kRows];
        for (int a = 0; a < 2; ++a) std::swap(rows[a][0], rows[a][kRows - 1]);  // of the strip before
        for (int b = 0; b <= 2 * count; ++b) {
          const int64_t y = 2 * first + b;
          const bool there = y < 2 * s.y, fresh = there && (b > 0 || first == 0);
          if (fresh) fill(2 * x + 1, y, rows[0][b]);
          if (fresh && !last) fill(2 * x + 2, y, rows[1][b]);
          source[0][b] = there ? kept[y] : zero;
          source[1][b] = there ? rows[0][b] : zero;
          source[2][b] = there && !last ? rows[1][b] : zero;
        }
        const int64_t row = (sample * s.x + x) * s.y + first;
        for (int i = 0; i < count; ++i) {
          Fine::Left(in, row + i, high, wide_in, scratch.data(), left.data() + i * left_size);
        }
        for (int t = 0; t < kTaps; ++t) {
          const Element* b[kStrip];
          for (int i = 0; i < count; ++i) b[i] = source[t / 9][2 * i + t / 3 % 3];
          Fine::AddTerms(count, left.data(), left_size, b, t % 3, high, wide_in, wide_out,
                         total.data() + t * wide_in * wide_out);
        }
        for (int i = 0; i < count; ++i) {
          const Element *a[kTaps], *b[kTaps];
          for (int t = 0; t < kTaps; ++t) {
            a[t] = source[t / 9][2 * i + t / 3 % 3] + t % 3 * deep;
            b[t] = weight.data() + t * deep * wide_in;
          }
          Product::Multiply(kTaps, a, 2 * deep, b, high, deep, wide_in, sum.data(), wide_in);
          if (wide_in != s.cin) Unpad(sum.data(), wide_in, s.z, s.cin, flat.data());
          in.Gradient(row + i, wide_in == s.cin ? sum.data() : flat.data(), places.data(), dx,
                      nullptr);
        }
        if (!last) {  // the row that the next strip begins with goes with that
          for (int b = 0; b < 2 * count; ++b) std::swap(kept[2 * first + b], rows[1][b]);
        }
      }
      moments.AddTwo(places.data(), in.size, in.padded);
    }
    moments.CopyTo(sums + sample * 2 * s.cin);
    for (int64_t t = 0; t < kTaps; ++t) {
      Unpad(total.data() + t * wide_in * wide_out, wide_out, s.cin, s.cout,
            dw + (sample * kTaps + t) * s.cin * s.cout);
    }
  });
}

}  // namespace cvn

#endif  // CVN_DECONV_H_
