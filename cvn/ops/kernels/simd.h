// Vectors of the instruction set that the compiler targets, and bfloat16.

#ifndef CVN_SIMD_H_
#define CVN_SIMD_H_

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <type_traits>
#include <utility>

#if defined(__AVX512BF16__) && defined(__AVX512VL__)
#include <immintrin.h>
#define CVN_PAIRS 1  // instructions that multiply pairs of bfloat16
#else
#define CVN_PAIRS 0
#endif

#define CVN_INLINE inline __attribute__((always_inline))

namespace cvn {

// Floats in a vector, and vectors that the registers hold. CVN_LANES asks for shorter vectors than
// the widest. A processor that computes 512 bits in two halves (Zen 4) gains nothing by AVX-512's
// width: there vectors of 256 bits waste less on numbers of channels that fill no 512.
#if defined(__AVX512VL__) || defined(__aarch64__)
constexpr int64_t kRegisters = 32;
#else
constexpr int64_t kRegisters = 16;
#endif
#if !defined(CVN_LANES)
#if defined(__AVX512VL__) && !defined(__znver3__) && !defined(__znver4__)  // older GCC: Zen 4 is 3
#define CVN_LANES 16
#elif defined(__AVX__)
#define CVN_LANES 8
#else
#define CVN_LANES 4
#endif
#endif
constexpr int64_t kLanes = CVN_LANES;

typedef float Vec __attribute__((vector_size(4 * kLanes), may_alias));
typedef float Loose __attribute__((vector_size(4 * kLanes), aligned(4), may_alias));  // anywhere
typedef int32_t Ints __attribute__((vector_size(4 * kLanes), may_alias));
typedef uint32_t Words __attribute__((vector_size(4 * kLanes), may_alias));
typedef uint16_t Halves __attribute__((vector_size(2 * kLanes), aligned(2), may_alias));

struct Bf16 {
  uint16_t bits;
};

typedef float Word __attribute__((may_alias, aligned(4)));  // a float, or a pair of bfloat16

inline int64_t RoundUp(int64_t n, int64_t multiple) {
  return (n + multiple - 1) / multiple * multiple;
}

// To the nearest bfloat16, ties to even; a NaN stays one.
CVN_INLINE Bf16 ToBf16(float x) {
  uint32_t u;
  std::memcpy(&u, &x, 4);
  return {static_cast<uint16_t>(x != x ? 0x7fc0 : (u + 0x7fff + ((u >> 16) & 1)) >> 16)};
}

CVN_INLINE float ToFloat(Bf16 x) {
  const uint32_t u = uint32_t{x.bits} << 16;
  float y;
  std::memcpy(&y, &u, 4);
  return y;
}

// A weight as a volume of T needs it.
template <typename T>
float Rounded(float x) {
  return std::is_same_v<T, Bf16> ? ToFloat(ToBf16(x)) : x;
}

CVN_INLINE Vec Load(const float* p) { return *reinterpret_cast<const Loose*>(p); }

CVN_INLINE Vec LoadWords(const Word* p) { return *reinterpret_cast<const Loose*>(p); }

CVN_INLINE Vec Load(const Bf16* p) {
  const Words wide = __builtin_convertvector(*reinterpret_cast<const Halves*>(p), Words) << 16;
  return reinterpret_cast<Vec>(wide);
}

CVN_INLINE void Store(float* p, Vec v) { *reinterpret_cast<Loose*>(p) = v; }

CVN_INLINE void Store(Bf16* p, Vec v) {
#if CVN_PAIRS && CVN_LANES == 16
  const __m256bh half = _mm512_cvtneps_pbh(reinterpret_cast<__m512>(v));
  std::memcpy(p, &half, sizeof half);
#elif CVN_PAIRS && CVN_LANES == 8
  const __m128bh half = _mm256_cvtneps_pbh(reinterpret_cast<__m256>(v));
  std::memcpy(p, &half, sizeof half);
#else
  const Words u = reinterpret_cast<Words>(v);
  const Words nan = reinterpret_cast<Words>(v != v);
  const Words rounded = (u + 0x7fff + ((u >> 16) & 1)) >> 16;
  *reinterpret_cast<Halves*>(p) =
      __builtin_convertvector((nan & 0x7fc0) | (~nan & rounded), Halves);
#endif
}

CVN_INLINE Vec Select(Ints mask, Vec a, Vec b) {
  return reinterpret_cast<Vec>((mask & reinterpret_cast<Ints>(a)) |
                               (~mask & reinterpret_cast<Ints>(b)));
}

// All ones in the first n lanes.
CVN_INLINE Ints FirstLanes(int64_t n) {
  Ints lane;
  for (int i = 0; i < kLanes; ++i) lane[i] = i;
  return lane < static_cast<int32_t>(n);
}

CVN_INLINE float Value(float x) { return x; }
CVN_INLINE float Value(Bf16 x) { return ToFloat(x); }
CVN_INLINE void Assign(float x, float* to) { *to = x; }
CVN_INLINE void Assign(float x, Bf16* to) { *to = ToBf16(x); }

// The first n lanes of a vector that may be the last of its array.
template <typename T>
CVN_INLINE Vec LoadSome(const T* p, int64_t n) {
  if (n >= kLanes) return Load(p);
  Vec v = {};
  for (int64_t i = 0; i < n; ++i) v[i] = Value(p[i]);
  return v;
}

template <typename T>
CVN_INLINE void StoreSome(T* p, Vec v, int64_t n) {
  if (n >= kLanes) return Store(p, v);
  for (int64_t i = 0; i < n; ++i) Assign(v[i], p + i);
}

// Asks for what lies behind a vector that is read now: left alone, the processor asks for too
// little too late where several maps are read at once.
template <typename T>
CVN_INLINE void PrefetchAfter(const T* p) {
  __builtin_prefetch(reinterpret_cast<const char*>(p) + 2048);
}

// Calls f with a number of channels, or a width in whole vectors, that the compiler knows, where it
// is a usual one.
template <typename F>
CVN_INLINE void WithChannels(int64_t channels, const F& f) {
  switch (channels) {
    case 16: return f(std::integral_constant<int64_t, 16>());
    case 24: return f(std::integral_constant<int64_t, 24>());
    case 32: return f(std::integral_constant<int64_t, 32>());
    default: return f(channels);
  }
}

// [rows][channels] -> [rows][padded], padded a multiple of kLanes; the padding becomes zero. Up to
// kLanes - 1 floats behind the last row are read.
template <typename To>
void Pad(const float* from, int64_t rows, int64_t channels, int64_t padded, To* to) {
  WithChannels(channels, [&](auto n) {
    const Ints last = FirstLanes(n % kLanes ? n % kLanes : kLanes);
    for (int64_t i = 0; i < rows; ++i) {
      for (int64_t c = 0; c < n; c += kLanes) {
        const Vec v = Load(from + i * n + c);
        Store(to + i * padded + c, c + kLanes > n ? Select(last, v, Vec{}) : v);
      }
    }
  });
}

// [rows][padded] -> [rows][channels], padded a multiple of kLanes. A vector may write past its row
// as long as what it writes belongs to rows that follow.
template <typename T>
void Unpad(const float* from, int64_t padded, int64_t rows, int64_t channels, T* to) {
  WithChannels(channels, [&](auto n) {
    int64_t i = 0;
    for (; i * n + RoundUp(n, kLanes) <= rows * n; ++i) {
      for (int64_t c = 0; c < n; c += kLanes) Store(to + i * n + c, Load(from + i * padded + c));
    }
    for (; i < rows; ++i) {
      for (int64_t c = 0; c < n; c += kLanes) {
        StoreSome(to + i * n + c, Load(from + i * padded + c), n - c);
      }
    }
  });
}

}  // namespace cvn

#endif  // CVN_SIMD_H_
