// Blocks of a matrix product whose sums stay in registers, and how they cover a matrix.
//
// Factors are words of 32 bits: floats, or pairs of bfloat16 that one instruction multiplies and
// adds up (AVX-512 BF16). Rows of a matrix are counted in words.

#ifndef CVN_BLOCKS_H_
#define CVN_BLOCKS_H_

#include "common.h"

namespace cvn {

constexpr int kMaxTaps = kTaps;

struct Floats {
  static CVN_INLINE Vec Add(Vec sum, float left, Vec right) { return sum + left * right; }
};

#if CVN_PAIRS

struct Bf16Pairs {
  static CVN_INLINE Vec Add(Vec sum, float left, Vec right) {
    // A pair is no number: arithmetic, even adding zero, might flush it to zero.
#if CVN_LANES == 16
    return (Vec)_mm512_dpbf16_ps((__m512)sum, (__m512bh)_mm512_set1_ps(left), (__m512bh)right);
#else
    return (Vec)_mm256_dpbf16_ps((__m256)sum, (__m256bh)_mm256_set1_ps(left), (__m256bh)right);
#endif
  }
};

#endif

// The most rows of a block that is this many vectors wide: the sums, a row of the right side and a
// factor of the left side fill the registers.
constexpr int MostRows(int vecs) {
  return kLanes == 16 ? 16 / vecs : std::min<int>((kRegisters - 1 - vecs) / vecs, 12);
}

// How many vectors wide the next block is, where `vecs` are left: 1, 2, 3, 4 or 6.
constexpr int BlockWidth(int64_t vecs) {
  if (kLanes == 16) return vecs > 1 ? 2 : 1;
  if (kRegisters == 16) return vecs % 3 == 0 ? 3 : vecs > 1 ? 2 : 1;
  return vecs % 6 == 0 ? 6 : vecs == 5 ? 3 : vecs > 4 ? 4 : static_cast<int>(vecs);
}

// Calls f with an integer from 1 to kMost that the compiler knows.
template <int kMost, typename F>
CVN_INLINE void WithRows(int64_t rows, const F& f) {
  if constexpr (kMost > 1) {
    if (rows < kMost) return WithRows<kMost - 1>(rows, f);
  }
  f(std::integral_constant<int, kMost>());
}

// Calls f(first row, first column, rows, vectors) for blocks that cover a matrix of n columns, a
// multiple of kLanes. The compiler knows the size of each block; blocks are about equally high.
template <typename F>
CVN_INLINE void ForBlocks(int64_t rows, int64_t n, const F& f) {
  const auto panel = [&](int64_t j, auto vecs) {
    constexpr int kMost = MostRows(vecs);
    int64_t i = 0;
    for (int64_t left = (rows + kMost - 1) / kMost; left > 0; --left) {
      const int64_t high = (rows - i + left - 1) / left;
      WithRows<kMost>(high, [&](auto block_rows) { f(i, j, block_rows, vecs); });
      i += high;
    }
  };
  for (int64_t j = 0; j < n;) {
    const int width = BlockWidth((n - j) / kLanes);
    WithRows<6>(width, [&](auto vecs) {
      if constexpr (BlockWidth(vecs) == vecs) panel(j, vecs);
    });
    j += width * kLanes;
  }
}

// One block of C: the sum over taps of A_tap B_tap. A's rows are `a_stride` words apart, B is
// [k][b_stride].
template <typename Factors, int kRows, int kVecs>
void Block(int taps, const Word* const* a, int64_t a_at, int64_t a_stride, const Word* const* b,
           int64_t b_at, int64_t b_stride, int64_t k, float* c, int64_t c_stride) {
  Vec sum[kRows][kVecs] = {};
  for (int t = 0; t < taps; ++t) {
    const Word* row = a[t] + a_at;
    const Word* panel = b[t] + b_at;
    for (int64_t i = 0; i < k; ++i, panel += b_stride) {
      Vec right[kVecs];
#pragma GCC unroll 8
      for (int v = 0; v < kVecs; ++v) right[v] = LoadWords(panel + v * kLanes);
#pragma GCC unroll 16
      for (int m = 0; m < kRows; ++m) {
        const float left = row[m * a_stride + i];
#pragma GCC unroll 8
        for (int v = 0; v < kVecs; ++v) sum[m][v] = Factors::Add(sum[m][v], left, right[v]);
      }
    }
  }
  for (int m = 0; m < kRows; ++m) {
    for (int v = 0; v < kVecs; ++v) Store(c + m * c_stride + v * kLanes, sum[m][v]);
  }
}

// C [rows][n] = the sum over taps of A_tap B_tap; n is a multiple of kLanes.
template <typename Factors>
void MultiplyRows(int taps, const Word* const* a, int64_t a_stride, const Word* const* b,
                  int64_t rows, int64_t k, int64_t n, float* c, int64_t c_stride) {
  ForBlocks(rows, n, [&](int64_t i, int64_t j, auto high, auto vecs) {
    Block<Factors, high, vecs>(taps, a, i * a_stride, a_stride, b, j, n, k, c + i * c_stride + j,
                               c_stride);
  });
}

// One block of C += the sum over pairs of A^T B, for A [k][m] and B with rows `a_stride` and
// `b_stride` words apart.
template <typename Factors, int kRows, int kVecs>
void OuterBlock(int pairs, const Word* const* a, int64_t a_at, int64_t a_stride,
                const Word* const* b, int64_t b_at, int64_t b_stride, int64_t k, float* c,
                int64_t c_stride) {
  Vec sum[kRows][kVecs];
  for (int m = 0; m < kRows; ++m) {
    for (int v = 0; v < kVecs; ++v) sum[m][v] = Load(c + m * c_stride + v * kLanes);
  }
  for (int p = 0; p < pairs; ++p) {
    const Word *left = a[p] + a_at, *row = b[p] + b_at;
    for (int64_t i = 0; i < k; ++i, left += a_stride, row += b_stride) {
      Vec right[kVecs];
#pragma GCC unroll 8
      for (int v = 0; v < kVecs; ++v) right[v] = LoadWords(row + v * kLanes);
#pragma GCC unroll 16
      for (int m = 0; m < kRows; ++m) {
#pragma GCC unroll 8
        for (int v = 0; v < kVecs; ++v) sum[m][v] = Factors::Add(sum[m][v], left[m], right[v]);
      }
    }
  }
  for (int m = 0; m < kRows; ++m) {
    for (int v = 0; v < kVecs; ++v) Store(c + m * c_stride + v * kLanes, sum[m][v]);
  }
}

// C [m][n] += the sum over pairs of A^T B; n is a multiple of kLanes.
template <typename Factors>
void AddOuter(int pairs, const Word* const* a, int64_t a_stride, const Word* const* b,
              int64_t b_stride, int64_t k, int64_t m, int64_t n, float* c, int64_t c_stride) {
  ForBlocks(m, n, [&](int64_t i, int64_t j, auto high, auto vecs) {
    OuterBlock<Factors, high, vecs>(pairs, a, i, a_stride, b, j, b_stride, k,
                                    c + i * c_stride + j, c_stride);
  });
}

}  // namespace cvn

#endif  // CVN_BLOCKS_H_
