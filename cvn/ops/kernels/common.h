// Vectors, bfloat16, scratch memory, threads: what all kernels stand on.

#ifndef CVN_COMMON_H_
#define CVN_COMMON_H_

#include <algorithm>
#include <array>
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <cstring>
#include <memory>
#include <mutex>
#include <type_traits>
#include <utility>
#include <vector>

#include "xla/ffi/api/ffi.h"

#if defined(__AVX512BF16__)
#include <immintrin.h>
#endif

namespace ffi = xla::ffi;

#define CVN_INLINE inline __attribute__((always_inline))

namespace cvn {

constexpr int64_t kLanes = 16;
constexpr int64_t kTaps = 27;
typedef float Vec __attribute__((vector_size(64), may_alias));
typedef float Loose __attribute__((vector_size(64), aligned(4), may_alias));  // anywhere in memory
typedef int32_t Ints __attribute__((vector_size(64), may_alias));
typedef uint32_t Words __attribute__((vector_size(64), may_alias));
typedef uint16_t Halves __attribute__((vector_size(32), aligned(2), may_alias));

struct Bf16 {
  uint16_t bits;
};

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

CVN_INLINE Vec Load(const Bf16* p) {
  const Words wide = __builtin_convertvector(*reinterpret_cast<const Halves*>(p), Words) << 16;
  return reinterpret_cast<Vec>(wide);
}

CVN_INLINE void Store(float* p, Vec v) { *reinterpret_cast<Loose*>(p) = v; }

CVN_INLINE void Store(Bf16* p, Vec v) {
#if defined(__AVX512BF16__)
  const __m256bh half = _mm512_cvtneps_pbh(reinterpret_cast<__m512>(v));
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

// Memory for a while, zero at first; a few more bytes than asked for may be read and written. A
// thread keeps what it gave back for the next time: fresh pages would cost more than the work done
// in them.
template <typename T>
class Scratch {
 public:
  explicit Scratch(int64_t size) {
    const size_t bytes = size * sizeof(T) + 4 * sizeof(Line);
    auto& kept = Kept();
    auto best = kept.end();
    for (auto it = kept.begin(); it != kept.end(); ++it) {
      if (it->size() >= bytes && (best == kept.end() || it->size() < best->size())) best = it;
    }
    if (best == kept.end()) {
      memory_.resize(bytes);
    } else {
      memory_ = std::move(*best);
      kept.erase(best);
      std::memset(memory_.data(), 0, bytes);
    }
  }
  ~Scratch() {
    if (memory_.size()) Kept().push_back(std::move(memory_));
  }
  Scratch(Scratch&& other) : memory_(std::move(other.memory_)) {}
  T* data() { return reinterpret_cast<T*>(memory_.data()); }
  const T* data() const { return reinterpret_cast<const T*>(memory_.data()); }
  T& operator[](int64_t i) { return data()[i]; }

 private:
  struct alignas(64) Line {
    char bytes[64];
  };
  class Lines {
   public:
    size_t size() const { return lines_.size() * sizeof(Line); }
    Line* data() { return lines_.data(); }
    const Line* data() const { return lines_.data(); }
    void resize(size_t bytes) { lines_.resize((bytes + sizeof(Line) - 1) / sizeof(Line)); }

   private:
    std::vector<Line> lines_;
  };
  static std::vector<Lines>& Kept() {
    static thread_local std::vector<Lines> kept;
    return kept;
  }
  Lines memory_;
};

// Calls f(0) ... f(n - 1) on the pool's threads and this one. What of the pool comes too late finds
// nothing to do, so that this returns even where the pool is busy.
template <typename F>
void ParallelFor(ffi::ThreadPool& pool, int64_t n, const F& f) {
  struct Shared {
    std::atomic<int64_t> next{0};
    int64_t done = 0;
    std::mutex mutex;
    std::condition_variable finished;
  };
  auto shared = std::make_shared<Shared>();
  const F* function = &f;
  auto work = [shared, function, n] {
    int64_t mine = 0;
    for (int64_t i; (i = shared->next.fetch_add(1)) < n; ++mine) (*function)(i);
    std::lock_guard<std::mutex> lock(shared->mutex);
    shared->done += mine;
    if (shared->done == n) shared->finished.notify_all();
  };
  const int64_t helpers = std::min<int64_t>(pool.num_threads(), n) - 1;
  for (int64_t i = 0; i < helpers; ++i) {
    auto task = work;
    pool.Schedule(std::move(task));
  }
  work();
  std::unique_lock<std::mutex> lock(shared->mutex);
  shared->finished.wait(lock, [&] { return shared->done == n; });
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

// [rows][channels] -> [rows][padded], padded a multiple of 16; the padding becomes zero. Up to 15
// floats behind the last row are read.
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

// [rows][padded] -> [rows][channels], padded a multiple of 16. Whole vectors are written as long as
// what they write too much belongs to rows that follow.
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

#endif  // CVN_COMMON_H_
