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

// Calls f(Tiles or Vectors): tiles for volumes of bfloat16, where the processor has them.
template <typename T, typename F>
void WithProducts(const F& f) {
#if CVN_TILES
  if constexpr (std::is_same_v<T, Bf16>) {
    if (TilesAllowed()) return f(Tiles());
  }
#endif
  f(Vectors());
}

}  // namespace cvn

#endif  // CVN_PRODUCTS_H_
