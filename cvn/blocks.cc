// Large blocks of memory are kept for the next request, in huge pages, instead of being given back
// to the system, which would clear them anew for every training step. Loaded before the program
// (LD_PRELOAD); what is smaller goes to the C library as before.

#include <errno.h>
#include <malloc.h>
#include <pthread.h>
#include <string.h>
#include <sys/mman.h>

#include <cstddef>
#include <cstdint>

extern "C" {
void* __libc_malloc(size_t size);
void* __libc_memalign(size_t alignment, size_t size);
void* __libc_realloc(void* p, size_t size);
void __libc_free(void* p);
}

namespace {

constexpr size_t kLarge = size_t{8} << 20;  // bytes from which on a block is kept
constexpr size_t kPage = size_t{2} << 20;   // a huge page
constexpr int kBlocks = 512;

struct Block {
  char* start;
  size_t size;
  bool used;
};

Block blocks[kBlocks];
int count = 0;
char *lowest = reinterpret_cast<char*>(UINTPTR_MAX), *highest = nullptr;
pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;

// The block that begins at p; null where it is the C library's. The mutex is held.
Block* Find(const void* p) {
  for (int i = 0; i < count; ++i) {
    if (blocks[i].start == p) return &blocks[i];
  }
  return nullptr;
}

bool MayBeOurs(const void* p) {
  return __atomic_load_n(&lowest, __ATOMIC_RELAXED) <= p &&
         p < __atomic_load_n(&highest, __ATOMIC_RELAXED);
}

void* Take(size_t size) {
  size = (size + kPage - 1) / kPage * kPage;
  pthread_mutex_lock(&mutex);
  Block* best = nullptr;
  for (int i = 0; i < count; ++i) {
    Block& b = blocks[i];
    // Not a much larger one: another request would have to do without.
    const bool fits = !b.used && b.size >= size && b.size <= size + size / 4;
    if (fits && (!best || b.size < best->size)) best = &b;
  }
  if (best == nullptr) {
    // What did not fit is given back, so that no more is held than was once needed at a time.
    for (int i = 0; i < count;) {
      if (blocks[i].used) {
        ++i;
      } else {
        munmap(blocks[i].start, blocks[i].size);
        blocks[i] = blocks[--count];
      }
    }
    if (count < kBlocks) {
      void* p = mmap(nullptr, size + kPage, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1,
                     0);
      if (p != MAP_FAILED) {
        char* start = reinterpret_cast<char*>((reinterpret_cast<uintptr_t>(p) + kPage - 1) / kPage *
                                              kPage);
        const size_t before = start - static_cast<char*>(p);
        if (before) munmap(p, before);
        if (kPage - before) munmap(start + size, kPage - before);
        madvise(start, size, MADV_HUGEPAGE);
        best = &blocks[count++];
        *best = {start, size, false};
        if (start < lowest) __atomic_store_n(&lowest, start, __ATOMIC_RELAXED);
        if (start + size > highest) __atomic_store_n(&highest, start + size, __ATOMIC_RELAXED);
      }
    }
  }
  if (best) best->used = true;
  void* p = best ? best->start : nullptr;
  pthread_mutex_unlock(&mutex);
  return p;
}

}  // namespace

extern "C" {

void* malloc(size_t size) {
  void* p = size >= kLarge ? Take(size) : nullptr;
  return p ? p : __libc_malloc(size);
}

int posix_memalign(void** out, size_t alignment, size_t size) {
  void* p = size >= kLarge && alignment <= kPage ? Take(size) : nullptr;
  if (p == nullptr) p = __libc_memalign(alignment, size);
  if (p == nullptr) return ENOMEM;
  *out = p;
  return 0;
}

void* aligned_alloc(size_t alignment, size_t size) {
  void* p = nullptr;
  return posix_memalign(&p, alignment, size) ? nullptr : p;
}

void free(void* p) {
  if (MayBeOurs(p)) {
    pthread_mutex_lock(&mutex);
    Block* block = Find(p);
    if (block) block->used = false;
    pthread_mutex_unlock(&mutex);
    if (block) return;
  }
  __libc_free(p);
}

void* realloc(void* p, size_t size) {
  if (MayBeOurs(p)) {
    pthread_mutex_lock(&mutex);
    const Block* block = Find(p);
    const size_t old = block ? block->size : 0;
    pthread_mutex_unlock(&mutex);
    if (old) {
      void* fresh = __libc_memalign(64, size);
      if (fresh) {
        memcpy(fresh, p, old < size ? old : size);
        free(p);
      }
      return fresh;
    }
  }
  return __libc_realloc(p, size);
}

}  // extern "C"
