// The gradients of conv.h's convolution.

#ifndef CVN_CONV_GRADIENT_H_
#define CVN_CONV_GRADIENT_H_

#include "deconv_gradient.h"

namespace cvn {

// What a block of voxels gets from all taps, whose rows are `from`; `weight` is [taps][wide].
template <int kRows, int kVecs>
void Spread(int64_t taps, const float* const* from, int64_t at, const float* weight, int64_t wide,
            float* to) {
  Vec sum[kRows][kVecs] = {};
  for (int64_t n = 0; n < taps; ++n, weight += wide) {
    const float* left = from[n] + at;
    Vec right[kVecs];
#pragma GCC unroll 8
    for (int v = 0; v < kVecs; ++v) right[v] = Load(weight + v * kLanes);
#pragma GCC unroll 16
    for (int m = 0; m < kRows; ++m) {
#pragma GCC unroll 8
      for (int v = 0; v < kVecs; ++v) sum[m][v] += left[m] * right[v];
    }
  }
  for (int m = 0; m < kRows; ++m) {
    for (int v = 0; v < kVecs; ++v) Store(to + m * wide + v * kLanes, sum[m][v]);
  }
}

// One block of a kernel's gradient: adds the products of all voxels' values with what each tap's
// row holds there.
template <int kRows, int kVecs>
void AddTaps(const float* const* from, const float* values, int64_t wide, int64_t voxels,
             float* total) {
  Vec sum[kRows][kVecs];
  for (int m = 0; m < kRows; ++m) {
    for (int v = 0; v < kVecs; ++v) sum[m][v] = Load(total + m * wide + v * kLanes);
  }
  const float* rows[kRows];
  for (int m = 0; m < kRows; ++m) rows[m] = from[m];
  for (int64_t z = 0; z < voxels; ++z, values += wide) {
    Vec right[kVecs];
#pragma GCC unroll 8
    for (int v = 0; v < kVecs; ++v) right[v] = Load(values + v * kLanes);
#pragma GCC unroll 16
    for (int m = 0; m < kRows; ++m) {
#pragma GCC unroll 8
      for (int v = 0; v < kVecs; ++v) sum[m][v] += rows[m][z] * right[v];
    }
  }
  for (int m = 0; m < kRows; ++m) {
    for (int v = 0; v < kVecs; ++v) Store(total + m * wide + v * kLanes, sum[m][v]);
  }
}

// What makes the gradients of rows of the input, for one kind of products each. Planes of the
// output's gradient are brought into its form row by row; the kernel's gradient is summed in its
// form, too.
template <typename Product>
class ConvolutionGradient;

template <>
class ConvolutionGradient<Vectors> {
 public:
  ConvolutionGradient(const Volume& s, const float* w)
      : s_(s), wide_(RoundUp(s.cin, kLanes)), taps_(s.cout * kTaps), weight_(taps_ * wide_) {
    for (int64_t t = 0; t < kTaps; ++t) {
      for (int64_t i = 0; i < s.cin; ++i) {
        for (int64_t o = 0; o < s.cout; ++o) {
          weight_[(o * kTaps + t) * wide_ + i] = w[(t * s.cin + i) * s.cout + o];
        }
      }
    }
  }

  // A plane is [out][y + 1][z + 1], with a margin of zeros.
  int64_t plane_size() const { return s_.cout * layer(); }
  void PutRow(const float* row, int64_t y, float* plane) const {
    for (int64_t o = 0; o < s_.cout; ++o) {
      float* to = plane + o * layer() + (y + 1) * row_size() + 1;
      for (int64_t z = 0; z < s_.z; ++z) to[z] = row[z * s_.cout + o];
    }
  }

  // [z][in] for a row, from the planes before, at and behind its own.
  void Input(const float* const* planes, int64_t y, float* scratch, float* da) const {
    const auto from = Rows(planes, y);
    ForBlocks(s_.z, wide_, [&](int64_t z, int64_t c, auto rows, auto vecs) {
      Spread<rows, vecs>(taps_, from.data(), z, weight_.data() + c, wide_, scratch + z * wide_ + c);
    });
    Unpad(scratch, wide_, s_.z, s_.cin, da);
  }
  int64_t scratch_size() const { return s_.z * wide_; }

  // A row of the input as AddTerms takes it: [z][wide].
  int64_t value_size() const { return s_.z * wide_; }
  void PutValue(const float* value, float* to) const { Pad(value, s_.z, s_.cin, wide_, to); }

  // The total is [out][27][wide].
  int64_t total_size() const { return taps_ * wide_; }
  int64_t TotalAt(int64_t tap, int64_t o) const { return (o * kTaps + tap) * wide_; }
  void AddTerms(const float* const* planes, int64_t y, int count, const float* values,
                float* total) const {
    for (int row = 0; row < count; ++row, values += value_size()) {
      const auto from = Rows(planes, y + row);
      ForBlocks(taps_, wide_, [&](int64_t n, int64_t c, auto rows, auto vecs) {
        AddTaps<rows, vecs>(from.data() + n, values + c, wide_, s_.z, total + n * wide_ + c);
      });
    }
  }

 private:
  int64_t row_size() const { return s_.z + 2; }
  int64_t layer() const { return (s_.y + 2) * row_size(); }

  // Where each tap of each output finds what a row gave to.
  std::vector<const float*> Rows(const float* const* planes, int64_t y) const {
    std::vector<const float*> from(taps_);
    for (int64_t n = 0; n < taps_; ++n) {
      const int64_t o = n / kTaps, t = n % kTaps;
      from[n] = planes[2 - t / 9] + o * layer() + (y + 2 - t / 3 % 3) * row_size() + 2 - t % 3;
    }
    return from;
  }

  const Volume& s_;
  const int64_t wide_, taps_;
  Scratch<float> weight_;  // [out][27][wide]
};

#if CVN_TILES

template <>
class ConvolutionGradient<Tiles> {
 public:
  ConvolutionGradient(const Volume& s, const float* w)
      : s_(s),
        strip_(std::max<int64_t>(kTileDepth / (3 * s.cout) - 2, 1)),
        near_(9 * s.cout),
        wide_(RoundUp(s.cin, kLanes)),
        deep_(RoundUp((strip_ + 2) * 3 * s.cout, kTileDepth)),
        long_z_(RoundUp(s.z, kTileDepth)),
        weight_(3 * strip_ * deep_ * wide_) {
    for (int64_t n = 0; n < 3 * strip_; ++n) {  // plane, and row of a strip
      Scratch<float> dense(deep_ * s.cin);
      for (int64_t k = 0; k < near_; ++k) {
        const int64_t tap = ((2 - n / strip_) * 3 + 2 - k / s.cout / 3) * 3 + 2 - k % 3;
        const int64_t o = k / 3 % s.cout;
        for (int64_t i = 0; i < s.cin; ++i) {
          dense[(n % strip_ * 3 * s.cout + k) * s.cin + i] = w[(tap * s.cin + i) * s.cout + o];
        }
      }
      Tiles::Pack(dense.data(), s.cin, 1, deep_, s.cin, weight_.data() + n * deep_ * wide_);
    }
  }

  // A plane has two forms, both with rows of zeros before and behind. First [y][out][3][z], where
  // the three are moved by a voxel against each other. Second [strip][z][deep]: what the voxels of
  // a strip's rows receive from, which is [y][out][3].
  int64_t plane_size() const { return Second() + strips() * high() * deep_; }
  void PutRow(const float* row, int64_t y, Bf16* plane) const {
    for (int64_t o = 0; o < s_.cout; ++o) {
      Bf16* first = plane + ((y + 1) * s_.cout + o) * 3 * long_z_;
      for (int64_t i = 0; i < 3; ++i) {
        for (int64_t z = std::max<int64_t>(1 - i, 0); z < std::min(s_.z, s_.z + 1 - i); ++z) {
          first[i * long_z_ + z] = ToBf16(row[(z - 1 + i) * s_.cout + o]);
        }
      }
      for (int64_t n = (y + 1) / strip_; n >= 0 && y + 1 < n * strip_ + strip_ + 2; --n) {
        if (n >= strips()) continue;
        Bf16* to = plane + Second() + n * high() * deep_ + ((y + 1 - n * strip_) * s_.cout + o) * 3;
        for (int64_t z = 0; z < s_.z; ++z) {
          for (int64_t i = 0; i < 3; ++i) to[z * deep_ + i] = first[i * long_z_ + z];
        }
      }
    }
  }

  void Input(const Bf16* const* planes, int64_t y, float* scratch, float* da) const {
    const Bf16 *a[3], *b[3];
    for (int64_t x = 0; x < 3; ++x) {
      a[x] = planes[x] + Second() + y / strip_ * high() * deep_;
      b[x] = weight_.data() + (x * strip_ + y % strip_) * deep_ * wide_;
    }
    TileMultiply<false>(3, a, deep_, b, high(), deep_, wide_, scratch, wide_);
    Unpad(scratch, wide_, s_.z, s_.cin, da);
  }
  int64_t scratch_size() const { return high() * wide_; }

  // Tiles of pairs of voxels.
  int64_t value_size() const { return long_z_ * wide_; }
  void PutValue(const float* value, Bf16* to) const {
    const int64_t column = long_z_ / kTileDepth * kTileSize;
    for (int64_t z = 0; z < s_.z; z += 2) {
      const float* first = value + z * s_.cin;
      InterleavePair(first, first + s_.cin, wide_, column, to + z / 2 * kTileDepth);
    }
  }

  // The total is [3 (x)][near, rounded up][wide].
  int64_t total_size() const { return 3 * RoundUp(near_, kTileRows) * wide_; }
  int64_t TotalAt(int64_t tap, int64_t o) const {
    const int64_t x = 2 - tap / 9, y = 2 - tap / 3 % 3, z = 2 - tap % 3;
    return (x * RoundUp(near_, kTileRows) + (y * s_.cout + o) * 3 + z) * wide_;
  }
  void AddTerms(const Bf16* const* planes, int64_t y, int count, const Bf16* values,
                float* total) const {
    for (int64_t x = 0; x < 3; ++x) {
      const Bf16 *a[kMaxTaps], *b[kMaxTaps];
      for (int i = 0; i < count; ++i) {
        a[i] = planes[x] + (y + i) * 3 * s_.cout * long_z_;
        b[i] = values + i * value_size();
      }
      const int64_t high = RoundUp(near_, kTileRows);
      TileMultiply<true>(count, a, long_z_, b, high, long_z_, wide_, total + x * high * wide_,
                         wide_);
    }
  }

 private:
  int64_t high() const { return RoundUp(s_.z, kTileRows); }
  int64_t strips() const { return (s_.y + strip_ - 1) / strip_; }
  int64_t Second() const {  // of the first, more rows are read than there are
    return ((s_.y + 2) * s_.cout * 3 + kTileRows) * long_z_;
  }

  const Volume& s_;
  const int64_t strip_, near_, wide_, deep_, long_z_;
  Scratch<Bf16> weight_;
};

#endif  // CVN_TILES

// The gradients of input, gain and offset (`sums`, see Source), and kernel; `dw` is
// [B, out, 27, in].
template <typename Product, typename In>
void ConvGradients(const Volume& s, const Source<In>& in, const float* w,
                   const Cotangent<float>& cotangent, ffi::ThreadPool& pool, In* dx, float* sums,
                   float* dw) {
  using Element = typename Product::Element;
  Scratch<float> rounded = RoundedWeights<In>(w, kTaps * s.cin * s.cout);
  const ConvolutionGradient<Product> gradient(s, rounded.data());
  ParallelFor(pool, s.b, [&](int64_t sample) {
    typename Product::Session session;
    const int64_t size = gradient.plane_size();
    Scratch<Element> buffer(4 * size), values(kStrip * gradient.value_size());
    Scratch<float> row(cotangent.padded), scratch(gradient.scratch_size()), da(in.padded);
    Scratch<float> value(in.padded + 2 * kLanes), places(2 * in.padded);
    Scratch<float> total(gradient.total_size());
    Sums moments(s.cin);
    const auto plane_at = [&](int64_t x) {
      return buffer.data() + (x < 0 || x >= s.x ? 3 : x % 3) * size;  // the last stays zero
    };
    const auto fill = [&](int64_t x) {
      if (x < 0 || x >= s.x) return;
      for (int64_t y = 0; y < s.y; ++y) {
        cotangent.Row((sample * s.x + x) * s.y + y, row.data());
        RoundRow<In, float>(row.data(), cotangent.size);
        gradient.PutRow(row.data(), y, plane_at(x));
      }
    };
    fill(0);
    for (int64_t x = 0; x < s.x; ++x) {
      fill(x + 1);
      const Element* const planes[3] = {plane_at(x - 1), plane_at(x), plane_at(x + 1)};
      for (int64_t y = 0; y < s.y; y += kStrip) {
        const int count = static_cast<int>(std::min<int64_t>(kStrip, s.y - y));
        for (int i = 0; i < count; ++i) {
          gradient.Input(planes, y + i, scratch.data(), da.data());
          in.Gradient((sample * s.x + x) * s.y + y + i, da.data(), places.data(), dx,
                      value.data());
          RoundRow<In, Element>(value.data(), in.size);
          gradient.PutValue(value.data(), values.data() + i * gradient.value_size());
        }
        gradient.AddTerms(planes, y, count, values.data(), total.data());
      }
      moments.AddTwo(places.data(), in.size, in.padded);
    }
    moments.CopyTo(sums + sample * 2 * s.cin);
    for (int64_t o = 0; o < s.cout; ++o) {
      for (int64_t t = 0; t < kTaps; ++t) {
        std::copy_n(total.data() + gradient.TotalAt(t, o), s.cin,
                    dw + ((sample * s.cout + o) * kTaps + t) * s.cin);
      }
    }
  });
}

}  // namespace cvn

#endif  // CVN_CONV_GRADIENT_H_
