// Matrix products of bfloat16 on tile units (AMX).

#ifndef CVN_TILES_H_
#define CVN_TILES_H_

#include "blocks.h"

#if defined(__AMX_BF16__) && defined(__AVX512BF16__) && defined(__linux__)
#include <immintrin.h>
#include <sys/syscall.h>
#include <unistd.h>
#define CVN_TILES 1
#else
#define CVN_TILES 0
#endif

namespace cvn {

#if CVN_TILES

// A tile is 16 rows of 64 bytes. Tiles 0 to 3 hold C, 4 and 5 A, 6 and 7 B.
constexpr int64_t kTileRows = 16;
constexpr int64_t kTileDepth = 32;  // bfloat16 in a row of A
constexpr int64_t kTileSize = kTileRows * kTileDepth;

inline bool TilesAllowed() {  // Linux has each process ask once
  static const bool allowed = syscall(SYS_arch_prctl, 0x1023, 18) == 0;
  return allowed;
}

// C, 16 kHigh by 16 kWide. A_tap's rows are `a_stride` elements apart and hold `depth` tiles' rows;
// B_tap is [column of tiles][depth] tiles of pairs. With `kAdd` C is added to.
template <int kHigh, int kWide, bool kAdd>
void TileBlock(int taps, const Bf16* const* a, int64_t a_stride, const Bf16* const* b,
               int64_t depth, float* c, int64_t c_stride) {
  const int64_t bytes = a_stride * 2, c_bytes = c_stride * 4;
  float* low = c + kTileRows * c_stride;
  if constexpr (kAdd) {
    _tile_loadd(0, c, c_bytes);
    if constexpr (kWide > 1) _tile_loadd(1, c + kLanes, c_bytes);
    if constexpr (kHigh > 1) _tile_loadd(2, low, c_bytes);
    if constexpr (kHigh > 1 && kWide > 1) _tile_loadd(3, low + kLanes, c_bytes);
  } else {
    _tile_zero(0);
    _tile_zero(1);
    _tile_zero(2);
    _tile_zero(3);
  }
  for (int t = 0; t < taps; ++t) {
    for (int64_t s = 0; s < depth; ++s) {
      const Bf16* left = a[t] + s * kTileDepth;
      const Bf16* right = b[t] + s * kTileSize;
      _tile_loadd(4, left, bytes);
      _tile_loadd(6, right, 64);
      _tile_dpbf16ps(0, 4, 6);
      if constexpr (kWide > 1) {
        _tile_loadd(7, right + depth * kTileSize, 64);
        _tile_dpbf16ps(1, 4, 7);
      }
      if constexpr (kHigh > 1) {
        _tile_loadd(5, left + kTileRows * a_stride, bytes);
        _tile_dpbf16ps(2, 5, 6);
      }
      if constexpr (kHigh > 1 && kWide > 1) _tile_dpbf16ps(3, 5, 7);
    }
  }
  _tile_stored(0, c, c_bytes);
  if constexpr (kWide > 1) _tile_stored(1, c + kLanes, c_bytes);
  if constexpr (kHigh > 1) _tile_stored(2, low, c_bytes);
  if constexpr (kHigh > 1 && kWide > 1) _tile_stored(3, low + kLanes, c_bytes);
}

template <bool kAdd>
void TileMultiply(int taps, const Bf16* const* a, int64_t a_stride, const Bf16* const* b,
                  int64_t rows, int64_t k, int64_t n, float* c, int64_t c_stride) {
  const int64_t depth = k / kTileDepth;
  const Bf16 *left[kMaxTaps], *right[kMaxTaps];
  for (int64_t j = 0; j < n; j += 2 * kLanes) {
    const bool wide = n - j >= 2 * kLanes;
    for (int t = 0; t < taps; ++t) right[t] = b[t] + j / kLanes * depth * kTileSize;
    for (int64_t i = 0; i < rows; i += 2 * kTileRows) {
      const bool high = rows - i >= 2 * kTileRows;
      for (int t = 0; t < taps; ++t) left[t] = a[t] + i * a_stride;
      const auto block = high ? (wide ? TileBlock<2, 2, kAdd> : TileBlock<2, 1, kAdd>)
                              : (wide ? TileBlock<1, 2, kAdd> : TileBlock<1, 1, kAdd>);
      block(taps, left, a_stride, right, depth, c + i * c_stride + j, c_stride);
    }
  }
}

struct Tiles {
  using Element = Bf16;
  static constexpr int64_t kRows = kTileRows, kDepth = kTileDepth;

  class Session {
   public:
    Session() {
      struct alignas(64) {
        uint8_t palette = 1, start = 0, reserved[14] = {};
        uint16_t bytes[16] = {};
        uint8_t rows[16] = {};
      } config;
      for (int i = 0; i < 8; ++i) config.bytes[i] = 64, config.rows[i] = kTileRows;
      _tile_loadconfig(&config);
    }
    ~Session() { _tile_release(); }
  };

  // [column of tiles][depth] tiles: rows of a tile are pairs of k, and a pair stands together.
  static void Pack(const float* from, int64_t k_stride, int64_t n_stride, int64_t k, int64_t n,
                   Bf16* to) {
    const int64_t depth = RoundUp(k, kDepth) / kDepth;
    for (int64_t j = 0; j < n; ++j) {
      for (int64_t i = 0; i < k; ++i) {
        const int64_t tile = j / kLanes * depth + i / kDepth;
        const int64_t row = i % kDepth / 2, column = j % kLanes * 2 + i % 2;
        to[tile * kTileSize + row * kDepth + column] =
            ToBf16(from[i * k_stride + j * n_stride]);
      }
    }
  }

  static void Multiply(int taps, const Bf16* const* a, int64_t a_stride, const Bf16* const* b,
                       int64_t rows, int64_t k, int64_t n, float* c, int64_t c_stride) {
    TileMultiply<false>(taps, a, a_stride, b, rows, k, n, c, c_stride);
  }
};

// Rows of pairs for B of a product over rows: from two rows of floats or bfloat16, n a multiple of
// kLanes; every 16 pairs go `stride` elements further.
template <typename T>
CVN_INLINE void InterleavePair(const T* first, const T* second, int64_t n, int64_t stride,
                               Bf16* to) {
  for (int64_t i = 0; i < n; i += kLanes, to += stride) {
    const __m512bh both = _mm512_cvtne2ps_pbh(reinterpret_cast<__m512>(Load(second + i)),
                                              reinterpret_cast<__m512>(Load(first + i)));
    alignas(64) static const uint16_t kOrder[32] = {
        0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23,
        8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31};
    const __m512i order = _mm512_load_si512(kOrder);
    _mm512_storeu_si512(to, _mm512_permutexvar_epi16(order, (__m512i)both));
  }
}

// [16][stride] floats -> [16][to_stride] bfloat16, transposed.
inline void Transpose16(const float* from, int64_t stride, Bf16* to, int64_t to_stride) {
  __m512 r[16], s[16];
  for (int i = 0; i < 16; ++i) r[i] = _mm512_loadu_ps(from + i * stride);
#pragma GCC unroll 8
  for (int i = 0; i < 16; i += 2) {
    s[i] = _mm512_unpacklo_ps(r[i], r[i + 1]);
    s[i + 1] = _mm512_unpackhi_ps(r[i], r[i + 1]);
  }
#pragma GCC unroll 4
  for (int i = 0; i < 16; i += 4) {
    for (int h = 0; h < 2; ++h) {
      const __m512d a = _mm512_castps_pd(s[i + h]), b = _mm512_castps_pd(s[i + h + 2]);
      r[i + 2 * h] = _mm512_castpd_ps(_mm512_unpacklo_pd(a, b));
      r[i + 2 * h + 1] = _mm512_castpd_ps(_mm512_unpackhi_pd(a, b));
    }
  }
  // r[4 i + c]: in each quarter q, column 4 q + c of rows 4 i to 4 i + 3.
#pragma GCC unroll 4
  for (int c = 0; c < 4; ++c) {
    const __m512 a = _mm512_shuffle_f32x4(r[c], r[4 + c], 0x88);
    const __m512 b = _mm512_shuffle_f32x4(r[8 + c], r[12 + c], 0x88);
    const __m512 d = _mm512_shuffle_f32x4(r[c], r[4 + c], 0xdd);
    const __m512 e = _mm512_shuffle_f32x4(r[8 + c], r[12 + c], 0xdd);
    s[c] = _mm512_shuffle_f32x4(a, b, 0x88);
    s[8 + c] = _mm512_shuffle_f32x4(a, b, 0xdd);
    s[4 + c] = _mm512_shuffle_f32x4(d, e, 0x88);
    s[12 + c] = _mm512_shuffle_f32x4(d, e, 0xdd);
  }
  for (int i = 0; i < 16; ++i) Store(to + i * to_stride, reinterpret_cast<Vec>(s[i]));
}

#endif  // CVN_TILES

}  // namespace cvn

#endif  // CVN_TILES_H_
