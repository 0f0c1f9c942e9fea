// The 3x3x3 convolution of f(gain x + offset) to a few channels: along one axis,
// o[v] += z[v + t - 1] w[t].

#ifndef CVN_CONV_H_
#define CVN_CONV_H_

#include "deconv.h"

namespace cvn {

template <int... kIndex>
Vec AddNeighbours(Vec a, Vec b, std::integer_sequence<int, kIndex...>) {
#if defined(__clang__) || __GNUC__ >= 12
  return __builtin_shufflevector(a, b, 2 * kIndex...) +
         __builtin_shufflevector(a, b, (2 * kIndex + 1)...);
#else
  const Ints even = {2 * kIndex...}, odd = {2 * kIndex + 1 ...};
  return __builtin_shuffle(a, b, even) + __builtin_shuffle(a, b, odd);
#endif
}

// The sums of kLanes vectors' lanes, as one vector.
CVN_INLINE Vec SumLanes(Vec* v) {
#pragma GCC unroll 8
  for (int64_t n = kLanes; n > 1; n /= 2) {
#pragma GCC unroll 16
    for (int64_t i = 0; i < n / 2; ++i) {
      v[i] = AddNeighbours(v[2 * i], v[2 * i + 1], std::make_integer_sequence<int, kLanes>());
    }
  }
  return v[0];
}

constexpr int64_t kVoxels = kRegisters / 2;  // whose sums are made at once

// kVoxels voxels of one output, to `to`: `from` are the taps' rows, `weight` is [27][wide].
template <typename Width>
void Convolve(const float* const* from, const float* weight, Width wide, float* to) {
  Vec sum[kVoxels] = {};
  for (int t = 0; t < kTaps; ++t) {
    const float* row = from[t];
    for (int64_t c = 0; c < wide; c += kLanes) {
      const Vec factor = Load(weight + t * wide + c);
#pragma GCC unroll 16
      for (int64_t i = 0; i < kVoxels; ++i) sum[i] += Load(row + i * wide + c) * factor;
    }
  }
#pragma GCC unroll 16
  for (int64_t i = 0; i < kVoxels; i += kLanes) Store(to + i, SumLanes(sum + i));
}

// What makes planes of the output: each for one kind of products.
template <typename Product>
class Convolution;

template <>
class Convolution<Vectors> {
 public:
  Convolution(const Volume& s, const float* w)
      : s_(s), wide_(RoundUp(s.cin, kLanes)), weight_(s.cout * kTaps * wide_) {
    for (int64_t t = 0; t < kTaps; ++t) {
      for (int64_t i = 0; i < s.cin; ++i) {
        for (int64_t o = 0; o < s.cout; ++o) {
          weight_[(o * kTaps + t) * wide_ + i] = w[(t * s.cin + i) * s.cout + o];
        }
      }
    }
  }

  // Of a plane's buffer, whose rows and voxels have a margin of one.
  int64_t padded() const { return wide_; }
  int64_t row_size() const { return (RoundUp(s_.z, kVoxels) + 2) * wide_; }
  int64_t rows() const { return s_.y + 2; }

  // Three planes -> [y][z][out].
  void Plane(const float* const* planes, float* out) const {
    // Along y first: two thirds of what a voxel reads is then in the nearest cache.
    for (int64_t z = 0; z < s_.z; z += kVoxels) {
      for (int64_t y = 0; y < s_.y; ++y) {
        const float* from[kTaps];
        for (int t = 0; t < kTaps; ++t) {
          from[t] = planes[t / 9] + (y + t / 3 % 3) * row_size() + (z + t % 3) * wide_;
        }
        float* to = out + (y * s_.z + z) * s_.cout;
        for (int64_t o = 0; o < s_.cout; ++o) {
          const float* weight = weight_.data() + o * kTaps * wide_;
          float sums[kVoxels];
          WithChannels(wide_, [&](auto wide) { Convolve(from, weight, wide, sums); });
          for (int64_t i = 0; i < std::min(kVoxels, s_.z - z); ++i) to[i * s_.cout + o] = sums[i];
        }
      }
    }
  }

 private:
  const Volume& s_;
  const int64_t wide_;
  Scratch<float> weight_;  // [out][27][in]
};

#if CVN_TILES

// A product gives what a voxel contributes to some rows of outputs and to the voxel before, its own
// and the one behind; these three are added in the end.
template <>
class Convolution<Tiles> {
 public:
  Convolution(const Volume& s, const float* w)
      : s_(s),
        deep_(RoundUp(s.cin, kTileDepth)),
        strip_(std::max<int64_t>(kLanes / (3 * s.cout), 1)),
        wide_(RoundUp(strip_ * 3 * s.cout, kLanes)),
        weight_(3 * (strip_ + 2) * deep_ * wide_) {
    for (int64_t n = 0; n < 3 * (strip_ + 2); ++n) {  // plane, and row from that before the strip
      Scratch<float> dense(s.cin * wide_);
      for (int64_t row = 0; row < strip_; ++row) {
        const int64_t y = n % (strip_ + 2) - row;
        if (y < 0 || y > 2) continue;
        for (int64_t z = 0; z < 3; ++z) {
          const float* from = w + ((n / (strip_ + 2) * 3 + y) * 3 + z) * s.cin * s.cout;
          for (int64_t i = 0; i < s.cin * s.cout; ++i) {
            dense[i / s.cout * wide_ + (row * 3 + z) * s.cout + i % s.cout] = from[i];
          }
        }
      }
      Tiles::Pack(dense.data(), wide_, 1, s.cin, wide_, weight_.data() + n * deep_ * wide_);
    }
  }

  int64_t padded() const { return deep_; }
  int64_t row_size() const { return (RoundUp(s_.z, kTileRows) + 2) * deep_; }
  int64_t rows() const { return RoundUp(s_.y, strip_) + 2; }

  void Plane(const Bf16* const* planes, float* out) const {
    const int64_t high = RoundUp(s_.z, kTileRows), taps = 3 * (strip_ + 2);
    Scratch<float> given((high + 2) * wide_);  // a voxel before the first and behind the last
    for (int64_t y = 0; y < s_.y; y += strip_) {
      const Bf16 *a[kMaxTaps], *b[kMaxTaps];
      for (int64_t n = 0; n < taps; ++n) {
        a[n] = planes[n / (strip_ + 2)] + (y + n % (strip_ + 2)) * row_size() + deep_;
        b[n] = weight_.data() + n * deep_ * wide_;
      }
      TileMultiply<false>(taps, a, deep_, b, high, deep_, wide_, given.data() + wide_, wide_);
      for (int64_t row = 0; row < std::min(strip_, s_.y - y); ++row) {
        float* to = out + (y + row) * s_.z * s_.cout;
        const float* from = given.data() + row * 3 * s_.cout;
        for (int64_t z = 0; z < s_.z; ++z, from += wide_) {
          for (int64_t o = 0; o < s_.cout; ++o) {
            to[z * s_.cout + o] = from[o] + from[wide_ + s_.cout + o] +
                                  from[2 * (wide_ + s_.cout) + o];
          }
        }
      }
    }
  }

 private:
  const Volume& s_;
  const int64_t deep_, strip_, wide_;
  Scratch<Bf16> weight_;
};

#endif  // CVN_TILES

constexpr int64_t kConvSlab = 16;  // planes done in a row, which share their neighbours' copies

// `sums` is [B, 2, out]: of the output and of its square.
template <typename Product, typename In>
void ConvRows(const Volume& s, const Source<In>& in, const float* w, ffi::ThreadPool& pool,
              float* out, float* sums) {
  using Element = typename Product::Element;
  Scratch<float> rounded = RoundedWeights<In>(w, kTaps * s.cin * s.cout);
  const Convolution<Product> convolution(s, rounded.data());
  const int64_t padded = convolution.padded(), row_size = convolution.row_size();
  const int64_t slabs = (s.x + kConvSlab - 1) / kConvSlab, size = convolution.rows() * row_size;
  Scratch<double> parts(s.b * slabs * 2 * s.cout);
  ParallelFor(pool, s.b * slabs, [&](int64_t item) {
    typename Product::Session session;
    const int64_t sample = item / slabs, first = item % slabs * kConvSlab;
    const int64_t last = std::min(first + kConvSlab, s.x), plane_size = s.y * s.z * s.cout;
    Scratch<Element> buffer(4 * size);  // the last plane stays zero
    Scratch<float> scratch(in.padded);
    Sums moments(s.cout);
    const auto plane_at = [&](int64_t x) {
      return buffer.data() + (x < 0 || x >= s.x ? 3 : x % 3) * size;
    };
    const auto fill = [&](int64_t x) {
      if (x < 0 || x >= s.x) return;
      for (int64_t y = 0; y < s.y; ++y) {
        in.Row((sample * s.x + x) * s.y + y, padded, scratch.data(),
               plane_at(x) + (y + 1) * row_size + padded);
      }
    };
    fill(first - 1);
    fill(first);
    for (int64_t x = first; x < last; ++x) {
      fill(x + 1);
      const Element* const planes[3] = {plane_at(x - 1), plane_at(x), plane_at(x + 1)};
      float* to = out + (sample * s.x + x) * plane_size;
      convolution.Plane(planes, to);
      moments.AddRun(to, plane_size);
    }
    std::copy_n(moments.data(), 2 * s.cout, parts.data() + item * 2 * s.cout);
  });
  AddParts(parts.data(), s.b, slabs, 2 * s.cout, sums);
}

}  // namespace cvn

#endif  // CVN_CONV_H_
