// What happens to a row of a volume, [z][channels], on its way between memory and a product: batch
// normalisation and the activation after it, and their derivatives.
//
// A volume is kept as the product before it left it. Its next reader takes f(gain x + offset),
// by channel. Vectors of channels are repeated over a row, so that a row is one run of floats.

#ifndef CVN_ROWS_H_
#define CVN_ROWS_H_

#include "common.h"

namespace cvn {

enum Activation : int64_t { kIdentity = 0, kElu = 1, kSigmoid = 2 };

CVN_INLINE Vec Larger(Vec a, Vec b) { return a > b ? a : b; }
CVN_INLINE Vec Smaller(Vec a, Vec b) { return a < b ? a : b; }

// e^x for x from -87 to 88, within 2e-7 of it near 0 and 2e-6 at the ends: 2^n 2^r, |r| <= 1/2.
CVN_INLINE Vec Exp(Vec x) {
  const float kShift = 12582912.0f, kLog2E = 1.44269504f;  // 1.5 2^23: adding it rounds
  const Vec shifted = x * kLog2E + kShift;
  const Vec r = x * kLog2E - (shifted - kShift);
  Vec p = r * 0.0013264727f + 0.009671513f;  // the polynomial that errs by 9e-8 at most
  p = p * r + 0.055507336f;
  p = p * r + 0.24022242f;
  p = p * r + 0.6931470f;
  p = p * r + 1.0f;
  const Ints power = reinterpret_cast<Ints>(shifted) << 23;  // n in the lowest bits
  return reinterpret_cast<Vec>(reinterpret_cast<Ints>(p) + power);
}

// Value and slope of an activation.
template <Activation kActivation>
CVN_INLINE void Activate(Vec v, Vec* value, Vec* slope) {
  const Vec one = Vec{} + 1.0f;
  if constexpr (kActivation == kElu) {
    const Vec e = Exp(Larger(Smaller(v, Vec{}), Vec{} - 87.0f));
    *value = Larger(v, Vec{}) + (e - one);
    *slope = e;  // 1 above 0
  } else if constexpr (kActivation == kSigmoid) {
    *value = one / (one + Exp(Larger(Smaller(-v, Vec{} + 88.0f), Vec{} - 87.0f)));
    *slope = *value * (one - *value);
  } else {
    *value = v;
    *slope = one;
  }
}

template <typename F>
CVN_INLINE void WithActivation(int64_t activation, const F& f) {
  switch (activation) {
    case kElu: return f(std::integral_constant<Activation, kElu>());
    case kSigmoid: return f(std::integral_constant<Activation, kSigmoid>());
    default: return f(std::integral_constant<Activation, kIdentity>());
  }
}

// Factors that belong to a volume of T, where they are kept as To.
template <typename T, typename To>
void RoundRow(float* row, int64_t n) {
  if constexpr (std::is_same_v<T, Bf16> && std::is_same_v<To, float>) {
    for (int64_t i = 0; i < n; ++i) row[i] = Rounded<T>(row[i]);
  }
}

// A value for each channel, over a row of n floats.
inline Scratch<float> Repeat(const float* values, int64_t channels, int64_t n) {
  Scratch<float> repeated(n);
  for (int64_t i = 0; i < n; ++i) repeated[i] = values[i % channels];
  return repeated;
}

// A volume [..., z, channels] as its reader takes it.
template <typename T>
class Source {
 public:
  Source(const T* x, const float* gain, const float* offset, int64_t activation, int64_t z,
         int64_t channels)
      : size(z * channels),
        padded(RoundUp(size, kLanes)),
        z(z),
        channels(channels),
        x_(x),
        gain_(Repeat(gain, channels, size)),
        offset_(Repeat(offset, channels, size)),
        activation_(activation) {}

  // f(gain x + offset) of a row.
  void Row(int64_t row, float* to) const {
    const T* x = x_ + row * size;
    const float *gain = gain_.data(), *offset = offset_.data();
    WithActivation(activation_, [&](auto kind) {
      for (int64_t i = 0; i < size; i += kLanes) {
        PrefetchAfter(x + i);
        Vec value, slope;
        const Vec v = LoadSome(x + i, size - i);
        Activate<kind>(v * Load(gain + i) + Load(offset + i), &value, &slope);
        Store(to + i, value);
      }
    });
  }

  // The same as a factor of a product, [z][padded].
  template <typename To>
  void Row(int64_t row, int64_t padded, float* scratch, To* to) const {
    if constexpr (std::is_same_v<T, float> && std::is_same_v<To, float>) {
      if (padded == channels && size % kLanes == 0) return Row(row, to);
    }
    Row(row, scratch);
    RoundRow<T, To>(scratch, size);
    Pad(scratch, z, channels, padded, to);
  }

  // The gradient with respect to x, dx = gain dz, for dz = da f'(gain x + offset); `sums`
  // [2][padded] get dz and dz x added. `value`, where it is not null, gets f(gain x + offset).
  void Gradient(int64_t row, const float* da, float* sums, T* dx, float* value_to) const {
    const T* x = x_ + row * size;
    const float *gain = gain_.data(), *offset = offset_.data();
    dx += row * size;
    WithActivation(activation_, [&](auto kind) {
      for (int64_t i = 0; i < size; i += kLanes) {
        PrefetchAfter(x + i);
        const Vec v = LoadSome(x + i, size - i), g = Load(gain + i);
        Vec value, slope;
        Activate<kind>(v * g + Load(offset + i), &value, &slope);
        const Vec dz = Load(da + i) * slope;
        Store(sums + i, Load(sums + i) + dz);
        Store(sums + padded + i, Load(sums + padded + i) + dz * v);
        StoreSome(dx + i, dz * g, size - i);
        if (value_to) Store(value_to + i, value);
      }
    });
  }

  const int64_t size, padded;  // floats of a row, and those of its vectors

 private:
  const int64_t z, channels;
  const T* x_;
  const Scratch<float> gain_, offset_;
  const int64_t activation_;
};

// The whole gradient with respect to a product's result y: what came back for it, dy, and for the
// sums of y and y^2 over all places, by channel.
template <typename T>
class Cotangent {
 public:
  Cotangent(const T* y, const T* dy, const float* dsums, int64_t z, int64_t channels)
      : size(z * channels),
        padded(RoundUp(size, kLanes)),
        z_(z),
        channels_(channels),
        y_(y),
        dy_(dy),
        first_(Repeat(dsums, channels, size)),
        second_(Repeat(dsums + channels, channels, size)) {
    for (int64_t i = 0; i < size; ++i) second_[i] *= 2;
  }

  void Row(int64_t row, float* to) const {
    const T *y = y_ + row * size, *dy = dy_ + row * size;
    const float *first = first_.data(), *second = second_.data();
    for (int64_t i = 0; i < size; i += kLanes) {
      PrefetchAfter(y + i);
      PrefetchAfter(dy + i);
      const int64_t n = size - i;
      Store(to + i, LoadSome(dy + i, n) + Load(first + i) + Load(second + i) * LoadSome(y + i, n));
    }
  }

  // The same as a factor of a product with a volume of In, [z][padded].
  template <typename In, typename To>
  void Row(int64_t row, int64_t padded, float* scratch, To* to) const {
    Row(row, scratch);
    RoundRow<In, To>(scratch, size);
    Pad(scratch, z_, channels_, padded, to);
  }

  const int64_t size, padded;  // floats of a row, and those of its vectors

 private:
  const int64_t z_, channels_;
  const T *y_, *dy_;
  Scratch<float> first_, second_;
};

// Sums of numbers and of their squares, or of two kinds of numbers, by channel; over rows in doubl
class Sums {
 public:
  explicit Sums(int64_t channels) : channels_(channels), total_(2 * channels) {}

  // Numbers and squares of [rows][padded].
  void AddRow(const float* row, int64_t padded, int64_t rows) {
    for (int64_t c = 0; c < channels_; c += kLanes) {
      Vec first = {}, second = {};
      for (int64_t i = 0; i < rows; ++i) {
        const Vec v = Load(row + i * padded + c);
        first += v;
        second += v * v;
      }
      for (int64_t l = 0; l < std::min(kLanes, channels_ - c); ++l) {
        total_[c + l] += first[l];
        total_[channels_ + c + l] += second[l];
      }
    }
  }

  // Numbers and squares of a run of n, channel after channel.
  void AddRun(const float* run, int64_t n) {
    const int64_t period = kLanes * channels_, whole = n / period * period;
    for (int64_t v = 0; v < period; v += kLanes) {
      Vec first = {}, second = {};
      for (int64_t i = v; i < whole; i += period) {
        const Vec x = Load(run + i);
        first += x;
        second += x * x;
      }
      for (int64_t l = 0; l < kLanes; ++l) {
        total_[(v + l) % channels_] += first[l];
        total_[channels_ + (v + l) % channels_] += second[l];
      }
    }
    for (int64_t i = whole; i < n; ++i) {
      total_[i % channels_] += run[i];
      total_[channels_ + i % channels_] += double{run[i]} * run[i];
    }
  }

  // The first `size` of each of [2][padded], which become zero.
  void AddTwo(float* sums, int64_t size, int64_t padded) {
    for (int64_t i = 0; i < size; ++i) {
      total_[i % channels_] += sums[i];
      total_[channels_ + i % channels_] += sums[padded + i];
    }
    std::fill(sums, sums + 2 * padded, 0.0f);
  }

  const double* data() const { return total_.data(); }
  void CopyTo(float* to) const {
    for (int64_t i = 0; i < 2 * channels_; ++i) to[i] = static_cast<float>(total_.data()[i]);
  }

 private:
  const int64_t channels_;
  Scratch<double> total_;
};

// Adds up [samples][parts][n] over the parts.
inline void AddParts(const double* parts, int64_t samples, int64_t count, int64_t n, float* to) {
  for (int64_t sample = 0; sample < samples; ++sample) {
    for (int64_t i = 0; i < n; ++i) {
      double sum = 0;
      for (int64_t p = 0; p < count; ++p) sum += parts[(sample * count + p) * n + i];
      to[sample * n + i] = static_cast<float>(sum);
    }
  }
}

}  // namespace cvn

#endif  // CVN_ROWS_H_
