// The kernels of cvn/ops/native.py, for a CPU: what XLA calls.
//
// Volumes are [B, X, Y, Z, C] of float32 or bfloat16, kernels [3, 3, 3, in, out] of float32. Sums
// are made in float32 and longer ones in double. Where a volume is of bfloat16, all factors of a
// product are, and products are made on tile units (AMX) where the processor has them. What is
// summed over a batch comes as one term a sample, so that it does not depend on the number of
// threads.

#include "conv.h"
#include "conv2d.h"
#include "conv_gradient.h"
#include "deconv.h"
#include "deconv_gradient.h"

namespace {

using namespace cvn;  // NOLINT
using Array = ffi::Buffer<ffi::F32>;
using Result = ffi::ResultBuffer<ffi::F32>;
using AnyArray = ffi::AnyBuffer;  // of float32 or bfloat16
using AnyResult = ffi::Result<ffi::AnyBuffer>;

// Calls f with a pointer of the elements' type.
template <typename F>
ffi::Error WithType(const AnyArray& x, const F& f) {
  switch (x.element_type()) {
    case ffi::F32: f(static_cast<float*>(x.untyped_data())); break;
    case ffi::BF16: f(static_cast<Bf16*>(x.untyped_data())); break;
    default: return ffi::Error::InvalidArgument("volumes must be of float32 or bfloat16");
  }
  return ffi::Error::Success();
}

template <typename T>
T* Data(const AnyArray& x, T*) {
  return static_cast<T*>(x.untyped_data());
}

template <typename T>
using Plain = std::remove_pointer_t<T>;

Volume VolumeOf(const AnyArray& x, const Array& w) {
  const auto d = x.dimensions(), k = w.dimensions();
  return {d[0], d[1], d[2], d[3], k[3], k[4]};
}

ffi::Error Deconv(ffi::ThreadPool pool, AnyArray x, Array gain, Array offset, Array w, AnyResult y,
                  Result sums, int64_t activation) {
  const Volume s = VolumeOf(x, w);
  return WithType(x, [&](auto* in) {
    using In = Plain<decltype(in)>;
    const Source<In> source(in, gain.typed_data(), offset.typed_data(), activation, s.z, s.cin);
    WithType(*y, [&](auto* out) {
      WithProducts<In>([&](auto product) {
        DeconvRows<decltype(product)>(s, source, w.typed_data(), pool, out, sums->typed_data());
      });
    });
  });
}

ffi::Error DeconvGradient(ffi::ThreadPool pool, AnyArray x, Array gain, Array offset, Array w,
                          AnyArray y, AnyArray dy, Array dsums, AnyResult dx, Result sums,
                          Result dw, int64_t activation) {
  const Volume s = VolumeOf(x, w);
  return WithType(x, [&](auto* in) {
    using In = Plain<decltype(in)>;
    const Source<In> source(in, gain.typed_data(), offset.typed_data(), activation, s.z, s.cin);
    WithType(y, [&](auto* out) {
      const Cotangent<Plain<decltype(out)>> cotangent(out, Data(dy, out), dsums.typed_data(),
                                                      2 * s.z, s.cout);
      WithProducts<In>([&](auto product) {
        DeconvGradients<decltype(product)>(s, source, w.typed_data(), cotangent, pool,
                                           Data(*dx, in), sums->typed_data(), dw->typed_data());
      });
    });
  });
}

ffi::Error Conv(ffi::ThreadPool pool, AnyArray x, Array gain, Array offset, Array w, Result y,
                Result sums, int64_t activation) {
  const Volume s = VolumeOf(x, w);
  return WithType(x, [&](auto* in) {
    using In = Plain<decltype(in)>;
    const Source<In> source(in, gain.typed_data(), offset.typed_data(), activation, s.z, s.cin);
    WithConvProducts<In>([&](auto product) {
      ConvRows<decltype(product)>(s, source, w.typed_data(), pool, y->typed_data(),
                                  sums->typed_data());
    });
  });
}

ffi::Error ConvGradient(ffi::ThreadPool pool, AnyArray x, Array gain, Array offset, Array w,
                        Array y, Array dy, Array dsums, AnyResult dx, Result sums, Result dw,
                        int64_t activation) {
  const Volume s = VolumeOf(x, w);
  return WithType(x, [&](auto* in) {
    using In = Plain<decltype(in)>;
    const Source<In> source(in, gain.typed_data(), offset.typed_data(), activation, s.z, s.cin);
    const Cotangent<float> cotangent(y.typed_data(), dy.typed_data(), dsums.typed_data(), s.z,
                                     s.cout);
    WithConvProducts<In>([&](auto product) {
      ConvGradients<decltype(product)>(s, source, w.typed_data(), cotangent, pool, Data(*dx, in),
                                       sums->typed_data(), dw->typed_data());
    });
  });
}

// f(gain x + offset) of a volume that no kernel reads.
ffi::Error Activated(ffi::ThreadPool pool, AnyArray x, Array gain, Array offset, AnyResult y,
                     int64_t activation) {
  const auto d = x.dimensions();
  return WithType(x, [&](auto* in) {
    const Source<Plain<decltype(in)>> source(in, gain.typed_data(), offset.typed_data(), activation,
                                             d[3], d[4]);
    auto* out = Data(*y, in);
    ParallelFor(pool, d[0] * d[1], [&](int64_t plane) {
      Scratch<float> row(source.padded);
      for (int64_t i = plane * d[2]; i < (plane + 1) * d[2]; ++i) {
        source.Row(i, row.data());
        Unpad(row.data(), source.padded, 1, source.size, out + i * source.size);
      }
    });
  });
}

ffi::Error ActivatedGradient(ffi::ThreadPool pool, AnyArray x, Array gain, Array offset,
                             AnyArray dy, AnyResult dx, Result sums, int64_t activation) {
  const auto d = x.dimensions();
  return WithType(x, [&](auto* in) {
    const Source<Plain<decltype(in)>> source(in, gain.typed_data(), offset.typed_data(), activation,
                                             d[3], d[4]);
    ParallelFor(pool, d[0], [&](int64_t sample) {
      Scratch<float> row(source.padded), places(2 * source.padded);
      Sums moments(d[4]);
      for (int64_t plane = sample * d[1]; plane < (sample + 1) * d[1]; ++plane) {
        for (int64_t i = plane * d[2]; i < (plane + 1) * d[2]; ++i) {
          const auto* from = Data(dy, in) + i * source.size;
          for (int64_t n = 0; n < source.size; n += kLanes) {
            Store(row.data() + n, LoadSome(from + n, source.size - n));
          }
          source.Gradient(i, row.data(), places.data(), Data(*dx, in), nullptr);
        }
        moments.AddTwo(places.data(), source.size, source.padded);
      }
      moments.CopyTo(sums->typed_data() + sample * 2 * d[4]);
    });
  });
}

Map MapOf(const Array& x, const Array& y, int64_t size) {
  const auto d = x.dimensions();
  return {d[0], d[1], d[2], d[3], y.dimensions()[3], size};
}

// Calls f(Tiles or Vectors): tiles where factors are to be of bfloat16 and the processor has them.
// Without, they remain of float32.
template <typename F>
ffi::Error WithMapProducts(bool mixed, const F& f) {
  mixed ? WithProducts<Bf16>(f) : WithProducts<float>(f);
  return ffi::Error::Success();
}

ffi::Error Conv2D(ffi::ThreadPool pool, Array x, Array w, Result y, bool mixed) {
  return WithMapProducts(mixed, [&](auto product) {
    MapRows<decltype(product)>(MapOf(x, *y, w.dimensions()[0]), x.typed_data(), w.typed_data(),
                               pool, y->typed_data());
  });
}

ffi::Error Conv2DInputGradient(ffi::ThreadPool pool, Array dy, Array w, Result dx, bool mixed) {
  return WithMapProducts(mixed, [&](auto product) {
    MapInputGradient<decltype(product)>(MapOf(*dx, dy, w.dimensions()[0]), w.typed_data(),
                                        dy.typed_data(), pool, dx->typed_data());
  });
}

ffi::Error Conv2DKernelGradient(ffi::ThreadPool pool, Array x, Array dy, Result dw, bool mixed) {
  return WithMapProducts(mixed, [&](auto product) {
    MapKernelGradient<decltype(product)>(MapOf(x, dy, dw->dimensions()[1]), x.typed_data(),
                                         dy.typed_data(), pool, dw->typed_data());
  });
}

}  // namespace

// What the kernels were compiled for.
extern "C" const char* cvn_instruction_set() {
#define CVN_TEXT(x) #x
#define CVN_STRING(x) CVN_TEXT(x)
#if CVN_TILES
#define CVN_SET "AVX-512 with BF16 and AMX"
#elif CVN_PAIRS
#define CVN_SET "AVX-512 with BF16"
#elif defined(__AVX512VL__)
#define CVN_SET "AVX-512"
#elif defined(__AVX2__)
#define CVN_SET "AVX2"
#elif defined(__AVX__)
#define CVN_SET "AVX"
#elif defined(__aarch64__)
#define CVN_SET "NEON"
#elif defined(__SSE2__)
#define CVN_SET "SSE2"
#else
#define CVN_SET "no vectors"
#endif
  return CVN_SET ", " CVN_STRING(CVN_LANES) " lanes";
}

#define CVN_KERNEL(name, function) \
  XLA_FFI_DEFINE_HANDLER_SYMBOL(name, function, ffi::Ffi::Bind().Ctx<ffi::ThreadPool>()

CVN_KERNEL(cvn_deconv, Deconv)
    .Arg<AnyArray>().Arg<Array>().Arg<Array>().Arg<Array>()
    .Ret<AnyArray>().Ret<Array>().Attr<int64_t>("activation"));
CVN_KERNEL(cvn_deconv_gradient, DeconvGradient)
    .Arg<AnyArray>().Arg<Array>().Arg<Array>().Arg<Array>().Arg<AnyArray>().Arg<AnyArray>()
    .Arg<Array>().Ret<AnyArray>().Ret<Array>().Ret<Array>().Attr<int64_t>("activation"));
CVN_KERNEL(cvn_conv, Conv)
    .Arg<AnyArray>().Arg<Array>().Arg<Array>().Arg<Array>()
    .Ret<Array>().Ret<Array>().Attr<int64_t>("activation"));
CVN_KERNEL(cvn_conv_gradient, ConvGradient)
    .Arg<AnyArray>().Arg<Array>().Arg<Array>().Arg<Array>().Arg<Array>().Arg<Array>()
    .Arg<Array>().Ret<AnyArray>().Ret<Array>().Ret<Array>().Attr<int64_t>("activation"));
CVN_KERNEL(cvn_activated, Activated)
    .Arg<AnyArray>().Arg<Array>().Arg<Array>().Ret<AnyArray>().Attr<int64_t>("activation"));
CVN_KERNEL(cvn_activated_gradient, ActivatedGradient)
    .Arg<AnyArray>().Arg<Array>().Arg<Array>().Arg<AnyArray>()
    .Ret<AnyArray>().Ret<Array>().Attr<int64_t>("activation"));
CVN_KERNEL(cvn_conv2d, Conv2D)
    .Arg<Array>().Arg<Array>().Ret<Array>().Attr<bool>("mixed"));
CVN_KERNEL(cvn_conv2d_input_gradient, Conv2DInputGradient)
    .Arg<Array>().Arg<Array>().Ret<Array>().Attr<bool>("mixed"));
CVN_KERNEL(cvn_conv2d_kernel_gradient, Conv2DKernelGradient)
    .Arg<Array>().Arg<Array>().Ret<Array>().Attr<bool>("mixed"));
