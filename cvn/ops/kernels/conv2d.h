// The encoder's 2D convolution of stride 2 to half the size, and its gradients: along one axis,
// y[j] += x[2 j + t - low] w[t], where low is (size of the kernel - 2) / 2.
//
// Maps are [B, H, W, C] of float32 with even H and W, kernels [size, size, in, out]. A row of the
// kernel times a voxel's neighbours along W is one run of memory, [size * in].

#ifndef CVN_CONV2D_H_
#define CVN_CONV2D_H_

#include "products.h"

namespace cvn {

struct Map {
  int64_t b, h, w;  // of the input
  int64_t cin, cout, size;

  int64_t low() const { return (size - 2) / 2; }
};

constexpr int64_t kMapSlab = 8;  // rows of the output done in a row, which share their neighbours

// Copies rows first, first + 1, ... of a map to [rows][row_size], each behind `margin` voxels.
template <typename To>
void CopyRows(const float* map, int64_t h, int64_t w, int64_t c, int64_t first, int64_t count,
              int64_t margin, int64_t row_size, To* to) {
  for (int64_t i = 0; i < count; ++i) {
    To* row = to + i * row_size + margin * c;
    const bool there = first + i >= 0 && first + i < h;
    const float* from = map + (there ? first + i : 0) * w * c;
    for (int64_t n = 0; n < w * c; n += kLanes) {
      StoreSome(row + n, there ? LoadSome(from + n, w * c - n) : Vec{}, w * c - n);
    }
  }
}

template <typename Product>
void MapRows(const Map& s, const float* x, const float* w, ffi::ThreadPool& pool, float* out) {
  using Element = typename Product::Element;
  const int64_t run = s.size * s.cin, deep = RoundUp(run, Product::kDepth);
  const int64_t wide = RoundUp(s.cout, kLanes), high = RoundUp(s.w / 2, Product::kRows);
  Scratch<Element> weight(s.size * deep * wide);
  for (int64_t t = 0; t < s.size; ++t) {
    Product::Pack(w + t * run * s.cout, s.cout, 1, run, s.cout, weight.data() + t * deep * wide);
  }
  const int64_t slabs = (s.h / 2 + kMapSlab - 1) / kMapSlab;
  ParallelFor(pool, s.b * slabs, [&](int64_t item) {
    typename Product::Session session;
    const int64_t sample = item / slabs, first = item % slabs * kMapSlab;
    const int64_t count = std::min(kMapSlab, s.h / 2 - first), rows = 2 * count + s.size - 2;
    const int64_t row_size = RoundUp((2 * high + s.size) * s.cin + deep, 32);
    Scratch<Element> buffer(rows * row_size);
    Scratch<float> sum(high * wide);
    CopyRows(x + sample * s.h * s.w * s.cin, s.h, s.w, s.cin, 2 * first - s.low(), rows, s.low(),
             row_size, buffer.data());
    for (int64_t y = 0; y < count; ++y) {
      const Element *a[kMaxTaps], *b[kMaxTaps];
      for (int64_t t = 0; t < s.size; ++t) {
        a[t] = buffer.data() + (2 * y + t) * row_size;
        b[t] = weight.data() + t * deep * wide;
      }
      Product::Multiply(static_cast<int>(s.size), a, 2 * s.cin, b, high, deep, wide, sum.data(),
                        wide);
      Unpad(sum.data(), wide, s.w / 2, s.cout,
            out + (sample * s.h / 2 + first + y) * (s.w / 2) * s.cout);
    }
  });
}

// The gradient with respect to the input.
template <typename Product>
void MapInputGradient(const Map& s, const float* w, const float* dy, ffi::ThreadPool& pool,
                      float* dx) {
  using Element = typename Product::Element;
  const int64_t deep = RoundUp(s.cout, std::max(kLanes, Product::kDepth));
  const int64_t wide = RoundUp(s.cin, kLanes);
  const int64_t high = RoundUp(s.w / 2, Product::kRows), margin = s.size;
  Scratch<Element> weight(s.size * s.size * deep * wide);
  for (int64_t t = 0; t < s.size * s.size; ++t) {
    Product::Pack(w + t * s.cin * s.cout, 1, s.cout, s.cout, s.cin,
                  weight.data() + t * deep * wide);
  }
  const int64_t slabs = (s.h / 2 + kMapSlab - 1) / kMapSlab;
  ParallelFor(pool, s.b * slabs, [&](int64_t item) {
    typename Product::Session session;
    const int64_t sample = item / slabs, first = item % slabs * kMapSlab;
    const int64_t count = std::min(kMapSlab, s.h / 2 - first), rows = count + 2 * margin;
    const int64_t row_size = (high + 2 * margin) * deep;
    Scratch<Element> buffer(rows * row_size);
    Scratch<float> sum(2 * high * wide), scratch(s.w / 2 * s.cout);
    for (int64_t i = 0; i < rows; ++i) {
      const int64_t row = first - margin + i;
      if (row < 0 || row >= s.h / 2) continue;
      Pad(dy + (sample * s.h / 2 + row) * (s.w / 2) * s.cout, s.w / 2, s.cout, deep,
          buffer.data() + i * row_size + margin * deep);
    }
    for (int64_t y = 2 * first; y < 2 * (first + count); ++y) {
      for (int64_t px = 0; px < 2; ++px) {
        const Element *a[kMaxTaps], *b[kMaxTaps];
        int taps = 0;
        for (int64_t ty = (y + s.low()) % 2; ty < s.size; ty += 2) {
          for (int64_t tx = (px + s.low()) % 2; tx < s.size; tx += 2) {
            // The outputs that this tap gave to: these sums are even.
            const int64_t row = (y + s.low() - ty) / 2 - first + margin;
            const int64_t column = (px + s.low() - tx) / 2 + margin;
            a[taps] = buffer.data() + row * row_size + column * deep;
            b[taps++] = weight.data() + (ty * s.size + tx) * deep * wide;
          }
        }
        Product::Multiply(taps, a, deep, b, high, deep, wide, sum.data() + px * wide, 2 * wide);
      }
      Unpad(sum.data(), wide, s.w, s.cin, dx + (sample * s.h + y) * s.w * s.cin);
    }
  });
}

// Sums products of some rows of the input, moved by each tap, and of the output's gradient.
template <typename Product>
struct MapTerms;

template <>
struct MapTerms<Vectors> {
  const Map& s;
  const int64_t run = s.size * s.cin, deep = run, wide = RoundUp(s.cout, kLanes);
  const int64_t row_size = RoundUp((s.w + s.size) * s.cin + deep, kLanes);

  int64_t rows_size(int64_t rows) const { return rows * row_size; }
  int64_t gradient_size() const { return s.w / 2 * wide; }
  int64_t total_size() const { return s.size * deep * wide; }
  int64_t TotalAt(int64_t ty, int64_t tx, int64_t c) const {
    return (ty * deep + tx * s.cin + c) * wide;
  }

  void PutRows(const float* x, int64_t first, int64_t rows, float* to) const {
    CopyRows(x, s.h, s.w, s.cin, first, rows, s.low(), row_size, to);
  }
  void PutGradient(const float* dy, float* to) const { Pad(dy, s.w / 2, s.cout, wide, to); }
  void Add(int64_t count, const float* rows, const float* gradient, float* total) const {
    const float *a[kMaxTaps], *b[kMaxTaps];
    for (int64_t t = 0; t < s.size; ++t) {
      for (int64_t i = 0; i < count; ++i) {
        a[i] = rows + (2 * i + t) * row_size;
        b[i] = gradient + i * gradient_size();
      }
      AddOuter<Floats>(static_cast<int>(count), a, 2 * s.cin, b, wide, s.w / 2, deep, wide,
               total + t * deep * wide, wide);
    }
  }
};

#if CVN_PAIRS

// A row of the input is [words][size * in]: what two neighbours of the output read.
template <>
struct MapTerms<Pairs> {
  const Map& s;
  const int64_t run = s.size * s.cin, deep = RoundUp(run, kLanes), wide = RoundUp(s.cout, kLanes);
  const int64_t words = (s.w / 2 + 1) / 2;

  int64_t rows_size(int64_t rows) const { return 2 * rows * words * deep; }
  int64_t gradient_size() const { return 2 * words * wide; }
  int64_t total_size() const { return s.size * deep * wide; }
  int64_t TotalAt(int64_t ty, int64_t tx, int64_t c) const {
    return (ty * deep + tx * s.cin + c) * wide;
  }

  void PutRows(const float* x, int64_t first, int64_t rows, Bf16* to) const {
    Scratch<float> row((4 * words + s.size) * s.cin + deep);
    for (int64_t i = 0; i < rows; ++i) {
      CopyRows(x, s.h, s.w, s.cin, first + i, 1, s.low(), 0, row.data());
      for (int64_t j = 0; j < words; ++j, to += 2 * deep) {
        Pairs::Join(row.data() + 4 * j * s.cin, row.data() + (4 * j + 2) * s.cin, deep, to);
      }
    }
  }
  void PutGradient(const float* dy, Bf16* to) const {
    Scratch<float> row(2 * words * wide);
    Pad(dy, s.w / 2, s.cout, wide, row.data());
    for (int64_t j = 0; j < words; ++j) {
      Pairs::Join(row.data() + 2 * j * wide, row.data() + (2 * j + 1) * wide, wide,
                  to + 2 * j * wide);
    }
  }
  void Add(int64_t count, const Bf16* rows, const Bf16* gradient, float* total) const {
    const Bf16 *a[kMaxTaps], *b[kMaxTaps];
    for (int64_t t = 0; t < s.size; ++t) {
      for (int64_t i = 0; i < count; ++i) {
        a[i] = rows + rows_size(2 * i + t);
        b[i] = gradient + i * gradient_size();
      }
      Pairs::AddOuter(static_cast<int>(count), a, deep, b, wide, words, deep, wide,
                      total + t * deep * wide);
    }
  }
};

#endif  // CVN_PAIRS

#if CVN_TILES

// A row of the input is [2][in][w / 2]: even and odd voxels apart.
template <>
struct MapTerms<Tiles> {
  const Map& s;
  const int64_t deep = RoundUp(s.cin, kTileRows), wide = RoundUp(s.cout, kLanes);
  const int64_t long_w = RoundUp(s.w / 2, kTileDepth), line = long_w + RoundUp(s.size, 32);
  const int64_t row_size = 2 * deep * line;

  int64_t rows_size(int64_t rows) const { return rows * row_size; }
  int64_t gradient_size() const { return long_w * wide; }
  int64_t total_size() const { return s.size * s.size * deep * wide; }
  int64_t TotalAt(int64_t ty, int64_t tx, int64_t c) const {
    return ((ty * s.size + tx) * deep + c) * wide;
  }

  void PutRows(const float* x, int64_t first, int64_t rows, Bf16* to) const {
    const int64_t voxels = 2 * RoundUp((s.w + s.size) / 2 + 1, kTileRows);
    Scratch<float> row(voxels * s.cin + 2 * kLanes);
    for (int64_t i = 0; i < rows; ++i) {
      CopyRows(x, s.h, s.w, s.cin, first + i, 1, s.low(), 0, row.data());
      for (int64_t odd = 0; odd < 2; ++odd) {
        for (int64_t c = 0; c < deep; c += kLanes) {
          for (int64_t j = 0; j < voxels / 2; j += kTileRows) {
            Transpose16(row.data() + (2 * j + odd) * s.cin + c, 2 * s.cin,
                        to + i * row_size + (odd * deep + c) * line + j, line);
          }
        }
      }
    }
  }
  void PutGradient(const float* dy, Bf16* to) const {
    Scratch<float> row(RoundUp(s.w / 2, 2) * wide);
    Pad(dy, s.w / 2, s.cout, wide, row.data());
    for (int64_t j = 0; j < s.w / 2; j += 2) {
      InterleavePair(row.data() + j * wide, row.data() + (j + 1) * wide, wide,
                     long_w / kTileDepth * kTileSize, to + j / 2 * kTileDepth);
    }
  }
  void Add(int64_t count, const Bf16* rows, const Bf16* gradient, float* total) const {
    const Bf16 *a[kMaxTaps], *b[kMaxTaps];
    for (int64_t t = 0; t < s.size * s.size; ++t) {
      const int64_t ty = t / s.size, tx = t % s.size;
      for (int64_t i = 0; i < count; ++i) {
        a[i] = rows + (2 * i + ty) * row_size + tx % 2 * deep * line + tx / 2;
        b[i] = gradient + i * gradient_size();
      }
      TileMultiply<true>(static_cast<int>(count), a, line, b, deep, long_w, wide,
                         total + t * deep * wide, wide);
    }
  }
};

#endif  // CVN_TILES

// The gradient with respect to the kernel, one term a sample: `dw` is [B, size, size, in, out].
template <typename Product>
void MapKernelGradient(const Map& s, const float* x, const float* dy, ffi::ThreadPool& pool,
                       float* dw) {
  using Element = typename Product::Element;
  const MapTerms<Product> terms{s};
  ParallelFor(pool, s.b, [&](int64_t sample) {
    typename Product::Session session;
    Scratch<Element> rows(terms.rows_size(2 * kMapSlab + s.size));
    Scratch<Element> gradient(kMapSlab * terms.gradient_size());
    Scratch<float> total(terms.total_size());
    for (int64_t first = 0; first < s.h / 2; first += kMapSlab) {
      const int64_t count = std::min(kMapSlab, s.h / 2 - first);
      terms.PutRows(x + sample * s.h * s.w * s.cin, 2 * first - s.low(), 2 * count + s.size - 2,
                    rows.data());
      for (int64_t i = 0; i < count; ++i) {
        terms.PutGradient(dy + (sample * s.h / 2 + first + i) * (s.w / 2) * s.cout,
                          gradient.data() + i * terms.gradient_size());
      }
      terms.Add(count, rows.data(), gradient.data(), total.data());
    }
    for (int64_t t = 0; t < s.size * s.size; ++t) {
      for (int64_t c = 0; c < s.cin; ++c) {
        std::copy_n(total.data() + terms.TotalAt(t / s.size, t % s.size, c), s.cout,
                    dw + ((sample * s.size * s.size + t) * s.cin + c) * s.cout);
      }
    }
  });
}

}  // namespace cvn

#endif  // CVN_CONV2D_H_
