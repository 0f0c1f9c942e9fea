// The gradients of deconv.h's deconvolution.

#ifndef CVN_DECONV_GRADIENT_H_
#define CVN_DECONV_GRADIENT_H_

#include "deconv.h"

namespace cvn {

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
                       int tap, int64_t high, int64_t wide_in, int64_t deep, int64_t wide_out,
                       float* total) {
    const float *a[kMaxTaps], *b[kMaxTaps];
    for (int i = 0; i < count; ++i) {
      a[i] = left + i * left_size;
      b[i] = rows[i] + tap * deep;
    }
    AddOuter<Floats>(count, a, wide_in, b, 2 * deep, high, wide_in, wide_out, total, wide_out);
  }

  // f(gain x + offset) for the left side of these products: [z][wide].
  static int64_t LeftSize(int64_t high, int64_t wide) { return high * wide; }
  template <typename In>
  static void Left(const Source<In>& in, int64_t row, int64_t, int64_t wide, float* scratch,
                   float* to) {
    in.Row(row, wide, scratch, to);
  }
};

#if CVN_PAIRS

// Behind the voxels, which are [2 high + 1][wide], there are for each tap along z the words of
// pairs of voxels that are two apart.
template <>
struct FineRows<Pairs> {
  static int64_t Words(int64_t high) { return (high + 1) / 2; }
  static int64_t At(int64_t tap, int64_t high, int64_t wide) {
    return (2 * high + 1 + 2 * tap * Words(high)) * wide;
  }
  static int64_t Size(int64_t high, int64_t wide) { return At(3, high, wide); }

  static void Finish(int64_t z, int64_t high, int64_t wide, Bf16* row) {
    for (int64_t t = 0; t < 3; ++t) {
      Bf16* to = row + At(t, high, wide);
      for (int64_t i = 0; i < z; i += 2, to += 2 * wide) {
        Pairs::Join(row + (2 * i + t) * wide, row + std::min(2 * i + 2 + t, 2 * high) * wide, wide,
                    to);
      }
    }
  }

  static void AddTerms(int count, const Bf16* left, int64_t left_size, const Bf16* const* rows,
                       int tap, int64_t high, int64_t wide_in, int64_t, int64_t wide_out,
                       float* total) {
    const Bf16 *a[kMaxTaps], *b[kMaxTaps];
    for (int i = 0; i < count; ++i) {
      a[i] = left + i * left_size;
      b[i] = rows[i] + At(tap, high, wide_out);
    }
    Pairs::AddOuter(count, a, wide_in, b, wide_out, Words(high), wide_in, wide_out, total);
  }

  // [words][wide]
  static int64_t LeftSize(int64_t high, int64_t wide) { return 2 * Words(high) * wide; }
  template <typename In>
  static void Left(const Source<In>& in, int64_t row, int64_t high, int64_t wide, float* scratch,
                   Bf16* to) {
    float* voxels = scratch + RoundUp(in.padded, kLanes);
    in.Row(row, wide, scratch, voxels);
    std::fill_n(voxels + high * wide, wide, 0.0f);  // behind the last voxel of an odd number
    for (int64_t i = 0; i < high; i += 2) {
      Pairs::Join(voxels + i * wide, voxels + (i + 1) * wide, wide, to + i * wide);
    }
  }
};

#endif  // CVN_PAIRS

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
                       int tap, int64_t high, int64_t wide_in, int64_t, int64_t wide_out,
                       float* total) {
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
  // Where the channels of three voxels fit one vector, voxels stand side by side: one product then
  // makes the terms of all three taps along z.
  const bool narrow = std::is_same_v<Product, Vectors> && 3 * s.cout <= kLanes;
  const int64_t deep = narrow ? s.cout : RoundUp(s.cout, std::max(kLanes, Product::kDepth));
  const int64_t high = RoundUp(s.z, Product::kRows);
  Scratch<float> rounded = RoundedWeights<In>(w, kTaps * s.cin * s.cout);
  Scratch<Element> weight(kTaps * deep * wide_in);
  for (int64_t t = 0; t < kTaps; ++t) {
    Product::Pack(rounded.data() + t * s.cin * s.cout, 1, s.cout, s.cout, s.cin,
                  weight.data() + t * deep * wide_in);
  }
  ParallelFor(pool, s.b, [&](int64_t sample) {
    typename Product::Session session;
    constexpr int kRows = 2 * kStrip + 1;  // of the output, for a strip
    const int64_t row_size = RoundUp(Fine::Size(high, wide_out), 32);
    const int64_t left_size = Fine::LeftSize(high, wide_in);
    // The output's plane 2 x + 2 is kept for the next x; of the two others a strip at a time.
    const int64_t kept_rows = 2 * s.y;
    Scratch<Element> buffer((kept_rows + 2 * kRows + 1) * row_size), left(kStrip * left_size);
    Scratch<float> fine(cotangent.padded), sum(high * wide_in), flat(in.padded);
    Scratch<float> scratch(2 * ((high + 1) * wide_in + in.padded)), total(kTaps * wide_in * wide_out);
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
        // The strip before ended with the row that this one begins with.
        for (int a = 0; a < 2; ++a) std::swap(rows[a][0], rows[a][kRows - 1]);
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
        for (int t = 0; t < kTaps; t += narrow ? 3 : 1) {
          const Element* b[kStrip];
          for (int i = 0; i < count; ++i) b[i] = source[t / 9][2 * i + t / 3 % 3];
          Fine::AddTerms(count, left.data(), left_size, b, t % 3, high, wide_in, deep, wide_out,
                         total.data() + t * wide_in * wide_out);
        }
        for (int i = 0; i < count; ++i) {
          const Element *a[kTaps], *b[kTaps];
          for (int t = 0; t < kTaps; ++t) {
            a[t] = source[t / 9][2 * i + t / 3 % 3] + t % 3 * deep;
            b[t] = weight.data() + t * deep * wide_in;
          }
          Product::Multiply(kTaps, a, 2 * deep, b, high, RoundUp(s.cout, Product::kDepth), wide_in,
                            sum.data(), wide_in);
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
      const int64_t place = narrow ? t / 3 * 3 * wide_in * wide_out + t % 3 * s.cout
                                   : t * wide_in * wide_out;
      Unpad(total.data() + place, wide_out, s.cin, s.cout,
            dw + (sample * kTaps + t) * s.cin * s.cout);
    }
  });
}

}  // namespace cvn

#endif  // CVN_DECONV_GRADIENT_H_
