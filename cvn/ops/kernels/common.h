// Scratch memory and threads.

#ifndef CVN_COMMON_H_
#define CVN_COMMON_H_

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <cstring>
#include <memory>
#include <mutex>
#include <utility>
#include <vector>

#include "simd.h"
#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;

namespace cvn {

constexpr int64_t kTaps = 27;

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

}  // namespace cvn

#endif  // CVN_COMMON_H_
