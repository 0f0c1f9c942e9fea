// The deconvolution and the convolution of cvn/deconv.py, with their gradients, for a CPU.
//
// Volumes are [B, X, Y, Z, C], kernels [3, 3, 3, in, out], all float32. Sums are made in float32.
// With `mixed`, the factors of every product are rounded to bfloat16 first; the deconvolution then
// runs on tile units (AMX) where the processor has them.
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

namespace {

constexpr int64_t kLanes = 16;
constexpr int64_t kTaps = 27;
typedef float Vec __attribute__((vector_size(64), may_alias));
typedef float Loose __attribute__((vector_size(64), aligned(4), may_alias));  // anywhere in memory

Vec Load(const float* p) { return *reinterpret_cast<const Loose*>(p); }
void Store(float* p, Vec v) { *reinterpret_cast<Loose*>(p) = v; }
int64_t RoundUp(int64_t n, int64_t multiple) { return (n + multiple - 1) / multiple * multiple; }

uint16_t ToBf16(float x) {  // to the nearest, ties to even; a NaN stays one
  uint32_t u;
  std::memcpy(&u, &x, 4);
  return x != x ? 0x7fc0 : (u + 0x7fff + ((u >> 16) & 1)) >> 16;
}

float Rounded(float x) {
  uint32_t u = uint32_t{ToBf16(x)} << 16;
  std::memcpy(&x, &u, 4);
  return x;
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

// [rows][padded] -> [rows][channels].
void CopyOut(const float* from, int64_t padded, int64_t rows, int64_t channels, float* to) {
  WithChannels(channels, [&](auto n) {
    for (int64_t i = 0; i < rows; ++i) std::memcpy(to + i * n, from + i * padded, n * sizeof(float));
  });
}

// [rows][channels] -> [rows][padded]; the padding is not touched.
void CopyIn(const float* from, int64_t rows, int64_t channels, bool mixed, int64_t padded,
            float* to) {
  WithChannels(channels, [&](auto n) {
    for (int64_t i = 0; i < rows; ++i) {
      if (mixed) {
        for (int64_t c = 0; c < n; ++c) to[i * padded + c] = Rounded(from[i * n + c]);
      } else {
        std::memcpy(to + i * padded, from + i * n, n * sizeof(float));
      }
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

// C [m][n] += A^T B for A [k][m], B's rows `b_stride` apart: kRows rows of C, kVecs vectors wide.
template <int kRows, int kVecs>
void OuterBlock(const float* a, int64_t a_stride, const float* b, int64_t b_stride, int64_t k,
                float* c, int64_t c_stride) {
  Vec sum[kRows][kVecs];
  for (int m = 0; m < kRows; ++m) {
    for (int v = 0; v < kVecs; ++v) sum[m][v] = Load(c + m * c_stride + v * kLanes);
  }
  for (int64_t i = 0; i < k; ++i, a += a_stride, b += b_stride) {
    Vec right[kVecs];
#pragma GCC unroll 4
    for (int v = 0; v < kVecs; ++v) right[v] = Load(b + v * kLanes);
#pragma GCC unroll 16
    for (int m = 0; m < kRows; ++m) {
#pragma GCC unroll 4
      for (int v = 0; v < kVecs; ++v) sum[m][v] += a[m] * right[v];
    }
  }
  for (int m = 0; m < kRows; ++m) {
    for (int v = 0; v < kVecs; ++v) Store(c + m * c_stride + v * kLanes, sum[m][v]);
  }
}

// C [m][n] += sum over i < k of A[i][m] B[i][n]; m is a multiple of 8, n of kLanes.
void AddOuter(const float* a, int64_t a_stride, const float* b, int64_t b_stride, int64_t k,
              int64_t m, int64_t n, float* c, int64_t c_stride) {
  for (int64_t j = 0; j < n;) {
    const bool wide = n - j >= 2 * kLanes;
    for (int64_t i = 0; i < m; i += 8) {
      float* out = c + i * c_stride + j;
      if (wide) {
        OuterBlock<8, 2>(a + i, a_stride, b + j, b_stride, k, out, c_stride);
      } else {
        OuterBlock<8, 1>(a + i, a_stride, b + j, b_stride, k, out, c_stride);
      }
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
void TileBlock(int taps, const uint16_t* const* a, int64_t a_stride, const uint16_t* const* b,
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
      const uint16_t* left = a[t] + s * kTileDepth;
      const uint16_t* right = b[t] + s * kTileSize;
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
void TileMultiply(int taps, const uint16_t* const* a, int64_t a_stride, const uint16_t* const* b,
                  int64_t b_stride, int64_t rows, int64_t depth, int64_t n, float* c,
                  int64_t c_stride) {
  const uint16_t *left[kMaxTaps], *right[kMaxTaps];
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
               int64_t depth, uint16_t* to) {
  for (int64_t j = 0; j < n; ++j) {
    for (int64_t i = 0; i < k; ++i) {
      const int64_t tile = j / kLanes * depth + i / kTileDepth;
      const int64_t row = i % kTileDepth / 2, column = j % kLanes * 2 + i % 2;
      to[tile * kTileSize + row * kTileDepth + column] =
          ToBf16(from[i * k_stride + j * n_stride]);
    }
  }
}

// [rows][channels] -> [rows][padded]; the padding is not touched.
void ToBf16Rows(const float* from, int64_t rows, int64_t channels, int64_t padded, uint16_t* to) {
  WithChannels(channels, [&](auto n) {
    for (int64_t i = 0; i < rows; ++i) {
      for (int64_t c = 0; c < n; ++c) to[i * padded + c] = ToBf16(from[i * n + c]);
    }
  });
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

void DeconvRows(const Volume& s, const float* x, const float* w, bool mixed, ffi::ThreadPool& pool,
                float* out) {
  const int64_t wide = RoundUp(s.cout, kLanes);
  Scratch<float> weight(kTaps * s.cin * wide);
  CopyIn(w, kTaps * s.cin, s.cout, mixed, wide, weight.data());
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
        CopyIn(x + ((item - i) * s.y + y) * s.z * s.cin, s.z, s.cin, mixed, s.cin,
               rows[i][0] + s.cin);
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

// The gradients of input and kernel, from that of the output; `dw` is [B, 27, in, out].
void DeconvGradients(const Volume& s, const float* x, const float* w, const float* dy, bool mixed,
                     ffi::ThreadPool& pool, float* dx, float* dw) {
  const int64_t wide_in = RoundUp(s.cin, kLanes), wide_out = RoundUp(s.cout, kLanes);
  Scratch<float> weight(kTaps * s.cout * wide_in);  // [27][out][in]
  for (int64_t t = 0; t < kTaps; ++t) {
    for (int64_t i = 0; i < s.cin; ++i) {
      for (int64_t o = 0; o < s.cout; ++o) {
        const float value = w[(t * s.cin + i) * s.cout + o];
        weight[(t * s.cout + o) * wide_in + i] = mixed ? Rounded(value) : value;
      }
    }
  }
  ParallelFor(pool, s.b, [&](int64_t sample) {
    const int64_t size = (2 * s.z + 1) * wide_out;  // a row's buffer ends with a voxel of zeros
    Scratch<float> buffer(9 * size), zero(size), left(s.z * wide_in), sum(s.z * wide_in);
    Scratch<float> total(kTaps * wide_in * wide_out);
    for (int64_t plane = 0; plane < s.x; ++plane) {
      float* rows[3][3];  // output rows 2 x + a, 2 y + b
      for (int i = 0; i < 9; ++i) rows[i / 3][i % 3] = buffer.data() + i * size;
      const auto fill = [&](int64_t a, int64_t row, float* to) {
        const int64_t at = FineRow(s, sample, 2 * plane + a, row) * s.cout;
        CopyIn(dy + at, 2 * s.z, s.cout, mixed, wide_out, to);
      };
      for (int64_t y = 0; y < s.y; ++y) {
        const float* source[3][3];
        for (int a = 0; a < 3; ++a) {
          std::swap(rows[a][0], rows[a][2]);
          for (int b = 0; b < 3; ++b) {
            const bool there = 2 * plane + a < 2 * s.x && 2 * y + b < 2 * s.y;
            if (there && (b > 0 || y == 0)) fill(a, 2 * y + b, rows[a][b]);
            source[a][b] = there ? rows[a][b] : zero.data();
          }
        }
        const int64_t at = ((sample * s.x + plane) * s.y + y) * s.z * s.cin;
        CopyIn(x + at, s.z, s.cin, mixed, wide_in, left.data());
        const float *a[kTaps], *b[kTaps];
        for (int t = 0; t < kTaps; ++t) {
          a[t] = source[t / 9][t / 3 % 3] + t % 3 * wide_out;
          b[t] = weight.data() + t * s.cout * wide_in;
          AddOuter(left.data(), wide_in, a[t], 2 * wide_out, s.z, RoundUp(s.cin, 8), wide_out,
                   total.data() + t * wide_in * wide_out, wide_out);
        }
        Multiply(kTaps, a, 2 * wide_out, b, wide_in, s.z, s.cout, wide_in, sum.data(), wide_in);
        CopyOut(sum.data(), wide_in, s.z, s.cin, dx + at);
      }
    }
    for (int64_t t = 0; t < kTaps; ++t) {
      CopyOut(total.data() + t * wide_in * wide_out, wide_out, s.cin, s.cout,
              dw + (sample * kTaps + t) * s.cin * s.cout);
    }
  });
}

#if CVN_TILES

void TileDeconvRows(const Volume& s, const float* x, const float* w, ffi::ThreadPool& pool,
                    float* out) {
  const int64_t wide = RoundUp(s.cout, kLanes), deep = RoundUp(s.cin, kTileDepth);
  const int64_t depth = deep / kTileDepth, high = RoundUp(s.z, kTileRows);
  Scratch<uint16_t> weight(kTaps * deep * wide);
  for (int64_t t = 0; t < kTaps; ++t) {
    PackTiles(w + t * s.cin * s.cout, s.cout, 1, s.cin, s.cout, depth,
              weight.data() + t * deep * wide);
  }
  ParallelFor(pool, s.b * s.x, [&](int64_t item) {
    TileSession session;
    const int64_t plane = item % s.x, size = (high + 1) * deep;
    Scratch<uint16_t> buffer(4 * size);
    Scratch<float> sum(2 * high * wide);
    uint16_t* rows[2][2];
    for (int i = 0; i < 4; ++i) rows[i / 2][i % 2] = buffer.data() + i * size;
    for (int64_t y = 0; y < s.y; ++y) {
      for (int i = 0; i < 2; ++i) {
        std::swap(rows[i][0], rows[i][1]);
        if (plane < i) continue;
        ToBf16Rows(x + ((item - i) * s.y + y) * s.z * s.cin, s.z, s.cin, deep, rows[i][0] + deep);
      }
      for (int phase = 0; phase < 8; ++phase) {
        const uint16_t *a[8], *b[8];
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

void TileDeconvGradients(const Volume& s, const float* x, const float* w, const float* dy,
                         ffi::ThreadPool& pool, float* dx, float* dw) {
  const int64_t wide_in = RoundUp(s.cin, kLanes), wide_out = RoundUp(s.cout, kLanes);
  const int64_t deep = RoundUp(s.cout, kTileDepth), depth = deep / kTileDepth;
  const int64_t high = RoundUp(s.z, kTileRows), long_z = RoundUp(s.z, kTileDepth);
  Scratch<uint16_t> weight(kTaps * deep * wide_in);
  for (int64_t t = 0; t < kTaps; ++t) {
    PackTiles(w + t * s.cin * s.cout, 1, s.cout, s.cout, s.cin, depth,
              weight.data() + t * deep * wide_in);
  }
  // One row of the output's gradient: as rows of voxels, and for each tap along z as tiles of pairs
  // of voxels that are two apart.
  struct Row {
    uint16_t* voxels;  // [2 high + 1][deep]
    uint16_t* pairs[3];  // [column of tiles][long_z / 32] tiles
  };
  const int64_t voxels = (2 * high + 1) * deep, pairs = long_z * wide_out;
  ParallelFor(pool, s.b, [&](int64_t sample) {
    TileSession session;
    Scratch<uint16_t> buffer(10 * (voxels + 3 * pairs)), left(wide_in * long_z);
    Scratch<float> sum(high * wide_in), total(kTaps * wide_in * wide_out);
    Row all[10];  // the last one stays zero
    for (int i = 0; i < 10; ++i) {
      uint16_t* start = buffer.data() + i * (voxels + 3 * pairs);
      all[i] = {start, {start + voxels, start + voxels + pairs, start + voxels + 2 * pairs}};
    }
    for (int64_t plane = 0; plane < s.x; ++plane) {
      Row rows[3][3];
      for (int i = 0; i < 9; ++i) rows[i / 3][i % 3] = all[i];
      const auto fill = [&](int64_t a, int64_t row, const Row& to) {
        const int64_t at = FineRow(s, sample, 2 * plane + a, row) * s.cout;
        ToBf16Rows(dy + at, 2 * s.z, s.cout, deep, to.voxels);
        const int64_t column = long_z / kTileDepth * kTileSize;
        for (int t = 0; t < 3; ++t) {
          for (int64_t z = 0; z < s.z; z += 2) {
            const uint16_t* first = to.voxels + (2 * z + t) * deep;
            const uint16_t* second = to.voxels + std::min(2 * z + 2 + t, 2 * high) * deep;
            uint16_t* pair = to.pairs[t] + z / kTileDepth * kTileSize + z % kTileDepth / 2 * 32;
            for (int64_t o = 0; o < wide_out; o += kLanes, pair += column) {
              for (int64_t l = 0; l < kLanes; ++l) {
                pair[2 * l] = first[o + l], pair[2 * l + 1] = second[o + l];
              }
            }
          }
        }
      };
      for (int64_t y = 0; y < s.y; ++y) {
        const Row* source[3][3];
        for (int a = 0; a < 3; ++a) {
          std::swap(rows[a][0], rows[a][2]);
          for (int b = 0; b < 3; ++b) {
            const bool there = 2 * plane + a < 2 * s.x && 2 * y + b < 2 * s.y;
            if (there && (b > 0 || y == 0)) fill(a, 2 * y + b, rows[a][b]);
            source[a][b] = there ? &rows[a][b] : &all[9];
          }
        }
        const int64_t at = ((sample * s.x + plane) * s.y + y) * s.z * s.cin;
        for (int64_t z = 0; z < s.z; ++z) {
          for (int64_t i = 0; i < s.cin; ++i) left[i * long_z + z] = ToBf16(x[at + z * s.cin + i]);
        }
        const uint16_t *a[kTaps], *b[kTaps];
        for (int t = 0; t < kTaps; ++t) {
          const Row& row = *source[t / 9][t / 3 % 3];
          a[t] = row.voxels + t % 3 * deep;
          b[t] = weight.data() + t * deep * wide_in;
          const uint16_t *from = left.data(), *with = row.pairs[t % 3];
          TileMultiply<true>(1, &from, long_z, &with, long_z / kTileDepth * kTileSize, wide_in,
                             long_z / kTileDepth, wide_out,
                             total.data() + t * wide_in * wide_out, wide_out);
        }
        TileMultiply<false>(kTaps, a, 2 * deep, b, depth * kTileSize, high, depth, wide_in,
                            sum.data(), wide_in);
        CopyOut(sum.data(), wide_in, s.z, s.cin, dx + at);
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
  return __builtin_shufflevector(a, b, 2 * kIndex...) +
         __builtin_shufflevector(a, b, (2 * kIndex + 1)...);
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
Vec Convolve16(const float* const* from, int64_t at, const float* weight, Width wide) {
  Vec sum[16] = {};
  for (int t = 0; t < kTaps; ++t) {
    const float* row = from[t] + at;
    for (int64_t c = 0; c < wide; c += kLanes) {
      const Vec factor = Load(weight + t * wide + c);
#pragma GCC unroll 16
      for (int i = 0; i < 16; ++i) sum[i] += Load(row + i * wide + c) * factor;
    }
  }
  return SumLanes(sum);
}

constexpr int64_t kSlab = 16;  // planes done in a row, which share their neighbours' copies

void ConvRows(const Volume& s, const float* in, const float* w, bool mixed, ffi::ThreadPool& pool,
              float* out) {
  const int64_t nx = s.x, ny = s.y, nz = s.z;
  const int64_t wide = RoundUp(s.cin, kLanes), row_size = (RoundUp(nz, kLanes) + 2) * wide;
  Scratch<float> weight(s.cout * kTaps * wide);  // [out][27][in]
  for (int64_t t = 0; t < kTaps; ++t) {
    for (int64_t i = 0; i < s.cin; ++i) {
      for (int64_t o = 0; o < s.cout; ++o) {
        const float value = w[(t * s.cin + i) * s.cout + o];
        weight[(o * kTaps + t) * wide + i] = mixed ? Rounded(value) : value;
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
        CopyIn(in + ((sample * nx + x) * ny + y) * nz * s.cin, nz, s.cin, mixed, wide,
               plane_at(x) + (y + 1) * row_size + wide);
      }
    };
    fill(first - 1);
    fill(first);
    for (int64_t x = first; x < last; ++x) {
      fill(x + 1);
      for (int64_t y = 0; y < ny; ++y) {
        float* to = out + ((sample * nx + x) * ny + y) * nz * s.cout;
        const float* from[kTaps];
        for (int t = 0; t < kTaps; ++t) {
          from[t] = plane_at(x + t / 9 - 1) + (y + t / 3 % 3) * row_size + t % 3 * wide;
        }
        for (int64_t o = 0; o < s.cout; ++o) {
          for (int64_t z = 0; z < nz; z += kLanes) {
            WithWidth(wide, [&](auto width) {
              const Vec sums = Convolve16(from, z * wide, weight.data() + o * kTaps * wide, width);
              for (int64_t i = 0; i < std::min(kLanes, nz - z); ++i) {
                to[(z + i) * s.cout + o] = sums[i];
              }
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
void ConvGradients(const Volume& s, const float* in, const float* w, const float* dout, bool mixed,
                   ffi::ThreadPool& pool, float* din, float* dw) {
  const int64_t nx = s.x, ny = s.y, nz = s.z;
  const int64_t wide = RoundUp(s.cin, kLanes), long_z = RoundUp(nz, 8), row_size = long_z + 2;
  const int64_t taps = s.cout * kTaps;
  Scratch<float> weight(taps * wide);  // [out][27][in]
  for (int64_t t = 0; t < kTaps; ++t) {
    for (int64_t i = 0; i < s.cin; ++i) {
      for (int64_t o = 0; o < s.cout; ++o) {
        const float value = w[(t * s.cin + i) * s.cout + o];
        weight[(o * kTaps + t) * wide + i] = mixed ? Rounded(value) : value;
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
          for (int64_t z = 0; z < nz; ++z) {
            const float value = from[z * s.cout + o];
            to[z] = mixed ? Rounded(value) : value;
          }
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
        CopyIn(in + at, nz, s.cin, mixed, wide, row.data());
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
typedef int32_t Ints __attribute__((vector_size(64)));

Vec Select(Ints mask, Vec a, Vec b) {
  return reinterpret_cast<Vec>((mask & reinterpret_cast<Ints>(a)) |
                               (~mask & reinterpret_cast<Ints>(b)));
}

// e^x to two units in the last place: 2^n e^r, |r| <= ln(2) / 2, and Taylor's polynomial.
Vec Exp(Vec x) {
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
void Activate(Vec v, Vec* value, Vec* slope) {
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

  Pieces(const Array& x)
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

  // Calls f(vector's place in the map, its place in the period, its floats: 16 or the rest).
  template <typename F>
  void ForVectors(int64_t sample, int64_t index, const F& f) const {
    const int64_t first = index * piece, last = std::min(first + piece, size);
    int64_t phase = 0;
    for (int64_t i = first; i < last; i += kLanes) {
      f(sample * size + i, phase, std::min(kLanes, last - i));
      phase = phase + kLanes == period ? 0 : phase + kLanes;
    }
  }
};

Vec LoadSome(const float* p, int64_t n) {
  if (n == kLanes) return Load(p);
  Vec v = {};
  std::memcpy(&v, p, n * sizeof(float));
  return v;
}

void StoreSome(float* p, Vec v, int64_t n) {
  if (n == kLanes) {
    Store(p, v);
  } else {
    std::memcpy(p, &v, n * sizeof(float));
  }
}

// Two sums over each sample's places, by channel: `sums` is [B, 2, C], f(place, phase, floats, first,
// second) adds to vectors.
template <typename F>
void SumTwo(const Pieces& p, ffi::ThreadPool& pool, float* sums, const F& f) {
  Scratch<double> parts(p.samples * p.count * 2 * p.channels);
  ParallelFor(pool, p.samples * p.count, [&](int64_t item) {
    Scratch<float> first(p.period), second(p.period);
    p.ForVectors(item / p.count, item % p.count, [&](int64_t at, int64_t phase, int64_t n) {
      Vec a = Load(&first[phase]), b = Load(&second[phase]);
      f(at, phase, n, &a, &b);
      Store(&first[phase], a);
      Store(&second[phase], b);
    });
    double* part = &parts[item * 2 * p.channels];
    for (int64_t i = 0; i < p.period; ++i) {
      part[i % p.channels] += first[i];
      part[p.channels + i % p.channels] += second[i];
    }
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

// ------------------------------------------------------------------------------------------------
// What XLA calls.

Volume VolumeOf(const Array& x, const Array& w) {
  const auto d = x.dimensions(), k = w.dimensions();
  return {d[0], d[1], d[2], d[3], k[3], k[4]};
}

ffi::Error Deconv(ffi::ThreadPool pool, Array x, Array w, Result y, bool mixed) {
  const Volume s = VolumeOf(x, w);
#if CVN_TILES
  if (mixed && TilesAllowed()) {
    TileDeconvRows(s, x.typed_data(), w.typed_data(), pool, y->typed_data());
    return ffi::Error::Success();
  }
#endif
  DeconvRows(s, x.typed_data(), w.typed_data(), mixed, pool, y->typed_data());
  return ffi::Error::Success();
}

ffi::Error DeconvGradient(ffi::ThreadPool pool, Array x, Array w, Array dy, Result dx, Result dw,
                          bool mixed) {
  const Volume s = VolumeOf(x, w);
#if CVN_TILES
  if (mixed && TilesAllowed()) {
    TileDeconvGradients(s, x.typed_data(), w.typed_data(), dy.typed_data(), pool, dx->typed_data(),
                        dw->typed_data());
    return ffi::Error::Success();
  }
#endif
  DeconvGradients(s, x.typed_data(), w.typed_data(), dy.typed_data(), mixed, pool,
                  dx->typed_data(), dw->typed_data());
  return ffi::Error::Success();
}

ffi::Error Conv(ffi::ThreadPool pool, Array z, Array w, Result o, bool mixed) {
  ConvRows(VolumeOf(z, w), z.typed_data(), w.typed_data(), mixed, pool, o->typed_data());
  return ffi::Error::Success();
}

ffi::Error ConvGradient(ffi::ThreadPool pool, Array z, Array w, Array dout, Result dz, Result dw,
                        bool mixed) {
  ConvGradients(VolumeOf(z, w), z.typed_data(), w.typed_data(), dout.typed_data(), mixed, pool,
                dz->typed_data(), dw->typed_data());
  return ffi::Error::Success();
}

// Sums of x and of x squared.
ffi::Error Moments(ffi::ThreadPool pool, Array x, Result sums) {
  const float* in = x.typed_data();
  SumTwo(Pieces(x), pool, sums->typed_data(),
         [&](int64_t at, int64_t, int64_t n, Vec* first, Vec* second) {
           const Vec v = LoadSome(in + at, n);
           *first += v;
           *second += v * v;
         });
  return ffi::Error::Success();
}

ffi::Error Activated(ffi::ThreadPool pool, Array x, Array gain, Array offset, Result y,
                     int64_t activation) {
  const Pieces p(x);
  Scratch<float> g = p.Repeat(gain.typed_data()), o = p.Repeat(offset.typed_data());
  const float* in = x.typed_data();
  float* out = y->typed_data();
  WithActivation(activation, [&](auto kind) {
    ParallelFor(pool, p.samples * p.count, [&](int64_t item) {
      p.ForVectors(item / p.count, item % p.count, [&](int64_t at, int64_t phase, int64_t n) {
        Vec value, slope;
        Activate<kind>(LoadSome(in + at, n) * Load(&g[phase]) + Load(&o[phase]), &value, &slope);
        StoreSome(out + at, value, n);
      });
    });
  });
  return ffi::Error::Success();
}

// Sums of dz and of dz x, for dz = dy f'(gain x + offset).
ffi::Error GradientSums(ffi::ThreadPool pool, Array x, Array dy, Array gain, Array offset,
                        Result sums, int64_t activation) {
  const Pieces p(x);
  Scratch<float> g = p.Repeat(gain.typed_data()), o = p.Repeat(offset.typed_data());
  const float *in = x.typed_data(), *din = dy.typed_data();
  WithActivation(activation, [&](auto kind) {
    SumTwo(p, pool, sums->typed_data(),
           [&](int64_t at, int64_t phase, int64_t n, Vec* first, Vec* second) {
             const Vec v = LoadSome(in + at, n);
             Vec value, slope;
             Activate<kind>(v * Load(&g[phase]) + Load(&o[phase]), &value, &slope);
             const Vec dz = LoadSome(din + at, n) * slope;
             *first += dz;
             *second += dz * v;
           });
  });
  return ffi::Error::Success();
}

// dx = gain dz + slope x + constant.
ffi::Error InputGradient(ffi::ThreadPool pool, Array x, Array dy, Array gain, Array offset,
                         Array slope, Array constant, Result dx, int64_t activation) {
  const Pieces p(x);
  Scratch<float> g = p.Repeat(gain.typed_data()), o = p.Repeat(offset.typed_data());
  Scratch<float> s = p.Repeat(slope.typed_data()), c = p.Repeat(constant.typed_data());
  const float *in = x.typed_data(), *din = dy.typed_data();
  float* out = dx->typed_data();
  WithActivation(activation, [&](auto kind) {
    ParallelFor(pool, p.samples * p.count, [&](int64_t item) {
      p.ForVectors(item / p.count, item % p.count, [&](int64_t at, int64_t phase, int64_t n) {
        const Vec v = LoadSome(in + at, n), gained = Load(&g[phase]);
        Vec value, f;
        Activate<kind>(v * gained + Load(&o[phase]), &value, &f);
        StoreSome(out + at,
                  gained * (LoadSome(din + at, n) * f) + Load(&s[phase]) * v + Load(&c[phase]), n);
      });
    });
  });
  return ffi::Error::Success();
}

}  // namespace

XLA_FFI_DEFINE_HANDLER_SYMBOL(cvn_moments, Moments,
                              ffi::Ffi::Bind().Ctx<ffi::ThreadPool>().Arg<Array>().Ret<Array>());
XLA_FFI_DEFINE_HANDLER_SYMBOL(cvn_activated, Activated,
                              ffi::Ffi::Bind()
                                  .Ctx<ffi::ThreadPool>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Ret<Array>()
                                  .Attr<int64_t>("activation"));
XLA_FFI_DEFINE_HANDLER_SYMBOL(cvn_gradient_sums, GradientSums,
                              ffi::Ffi::Bind()
                                  .Ctx<ffi::ThreadPool>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Ret<Array>()
                                  .Attr<int64_t>("activation"));
XLA_FFI_DEFINE_HANDLER_SYMBOL(cvn_input_gradient, InputGradient,
                              ffi::Ffi::Bind()
                                  .Ctx<ffi::ThreadPool>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Ret<Array>()
                                  .Attr<int64_t>("activation"));
XLA_FFI_DEFINE_HANDLER_SYMBOL(cvn_deconv, Deconv,
                              ffi::Ffi::Bind()
                                  .Ctx<ffi::ThreadPool>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Ret<Array>()
                                  .Attr<bool>("mixed"));
XLA_FFI_DEFINE_HANDLER_SYMBOL(cvn_deconv_gradient, DeconvGradient,
                              ffi::Ffi::Bind()
                                  .Ctx<ffi::ThreadPool>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Ret<Array>()
                                  .Ret<Array>()
                                  .Attr<bool>("mixed"));
XLA_FFI_DEFINE_HANDLER_SYMBOL(cvn_conv, Conv,
                              ffi::Ffi::Bind()
                                  .Ctx<ffi::ThreadPool>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Ret<Array>()
                                  .Attr<bool>("mixed"));
XLA_FFI_DEFINE_HANDLER_SYMBOL(cvn_conv_gradient, ConvGradient,
                              ffi::Ffi::Bind()
                                  .Ctx<ffi::ThreadPool>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Arg<Array>()
                                  .Ret<Array>()
                                  .Ret<Array>()
                                  .Attr<bool>("mixed"));
