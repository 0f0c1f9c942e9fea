// Matrix products of rows in the nearest cache: rows of C = sum over taps of rows of A_tap times
// B_tap, in vectors of float32, in vectors of bfloat16 pairs (AVX-512 BF16), or on tile units of
// bfloat16 (AMX).
//
// Each comes as a struct of the same form, so that a kernel is written once:
//   Element        the type of the elements of A and B;
//   kRows, kDepth  the numbers that counts of rows and of factors are rounded up to;
//   Session        exists while a thread multiplies;
//   Pack           makes B, [k][n] floats, k `k_stride` and n `n_stride` apart;
//   Multiply       C = ..., for `rows`, `k` and `n` that are rounded up.

#ifndef CVN_PRODUCTS_H_
#define CVN_PRODUCTS_H_

#include "blocks.h"
#include "tiles.h"

namespace cvn {

struct Vectors {
  using Element = float;
  static constexpr int64_t kRows = 1, kDepth = 1;
  struct Session {
    ~Session() {}
  };

  static void Pack(const float* from, int64_t k_stride, int64_t n_stride, int64_t k, int64_t n,
                   float* to) {
    for (int64_t i = 0; i < k; ++i) {
      for (int64_t j = 0; j < n; ++j) {
        to[i * RoundUp(n, kLanes) + j] = from[i * k_stride + j * n_stride];
      }
    }
  }

  static void Multiply(int taps, const float* const* a, int64_t a_stride, const float* const* b,
                       int64_t rows, int64_t k, int64_t n, float* c, int64_t c_stride) {
    MultiplyRows<Floats>(taps, a, a_stride, b, rows, k, n, c, c_stride);
  }
};

#if CVN_PAIRS

// Pairs of bfloat16 along the sum's axis stand together, in words.
struct Pairs {
  using Element = Bf16;
  static constexpr int64_t kRows = 1, kDepth = 2;
  struct Session {
    ~Session() {}
  };

  static void Pack(const float* from, int64_t k_stride, int64_t n_stride, int64_t k, int64_t n,
                   Bf16* to) {
    for (int64_t i = 0; i < k; ++i) {
      for (int64_t j = 0; j < n; ++j) {
        to[(i / 2 * RoundUp(n, kLanes) + j) * 2 + i % 2] = ToBf16(from[i * k_stride + j * n_stride]);
      }
    }
  }

  static void Multiply(int taps, const Bf16* const* a, int64_t a_stride, const Bf16* const* b,
                       int64_t rows, int64_t k, int64_t n, float* c, int64_t c_stride) {
    const Word *left[kMaxTaps], *right[kMaxTaps];
    AsWords(taps, a, left);
    AsWords(taps, b, right);
    MultiplyRows<Bf16Pairs>(taps, left, a_stride / 2, right, rows, k / 2, n, c, c_stride);
  }

  // C [m][n] += the sum over `count` factors of A^T B, both rows of words; strides are in words.
  static void AddOuter(int count, const Bf16* const* a, int64_t a_stride, const Bf16* const* b,
                       int64_t b_stride, int64_t k, int64_t m, int64_t n, float* c) {
    const Word *left[kMaxTaps], *right[kMaxTaps];
    AsWords(count, a, left);
    AsWords(count, b, right);
    cvn::AddOuter<Bf16Pairs>(count, left, a_stride, right, b_stride, k, m, n, c, n);
  }

  // Two rows of n numbers as one row of words; n is a multiple of kLanes.
  template <typename T>
  static void Join(const T* first, const T* second, int64_t n, Bf16* to) {
    for (int64_t i = 0; i < n; i += kLanes) {
      const Words words = Bits(first + i) | Bits(second + i) << 16;
      std::memcpy(to + 2 * i, &words, sizeof words);
    }
  }

 private:
  static CVN_INLINE void AsWords(int count, const Bf16* const* from, const Word** to) {
    for (int i = 0; i < count; ++i) to[i] = reinterpret_cast<const Word*>(from[i]);
  }
  static CVN_INLINE Words Bits(const Bf16* p) {
    return __builtin_convertvector(*reinterpret_cast<const Halves*>(p), Words);
  }
  static CVN_INLINE Words Bits(const float* p) {
    Bf16 rounded[kLanes];
    Store(rounded, Load(p));
    return Bits(rounded);
  }
};

#endif

// Calls f(Tiles, Pairs or Vectors): the best that the processor has for volumes of T.
template <typename T, typename F>
void WithProducts(const F& f) {
  if constexpr (std::is_same_v<T, Bf16>) {
#if CVN_TILES
    if (TilesAllowed()) return f(Tiles());
#endif
#if CVN_PAIRS
    return f(Pairs());
#endif
  }
  f(Vectors());
}

// The same for a convolution to a few channels, which has no program for pairs.
template <typename T, typename F>
void WithConvProducts(const F& f) {
  WithProducts<T>([&](auto product) {
    if constexpr (std::is_same_v<typename decltype(product)::Element, float>) return f(product);
#if CVN_TILES
    if constexpr (std::is_same_v<decltype(product), Tiles>) return f(product);
#endif
    f(Vectors());
  });
}

}  // namespace cvn

#endif  // CVN_PRODUCTS_H_
