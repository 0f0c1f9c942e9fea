// The deconvolution and the convolution of cvn/deconv.py, with their gradients, for a CPU.
//
// Volumes are [B, X, Y, Z, C] of float32 or bfloat16, kernels [3, 3, 3, in, out] of float32. Sums are
// made in float32. Where a volume is of bfloat16, all factors of a product are, and the
// deconvolution runs on tile units (AMX) where the processor has them.
//
// Along one axis, y[2 j + t] += x[j] w[t] for the deconvolution, and o[v] += z[v + t - 1] w[t] for
// the convolution. Rows along z are copied into buffers with zeros where the map ends, so that the
// innermost loops know no borders. A gradient of a kernel comes as one term a sample, so that its
// sum does not depend on the number of threads.

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

#if defined(__AMX_BF16__) && defined(__linux__)
#include <immintrin.h>
#include <sys/syscall.h>
#include <unistd.h>
#define CVN_TILES 1
#else
#define CVN_TILES 0
#endif

namespace ffi = xla::ffi;
using Array = ffi::Buffer<ffi::F32>;
using Result = ffi::ResultBuffer<ffi::F32>;
using AnyArray = ffi::AnyBuffer;  // of float32 or bfloat16
using AnyResult = ffi::Result<ffi::AnyBuffer>;

#define CVN_INLINE inline __attribute__((always_inline))

namespace {

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

CVN_INLINE Vec Load(const float* p) { return *reinterpret_cast<const Loose*>(p); }
CVN_INLINE void Store(float* p, Vec v) { *reinterpret_cast<Loose*>(p) = v; }
int64_t RoundUp(int64_t n, int64_t multiple) { return (n + multiple - 1) / multiple * multiple; }

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

CVN_INLINE Vec Load(const Bf16* p) {
  const Words wide = __builtin_convertvector(*reinterpret_cast<const Halves*>(p), Words) << 16;
  return reinterpret_cast<Vec>(wide);
}

CVN_INLINE void Store(Bf16* p, Vec v) {
  const Words u = reinterpret_cast<Words>(v);
  const Words nan = reinterpret_cast<Words>(v != v);
  const Words rounded = (u + 0x7fff + ((u >> 16) & 1)) >> 16;
  *reinterpret_cast<Halves*>(p) =
      __builtin_convertvector((nan & 0x7fc0) | (~nan & rounded), Halves);
}

// Memory for a while, zero at first. A thread keeps what it gave back for the next time: fresh pages
// would cost more than the work done in them.
template <typename T>
class Scratch {
 public:
  explicit Scratch(int64_t size) {
    const size_t bytes = size * sizeof(T);
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
  T& operator[](int64_t i) { return data()[i]; }

 private:
  struct alignas(64) Line {
    char bytes[64];
  };
  class Lines {
   public:
    size_t size() const { return lines_.size() * sizeof(Line); }
    Line* data() { return lines_.data(); }
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

// Asks for what lies behind `n` elements that are read now: left alone, the processor asks for too
// little too late where several maps are read at once.
template <typename T>
CVN_INLINE void PrefetchAfter(const T* p, int64_t n) {
  const char* start = reinterpret_cast<const char*>(p) + 2048;
  for (int64_t i = 0; i < static_cast<int64_t>(n * sizeof(T)); i += 64) __builtin_prefetch(start + i);
}

// Calls f with a number of channels that the compiler knows, where it is a usual one.
template <typename F>
void WithChannels(int64_t channels, const F& f) {
  switch (channels) {
    case 16: return f(std::integral_constant<int64_t, 16>());
    case 24: return f(std::integral_constant<int64_t, 24>());
    case 32: return f(std::integral_constant<int64_t, 32>());
    default: return f(channels);
  }
}

// The same for a width in whole vectors.
template <typename F>
void WithWidth(int64_t wide, const F& f) {
  switch (wide) {
    case 16: return f(std::integral_constant<int64_t, 16>());
    case 32: return f(std::integral_constant<int64_t, 32>());
    default: return f(wide);
  }
}

void Copy(const float* from, int64_t n, float* to) { std::memcpy(to, from, n * sizeof(float)); }
void Copy(const Bf16* from, int64_t n, Bf16* to) { std::memcpy(to, from, n * sizeof(Bf16)); }
void Copy(const Bf16* from, int64_t n, float* to) {
  for (int64_t i = 0; i < n; ++i) to[i] = ToFloat(from[i]);
}
void Copy(const float* from, int64_t n, Bf16* to) {
  for (int64_t i = 0; i < n; ++i) to[i] = ToBf16(from[i]);
}

// [rows][padded] -> [rows][channels].
template <typename T>
void CopyOut(const float* from, int64_t padded, int64_t rows, int64_t channels, T* to) {
  WithChannels(channels, [&](auto n) {
    for (int64_t i = 0; i < rows; ++i) Copy(from + i * padded, n, to + i * n);
  });
}

// [rows][channels] -> [rows][padded]; the padding is not touched.
template <typename T, typename To>
void CopyIn(const T* from, int64_t rows, int64_t channels, int64_t padded, To* to) {
  WithChannels(channels, [&](auto n) {
    for (int64_t i = 0; i < rows; ++i) {
      PrefetchAfter(from + i * n, n);
      Copy(from + i * n, n, to + i * padded);
    }
  });
}

// ------------------------------------------------------------------------------------------------
// Products: rows of C = sum over taps of rows of A_tap times B_tap.

// One block of C in registers. A's rows are `a_stride` floats apart, B is [k][b_stride].
template <int kRows, int kVecs>
void Block(int taps, const float* const* a, int64_t a_stride, const float* const* b,
           int64_t b_stride, int64_t k, float* c, int64_t c_stride) {
  Vec sum[kRows][kVecs] = {};
  for (int t = 0; t < taps; ++t) {
    const float* row = a[t];
    const float* panel = b[t];
    for (int64_t i = 0; i < k; ++i, panel += b_stride) {
      Vec right[kVecs];
#pragma GCC unroll 4
      for (int v = 0; v < kVecs; ++v) right[v] = Load(panel + v * kLanes);
#pragma GCC unroll 16
      for (int m = 0; m < kRows; ++m) {
        const float left = row[m * a_stride + i];
#pragma GCC unroll 4
        for (int v = 0; v < kVecs; ++v) sum[m][v] += left * right[v];
      }
    }
  }
  for (int m = 0; m < kRows; ++m) {
    for (int v = 0; v < kVecs; ++v) Store(c + m * c_stride + v * kLanes, sum[m][v]);
  }
}

constexpr int kMaxTaps = kTaps;

// C [rows][c_stride] = sum of A_tap [rows][k] B_tap [k][n]; n is a multiple of kLanes.
void Multiply(int taps, const float* const* a, int64_t a_stride, const float* const* b,
              int64_t b_stride, int64_t rows, int64_t k, int64_t n, float* c, int64_t c_stride) {
  const float *left[kMaxTaps], *right[kMaxTaps];
  for (int64_t j = 0; j < n;) {
    const int64_t width = n - j >= 2 * kLanes ? 2 * kLanes : kLanes;
    for (int t = 0; t < taps; ++t) right[t] = b[t] + j;
    for (int64_t i = 0; i < rows;) {
      for (int t = 0; t < taps; ++t) left[t] = a[t] + i * a_stride;
      float* out = c + i * c_stride + j;
      const int64_t rest = rows - i;
      if (width == 2 * kLanes) {
        if (rest >= 8) {
          Block<8, 2>(taps, left, a_stride, right, b_stride, k, out, c_stride);
          i += 8;
        } else {
          Block<1, 2>(taps, left, a_stride, right, b_stride, k, out, c_stride);
          i += 1;
        }
      } else if (rest >= 16) {
        Block<16, 1>(taps, left, a_stride, right, b_stride, k, out, c_stride);
        i += 16;
      } else if (rest >= 8) {
        Block<8, 1>(taps, left, a_stride, right, b_stride, k, out, c_stride);
        i += 8;
      } else {
        Block<1, 1>(taps, left, a_stride, right, b_stride, k, out, c_stride);
        i += 1;
      }
    }
    j += width;
  }
}

// One block of C += sum of A^T B, for A [k][m] and B with rows `a_stride` and `b_stride` apart.
template <int kRows, int kVecs>
void OuterBlock(int pairs, const float* const* a, int64_t a_stride, const float* const* b,
                int64_t b_stride, int64_t k, float* c, int64_t c_stride) {
  Vec sum[kRows][kVecs];
  for (int m = 0; m < kRows; ++m) {
    for (int v = 0; v < kVecs; ++v) sum[m][v] = Load(c + m * c_stride + v * kLanes);
  }
  for (int p = 0; p < pairs; ++p) {
    const float *left = a[p], *row = b[p];
    for (int64_t i = 0; i < k; ++i, left += a_stride, row += b_stride) {
      Vec right[kVecs];
#pragma GCC unroll 4
      for (int v = 0; v < kVecs; ++v) right[v] = Load(row + v * kLanes);
#pragma GCC unroll 16
      for (int m = 0; m < kRows; ++m) {
#pragma GCC unroll 4
        for (int v = 0; v < kVecs; ++v) sum[m][v] += left[m] * right[v];
      }
    }
  }
  for (int m = 0; m < kRows; ++m) {
    for (int v = 0; v < kVecs; ++v) Store(c + m * c_stride + v * kLanes, sum[m][v]);
  }
}

// C [m][n] += sum of A_p^T B_p; m is a multiple of 8, n of kLanes.
void AddOuter(int pairs, const float* const* a, int64_t a_stride, const float* const* b,
              int64_t b_stride, int64_t k, int64_t m, int64_t n, float* c, int64_t c_stride) {
  const float *left[kMaxTaps], *right[kMaxTaps];
  for (int64_t j = 0; j < n;) {
    const bool wide = n - j >= 2 * kLanes;
    for (int p = 0; p < pairs; ++p) right[p] = b[p] + j;
    for (int64_t i = 0; i < m; i += 8) {
      for (int p = 0; p < pairs; ++p) left[p] = a[p] + i;
      float* out = c + i * c_stride + j;
      const auto block = wide ? OuterBlock<8, 2> : OuterBlock<8, 1>;
      block(pairs, left, a_stride, right, b_stride, k, out, c_stride);
    }
    j += wide ? 2 * kLanes : kLanes;
  }
}

// ------------------------------------------------------------------------------------------------
// The same on tile units: a tile is 16 rows of 64 bytes. Tiles 0 to 3 hold C, 4 and 5 A, 6 and 7 B.

#if CVN_TILES

constexpr int64_t kTileRows = 16;
constexpr int64_t kTileDepth = 32;  // bfloat16 in a row of A
constexpr int64_t kTileSize = kTileRows * kTileDepth;

bool TilesAllowed() {  // Linux has each process ask once
  static const bool allowed = syscall(SYS_arch_prctl, 0x1023, 18) == 0;
  return allowed;
}

class TileSession {
 public:
  TileSession() {
    struct alignas(64) {
      uint8_t palette = 1, start = 0, reserved[14] = {};
      uint16_t bytes[16] = {};
      uint8_t rows[16] = {};
    } config;
    for (int i = 0; i < 8; ++i) config.bytes[i] = 64, config.rows[i] = kTileRows;
    _tile_loadconfig(&config);
  }
  ~TileSession() { _tile_release(); }
};

// C, 16 kHigh by 16 kWide. A_tap's rows are `a_stride` elements apart and hold `depth` tiles' rows;
// B_tap is [column of tiles][depth] tiles of pairs, `b_stride` elements a column. With `kAdd` C is
// added to.
template <int kHigh, int kWide, bool kAdd>
void TileBlock(int taps, const Bf16* const* a, int64_t a_stride, const Bf16* const* b,
               int64_t b_stride, int64_t depth, float* c, int64_t c_stride) {
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
        _tile_loadd(7, right + b_stride, 64);
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

// As Multiply, for rows and n that are multiples of 16.
template <bool kAdd>
void TileMultiply(int taps, const Bf16* const* a, int64_t a_stride, const Bf16* const* b,
                  int64_t b_stride, int64_t rows, int64_t depth, int64_t n, float* c,
                  int64_t c_stride) {
  const Bf16 *left[kMaxTaps], *right[kMaxTaps];
  for (int64_t j = 0; j < n; j += 2 * kLanes) {
    const bool wide = n - j >= 2 * kLanes;
    for (int t = 0; t < taps; ++t) right[t] = b[t] + j / kLanes * b_stride;
    for (int64_t i = 0; i < rows; i += 2 * kTileRows) {
      const bool high = rows - i >= 2 * kTileRows;
      for (int t = 0; t < taps; ++t) left[t] = a[t] + i * a_stride;
      float* out = c + i * c_stride + j;
      const auto block = high ? (wide ? TileBlock<2, 2, kAdd> : TileBlock<2, 1, kAdd>)
                              : (wide ? TileBlock<1, 2, kAdd> : TileBlock<1, 1, kAdd>);
      block(taps, left, a_stride, right, b_stride, depth, out, c_stride);
    }
  }
}

// [k][n] floats, k `k_stride` and n `n_stride` apart -> [column of tiles][depth] tiles of pairs:
// rows of a tile are pairs of k, and a pair stands together.
void PackTiles(const float* from, int64_t k_stride, int64_t n_stride, int64_t k, int64_t n,
               int64_t depth, Bf16* to) {
  for (int64_t j = 0; j < n; ++j) {
    for (int64_t i = 0; i < k; ++i) {
      const int64_t tile = j / kLanes * depth + i / kTileDepth;
      const int64_t row = i % kTileDepth / 2, column = j % kLanes * 2 + i % 2;
      to[tile * kTileSize + row * kTileDepth + column] =
          ToBf16(from[i * k_stride + j * n_stride]);
    }
  }
}

#endif  // CVN_TILES

// ------------------------------------------------------------------------------------------------
// The deconvolution.

struct Volume {
  int64_t b, x, y, z;  // of the input
  int64_t cin, cout;
};

// Where a row of the output begins, in voxels.
int64_t FineRow(const Volume& s, int64_t sample, int64_t x, int64_t y) {
  return ((sample * 2 * s.x + x) * 2 * s.y + y) * 2 * s.z;
}

// The taps that an output of a parity reads along an axis, and how many voxels back.
struct Reads {
  int count;
  int shift[2], tap[2];
};
constexpr Reads kReads[2] = {{2, {0, 1}, {0, 2}}, {1, {0, 0}, {1, 0}}};

// Lists the taps of one phase: f(tap's index, its number of 27, shifts along x, y and z).
template <typename F>
int ForTaps(int phase, const F& f) {
  const Reads &x = kReads[phase >> 2], &y = kReads[phase >> 1 & 1], &z = kReads[phase & 1];
  int n = 0;
  for (int i = 0; i < x.count; ++i) {
    for (int j = 0; j < y.count; ++j) {
      for (int k = 0; k < z.count; ++k) {
        f(n++, (x.tap[i] * 3 + y.tap[j]) * 3 + z.tap[k], x.shift[i], y.shift[j], z.shift[k]);
      }
    }
  }
  return n;
}

template <typename In, typename Out>
void DeconvRows(const Volume& s, const In* x, const float* w, ffi::ThreadPool& pool, Out* out) {
  const int64_t wide = RoundUp(s.cout, kLanes);
  Scratch<float> weight(kTaps * s.cin * wide);
  for (int64_t i = 0; i < kTaps * s.cin; ++i) {
    for (int64_t o = 0; o < s.cout; ++o) weight[i * wide + o] = Rounded<In>(w[i * s.cout + o]);
  }
  ParallelFor(pool, s.b * s.x, [&](int64_t item) {
    const int64_t plane = item % s.x;
    const int64_t size = (s.z + 1) * s.cin;  // a row's buffer begins with a voxel of zeros
    Scratch<float> buffer(4 * size), sum(2 * s.z * wide);
    float* rows[2][2];  // [x back][y back]
    for (int i = 0; i < 4; ++i) rows[i / 2][i % 2] = buffer.data() + i * size;
    for (int64_t y = 0; y < s.y; ++y) {
      for (int i = 0; i < 2; ++i) {
        std::swap(rows[i][0], rows[i][1]);
        if (plane < i) continue;  // stays zero
        CopyIn(x + ((item - i) * s.y + y) * s.z * s.cin, s.z, s.cin, s.cin, rows[i][0] + s.cin);
      }
      for (int phase = 0; phase < 8; ++phase) {
        const float *a[8], *b[8];
        const int taps = ForTaps(phase, [&](int n, int tap, int i, int j, int k) {
          a[n] = rows[i][j] + (1 - k) * s.cin;
          b[n] = weight.data() + tap * s.cin * wide;
        });
        Multiply(taps, a, s.cin, b, wide, s.z, s.cin, wide, sum.data() + phase % 2 * wide,
                 2 * wide);
        if (phase % 2) {
          const int64_t row = FineRow(s, item / s.x, 2 * plane + phase / 4, 2 * y + phase / 2 % 2);
          CopyOut(sum.data(), wide, 2 * s.z, s.cout, out + row * s.cout);
        }
      }
    }
  });
}

constexpr int kStrip = 4;  // rows whose terms of a kernel's gradient are summed in registers

// The gradients of input and kernel, from that of the output; `dw` is [B, 27, in, out].
template <typename In, typename Out>
void DeconvGradients(const Volume& s, const In* x, const float* w, const Out* dy,
                     ffi::ThreadPool& pool, In* dx, float* dw) {
  const int64_t wide_in = RoundUp(s.cin, kLanes), wide_out = RoundUp(s.cout, kLanes);
  Scratch<float> weight(kTaps * s.cout * wide_in);  // [27][out][in]
  for (int64_t t = 0; t < kTaps; ++t) {
    for (int64_t i = 0; i < s.cin; ++i) {
      for (int64_t o = 0; o < s.cout; ++o) {
        weight[(t * s.cout + o) * wide_in + i] = Rounded<In>(w[(t * s.cin + i) * s.cout + o]);
      }
    }
  }
  ParallelFor(pool, s.b, [&](int64_t sample) {
    const int64_t size = (2 * s.z + 1) * wide_out;  // a row's buffer ends with a voxel of zeros
    constexpr int kRows = 2 * kStrip + 1;  // of the output, for a strip
    Scratch<float> buffer(3 * kRows * size), zero(size), sum(s.z * wide_in);
    Scratch<float> left(kStrip * s.z * wide_in), total(kTaps * wide_in * wide_out);
    for (int64_t plane = 0; plane < s.x; ++plane) {
      float* rows[3][kRows];  // output rows 2 x + a, 2 y + b
      for (int i = 0; i < 3 * kRows; ++i) rows[i / kRows][i % kRows] = buffer.data() + i * size;
      for (int64_t first = 0; first < s.y; first += kStrip) {
        const int count = static_cast<int>(std::min<int64_t>(kStrip, s.y - first));
        const float* source[3][kRows];
        for (int a = 0; a < 3; ++a) {
          std::swap(rows[a][0], rows[a][kRows - 1]);  // the last one of the strip before
          for (int b = 0; b <= 2 * count; ++b) {
            const int64_t row = 2 * first + b;
            const bool there = 2 * plane + a < 2 * s.x && row < 2 * s.y;
            if (there && (b > 0 || first == 0)) {
              const int64_t at = FineRow(s, sample, 2 * plane + a, row) * s.cout;
              CopyIn(dy + at, 2 * s.z, s.cout, wide_out, rows[a][b]);
              for (int64_t i = 0; i < size; ++i) rows[a][b][i] = Rounded<In>(rows[a][b][i]);
            }
            source[a][b] = there ? rows[a][b] : zero.data();
          }
        }
        const int64_t at = ((sample * s.x + plane) * s.y + first) * s.z * s.cin;
        CopyIn(x + at, count * s.z, s.cin, wide_in, left.data());
        for (int t = 0; t < kTaps; ++t) {
          const float *a[kStrip], *b[kStrip];
          for (int i = 0; i < count; ++i) {
            a[i] = left.data() + i * s.z * wide_in;
            b[i] = source[t / 9][2 * i + t / 3 % 3] + t % 3 * wide_out;
          }
          AddOuter(count, a, wide_in, b, 2 * wide_out, s.z, RoundUp(s.cin, 8), wide_out,
                   total.data() + t * wide_in * wide_out, wide_out);
        }
        for (int i = 0; i < count; ++i) {
          const float *a[kTaps], *b[kTaps];
          for (int t = 0; t < kTaps; ++t) {
            a[t] = source[t / 9][2 * i + t / 3 % 3] + t % 3 * wide_out;
            b[t] = weight.data() + t * s.cout * wide_in;
          }
          Multiply(kTaps, a, 2 * wide_out, b, wide_in, s.z, s.cout, wide_in, sum.data(), wide_in);
          CopyOut(sum.data(), wide_in, s.z, s.cin, dx + at + i * s.z * s.cin);
        }
      }
    }
    for (int64_t t = 0; t < kTaps; ++t) {
      CopyOut(total.data() + t * wide_in * wide_out, wide_out, s.cin, s.cout,
              dw + (sample * kTaps + t) * s.cin * s.cout);
    }
  });
}

#if CVN_TILES

template <typename Out>
void TileDeconvRows(const Volume& s, const Bf16* x, const float* w, ffi::ThreadPool& pool,
                    Out* out) {
  const int64_t wide = RoundUp(s.cout, kLanes), deep = RoundUp(s.cin, kTileDepth);
  const int64_t depth = deep / kTileDepth, high = RoundUp(s.z, kTileRows);
  Scratch<Bf16> weight(kTaps * deep * wide);
  for (int64_t t = 0; t < kTaps; ++t) {
    PackTiles(w + t * s.cin * s.cout, s.cout, 1, s.cin, s.cout, depth,
              weight.data() + t * deep * wide);
  }
  ParallelFor(pool, s.b * s.x, [&](int64_t item) {
    TileSession session;
    const int64_t plane = item % s.x, size = (high + 1) * deep;
    Scratch<Bf16> buffer(4 * size);
    Scratch<float> sum(2 * high * wide);
    Bf16* rows[2][2];
    for (int i = 0; i < 4; ++i) rows[i / 2][i % 2] = buffer.data() + i * size;
    for (int64_t y = 0; y < s.y; ++y) {
      for (int i = 0; i < 2; ++i) {
        std::swap(rows[i][0], rows[i][1]);
        if (plane < i) continue;
        CopyIn(x + ((item - i) * s.y + y) * s.z * s.cin, s.z, s.cin, deep, rows[i][0] + deep);
      }
      for (int phase = 0; phase < 8; ++phase) {
        const Bf16 *a[8], *b[8];
        const int taps = ForTaps(phase, [&](int n, int tap, int i, int j, int k) {
          a[n] = rows[i][j] + (1 - k) * deep;
          b[n] = weight.data() + tap * deep * wide;
        });
        TileMultiply<false>(taps, a, deep, b, depth * kTileSize, high, depth, wide,
                            sum.data() + phase % 2 * wide, 2 * wide);
        if (phase % 2) {
          const int64_t row = FineRow(s, item / s.x, 2 * plane + phase / 4, 2 * y + phase / 2 % 2);
          CopyOut(sum.data(), wide, 2 * s.z, s.cout, out + row * s.cout);
        }
      }
    }
  });
}

template <typename Out>
void TileDeconvGradients(const Volume& s, const Bf16* x, const float* w, const Out* dy,
                         ffi::ThreadPool& pool, Bf16* dx, float* dw) {
  const int64_t wide_in = RoundUp(s.cin, kLanes), wide_out = RoundUp(s.cout, kLanes);
  const int64_t deep = RoundUp(s.cout, kTileDepth), depth = deep / kTileDepth;
  const int64_t high = RoundUp(s.z, kTileRows), long_z = RoundUp(s.z, kTileDepth);
  Scratch<Bf16> weight(kTaps * deep * wide_in);
  for (int64_t t = 0; t < kTaps; ++t) {
    PackTiles(w + t * s.cin * s.cout, 1, s.cout, s.cout, s.cin, depth,
              weight.data() + t * deep * wide_in);
  }
  // One row of the output's gradient: as rows of voxels, and for each tap along z as tiles of pairs
  // of voxels that are two apart.
  struct Row {
    Bf16* voxels;  // [2 high + 1][deep]
    Bf16* pairs[3];  // [column of tiles][long_z / 32] tiles
  };
  const int64_t voxels = (2 * high + 1) * deep, pairs = long_z * wide_out;
  ParallelFor(pool, s.b, [&](int64_t sample) {
    TileSession session;
    constexpr int kRows = 2 * kStrip + 1;  // of the output, for a strip
    Scratch<Bf16> buffer((3 * kRows + 1) * (voxels + 3 * pairs));
    Scratch<Bf16> left(kStrip * wide_in * long_z);
    Scratch<float> sum(high * wide_in), total(kTaps * wide_in * wide_out);
    const auto row_at = [&](int i) -> Row {
      Bf16* start = buffer.data() + i * (voxels + 3 * pairs);
      return {start, {start + voxels, start + voxels + pairs, start + voxels + 2 * pairs}};
    };
    const Row zero = row_at(3 * kRows);  // stays so
    const auto fill = [&](int64_t fine_x, int64_t fine_y, const Row& to) {
      CopyIn(dy + FineRow(s, sample, fine_x, fine_y) * s.cout, 2 * s.z, s.cout, deep, to.voxels);
      const int64_t column = long_z / kTileDepth * kTileSize;
      for (int t = 0; t < 3; ++t) {
        for (int64_t z = 0; z < s.z; z += 2) {
          const Bf16* first = to.voxels + (2 * z + t) * deep;
          const Bf16* second = to.voxels + std::min(2 * z + 2 + t, 2 * high) * deep;
          Bf16* pair = to.pairs[t] + z / kTileDepth * kTileSize + z % kTileDepth / 2 * 32;
          for (int64_t o = 0; o < wide_out; o += kLanes, pair += column) {
            for (int64_t l = 0; l < kLanes; ++l) {
              pair[2 * l] = first[o + l], pair[2 * l + 1] = second[o + l];
            }
          }
        }
      }
    };
    for (int64_t plane = 0; plane < s.x; ++plane) {
      Row rows[3][kRows];
      for (int i = 0; i < 3 * kRows; ++i) rows[i / kRows][i % kRows] = row_at(i);
      for (int64_t first = 0; first < s.y; first += kStrip) {
        const int count = static_cast<int>(std::min<int64_t>(kStrip, s.y - first));
        const Row* source[3][kRows];
        for (int a = 0; a < 3; ++a) {
          std::swap(rows[a][0], rows[a][kRows - 1]);  // the last one of the strip before
          for (int b = 0; b <= 2 * count; ++b) {
            const int64_t row = 2 * first + b;
            const bool there = 2 * plane + a < 2 * s.x && row < 2 * s.y;
            if (there && (b > 0 || first == 0)) fill(2 * plane + a, row, rows[a][b]);
            source[a][b] = there ? &rows[a][b] : &zero;
          }
        }
        const int64_t at = ((sample * s.x + plane) * s.y + first) * s.z * s.cin;
        for (int64_t n = 0; n < count * s.z; ++n) {
          Bf16* to = left.data() + n / s.z * wide_in * long_z + n % s.z;
          for (int64_t i = 0; i < s.cin; ++i) to[i * long_z] = x[at + n * s.cin + i];
        }
        for (int t = 0; t < kTaps; ++t) {
          const Bf16 *a[kStrip], *b[kStrip];
          for (int i = 0; i < count; ++i) {
            a[i] = left.data() + i * wide_in * long_z;
            b[i] = source[t / 9][2 * i + t / 3 % 3]->pairs[t % 3];
          }
          TileMultiply<true>(count, a, long_z, b, long_z / kTileDepth * kTileSize, wide_in,
                             long_z / kTileDepth, wide_out,
                             total.data() + t * wide_in * wide_out, wide_out);
        }
        for (int i = 0; i < count; ++i) {
          const Bf16 *a[kTaps], *b[kTaps];
          for (int t = 0; t < kTaps; ++t) {
            a[t] = source[t / 9][2 * i + t / 3 % 3]->voxels + t % 3 * deep;
            b[t] = weight.data() + t * deep * wide_in;
          }
          TileMultiply<false>(kTaps, a, 2 * deep, b, depth * kTileSize, high, depth, wide_in,
                              sum.data(), wide_in);
          CopyOut(sum.data(), wide_in, s.z, s.cin, dx + at + i * s.z * s.cin);
        }
      }
    }
    for (int64_t t = 0; t < kTaps; ++t) {
      CopyOut(total.data() + t * wide_in * wide_out, wide_out, s.cin, s.cout,
              dw + (sample * kTaps + t) * s.cin * s.cout);
    }
  });
}

#endif  // CVN_TILES

// ------------------------------------------------------------------------------------------------
// The convolution.

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

// The sums of 16 vectors' lanes, as one vector.
Vec SumLanes(Vec* v) {
  for (int n = 16; n > 1; n /= 2) {
    for (int i = 0; i < n / 2; ++i) {
      v[i] = AddNeighbours(v[2 * i], v[2 * i + 1], std::make_integer_sequence<int, 16>());
    }
  }
  return v[0];
}

// Sixteen voxels of one output: `from` are the taps' rows, `weight` is [27][wide].
template <typename Width>
Vec Convolve16(const float* const* from, const float* weight, Width wide) {
  Vec sum[16] = {};
  for (int t = 0; t < kTaps; ++t) {
    const float* row = from[t];
    for (int64_t c = 0; c < wide; c += kLanes) {
      const Vec factor = Load(weight + t * wide + c);
#pragma GCC unroll 16
      for (int i = 0; i < 16; ++i) sum[i] += Load(row + i * wide + c) * factor;
    }
  }
  return SumLanes(sum);
}

constexpr int64_t kSlab = 16;  // planes done in a row, which share their neighbours' copies

template <typename In>
void ConvRows(const Volume& s, const In* in, const float* w, ffi::ThreadPool& pool, float* out) {
  const int64_t nx = s.x, ny = s.y, nz = s.z;
  const int64_t wide = RoundUp(s.cin, kLanes), row_size = (RoundUp(nz, kLanes) + 2) * wide;
  Scratch<float> weight(s.cout * kTaps * wide);  // [out][27][in]
  for (int64_t t = 0; t < kTaps; ++t) {
    for (int64_t i = 0; i < s.cin; ++i) {
      for (int64_t o = 0; o < s.cout; ++o) {
        weight[(o * kTaps + t) * wide + i] = Rounded<In>(w[(t * s.cin + i) * s.cout + o]);
      }
    }
  }
  const int64_t slabs = (nx + kSlab - 1) / kSlab;
  ParallelFor(pool, s.b * slabs, [&](int64_t item) {
    const int64_t sample = item / slabs, first = item % slabs * kSlab;
    const int64_t last = std::min(first + kSlab, nx), size = (ny + 2) * row_size;
    Scratch<float> buffer(4 * size);  // planes with a margin of zeros; the last one stays zero
    const auto plane_at = [&](int64_t x) {
      return buffer.data() + (x < 0 || x >= nx ? 3 : x % 3) * size;
    };
    const auto fill = [&](int64_t x) {
      if (x < 0 || x >= nx) return;
      for (int64_t y = 0; y < ny; ++y) {
        CopyIn(in + ((sample * nx + x) * ny + y) * nz * s.cin, nz, s.cin, wide,
               plane_at(x) + (y + 1) * row_size + wide);
      }
    };
    fill(first - 1);
    fill(first);
    for (int64_t x = first; x < last; ++x) {
      fill(x + 1);
      const float* const planes[3] = {plane_at(x - 1), plane_at(x), plane_at(x + 1)};
      // Along y first: two thirds of what a voxel reads is then in the nearest cache.
      for (int64_t z = 0; z < nz; z += kLanes) {
        for (int64_t y = 0; y < ny; ++y) {
          const float* from[kTaps];
          for (int t = 0; t < kTaps; ++t) {
            from[t] = planes[t / 9] + (y + t / 3 % 3) * row_size + (z + t % 3) * wide;
          }
          float* to = out + (((sample * nx + x) * ny + y) * nz + z) * s.cout;
          for (int64_t o = 0; o < s.cout; ++o) {
            WithWidth(wide, [&](auto width) {
              const Vec sums = Convolve16(from, weight.data() + o * kTaps * wide, width);
              for (int64_t i = 0; i < std::min(kLanes, nz - z); ++i) to[i * s.cout + o] = sums[i];
            });
          }
        }
      }
    }
  });
}

// What eight voxels get from all taps: `from` are the taps' rows, `weight` is [taps][wide].
template <typename Width>
void Spread8(int64_t taps, const float* const* from, int64_t at, const float* weight, Width wide,
             float* to) {
  constexpr int64_t kVecs = 2;
  for (int64_t c = 0; c < wide; c += kVecs * kLanes) {
    const bool pair = wide - c >= kVecs * kLanes;
    Vec first[8] = {}, second[8] = {};
    for (int64_t n = 0; n < taps; ++n) {
      const float* left = from[n] + at;
      const Vec a = Load(weight + n * wide + c);
      const Vec b = pair ? Load(weight + n * wide + c + kLanes) : Vec{};
#pragma GCC unroll 8
      for (int i = 0; i < 8; ++i) {
        first[i] += left[i] * a;
        if (pair) second[i] += left[i] * b;
      }
    }
    for (int i = 0; i < 8; ++i) {
      Store(to + i * wide + c, first[i]);
      if (pair) Store(to + i * wide + c + kLanes, second[i]);
    }
  }
}

// The gradients of input and kernel, from that of the output; `dw` is [B, out, 27, in].
template <typename In>
void ConvGradients(const Volume& s, const In* in, const float* w, const float* dout,
                   ffi::ThreadPool& pool, In* din, float* dw) {
  const int64_t nx = s.x, ny = s.y, nz = s.z;
  const int64_t wide = RoundUp(s.cin, kLanes), long_z = RoundUp(nz, 8), row_size = long_z + 2;
  const int64_t taps = s.cout * kTaps;
  Scratch<float> weight(taps * wide);  // [out][27][in]
  for (int64_t t = 0; t < kTaps; ++t) {
    for (int64_t i = 0; i < s.cin; ++i) {
      for (int64_t o = 0; o < s.cout; ++o) {
        weight[(o * kTaps + t) * wide + i] = Rounded<In>(w[(t * s.cin + i) * s.cout + o]);
      }
    }
  }
  ParallelFor(pool, s.b, [&](int64_t sample) {
    const int64_t layer = (ny + 2) * row_size, size = s.cout * layer;
    Scratch<float> buffer(4 * size);  // [plane][out][y + 1][z + 1]; the last plane stays zero
    Scratch<float> row(nz * wide), sum(long_z * wide), total(taps * wide);
    const auto plane_at = [&](int64_t x) {
      return buffer.data() + (x < 0 || x >= nx ? 3 : x % 3) * size;
    };
    const auto fill = [&](int64_t x) {
      if (x < 0 || x >= nx) return;
      for (int64_t y = 0; y < ny; ++y) {
        const float* from = dout + ((sample * nx + x) * ny + y) * nz * s.cout;
        for (int64_t o = 0; o < s.cout; ++o) {
          float* to = plane_at(x) + o * layer + (y + 1) * row_size + 1;
          for (int64_t z = 0; z < nz; ++z) to[z] = Rounded<In>(from[z * s.cout + o]);
        }
      }
    };
    fill(0);
    std::vector<const float*> from(taps);
    for (int64_t x = 0; x < nx; ++x) {
      fill(x + 1);
      for (int64_t y = 0; y < ny; ++y) {
        for (int64_t n = 0; n < taps; ++n) {
          const int64_t o = n / kTaps, t = n % kTaps;
          from[n] = plane_at(x + 1 - t / 9) + o * layer + (y + 2 - t / 3 % 3) * row_size + 2 - t % 3;
        }
        const int64_t at = ((sample * nx + x) * ny + y) * nz * s.cin;
        CopyIn(in + at, nz, s.cin, wide, row.data());
        for (int64_t c = 0; c < wide; c += kLanes) {
          for (int64_t n = 0; n < taps; n += 9) {
            Vec part[9];
            for (int i = 0; i < 9; ++i) part[i] = Load(total.data() + (n + i) * wide + c);
            for (int64_t z = 0; z < nz; ++z) {
              const Vec value = Load(row.data() + z * wide + c);
#pragma GCC unroll 9
              for (int i = 0; i < 9; ++i) part[i] += from[n + i][z] * value;
            }
            for (int i = 0; i < 9; ++i) Store(total.data() + (n + i) * wide + c, part[i]);
          }
        }
        WithWidth(wide, [&](auto width) {
          for (int64_t z = 0; z < long_z; z += 8) {
            Spread8(taps, from.data(), z, weight.data(), width, sum.data() + z * wide);
          }
        });
        CopyOut(sum.data(), wide, nz, s.cin, din + at);
      }
    }
    for (int64_t n = 0; n < taps; ++n) {
      std::memcpy(dw + (sample * taps + n) * s.cin, total.data() + n * wide,
                  s.cin * sizeof(float));
    }
  });
}

// ------------------------------------------------------------------------------------------------
// Batch normalisation and the activation after it, of maps [B, ..., C]: y = f(gain x + offset).
//
// A map is read as vectors of 16 floats, whatever C is: after a period of lcm(C, 16) floats the
// channels come round again. Sums are a sample's; over its pieces they are made in double.

enum Activation : int64_t { kIdentity = 0, kElu = 1, kSigmoid = 2 };

CVN_INLINE Vec Select(Ints mask, Vec a, Vec b) {
  return reinterpret_cast<Vec>((mask & reinterpret_cast<Ints>(a)) |
                               (~mask & reinterpret_cast<Ints>(b)));
}

// e^x to two units in the last place: 2^n e^r, |r| <= ln(2) / 2, and Taylor's polynomial.
CVN_INLINE Vec Exp(Vec x) {
  x = Select(x < -87.0f, Vec{} - 87.0f, x);
  x = Select(x > 88.0f, Vec{} + 88.0f, x);
  const float kShift = 12582912.0f;  // 1.5 2^23: adding it rounds to a whole number
  const Vec shifted = x * 1.44269504f + kShift;
  const Vec n = shifted - kShift;
  const Vec r = x - n * 0.693359375f + n * 2.12194440e-4f;
  Vec p = r * (1.0f / 5040) + 1.0f / 720;
  p = p * r + 1.0f / 120;
  p = p * r + 1.0f / 24;
  p = p * r + 1.0f / 6;
  p = p * r + 0.5f;
  p = p * (r * r) + r + 1.0f;
  const Ints power = reinterpret_cast<Ints>(shifted) << 23;  // n in the lowest bits
  return reinterpret_cast<Vec>(reinterpret_cast<Ints>(p) + power);
}

// Value and slope of an activation.
template <Activation kActivation>
CVN_INLINE void Activate(Vec v, Vec* value, Vec* slope) {
  const Vec one = Vec{} + 1.0f;
  if constexpr (kActivation == kElu) {
    const Vec e = Exp(Select(v > 0.0f, Vec{}, v));
    *value = Select(v > 0.0f, v, e - one);
    *slope = e;  // 1 above 0
  } else if constexpr (kActivation == kSigmoid) {
    *value = one / (one + Exp(-v));
    *slope = *value * (one - *value);
  } else {
    *value = v;
    *slope = one;
  }
}

template <typename F>
void WithActivation(int64_t activation, const F& f) {
  switch (activation) {
    case kElu: return f(std::integral_constant<Activation, kElu>());
    case kSigmoid: return f(std::integral_constant<Activation, kSigmoid>());
    default: return f(std::integral_constant<Activation, kIdentity>());
  }
}

constexpr int64_t kPiece = 1 << 15;  // floats handled at a time, about

// A map's pieces: whole periods of one sample, so that each begins with channel 0.
struct Pieces {
  int64_t samples, channels, size;  // floats of a sample
  int64_t period, piece, count;     // floats, floats, pieces of a sample

  explicit Pieces(const AnyArray& x)
      : samples(x.dimensions()[0]),
        channels(x.dimensions().back()),
        size(static_cast<int64_t>(x.element_count()) / std::max<int64_t>(samples, 1)) {
    for (period = kLanes; period % channels;) period += kLanes;
    piece = RoundUp(kPiece, period);
    count = (size + piece - 1) / piece;
  }

  // Each channel's value, repeated over a period.
  Scratch<float> Repeat(const float* values) const {
    Scratch<float> repeated(period);
    for (int64_t i = 0; i < period; ++i) repeated[i] = values[i % channels];
    return repeated;
  }

  int64_t Begin(int64_t item) const { return item / count * size + item % count * piece; }
  int64_t End(int64_t item) const {
    return item / count * size + std::min(item % count * piece + piece, size);
  }
};

// Calls f with the number of vectors of a period, which the compiler then knows, or with 1.
template <typename F>
void WithVectors(int64_t period, const F& f) {
  switch (period / kLanes) {
    case 2: return f(std::integral_constant<int, 2>());
    case 3: return f(std::integral_constant<int, 3>());
    case 4: return f(std::integral_constant<int, 4>());
    default: return f(std::integral_constant<int, 1>());
  }
}

// Calls f(place in the map, vector of the period, floats: 16 or the rest) for a piece, whose period
// has kVecs vectors or, where kVecs is 1, any number.
template <int kVecs, typename F>
CVN_INLINE void ForVectors(const Pieces& p, int64_t item, const F& f) {
  int64_t i = p.Begin(item);
  const int64_t end = p.End(item), all = kVecs == 1 ? p.period / kLanes : kVecs;
  if (all == kVecs) {
    for (; i + kVecs * kLanes <= end; i += kVecs * kLanes) {
#pragma GCC unroll 4
      for (int v = 0; v < kVecs; ++v) f(i + v * kLanes, v, kLanes);
    }
  }
  for (int64_t v = 0; i < end; i += kLanes, v = v + 1 == all ? 0 : v + 1) {
    f(i, v, std::min(kLanes, end - i));
  }
}

template <typename T>
CVN_INLINE Vec LoadSome(const T* p, int64_t n) {
  PrefetchAfter(p, kLanes);
  if (n == kLanes) return Load(p);
  Vec v = {};
  Copy(p, n, reinterpret_cast<float*>(&v));
  return v;
}

template <typename T>
CVN_INLINE void StoreSome(T* p, Vec v, int64_t n) {
  if (n == kLanes) {
    Store(p, v);
  } else {
    Copy(reinterpret_cast<const float*>(&v), n, p);
  }
}

// Two sums over each sample's places, by channel: `sums` is [B, 2, C], and f(place, vector of the
// period, floats, first, second) adds to vectors.
template <typename F>
void SumTwo(const Pieces& p, ffi::ThreadPool& pool, float* sums, const F& f) {
  Scratch<double> parts(p.samples * p.count * 2 * p.channels);
  WithVectors(p.period, [&](auto vecs) {
    ParallelFor(pool, p.samples * p.count, [&](int64_t item) {
      Scratch<float> memory(2 * p.period);  // of periods that are longer than registers go
      float *first = memory.data(), *second = first + p.period;
      Vec sum[2][vecs] = {};
      ForVectors<vecs>(p, item, [&](int64_t at, int64_t v, int64_t n) {
        if (vecs > 1 || p.period == kLanes) return f(at, v, n, &sum[0][v], &sum[1][v]);
        Vec a = Load(first + v * kLanes), b = Load(second + v * kLanes);
        f(at, v, n, &a, &b);
        Store(first + v * kLanes, a);
        Store(second + v * kLanes, b);
      });
      if (vecs > 1 || p.period == kLanes) {
        for (int v = 0; v < vecs; ++v) {
          Store(first + v * kLanes, sum[0][v]);
          Store(second + v * kLanes, sum[1][v]);
        }
      }
      double* part = &parts[item * 2 * p.channels];
      for (int64_t i = 0; i < p.period; ++i) {
        part[i % p.channels] += first[i];
        part[p.channels + i % p.channels] += second[i];
      }
    });
  });
  for (int64_t sample = 0; sample < p.samples; ++sample) {
    for (int64_t c = 0; c < 2 * p.channels; ++c) {
      double sum = 0;
      for (int64_t i = 0; i < p.count; ++i) {
        sum += parts[(sample * p.count + i) * 2 * p.channels + c];
      }
      sums[sample * 2 * p.channels + c] = static_cast<float>(sum);
    }
  }
}

// Calls f(place, vector of the period, floats) for all of a map.
template <typename F>
void ForAll(const Pieces& p, ffi::ThreadPool& pool, const F& f) {
  WithVectors(p.period, [&](auto vecs) {
    ParallelFor(pool, p.samples * p.count, [&](int64_t item) { ForVectors<vecs>(p, item, f); });
  });
}

// ------------------------------------------------------------------------------------------------
// What XLA calls.

// Calls f with pointers of the elements' type, after the first of them.
template <typename F>
ffi::Error WithType(const AnyArray& x, const F& f) {
  switch (x.element_type()) {
    case ffi::F32: f(static_cast<float*>(nullptr)); break;
    case ffi::BF16: f(static_cast<Bf16*>(nullptr)); break;
    default: return ffi::Error::InvalidArgument("volumes must be of float32 or bfloat16");
  }
  return ffi::Error::Success();
}

template <typename T>
T* Data(const AnyArray& x, T*) {
  return static_cast<T*>(const_cast<void*>(x.untyped_data()));
}

Volume VolumeOf(const AnyArray& x, const Array& w) {
  const auto d = x.dimensions(), k = w.dimensions();
  return {d[0], d[1], d[2], d[3], k[3], k[4]};
}

ffi::Error Deconv(ffi::ThreadPool pool, AnyArray x, Array w, AnyResult y) {
  const Volume s = VolumeOf(x, w);
  const float* weight = w.typed_data();
  return WithType(x, [&](auto* in) {
    WithType(*y, [&](auto* out) {
#if CVN_TILES
      if constexpr (std::is_same_v<decltype(in), Bf16*>) {
        if (TilesAllowed()) {
          return TileDeconvRows(s, Data(x, in), weight, pool, Data(*y, out));
        }
      }
#endif
      DeconvRows(s, Data(x, in), weight, pool, Data(*y, out));
    });
  });
}

ffi::Error DeconvGradient(ffi::ThreadPool pool, AnyArray x, Array w, AnyArray dy, AnyResult dx,
                          Result dw) {
  const Volume s = VolumeOf(x, w);
  const float* weight = w.typed_data();
  float* dweight = dw->typed_data();
  return WithType(x, [&](auto* in) {
    WithType(dy, [&](auto* out) {
#if CVN_TILES
      if constexpr (std::is_same_v<decltype(in), Bf16*>) {
        if (TilesAllowed()) {
          return TileDeconvGradients(s, Data(x, in), weight, Data(dy, out), pool, Data(*dx, in),
                                     dweight);
        }
      }
#endif
      DeconvGradients(s, Data(x, in), weight, Data(dy, out), pool, Data(*dx, in), dweight);
    });
  });
}

ffi::Error Conv(ffi::ThreadPool pool, AnyArray z, Array w, Result o) {
  return WithType(z, [&](auto* in) {
    ConvRows(VolumeOf(z, w), Data(z, in), w.typed_data(), pool, o->typed_data());
  });
}

ffi::Error ConvGradient(ffi::ThreadPool pool, AnyArray z, Array w, Array dout, AnyResult dz,
                        Result dw) {
  return WithType(z, [&](auto* in) {
    ConvGradients(VolumeOf(z, w), Data(z, in), w.typed_data(), dout.typed_data(), pool,
                  Data(*dz, in), dw->typed_data());
  });
}

// Sums of x and of x squared.
ffi::Error Moments(ffi::ThreadPool pool, AnyArray x, Result sums) {
  return WithType(x, [&](auto* type) {
    const auto* in = Data(x, type);
    SumTwo(Pieces(x), pool, sums->typed_data(),
           [&](int64_t at, int64_t, int64_t n, Vec* first, Vec* second) {
             const Vec v = LoadSome(in + at, n);
             *first += v;
             *second += v * v;
           });
  });
}

ffi::Error Activated(ffi::ThreadPool pool, AnyArray x, Array gain, Array offset, AnyResult y,
                     int64_t activation) {
  const Pieces p(x);
  Scratch<float> g = p.Repeat(gain.typed_data()), o = p.Repeat(offset.typed_data());
  return WithType(x, [&](auto* type) {
    const auto* in = Data(x, type);
    auto* out = Data(*y, type);
    WithActivation(activation, [&](auto kind) {
      ForAll(p, pool, [&, g = g.data(), o = o.data()](int64_t at, int64_t i, int64_t n) {
        Vec value, slope;
        Activate<kind>(LoadSome(in + at, n) * Load(g + i * kLanes) + Load(o + i * kLanes), &value,
                       &slope);
        StoreSome(out + at, value, n);
      });
    });
  });
}

// Sums of dz and of dz x, for dz = dy f'(gain x + offset).
ffi::Error GradientSums(ffi::ThreadPool pool, AnyArray x, AnyArray dy, Array gain, Array offset,
                        Result sums, int64_t activation) {
  const Pieces p(x);
  Scratch<float> g = p.Repeat(gain.typed_data()), o = p.Repeat(offset.typed_data());
  return WithType(x, [&](auto* type) {
    const auto *in = Data(x, type), *din = Data(dy, type);
    WithActivation(activation, [&](auto kind) {
      SumTwo(p, pool, sums->typed_data(),
             [&, g = g.data(), o = o.data()](int64_t at, int64_t i, int64_t n, Vec* first,
                                             Vec* second) {
               const Vec v = LoadSome(in + at, n);
               Vec value, slope;
               Activate<kind>(v * Load(g + i * kLanes) + Load(o + i * kLanes), &value, &slope);
               const Vec dz = LoadSome(din + at, n) * slope;
               *first += dz;
               *second += dz * v;
             });
    });
  });
}

// dx = gain dz + slope x + constant.
ffi::Error InputGradient(ffi::ThreadPool pool, AnyArray x, AnyArray dy, Array gain, Array offset,
                         Array slope, Array constant, AnyResult dx, int64_t activation) {
  const Pieces p(x);
  Scratch<float> g = p.Repeat(gain.typed_data()), o = p.Repeat(offset.typed_data());
  Scratch<float> s = p.Repeat(slope.typed_data()), c = p.Repeat(constant.typed_data());
  return WithType(x, [&](auto* type) {
    const auto *in = Data(x, type), *din = Data(dy, type);
    auto* out = Data(*dx, type);
    WithActivation(activation, [&](auto kind) {
      ForAll(p, pool, [&, g = g.data(), o = o.data(), s = s.data(), c = c.data()](
                          int64_t at, int64_t i, int64_t n) {
        const Vec v = LoadSome(in + at, n), gained = Load(g + i * kLanes);
        Vec value, f;
        Activate<kind>(v * gained + Load(o + i * kLanes), &value, &f);
        const Vec dz = LoadSome(din + at, n) * f;
        StoreSome(out + at, gained * dz + Load(s + i * kLanes) * v + Load(c + i * kLanes), n);
      });
    });
  });
}

}  // namespace

#define CVN_KERNEL(name, function) \
  XLA_FFI_DEFINE_HANDLER_SYMBOL(name, function, ffi::Ffi::Bind().Ctx<ffi::ThreadPool>()

CVN_KERNEL(cvn_deconv, Deconv).Arg<AnyArray>().Arg<Array>().Ret<AnyArray>());
CVN_KERNEL(cvn_deconv_gradient, DeconvGradient)
    .Arg<AnyArray>().Arg<Array>().Arg<AnyArray>().Ret<AnyArray>().Ret<Array>());
CVN_KERNEL(cvn_conv, Conv).Arg<AnyArray>().Arg<Array>().Ret<Array>());
CVN_KERNEL(cvn_conv_gradient, ConvGradient)
    .Arg<AnyArray>().Arg<Array>().Arg<Array>().Ret<AnyArray>().Ret<Array>());
CVN_KERNEL(cvn_moments, Moments).Arg<AnyArray>().Ret<Array>());
CVN_KERNEL(cvn_activated, Activated)
    .Arg<AnyArray>().Arg<Array>().Arg<Array>().Ret<AnyArray>().Attr<int64_t>("activation"));
CVN_KERNEL(cvn_gradient_sums, GradientSums)
    .Arg<AnyArray>().Arg<AnyArray>().Arg<Array>().Arg<Array>().Ret<Array>()
    .Attr<int64_t>("activation"));
CVN_KERNEL(cvn_input_gradient, InputGradient)
    .Arg<AnyArray>().Arg<AnyArray>().Arg<Array>().Arg<Array>().Arg<Array>().Arg<Array>()
    .Ret<AnyArray>().Attr<int64_t>("activation"));
